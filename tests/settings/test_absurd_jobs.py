"""Every key of a job and of a simulation with every wrong value: one sentence that names the key, never more."""

from pathlib import Path

import pytest
from fuzz.tables import LIST, NOT_A_NUMBER, NOT_A_WORD, NUMBER, PAIR, TEXT
from helpers import refused

from hpcred import Chord, Krylov, Modes, Rayleigh
from hpcred.parallel.failures import InputError
from hpcred.parallel.ranges import FREQUENCY, within
from hpcred.settings.declared_terms import viscoelastic_of
from hpcred.settings.job_file import read_job
from hpcred.settings.simulation_file import read_simulation

POINT = '[[basis]]\nkind = "krylov"\nfrequency = 10.0\n'
JOB = 'model = "model.h5"\nband = [0.0, 300.0]\n'
# what a job is without the key, the key, and values that it must not take
FACE = '[[interface]]\nname = "end"\nnodes = [7, 8]\n'
KEYS = [
    *((JOB + POINT, key, NOT_A_WORD) for key in ("output", "projection", "unreached", "out_of_core")),
    (POINT, "model", NOT_A_WORD),
    *((JOB + POINT, key, NUMBER) for key in ("tolerance", "deflation_tolerance", "drop_above", "groups")),
    *((JOB + POINT, key, NOT_A_NUMBER) for key in ("low_rank", "memory_mb")),
    *((JOB + POINT, key, ["1", "nan", '"true"', "[]"]) for key in ("write_basis", "lumped_integrals")),
    ('model = "m.h5"\n' + POINT, "band", NUMBER + PAIR),
    *((JOB + POINT, key, ["1", "nan", "[]", "{}", '""', "[[1]]", '[[1, "w"]]', "[0]", "[-1]", "[1.5]", "[4294967296]",
                          '[[0, "x"]]', "[[1, 2]]", '"\\u0000"', "1979-05-27"]) for key in ("inputs", "outputs")),
    (JOB + POINT, "body_origin", NUMBER + PAIR),
    *((JOB + "tolerance = 1e-3\n", f"adaptive.{key}", [*NUMBER, "-1"])
      for key in ("factorisations", "columns", "size", "seconds", "zeta0")),
    (JOB + "tolerance = 1e-3\n", "adaptive.points", LIST),
    (JOB + POINT + '[frame]\nkind = "tangent"\n', "frame.node",
     [*(value for value in NUMBER if value != TEXT), "0", "-1", "1.5"]),
    (JOB + POINT + '[frame]\nkind = "chord"\n', "frame.nodes", [*NUMBER, *PAIR[:-1], "[0, 1, 2]", "[1, 2]"]),
    (JOB + POINT + '[frame]\nkind = "chord"\nnodes = [1, 2, 3]\n', "frame.axes", [*NOT_A_WORD, '"xxy"', '"xy"']),
    (JOB + POINT + '[frame]\nkind = "buckens"\n', "frame.supports", ["1", "nan", '[[1, "w"]]', '[[0, "x"]]', "[[1]]"]),
    *((JOB + POINT + '[damping]\nkind = "rayleigh"\n', f"damping.{key}", [*NUMBER, "-1.0"])
      for key in ("alpha", "beta")),
    (JOB + POINT + '[damping]\nkind = "structural"\n', "damping.loss_factor", [*NUMBER, "-1.0"]),
    (JOB + POINT + '[damping]\nkind = "caughey"\n', "damping.coefficients", [*LIST, "[]"]),
    *((JOB + POINT + '[damping]\nkind = "modal"\n', f"damping.{key}", values) for key, values in (
        ("ratio", [*NUMBER, "-0.1"]), ("ratios", [*LIST, "[]", "[-0.1]"]),
        ("table", [*LIST, "[]", "[[1.0]]", "[[1.0, nan]]", "[[-1.0, 0.1]]", "[[2.0, 0.1], [1.0, 0.1]]"]))),
    *((JOB + '[[basis]]\nkind = "modes"\n', f"basis.0.{key}", values) for key, values in (
        ("count", [*NUMBER, "0", "-1"]), ("band", NUMBER + PAIR), ("index", [*LIST, "[]", "[0]"]))),
    (JOB + '[[basis]]\nkind = "modes"\ncount = 3\n', "basis.0.dominant", [*NUMBER, "0"]),
    *((JOB + f'[[basis]]\nkind = "{kind}"\n', f"basis.0.{key}", [*NUMBER, "-1.0"])
      for kind in ("krylov", "second_order_krylov") for key in ("frequency", "decay")),
    *((JOB + f'[[basis]]\nkind = "{kind}"\nfrequency = 1.0\n', "basis.0.order", [*NUMBER, "-1", "1.5"])
      for kind in ("krylov", "second_order_krylov")),
    (JOB + '[[basis]]\nkind = "second_order_krylov"\n', "basis.0.s", NUMBER + PAIR),
    *((POINT + '[model]\nK = "K.mtx"\nM = "M.mtx"\n', f"model.{key}", NOT_A_WORD)
      for key in ("K", "M", "D", "B", "C", "nodes", "dofs")),
    *((JOB + POINT + FACE, f"interface.0.{key}", values) for key, values in (
        ("name", [*NOT_A_WORD, '"a:x"', '"7"', '"a b"']), ("at", NUMBER + PAIR), ("node", [*NUMBER, "0", "-1", "1.5"]),
        ("nodes", ["1", "nan", '"\\u0000"', '""', "[]", "{}", "[0]", "[-1]", "[1, 1]", "[1.5]", "[[1]]",
                   "{box = [1]}", "{set = 1}", "{box = [[0.0, 0.0, nan], [1.0, 1.0, 1.0]]}",
                   "{sphere = [[0.0, 0.0, 0.0], -1.0]}", "{sphere = [[0.0, 0.0, 0.0], inf]}",
                   '{set = "A", sphere = [[0.0, 0.0, 0.0], 1.0]}',
                   "{cylinder = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 1.0]}"]),
        ("kind", NOT_A_WORD), ("weights", ["1", "nan", "[1.0]", "[1.0, -1.0]", "[1.0, inf]", '"heavy"']),
        ("directions", ["[]", '["w"]', '["x", "x"]', "1", '"x"']),
    )),
    (JOB + POINT, "coordinates", [*NOT_A_WORD, '"physical"']),
    *((JOB + '[[basis]]\nkind = "craig_bampton"\n', f"basis.0.{key}", [*NUMBER, *more, "-1"])
      for key, more in (("count", ["0", "1.5"]), ("band", PAIR))),
    *((JOB, key, ["1", '"text"', "nan", "[1]", "[[]]", '{kind = "none such"}', '{a = 1}'])
      for key in ("frame", "damping", "basis", "adaptive")),
]  # fmt: skip
FORCES = {
    "sine": ["amplitude = [0.0, 0.0, 1.0]", "frequency = 1.0"], "constant": ["value = [0.0, 0.0, 1.0]"],
    "table": ["times = [0.0, 1.0]", "values = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]"],
}  # fmt: skip
BODY = 'body = "result.h5"\nend = 1.0\n'


def simulation(kind):
    lines = "\n".join(FORCES[kind])
    return f'{BODY}[[constraint]]\nnode = 1\n[[force]]\nkind = "{kind}"\nnode = 1\n{lines}\n'


MOTIONS = [
    *((simulation("sine"), key, NOT_A_WORD) for key in ("body", "output", "start")),
    *((simulation("sine"), key, [*NUMBER, "0.0", "-1.0"])
      for key in ("end", "steps", "relative_tolerance", "absolute_tolerance", "force.0.frequency")),
    *((simulation("sine"), key, NUMBER + PAIR) for key in ("gravity", "position", "rotation", "velocity",
                                                           "angular_velocity", "constraint.0.at", "force.0.amplitude")),
    (simulation("sine"), "force.0.phase", NUMBER), (simulation("constant"), "force.0.value", NUMBER + PAIR),
    (simulation("table"), "force.0.times", LIST), (simulation("table"), "force.0.values", LIST),
    *((simulation("sine"), key, [*(value for value in NUMBER if '"' not in value), "0", "-1"])  # a text is a name
      for key in ("force.0.node", "constraint.0.node")),
    *((simulation("sine"), key, LIST) for key in ("elastic", "elastic_velocity")),
    (simulation("sine"), "observe", [*LIST, "[0]", "[-1]"]),
    (simulation("sine"), "constraint.0.directions", ["[]", '["w"]', '["x", "x"]', "1", "nan", '"x"', "{}"]),
]  # fmt: skip


def refusal(reader, path, text, override=()):
    """The sentence with which a file is refused."""
    Path(path).write_text(text)
    with pytest.raises(InputError) as caught:
        job = reader(path, override)
        assert job.factoring is None, f"{override} was taken"  # the folder and the limits of a job are looked at there
    sentence = str(caught.value)
    assert len(sentence) < 600 and "\n" not in sentence, sentence
    return sentence


@pytest.mark.parametrize(
    "reader, text, key, values",
    [(reader, *case) for reader, cases in ((read_job, KEYS), (read_simulation, MOTIONS)) for case in cases],
)
def test_wrong_values_are_refused_with_the_key(tmp_path, reader, text, key, values):
    for value in values:
        if key.endswith((".K", ".M")):
            text = text.replace(f'{key[-1]} = "{key[-1]}.mtx"\n', "")
        sentence = refusal(reader, tmp_path / "file.toml", text, [f"{key}={value}"])
        word = key.replace(".0", "").split(".")[-1]
        named = {"kind", word, key.split(".")[0]}
        assert any(name in sentence for name in named), (value, sentence)


@pytest.mark.parametrize(
    "text",
    [
        "x = " + 5000 * "[" + 5000 * "]", "x = " + 2000 * "{a=" + "1" + 2000 * "}", ".".join(3000 * "a") + " = 1\n",
        "[" + ".".join(500 * "a") + "]\nb = 1\n", JOB + POINT + "x = " + 300 * "[" + 300 * "]",
        'model = "a\x00b"\n', "\x01\x02", 'model = "\\ud800"\n', 5000 * "k" + " = 1\n", "", "[[[", "basis = 1",
    ],
)  # fmt: skip
def test_what_is_no_file_of_a_job_is_refused(tmp_path, text):
    for reader in (read_job, read_simulation):
        refusal(reader, tmp_path / "file.toml", text)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Modes(band=(0.0, float("inf"))), lambda: Modes(band=(float("nan"), 1.0)), lambda: Modes(count=2**40),
        lambda: Krylov(float("inf")), lambda: Krylov(1e300), lambda: Rayleigh(float("nan"), 0.0),
        lambda: Rayleigh(0.0, 1e300), lambda: Chord(nodes=(0, 1, 2)), lambda: within("f", float("nan"), FREQUENCY),
    ],
)  # fmt: skip
def test_python_has_the_same_ranges(make):
    with pytest.raises(InputError):
        make()


def test_ends_of_a_range_are_inside():
    within("f", [0.0, 1e12, (5, None)], FREQUENCY)
    with pytest.raises(InputError, match=r"f: found 1e\+13, expected 0 to 1e\+12 Hz"):
        within("f", [0.0, 1e13], FREQUENCY)
    within("f", 3e-308, FREQUENCY)
    with pytest.raises(InputError, match="f: found 1e-310, which is too small to have all its digits; expected 0 or"):
        within("f", [0.0, 1e-310], FREQUENCY)


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["response", "model.h5", "--band", "0,inf"], "--band"),
        (["response", "model.h5", "--band", "0,1e300"], "--band"),
        (["response", "model.h5", "--band", "nan,1"], "--band"),
        (["response", "model.h5", "--frequencies", "1,nan"], "--frequencies"),
        (["response", "model.h5", "--band", "0,9", "--tolerance", "nan"], "tolerance"),
        (["response", "model.h5", "--band", "0,9", "--points", "1000000000000"], "points"),
        (["response", "model.h5", "--band", "0,9", "--check", "-1"], "check: found -1"),
        (["response", "model.h5", "--band", "1,9", "--check", "1", "--seed", "-1"], "seed: found -1"),
        (["response", "model.h5", "--band", "0,9", "--damping", "rayleigh:1,inf"], "--damping"),
        (["response", "model.h5", "--band", "0,9", "--inputs", "0"], "dof 0"),
        (["info", "model.h5", "--below", "inf"], "--below"),
        (["info", "model.h5", "--band-top", "nan"], "--band-top"),
        (["info", "model.h5", "--modes", "-1"], "--modes"),
        (["modes", "model.h5", "--count", "1000000"], "1000000 modes asked for"),
        (["example", "solid", "--cells", "100000", "100000", "100000", "-o", "x.h5"], "cells"),
        (["example", "solid", "--cells", "1", "1", "1", "--size", "nan", "1", "1", "-o", "x.h5"], "size"),
        (["reduce", "job.toml", "--set", 'interface=[{name = "end", nodes = "none.txt"}]'], "no such file"),
        (["info", "a\0b"], "no such file"),
        (["info", 300 * "n"], "no such file"),
    ],
)
def test_numbers_of_a_command_line(linkage_folder, capsys, arguments, says):
    assert says in refused(capsys, *arguments)


@pytest.mark.parametrize("value", [5000 * "9", "0x" + 5000 * "f", 9000 * "["], ids=["long", "long in base 16", "deep"])
def test_what_python_gives_up_on_is_refused(tmp_path, value):
    """Whole numbers of thousands of digits, and lists inside each other: in a file, and in options."""
    refusal(read_job, tmp_path / "job.toml", f"groups = {value}\n{JOB}{POINT}")
    refusal(read_job, tmp_path / "job.toml", JOB + POINT, [f"groups={value}"])
    with pytest.raises(InputError):
        viscoelastic_of((f"{{file = {value}}}",), "--viscoelastic")
