"""Random, harmonic and shock loads of a result by the command line, and each refusal of a table."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import refused
from mpi4py import MPI

import hpcred
from hpcred.cli.main import run
from hpcred.settings.job_file import read_job
from hpcred.workflows.driven import _random
from hpcred.workflows.model_of_job import model_of_job

ON_BASE = """model = "model.h5"
output = "result.h5"
band = [0.0, 4000.0]
tolerance = 1e-3
inputs = [["piston", "z"]]
outputs = [["piston", "z"]]
damping = {kind = "modal", ratio = 0.02}
base = [{directions = ["z"], on = "crank", absolute = [["piston", "z"]]}]
interface = [{name = "crank", nodes = {set = "BIG_EYE"}}, {name = "piston", nodes = {set = "SMALL_EYE"}}]
load = [{name = "weight", kind = "gravity", value = [0.0, 0.0, -9.81]}]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A result of an oscillator on a base at 20 Hz, with a quality of 10."""
    from hpcred.loads import LoadColumn

    where, w = tmp_path_factory.mktemp("driven"), 2 * np.pi * 20.0
    model = hpcred.ReducedModel(
        np.eye(1), np.array([[0.1 * w]]), np.array([[w * w]]), B=np.array([[-1.0, 1.0]]), C=np.array([[1.0], [0.0]]),
        Ca=np.array([[0.0], [1.0]]), frequencies=np.array([20.0]), input_names=("base:z", "1:z"),
        output_names=("1:z", "absolute acceleration 1:z"), feedthrough=np.array([[0.0, 0.0], [1.0, 0.0]]),
    )  # fmt: skip
    with hpcred.linkage() as linkage:
        made = hpcred.reduce(linkage, [hpcred.Modes(count=2)], hpcred.Buckens())
        load = LoadColumn(name="base:z", kind="base", force=(0.0, 0.0, -1.0), moment=(0.0, 0.0, 0.0))
        record = replace(made.record, loads=(load,))
        made.close()
    hpcred.write_result(where / "result.h5", replace(model, record=record))
    return where


def test_miles(folder, monkeypatch, capsys):
    """RMS of 1 g^2/Hz by Miles' equation, and a density in the file with its unit."""
    monkeypatch.chdir(folder)
    (folder / "psd.csv").write_text("f [Hz],base:z [g^2/Hz]\n0.01,1\n100000,1\n")
    report = hpcred.workflows.driven_response("result.h5", psd="psd.csv", output="out.csv")
    miles = np.sqrt(np.pi / 2 * 20 * 10 * 9.80665**2 * (1 + 1 / 100))
    assert report["rows"][1]["RMS"] == pytest.approx(miles, rel=1e-3) and report["rows"][1]["unit"] == "m/s^2"
    assert (folder / "out.csv").read_text().startswith("f_hz,1:z [m^2/Hz],absolute acceleration 1:z [(m/s^2)^2/Hz]")
    assert run(["response", "result.h5", "--psd", "psd.csv"]) == 0


def test_units_of_stresses(folder):
    loads = SimpleNamespace(over=np.array([1.0, 50.0]), values=np.ones((2, 2)), orders=None)
    stress = hpcred.body.StressModes(np.array([7]), np.ones((1, 1, 6)), "made up")
    reduced = hpcred.read_result(folder / "result.h5").reduced
    _, curves, rows = _random(reduced, loads, None, stress)
    assert [row["unit"] for row in rows] == ["m", "m/s^2", *["Pa"] * 7]
    assert [unit for _, unit, _ in curves[2:]] == ["Pa^2/Hz"] * 7


def test_harmonic_and_shock(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "h.csv").write_text("f [Hz],base:z [mm],base:z phase [deg]\n20,1,90\n")
    row = hpcred.workflows.driven_response("result.h5", harmonic="h.csv")["rows"][0]
    assert row["amplitude"] == pytest.approx(1e-2, rel=1e-9)
    t = np.linspace(0, 0.011, 60)
    lines = [f"{x},{np.sin(np.pi * x / 0.011)}" for x in t]
    (folder / "t.csv").write_text("\n".join(["t [s],base:z [g]", *lines, ""]))
    rows = hpcred.workflows.driven_response("result.h5", srs="t.csv", q=50.0)["rows"]
    assert rows[0]["largest of SRS"] == pytest.approx(1.75 * 9.80665, rel=0.02)


def test_response_after_a_shock(folder, monkeypatch):
    """The oscillator on its base is largest after a short pulse: its acceleration is the shock spectrum at 20 Hz."""
    monkeypatch.chdir(folder)
    times, pulse = hpcred.analysis.half_sine(100.0, 0.002, 50)
    lines = [f"{x},{y}" for x, y in zip(times, pulse, strict=True)]
    (folder / "s.csv").write_text("\n".join(["t [s],base:z [m/s^2]", *lines, ""]))
    expected = hpcred.analysis.shock_spectrum(times, pulse, [20.0], q=10.0).maximax[0]
    rows = hpcred.workflows.driven_response("result.h5", srs="s.csv")["rows"]
    assert rows[1]["largest"] == pytest.approx(expected, rel=2e-3)
    # the spectrum of what rings at 20 Hz with a quality of 10: an oscillator of the same reaches Q / e times it
    assert rows[1]["largest of SRS"] == pytest.approx(10 / np.e * expected, rel=0.1)
    # a force has no shock spectrum
    (folder / "s.csv").write_text("t [s],1:z [N]\n0,0\n0.001,1\n0.002,0\n")
    assert [row["of"] for row in hpcred.workflows.driven_response("result.h5", srs="s.csv")["rows"]] == [
        "absolute acceleration 1:z"
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f [Hz],base:z\n1,1\n2,1\n", "found no unit"), ("f [Hz],base:z [N^2/Hz]\n1,1\n2,1\n", "found the unit"),
        ("f [Hz],base:x [g^2/Hz]\n1,1\n2,1\n", "has no input 'base:x'"),
        ("f [Hz],base:z [g^2/Hz]\n2,1\n1,1\n", "found 1 after 2"),
        ("f [Hz],base:z [g^2/Hz],1:z [N^2/Hz],base:z/1:z coherence [1]\n1,1,1,2\n2,1,1,2\n", "positive semidefinite"),
        ("f [Hz],base:z [g^2/Hz],base:z phase [deg]\n1,1,1\n2,1,1\n", "of one input, expected one of two"),
        ("f [Hz],base:z [g^2/Hz],1:z [N^2/Hz],base:z/1:z coherence [2]\n1,1,1,1\n2,1,1,1\n", "found the unit 2"),
        ("time,base:z [g]\n1,1\n", "found the first head"), ("", "found no heads"),
        ("# none\n", "the first head '# none'"),
        ("f [Hz];base:z [g^2/Hz]\n1;1\n", "separated by commas"), ("f [Hz],base:z [g^2/Hz]\n", "found 0 lines"),
        ("f [Hz],base:z [g^2/Hz]\n1,1\n", "found 1 lines of numbers, expected 2 or more"),
        ("f [Hz],base:z [g^2/Hz]\n1,1\n\n2\n", "line 4: found '2', expected 2 numbers"),
        ("f [Hz],base:z [g^2/Hz]\n1,nan\n2,1\n", "base:z [g^2/Hz]: found nan in the 1. line of numbers"),
        ("f [Hz],base:z [g^2/Hz]\n1,one\n2,1\n", "line 2: found '1,one', expected 2 numbers a line"),
        ("f [Hz],base:z [g^2/Hz]\n-1,1\n2,1\n", "found -1, expected frequencies of 0 or more"),
        ("f [Hz],base:z [g^2/Hz]\n1,-1\n2,1\n", "base:z [g^2/Hz]: found -1 at 1 Hz"),
        ("f [Hz],base:z [g^2/Hz]\n1,1_0\n2,1\n", "line 2: found '1,1_0'"),
        ("f [Hz],base:z [g^2/Hz]\n1,\u0661\n2,1\n", "line 2: found"),
        ("f [Hz],base:z [g^2/Hz]\n1,1e31\n2,1\n", "found 1e+31 in the 1. line of numbers, expected finite ones"),
        ("f [Hz],base:z [g^2/Hz]\n1e-320,1\n2,1\n", "f [Hz]: found 9.99989e-321 in the 1. line of numbers, expected"),
        ("f [Hz],base:z [g^2/Hz]\n1,10\n2,1", "found no line break at its end; the file is cut off"),
    ],
)  # fmt: skip
def test_refused(folder, monkeypatch, capsys, text, message):
    monkeypatch.chdir(folder)
    (folder / "bad.csv").write_text(text)
    assert message in refused(capsys, "response", "result.h5", "--psd", "bad.csv")


def test_options_are_refused(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    (folder / "psd.csv").write_text("f [Hz],base:z [g^2/Hz]\n1,1\n100,1\n")
    assert "over the band" in refused(capsys, "response", "result.h5", "--psd", "psd.csv", "--band", "1,200")
    assert "above 0" in refused(capsys, "response", "result.h5", "--srs", "psd.csv", "--band", "0,200")
    for option in ("--polar", "--groups=2", "--tolerance=1e-3"):
        assert "belongs to a full model" in refused(capsys, "response", "result.h5", "--psd", "psd.csv", option)
    assert "no stress modes" in refused(capsys, "response", "result.h5", "--psd", "psd.csv", "--stress", "3")


def test_heads(folder):
    """Names that end as the parts of a pair do, and a cross spectrum in the unit of another motion."""
    from dataclasses import replace

    from hpcred.readers.drive_table import read_drive_table

    one = replace(hpcred.read_result(folder / "result.h5").reduced, record=None, input_names=("pressure", "him"))
    (folder / "p.csv").write_text("f [Hz],pressure [1/Hz],him [1/Hz],pressure/him re [1/Hz]\n1,4,1,2\n2,4,1,2\n")
    assert np.array_equal(read_drive_table(folder / "p.csv", one, "psd").values[0], [[4.0, 2.0], [2.0, 1.0]])
    record = hpcred.read_result(folder / "result.h5").reduced.record
    loads = [replace(record.loads[0], name=f"base:{axis}") for axis in "xz"]
    two = replace(one, record=replace(record, loads=tuple(loads)), input_names=("base:x", "base:z"))
    heads = "f [Hz],base:x [g^2/Hz],base:z [g^2/Hz],base:x/base:z re [m^2/Hz]"
    (folder / "c.csv").write_text(f"{heads}\n1,1,1,1\n2,1,1,1\n")
    with pytest.raises(hpcred.InputError, match="another quantity"):
        read_drive_table(folder / "c.csv", two, "psd")


def test_shock_spectra_refuse_what_would_take_forever(folder, monkeypatch, capsys):
    """A band from 0 Hz, whose logarithm is infinite, and histories of too many steps."""
    monkeypatch.chdir(folder)
    (folder / "t.csv").write_text("t [s],base:z [g]\n0,0\n0.01,1\n0.02,0\n")
    assert "above 0 Hz" in refused(capsys, "response", "result.h5", "--srs", "t.csv", "--band", "0,100")
    assert "steps of" in refused(capsys, "response", "result.h5", "--srs", "t.csv", "--band", "1,1e9")
    (folder / "t.csv").write_text("t [s],base:z [g]\n0,0\n1e-9,1\n200,0\n")
    assert "steps of" in refused(capsys, "response", "result.h5", "--srs", "t.csv")


def write_table(path, head, *columns):
    np.savetxt(path, np.column_stack(columns), "%.17g", ",", header=head, comments="")


def test_displacements_and_velocities_over_time(folder, monkeypatch, capsys):
    """A base that goes up by a smooth step: its displacement, velocity and acceleration have the same spectra."""
    monkeypatch.chdir(folder)
    T, t = 0.05, np.linspace(0.0, 0.05, 101)
    w = 2 * np.pi / T
    motions = {"m": 1e-3 * (t / T - np.sin(w * t) / (2 * np.pi)), "m/s": 1e-3 * (1 - np.cos(w * t)) / T,
               "m/s^2": 1e-3 * w * np.sin(w * t) / T}  # fmt: skip
    largest = []
    for unit, values in motions.items():
        write_table(folder / "m.csv", f"t [s],base:z [{unit}]", t, values)
        rows = hpcred.workflows.driven_response("result.h5", srs="m.csv", band=(5.0, 200.0))["rows"]
        largest.append([row[key] for row in rows for key in ("largest", "largest of SRS")])
    np.testing.assert_allclose(largest[0], largest[2], rtol=5e-3)
    np.testing.assert_allclose(largest[1], largest[2], rtol=5e-3)
    write_table(folder / "m.csv", "t [s],base:z [mm/s]", t, np.cos(w * t))
    assert "found 1 at first, expected 0" in refused(capsys, "response", "result.h5", "--srs", "m.csv")


def test_rotations_of_a_base_have_spectra(folder, tmp_path):
    """In rad/s^2."""
    from dataclasses import replace

    found = hpcred.read_result(folder / "result.h5").reduced
    load = replace(found.record.loads[0], name="base:ry")
    names = {"input_names": ("base:ry", "1:z"), "output_names": ("1:ry", "absolute acceleration 1:ry")}
    turned = replace(found, **names, record=replace(found.record, loads=(load,)))
    hpcred.write_result(tmp_path / "turned.h5", turned)
    times, pulse = hpcred.analysis.half_sine(50.0, 0.011, 60)
    write_table(tmp_path / "t.csv", "t [s],base:ry [rad/s^2]", times, pulse)
    rows = hpcred.workflows.driven_response(tmp_path / "turned.h5", srs=tmp_path / "t.csv", q=50.0)["rows"]
    assert [row["unit"] for row in rows] == ["rad/s^2"] * 2
    assert rows[0]["largest of SRS"] == pytest.approx(1.75 * 50, rel=0.02)


def test_figures(folder, monkeypatch, capsys):
    """A panel for each unit, of densities, amplitudes with phases, and shock spectra."""
    from hpcred.report import figures

    monkeypatch.chdir(folder)
    panels, finish = [], figures._finish

    def finish_last(figure, drawn, frequencies, path, kind):
        panels.append([(axes.get_ylabel(), len(axes.lines)) for axes in drawn])
        assert any("1:z" in line.get_label() for axes in drawn for line in axes.lines)
        finish(figure, drawn, frequencies, path, kind) if len(panels) == 3 else path.touch()

    monkeypatch.setattr(figures, "_finish", finish_last)
    times, pulse = hpcred.analysis.half_sine(50.0, 0.011, 60)
    write_table(folder / "t.csv", "t [s],base:z [g]", times, pulse)
    (folder / "p.csv").write_text("f [Hz],base:z [g^2/Hz]\n0,1\n100,1\n")
    (folder / "h.csv").write_text("f [Hz],base:z [g]\n5,1\n20,1\n100,1\n")
    for option, table in (("--psd", "p.csv"), ("--harmonic", "h.csv"), ("--srs", "t.csv")):
        assert run(["response", "result.h5", option, table, "--figure", f"{table}.svg"]) == 0
    assert (folder / "t.csv.svg").read_text().count("1:z") >= 1
    assert panels == [[("(m/s^2)^2/Hz", 1), ("m^2/Hz", 1)],
                      [("m/s^2", 1), ("m", 1), ("phase (degrees)", 2)], [("m/s^2", 2)]]  # fmt: skip
    message = refused(capsys, "response", "result.h5", "--psd", "p.csv", "--figure", "x.jpg")
    assert "expected a name that ends in .png" in message


@pytest.mark.parametrize("option", ["--package=mumps", "--low-rank=1e-8", "--out-of-core=."])
def test_how_full_models_are_factored_is_refused(folder, monkeypatch, capsys, option):
    monkeypatch.chdir(folder)
    (folder / "p.csv").write_text("f [Hz],base:z [g^2/Hz]\n5,1\n100,1\n")
    message = refused(capsys, "response", "result.h5", "--psd", "p.csv", option)
    assert f"{option.partition('=')[0]}: belongs to a full model" in message


def test_a_body_on_an_interface_that_moves_is_compared_with_its_full_model(tmp_path, monkeypatch):
    """The model file has neither the interface, nor the base, nor the load of the job."""
    monkeypatch.chdir(tmp_path)
    with hpcred.crank(dofs=600) as model:
        hpcred.write_model("model.h5", model)
    (tmp_path / "job.toml").write_text(ON_BASE)
    assert run(["reduce", "job.toml"]) == 0
    report = hpcred.evaluate("result.h5", "model.h5", points=3)
    assert report["eps_max"] < 1e-3 and "weight" in hpcred.read_result("result.h5").reduced.input_names


def test_round_off_of_what_a_base_moves_is_no_other_model(tmp_path, monkeypatch):
    """The sums behind absolute accelerations, here near 1, have other last digits on other ranks and builds."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "job.toml").write_text(ON_BASE)
    with hpcred.crank(dofs=600) as model:
        hpcred.write_model("model.h5", model)
    found = set()
    with model_of_job(read_job("job.toml"), MPI.COMM_WORLD) as moved:
        for error in (1e-12, -1e-12):
            direct = moved.rates.direct * (1 + error)
            with moved.with_fields(rates=replace(moved.rates, direct=direct)) as other:
                found.add(other.digests["derivatives"])
    assert len(found) == 1
