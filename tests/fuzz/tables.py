"""Good job, simulation and sweep files with one key replaced by every kind of value: cases of the commands leave.

Keys and what they take come from the dataclasses; every dataclass stands in one of the good files.
"""

import functools
import json
import sys
import tempfile
import types
import typing
from dataclasses import fields, is_dataclass
from pathlib import Path

import h5py
import numpy as np
import scipy.io
import scipy.sparse
from helpers import MODES_JOB

from .judge import Case, inside, run_good

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TEXT = '"text"'  # where a node may be an interface by name it is no wrong value
NOT_A_NUMBER = ["nan", "inf", "-inf", TEXT, "true", "[]", "{}", "[nan]", "[[]]", "1979-05-27", "[{}]",
                '{a.b = "c"}']  # fmt: skip
ABSURD = ["1e300", "-1e300", "1e31", 400 * "1", "99999999999999999999"]
PAIR = ["[nan, 1.0]", "[0.0, inf]", "[inf, inf]", "[1e300, 1e301]", "[1.0]", "[1.0, 2.0, 3.0, 4.0]", '["a", "b"]']
NOT_A_WORD = ["1", "nan", "true", "[]", "[[1, 2]]", "{}", '{a.b = "c"}', "1979-05-27", '"\\u0000"', '""', '" "',
              '"' + 5000 * "x" + '"', '"a\\u0001b"']  # fmt: skip
NUMBER, LIST = NOT_A_NUMBER + ABSURD, ["nan", "1", '"text"', "{}", "[[]]", "[true]", *PAIR[:4], "[1e300]"]
OTHERS = ["0", "-1", "1.5", "0.0", "-0.0", "1e-300", "5e-324", "2", "3.0", "1e9", "2147483648", "-9999999999999999999",
          '"x"', '"no/x.h5"', '"é\\u202e"', '"\\u001b[31m"', '"%s{0}$HOME"', '"1"', '"nan"', "[1]", "[0]", "[-1]",
          "[1.0, 1.0]", "[1.0, 0.0]", "[0.0, 1.0]", "[1, 1]", "[1.0, 2.0, 3.0]", "[0.0, 0.0, 0.0]", "[1e300, 0.0, 0.0]",
          '["x"]', '["x", "x"]', '[[1, "x"]]', '[[1, "w"]]', "[[1.0, 2.0]]", "[[[1.0]]]", "[nan, nan, nan]", "12:00:00",
          "false", "0x10", "1_000", '{kind = "none"}', '{kind = "no such"}', "{kind = 1}", '{"a b" = 1}', "[[1], []]",
          "[{kind = 1}]", 50 * "[" + 50 * "]", '"' + 300 * "y" + '"', "[" + 3000 * "1, " + "1]"]  # fmt: skip
VALUES = list(dict.fromkeys([*NUMBER, *PAIR, *NOT_A_WORD, *LIST, *OTHERS]))

CHORD = 'frame = {kind = "chord", nodes = [1, 7, 14], axes = "yxz"}\n'
JOB = 'model = "model.h5"\nband = [0.0, 300.0]\ninputs = [[20, "z"]]\n'
MODES = '[[basis]]\nkind = "modes"\ncount = 3\n'
END = "on = {box = [[0.039, -1.0, -1.0], [0.041, 1.0, 1.0]]}\n"
BLOCK = 'model = "block.h5"\n[[interface]]\nname = "end"\nnodes = {box = [[0.039, -1.0, -1.0], [0.041, 1.0, 1.0]]}\n'
JOBS = [
    JOB + CHORD + MODES,
    JOB + 'frame = {kind = "tangent", node = 1}\ndamping = {kind = "none"}\n[[basis]]\nkind = "static_correction"\n',
    JOB + 'damping = {kind = "rayleigh", alpha = 2.0, beta = 1e-5}\n[frame]\nkind = "buckens"\n'
          '[[basis]]\nkind = "krylov"\nfrequency = 100.0\norder = 1\n',
    JOB + CHORD + '[damping]\nkind = "modal"\nratio = 0.01\n' + MODES,
    JOB + CHORD + '[damping]\nkind = "caughey"\ncoefficients = [1.0, 1e-5]\n' + MODES,
    JOB + CHORD + '[damping]\nkind = "structural"\nloss_factor = 0.02\n' + MODES,
    'inputs = [1]\nmodel = {K = "K.mtx", M = "M.mtx", D = "K.mtx"}\nframe = {kind = "none"}\n'
    'damping = {kind = "given"}\n' + MODES,
    JOB + CHORD + 'tolerance = 1e-2\n[adaptive]\nfactorisations = 6\n',
    JOB + CHORD + '[solver]\nunfit = "multigrid"\nprecision = "double"\nthreshold = 0.01\n'
          '[[basis]]\nkind = "krylov"\nfrequency = 0.0\n',
    JOB + CHORD + '[[basis]]\nkind = "second_order_krylov"\nfrequency = 100.0\n',
    *(BLOCK + f'[[basis]]\nkind = "{kind}"\n{count}' for kind, count in (
        ("craig_bampton", "count = 3\n"), ("guyan", ""), ("constraint_modes", ""),
        ("residual_attachment", ""))),
    BLOCK + '[[basis]]\nkind = "constraint_modes"\n[[basis]]\nkind = "fixed_interface_modes"\ncount = 3\n',
    'inputs = [1]\nmodel = {K = "K.mtx", M = "M.mtx", nodes = "nodes.txt"}\n' + MODES,
    'model = "block.h5"\ninputs = [[13, "x"]]\noutputs = [[13, "x"], {node = 13, stress = "xx"}, '
    '{node = 13, direction = "y", quantity = "velocity"}]\nstress = [13]\n'
    + MODES,
    *('model = "block.h5"\n' + MODES + f'[[load]]\nname = "a"\nkind = "{kind}"\n' + more for kind, more in (
        ("pressure", END), ("traction", END + "value = [1.0, 0.0, 0.0]\n"), ("gravity", "value = [0.0, 0.0, -9.81]\n"),
        ("line", "on = [13, 14]\nvalue = [1.0, 0.0, 0.0]\n"), ("temperature", "value = 10.0\n"),
        ("moving", "on = [1, 5, 9, 13]\nvalue = [0.0, 1.0, 0.0]\npoints = 3\n"),
        ("centrifugal", 'axis = "z"\n'), ("given", 'file = "wind.mtx"\n'), ("deck", 'file = "loads.inp"\nstep = 1\n'))),
    'model = "block.h5"\ninputs = [[13, "x"]]\n' + MODES + '[[geometric_stiffness]]\nstate = "wz^2"\nvalue = 1e4\n'
    'file = "loaded.h5"\n',
    *(JOB + CHORD + MODES + f'[[viscoelastic]]\nfile = "Kv.mtx"\nlaw = {{kind = "{law}}}\n' for law in (
        'maxwell", factors = [0.5], times = [1e-3], constant = 1.0',
        'fractional", low = 1.0, high = 2.0, time = 1e-3, exponent = 0.5',
        'fractional_kelvin_voigt", low = 1.0, rise = 1.0, time = 1e-3, exponent = 0.5',
        'hysteretic", frequencies = [0.0, 1.0], loss_factors = [0.1, 0.2]',
        'table", frequencies = [0.0, 1.0], real = [1.0, 2.0], imaginary = [0.0, 0.1]')),
    'model = {K = "K.mtx", M = "M.mtx"}\ninputs = [1]\nband = [0.0, 0.3]\ntolerance = 1e-2\n'
    '[[parameter]]\nname = "e"\nrange = [0.0, 1.0]\n[[term]]\nof = "K"\nfile = "K.mtx"\nfactor = "e"\n'
    '[parameter_search]\npoints = 3\n',
    'model = "block.h5"\ninputs = [[13, "x"]]\noutputs = [{cut = "half"}]\n' + MODES,
    'model = "block.h5"\n' + MODES + '[[base]]\n' + END + 'directions = ["z"]\nabsolute = [[5, "z"]]\n',
]  # fmt: skip
MOTION = 'body = "result.h5"\nend = 0.01\nsteps = 4\n'
HOLD = '[[constraint]]\nnode = 1\n[[constraint]]\nnode = 7\ndirections = ["x", "z"]\n[[constraint]]\nnode = 14\n' \
       'directions = ["z"]\n'  # fmt: skip
CURVES = {"constant": "value = {0}\n", "sine": "amplitude = {0}\nfrequency = 5.0\n",
          "table": "times = [0.0, 0.01]\nvalues = [{0}, {0}]\n", "ramp": "rate = {0}\n"}  # fmt: skip
MOTIONS = [
    MOTION + HOLD,
    *(MOTION + HOLD + f'[[{key}]]\nnode = 20\nkind = "{kind}"\n' + CURVES[kind].format("[0.0, 0.0, 1.0]")
      for key in ("force", "moment") for kind in ("constant", "sine", "table")),
    *(MOTION + f'[[drive]]\nnode = 1\nkind = "{kind}"\nalong = [1.0, 0.0, 0.0]\n' + CURVES[kind].format("0.0")
      for kind in CURVES),
    *(MOTION + f'[[load]]\nname = "20:z"\nkind = "{kind}"\n' + CURVES[kind].format("1.0")
      for kind in ("constant", "sine", "table")),
    MOTION + '[[spring]]\nnode = 20\nkind = "line"\nat = [0.0, 0.0, 9.0]\nstiffness = 10.0\n',
    MOTION + '[[spring]]\nnode = 20\nkind = "bushing"\nstiffness = [1.0, 1.0, 1.0]\n',
]
SWEEPS = [
    'job = "job.toml"\n[[vary]]\nkey = "basis.0.index"\nvalues = [[7], [7, 8]]\n',
    'job = "job.toml"\nevaluate = {points = 3, band = [0.0, 9.0]}\nlaunch = {ranks = 1}\n[[vary]]\n'
    'key = "deflation_tolerance"\nrange = [1e-9, 1e-8, 2]\n',
    'job = "job.toml"\n[[run]]\nname = "one"\n"damping.alpha" = 1.0\n',
]  # fmt: skip


@functools.cache
def good_files() -> dict[str, bytes]:
    """Models, matrices, a job and its result, made once."""
    import hpcred

    with tempfile.TemporaryDirectory() as name, inside(name):
        with hpcred.linkage() as model:
            hpcred.write_model("model.h5", model)
            scipy.io.mmwrite("Kv.mtx", scipy.sparse.eye(model.size, format="coo"))
        steel = hpcred.fe.Material(name="steel", young=2.1e11, poisson=0.3, density=7850.0, expansion=1.2e-5)
        with hpcred.solid((4, 1, 1)) as model:
            half = np.unique(model.dofs.node[model.dofs.position[:, 0] > 0.025])
            hpcred.write_model("block.h5", model.with_material(steel).with_fields(sets={"half": half}))
            model.K.scale(1.001)
            hpcred.write_model("loaded.h5", model)
            scipy.io.mmwrite("wind.mtx", scipy.sparse.coo_matrix(np.ones((model.size, 1))))
        Path("loads.inp").write_text("*NODE\n16, 0.04, 0.01, 0.01\n*STEP\n*STATIC\n*CLOAD\n16, 2, 1.0\n*END STEP\n")
        chain = np.diag([2.0, 2, 2, 2, 2, 1]) - np.eye(6, k=1) - np.eye(6, k=-1)
        for key, matrix in (("K", chain), ("M", np.eye(6))):
            scipy.io.mmwrite(f"{key}.mtx", scipy.sparse.coo_matrix(matrix))
        Path("nodes.txt").write_text("1 0 0 0\n2 1 0 0\n")
        Path("job.toml").write_text(MODES_JOB)
        run_good(["reduce", "job.toml"])
        return {path.name: path.read_bytes() for path in Path().iterdir()}


def fits(value, kind) -> bool:
    """Whether a value of TOML is of a type, numbers finite."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if kind is typing.Any:
        return True
    if origin is typing.Annotated:
        return fits(value, parts[0])
    if origin is typing.Literal:
        return isinstance(value, str) and value in parts
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, part) for part in parts)
    if origin is tuple:
        if not isinstance(value, list) or (... not in parts and len(value) != len(parts)):
            return False
        return all(fits(item, parts[0] if ... in parts else parts[k]) for k, item in enumerate(value))
    if origin is dict:
        return isinstance(value, dict) and all(fits(item, parts[1]) for item in value.values())
    if is_dataclass(kind):
        known = typing.get_type_hints(kind, include_extras=True)
        return isinstance(value, dict) and all(key in known and fits(item, known[key]) for key, item in value.items())
    if kind is float:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return number and abs(value) < 10**308  # neither inf nor nan
    return kind is not type(None) and type(value) is kind


def dataclasses_of(kind) -> set:
    """All dataclasses in a type, and in the types of their fields."""
    found, todo = set(), [kind]
    while todo:
        kind = todo.pop()
        todo += typing.get_args(kind)
        if isinstance(kind, type) and is_dataclass(kind) and kind not in found:
            found.add(kind)
            todo += typing.get_type_hints(kind, include_extras=True).values()
    return found


def keys_of(kind, table, path=()):
    """(path, type, dataclass) of each key that a good table has or may have, tables inside of it included."""
    hints = typing.get_type_hints(kind, include_extras=True)
    for item in fields(kind):
        yield (*path, item.name), hints[item.name], kind
        value = table.get(item.name)
        for step, inner in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(inner, dict) and (meant := _meant(hints[item.name], inner)):
                yield from keys_of(meant, inner, (*path, item.name, *([] if step is None else [step])))


def _meant(kind, table):
    """The dataclass of a type that a table is meant for, or None."""
    tables = [item for item in _parts(kind) if is_dataclass(item)]
    named = [item for item in tables if any(field.name == "kind" and field.default == table.get("kind", field.default)
                                            for field in fields(item))]  # fmt: skip
    fitting = [item for item in tables if set(table) <= {field.name for field in fields(item)}]
    return next(iter(named or fitting or tables), None)


def _parts(kind):
    """The types that a table of this type, or of a list of it, may be of."""
    if is_dataclass(kind) or typing.get_origin(kind) is None:
        return [kind]
    return [part for item in typing.get_args(kind) for part in _parts(item)]


def toml(value) -> str:
    """A value as TOML in one line; a Raw text as it is."""
    if isinstance(value, Raw):
        return str(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value) if isinstance(value, (str, bool)) else repr(value)


@functools.cache
def parsed(text):
    return tomllib.loads(f"x = {text}")["x"]


def chosen(rng, options):
    return options[int(rng.integers(len(options)))] if options else VALUES[0]


class Raw(str):
    """TOML to put in as it is."""


def put(table, path, value):
    for step in path[:-1]:
        table = table[step]
    table[path[-1]] = value


def of(told, found):
    """What was found, without the keys of its tables that were not told."""
    if isinstance(told, dict) and isinstance(found, dict):
        return {key: of(told[key], found.get(key)) for key in told}
    if isinstance(told, list) and isinstance(found, list) and len(told) == len(found):
        return [of(one, other) for one, other in zip(told, found, strict=True)]
    return found


def plain(value):
    """Numbers as floats, for comparison."""
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items() if item is not None}
    whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) < 10**308
    return float(value) if whole else value


def case(rng, root, goods, name, command, echo) -> Case:
    """A good file with one key replaced, added, or left out. `echo(folder)`: the settings that the run wrote down."""
    base = goods[int(rng.integers(len(goods)))]
    table = tomllib.loads(base)
    keys = list(keys_of(root, table))
    path, kind, owner = keys[int(rng.integers(len(keys)))]
    value = Raw(chosen(rng, [text for text in VALUES if fits(parsed(text), kind)] if rng.random() < 0.4 else VALUES))
    chance = rng.random()
    if chance < 0.03:
        files = {key: item for key, item in good_files().items() if (command[0], key) != ("reduce", "result.h5")}
        return Case(f"good: {base!r}", {**files, name: base.encode()}, command, {}, lambda folder: {}, good=True)
    if chance < 0.05:
        path, kind = (*path[:-1], "no_such_key"), type(None)
    if path[-1] == "end" and fits(parsed(value), float) and parsed(value) > 0.1:
        value = Raw("nan")  # a long simulation is no error
    put(table, path, value)
    text = "".join(f"{json.dumps(key)} = {toml(item)}\n" for key, item in table.items())
    shown = ".".join(map(str, path)) + f" = {value if len(value) < 60 else value[:60] + '...'} ({owner.__name__})"
    is_name = path[-1] in NAMES

    def read(folder):
        settings, finite = echo(folder)
        for step in path if told is not None else ():
            settings = settings[step]
        return outcome(None if told is None else of(told, settings), finite)

    told = None if is_name or echo is no_echo else parsed(value)
    expected = outcome(told, True) if fits(parsed(value), kind) else None
    files = {**good_files(), name: text.encode()}
    if command[0] == "reduce":
        del files["result.h5"]  # which would be replaced
    return Case(shown, files, command, expected, read)


def outcome(settings, finite):
    return {"settings": np.array(json.dumps(plain(settings))), "finite": np.array(finite)}


# names of files, and what a run fills in by itself
NAMES = ("output", "model", "inputs", "outputs", "out_of_core", "store", "K", "M", "D", "B", "C", "nodes", "dofs",
         "body", "job", "kind", "interface", "at", "file")  # fmt: skip


def of_result(folder):
    """The job in the record of the newest result, and whether all numbers are finite."""
    path = newest(folder, "hpcred-result")
    with h5py.File(path) as file:
        return json.loads(file["record"][()])["job"], all_finite(file)


def of_motion(folder):
    with h5py.File(newest(folder, "hpcred-simulation")) as file:
        return json.loads(file["provenance"][()])["setup"], all_finite(file)


def no_echo(folder):
    return None, True


def newest(folder, kind):
    found = []
    for path in Path(folder).rglob("*"):
        if path.is_file() and path.read_bytes()[:4] == b"\x89HDF":
            with h5py.File(path) as file:
                if file.attrs.get("format") == kind:
                    found.append((path.stat().st_mtime_ns, path))
    return max(found)[1]


def all_finite(file) -> bool:
    wrong = []
    file.visititems(lambda name, item: wrong.append(name) if isinstance(item, h5py.Dataset) and item.dtype.kind == "f"
                    and not np.isfinite(item[...]).all() else None)  # fmt: skip
    return not wrong


def job(rng, kind):
    from hpcred.settings.job_file import Job

    return case(rng, Job, JOBS, "fuzz.toml", ["reduce", "fuzz.toml"], of_result)


def simulation(rng, kind):
    from hpcred.settings.simulation_file import SimulationJob

    return case(rng, SimulationJob, MOTIONS, "fuzz.toml", ["simulate", "fuzz.toml"], of_motion)


def sweep(rng, kind):
    from hpcred.settings.sweep_file import _File

    return case(rng, _File, SWEEPS, "fuzz.toml", ["sweep", "fuzz.toml", "--dry-run"], no_echo)


KINDS = {"job.toml": job, "sim.toml": simulation, "sweep.toml": sweep}
