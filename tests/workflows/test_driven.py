"""Random, harmonic and shock loads of a result by the command line, and each refusal of a table."""

import numpy as np
import pytest
from helpers import refused

import hpcred
from hpcred.cli.main import run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A result of an oscillator on a base at 20 Hz, with a quality of 10."""
    from dataclasses import replace

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


def test_harmonic_and_shock(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "h.csv").write_text("f [Hz],base:z [mm],base:z phase [deg]\n20,1,90\n")
    row = hpcred.workflows.driven_response("result.h5", harmonic="h.csv")["rows"][0]
    assert row["amplitude"] == pytest.approx(1e-2, rel=1e-9)
    t = np.linspace(0, 0.011, 60)
    lines = [f"{x},{np.sin(np.pi * x / 0.011)}" for x in t]
    (folder / "t.csv").write_text("\n".join(["t [s],base:z [g]", *lines, ""]))
    rows = hpcred.workflows.driven_response("result.h5", srs="t.csv", q=50.0)["rows"]
    assert rows[0]["largest of SRS (m/s^2)"] == pytest.approx(1.75 * 9.80665, rel=0.02)


def test_response_after_a_shock(folder, monkeypatch):
    """The oscillator on its base is largest after a short pulse: its acceleration is the shock spectrum at 20 Hz."""
    monkeypatch.chdir(folder)
    times, pulse = hpcred.analysis.half_sine(100.0, 0.002, 50)
    lines = [f"{x},{y}" for x, y in zip(times, pulse, strict=True)]
    (folder / "s.csv").write_text("\n".join(["t [s],base:z [m/s^2]", *lines, ""]))
    expected = hpcred.analysis.shock_spectrum(times, pulse, [20.0], q=10.0).maximax[0]
    rows = hpcred.workflows.driven_response("result.h5", srs="s.csv")["rows"]
    assert rows[1]["largest (m/s^2)"] == pytest.approx(expected, rel=2e-3)
    # the spectrum of what rings at 20 Hz with a quality of 10: an oscillator of the same reaches Q / e times it
    assert rows[1]["largest of SRS (m/s^2)"] == pytest.approx(10 / np.e * expected, rel=0.1)
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
        ("time,base:z [g]\n1,1\n", "found the first head"), ("", "found no lines"), ("# none\n", "found no lines"),
        ("f [Hz];base:z [g^2/Hz]\n1;1\n", "separated by commas"), ("f [Hz],base:z [g^2/Hz]\n", "found 0 lines"),
        ("f [Hz],base:z [g^2/Hz]\n1,1\n", "found 1 lines of numbers, expected 2 or more"),
        ("f [Hz],base:z [g^2/Hz]\n1,1\n\n2\n", "line 4: found 1 cells below 2 heads"),
        ("f [Hz],base:z [g^2/Hz]\n1,nan\n2,1\n", "line 2: base:z [g^2/Hz]: found nan, expected a finite number"),
        ("f [Hz],base:z [g^2/Hz]\n1,one\n2,1\n", "line 2: base:z [g^2/Hz]: found 'one'"),
        ("f [Hz],base:z [g^2/Hz]\n-1,1\n2,1\n", "found -1, expected frequencies of 0 or more"),
        ("f [Hz],base:z [g^2/Hz]\n1,-1\n2,1\n", "base:z [g^2/Hz]: found -1 at 1 Hz"),
        ("f [Hz],base:z [g^2/Hz]\n1,1_0\n2,1\n", "line 2: base:z [g^2/Hz]: found '1_0'"),
        ("f [Hz],base:z [g^2/Hz]\n1,\u0661\n2,1\n", "line 2: base:z [g^2/Hz]: found '\u0661'"),
        ("f [Hz],base:z [g^2/Hz]\n1,1e31\n2,1\n", "found 1e+31, expected -1e+30 to 1e+30"),
        ("f [Hz],base:z [g^2/Hz]\n1,10\n2,1", "found no line break at its end; the file is cut off"),
    ],
)  # fmt: skip
def test_refused(folder, monkeypatch, capsys, text, message):
    monkeypatch.chdir(folder)
    (folder / "bad.csv").write_text(text)
    assert message in refused(capsys, "response", "result.h5", "--psd", "bad.csv")
    (folder / "psd.csv").write_text("f [Hz],base:z [g^2/Hz]\n1,1\n100,1\n")
    assert "over the band" in refused(capsys, "response", "result.h5", "--psd", "psd.csv", "--band", "1,200")
    assert "above 0" in refused(capsys, "response", "result.h5", "--srs", "psd.csv", "--band", "0,200")
    for option in ("--polar", "--groups=2", "--tolerance=1e-3"):
        assert "belongs to a full model" in refused(capsys, "response", "result.h5", "--psd", "psd.csv", option)
    assert "no stress modes" in refused(capsys, "response", "result.h5", "--psd", "psd.csv", "--stress", "3")


def test_heads(folder):
    """Names that end as the parts of a pair do, and a cross spectrum in the unit of another motion."""
    from dataclasses import replace

    from hpcred.files.drive_table import read_drive_table

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
