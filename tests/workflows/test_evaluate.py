"""From foreign files to the error of the reduced model, by the command line."""

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from conftest import DATA
from helpers import CHORD_JOB, refused

import hpcred as package
from hpcred.cli.main import run
from hpcred.examples.linkage import Rod
from hpcred.files.names import FileNames
from hpcred.parallel.petsc import PETSc, is_complex
from hpcred.workflows import evaluate, pair_figures
from hpcred.workflows.pair_figures import pairs_to_show


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_from_foreign_files_to_the_error(hpcred, request, tmp_path, monkeypatch, ranks):
    """convert, info, reduce, evaluate on real matrices; every table also as JSON. On one rank, where no process starts,
    the option of PETSc is set before; test_prompt gives some on the command line."""
    job = """
    model = "model.h5"
    output = "result.h5"
    band = [0.0, 600.0]
    inputs = [[1, "x"], [20, "z"], [100, "y"]]
    [frame]
    kind = "buckens"
    [damping]
    kind = "rayleigh"
    beta = 1e-6
    [[basis]]
    kind = "modes"
    band = [0.0, 600.0]
    [[basis]]
    kind = "krylov"
    frequency = 0.0
    [[basis]]
    kind = "krylov"
    frequency = 500.0
    order = 1
    """
    (tmp_path / "job.toml").write_text(job)
    monkeypatch.chdir(tmp_path)
    for arguments in (
        ["convert", DATA / "blockC3D8.inp", "model.h5", "--json", "convert.json"],
        ["info", "model.h5", "--below", "500,1000", "--band-top", "600", "--json", "info.json"],
        ["reduce", "job.toml", "--json", "reduce.json", "--", "-shift_mat_mumps_icntl_14", "77"],
        ["evaluate", "result.h5", "--full", "model.h5", "--points", "13", "--json", "eps.json", "-o", "h.h5"],
    ):
        if ranks == 1:
            words = [str(word) for word in arguments]
            if "--" in words:
                option, value = words[words.index("--") + 1 :]
                PETSc.Options().setValue(option.removeprefix("-"), value)
                request.addfinalizer(lambda name=option: PETSc.Options().delValue(name.removeprefix("-")))
                words = words[: words.index("--")]
            assert run(words) == 0
            continue
        result = hpcred(*arguments, ranks=ranks)
        assert result.returncode == 0, result.stderr
    info, reduced, eps = (json.loads((tmp_path / f"{key}.json").read_text()) for key in ("info", "reduce", "eps"))
    counts = (None, None) if is_complex() else (2, 5)  # a complex build has no inertia
    assert info["elastic_modes_below_hz"][:2] == [[500.0, counts[0]], [1000.0, counts[1]]]
    assert reduced["reduced_size"] == 12 and reduced["symbolic_analyses"] == 1
    assert reduced["petsc_options"]["shift_mat_mumps_icntl_14"] == "77"
    assert reduced["ranks"] == ranks
    assert eps["eps_max"] < 1e-4 and eps["Q"] < 600 * 1e-4
    assert len(eps["eps"]) == 13
    responses = package.read_responses(tmp_path / "h.h5")
    assert np.allclose(np.linalg.norm(responses.full, axis=(1, 2)), eps["full_norm"])
    assert np.allclose(package.relative_error(responses.full, responses.reduced), eps["eps"])
    assert responses.input_names == ("1:x", "20:z", "100:y")


def test_a_two_sided_job_with_second_order_krylov(linkage_folder):
    """Outputs of their own, Rayleigh damping, and the error against the full model."""
    Path("job.toml").write_text(
        CHORD_JOB.replace(
            "[frame]", 'outputs = [[17, "z"], [18, "rx"]]\nprojection = "two_sided"\nallow_unstable = true\n[frame]'
        )
        .replace("[[basis]]", '[damping]\nkind = "rayleigh"\nalpha = 2.0\nbeta = 1e-5\n[[basis]]')
        .replace('"krylov"', '"second_order_krylov"')
    )
    assert run(["reduce", "job.toml", "--json", "r.json"]) == 0
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--frequencies", "99,100,101", "--json", "e.json"]) == 0
    record, errors = json.loads(Path("r.json").read_text()), json.loads(Path("e.json").read_text())
    assert record["projection"] == "two_sided" and record["outputs"] == ["17:z", "18:rx"]
    assert errors["eps"][1] < 1e-8 and errors["eps_max"] < 1e-2
    with h5py.File("result.h5") as file:
        assert file["basis/W"].shape == file["basis/V"].shape


def test_another_model_or_other_inputs_are_noticed(linkage_folder, capsys):
    """Names and sizes are the same; the matrices, or the columns of the file of inputs, are not."""
    assert run(["reduce", "job.toml"]) == 0
    with package.linkage(rod=Rod(diameter=0.0221)) as model:
        package.write_model("other.h5", model)
    capsys.readouterr()
    assert run(["evaluate", "result.h5", "--full", "other.h5", "--points", "3"]) == 2
    assert "its matrix M differs from what result.h5 was reduced from" in capsys.readouterr().err
    with package.solid((1, 1, 1), inputs=1) as model:
        package.write_model("small.h5", model)
        size = model.size
    assert run(["evaluate", "result.h5", "--full", "small.h5", "--points", "3"]) == 2
    assert f"small.h5: has {size} dofs, and the model that result.h5 was reduced from" in capsys.readouterr().err
    columns = np.zeros((120, 1))
    columns[116] = 1.0
    scipy.io.mmwrite("B.mtx", columns)
    assert run(["reduce", "job.toml", "--set", 'inputs="B.mtx"']) == 0
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--points", "3"]) == 0
    columns[116], columns[117] = 0.0, 1.0
    scipy.io.mmwrite("B.mtx", columns)
    capsys.readouterr()
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--points", "3"]) == 2
    assert "its inputs differ from what result.h5 was reduced from" in capsys.readouterr().err


def test_a_file_of_inputs_is_found_from_another_folder(linkage_folder, monkeypatch):
    scipy.io.mmwrite("B.mtx", np.eye(120)[:, [116]])
    assert run(["reduce", "job.toml", "--set", 'inputs="B.mtx"']) == 0
    (linkage_folder / "elsewhere").mkdir()
    monkeypatch.chdir(linkage_folder / "elsewhere")
    assert run(["evaluate", "../result.h5", "--full", "../model.h5", "--points", "3"]) == 0


@pytest.mark.parametrize("points", ["0", "1", "-3"])
def test_a_grid_needs_two_points(linkage_folder, capsys, points):
    assert run(["reduce", "job.toml"]) == 0
    capsys.readouterr()
    assert run(["evaluate", "result.h5", "--points", points]) == 2
    assert "expected at least 2 frequencies" in capsys.readouterr().err


def test_what_the_factors_of_a_reduction_were_told_reaches_the_full_response(linkage_folder):
    """A model that fits only out of core can be evaluated; the folder for that is made."""
    assert run(["reduce", "job.toml", "--set", 'out_of_core="factors"']) == 0
    record = package.read_result("result.h5").reduced.record
    assert record.job["out_of_core"] == str(linkage_folder / "factors")
    (linkage_folder / "factors").rmdir()
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--points", "3"]) == 0
    assert (linkage_folder / "factors").is_dir()


LAWS = {
    "none": (None, "measured with the loss factor 0.002 (undamped)"),
    "rayleigh": (package.Rayleigh(2.0, 1e-5), "measured with the damping of the model"),
    "structural": (package.Structural(0.02), "measured with the loss factor 0.02"),
    "modal": (package.ModalDamping(ratio=0.01), "measured with the loss factor 0.02 (the smallest modal ratio)"),
    "caughey": (package.Caughey((2.0, 1e-5, 1e-14)), "measured with the damping of the model"),
}


def reduce_to_tolerance(folder, damping):
    """Reduce the linkage to eps <= 1e-4 with damping, into result.h5 beside model.h5; returns its accuracy."""
    with package.linkage() as model:
        package.write_model(folder / "model.h5", model)
        with package.reduce(model, frame=package.Buckens(), damping=damping, tolerance=1e-4, band=(0, 300)) as rom:
            package.write_result(folder / "result.h5", rom, model)
            return rom.record.accuracy


@pytest.fixture(scope="module")
def automatic_once(tmp_path_factory):
    """A folder with the two files, and the accuracy."""
    folder = tmp_path_factory.mktemp("automatic")
    return folder, reduce_to_tolerance(folder, LAWS["rayleigh"][0])


@pytest.fixture
def automatic(automatic_once, tmp_path, monkeypatch):
    """The accuracy of a copy of them in the working folder."""
    shutil.copytree(automatic_once[0], tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return automatic_once[1]


@pytest.mark.parametrize("name", LAWS)
def test_fresh_frequencies_bear_out_what_was_said(tmp_path, monkeypatch, capsys, name):
    """Never above eps, and within a factor of 2 of what was said, or what else is unknown."""
    damping, measured = LAWS[name]
    monkeypatch.chdir(tmp_path)
    accuracy = reduce_to_tolerance(tmp_path, damping)
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--check", "12", "--seed", "3", "--json", "c.json"]) == 0
    report = json.loads(Path("c.json").read_text())
    assert measured in report["measured"]
    rows = report["rows"]
    assert 12 < len(rows) <= 15 and max(row["measured"] for row in rows) <= 1e-4
    unknown = max(10 * accuracy.noise, 0.03 * accuracy.largest, accuracy.points[-1].estimate)
    pairs = [(row["estimated"], row["measured"]) for row in rows]
    assert max(said for said, _ in pairs) > 0.1 * accuracy.largest
    assert all(abs(true - said) <= unknown or 0.5 < true / said < 2 for said, true in pairs)
    assert ": largest error" in capsys.readouterr().out


def test_a_check_draws_anew_and_repeats_by_its_seed(automatic):
    check = ["evaluate", "result.h5", "--full", "model.h5", "--check", "2", "--json"]
    reports = []
    for seed in ([], [], ["--seed"]):
        chosen = [*seed, str(reports[0]["seed"])] if seed else []
        assert run([*check, "c.json", *chosen]) == 0
        reports.append(json.loads(Path("c.json").read_text()))
    assert reports[0]["seed"] != reports[1]["seed"] and reports[0]["rows"] != reports[1]["rows"]
    assert reports[0]["rows"] == reports[2]["rows"]


def test_a_check_notices_another_reduced_model(automatic, capsys):
    """A pseudo-frequency that is 0.1 % too high: status 1."""
    with h5py.File("result.h5", "a") as file:
        del file.attrs["xxh3"]  # as in files of before there were any
        file["reduced/K"][1, 1] *= 1.002
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--check", "5"]) == 1
    assert "ABOVE at" in capsys.readouterr().out


def test_the_estimate_from_the_result_alone(automatic, capsys):
    """The largest of every part of the band is in the table, and at given frequencies the curve itself."""
    accuracy = automatic
    Path("model.h5").unlink()
    assert run(["evaluate", "result.h5", "--estimate", "--points", "20", "--json", "e.json"]) == 0
    assert accuracy.sentence in capsys.readouterr().out
    report = json.loads(Path("e.json").read_text())
    rows = report["rows"]
    assert len(rows) == 20 and max(row["eps"] for row in rows) == max(accuracy.eps)
    for f, eps in zip(accuracy.frequencies, accuracy.eps, strict=True):
        assert eps <= rows[min(int(f / 15.0), 19)]["eps"]
    assert report["Q"] == pytest.approx(package.error_integral(np.array(report["frequencies_hz"]),
                                                               np.array(report["eps"])))  # fmt: skip
    some = accuracy.frequencies[40], accuracy.frequencies[400]
    chosen = ["--frequencies", f"{some[0]!r},{some[1]!r}", "--json", "e.json"]
    assert run(["evaluate", "result.h5", "--estimate", *chosen]) == 0
    rows = json.loads(Path("e.json").read_text())["rows"]
    assert [row["eps"] for row in rows] == pytest.approx([accuracy.eps[40], accuracy.eps[400]], rel=1e-9)


@pytest.mark.parametrize("arguments", [["--estimate"], ["--check", "3", "--full", "model.h5"]])
def test_a_basis_by_hand_has_no_estimate(linkage_folder, capsys, arguments):
    assert run(["reduce", "job.toml"]) == 0
    capsys.readouterr()
    assert run(["evaluate", "result.h5", *arguments]) == 2
    assert "its basis was chosen by hand, so that nothing is known of its error" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--check", "3"], "--check: the model file is missing; give it by --full MODEL.h5"),
        (["--check", "0", "--full", "model.h5"], "check: found 0, expected 1 to 1e"),
        (["--check", "3", "--full", "model.h5", "--seed", "-1"], "seed: found -1"),
        (["--check", "3", "--full", "model.h5", "--band", "0,1"], "--check: cannot be combined with --band"),
        (["--estimate", "--full", "model.h5"], "--estimate: cannot be combined with --full"),
        (["--estimate", "--check", "3", "--full", "model.h5"], "--check: cannot be combined with --estimate"),
        (["--estimate", "--frequencies", "100,301"], "found 100 to 301 Hz, expected 0 to 300 Hz"),
        (["--estimate", "--points", "0"], "points: found 0"),
        (["--seed", "3"], "--seed: belongs to --check"),
    ],
)
def test_what_does_not_go_together_is_refused(automatic, capsys, arguments, says):
    assert run(["evaluate", "result.h5", *arguments]) == 2
    assert says in capsys.readouterr().err


def test_a_figure_of_every_response(linkage_folder, monkeypatch, capsys):
    """Named after the pair where there are several; the reduced model alone, or with the full one and their error."""
    assert run(["reduce", "job.toml"]) == 0
    assert run(["evaluate", "result.h5", "--band", "1,300", "--points", "5", "--figure", "one.svg"]) == 0
    text = Path("one.svg").read_text()
    command = ["evaluate", "result.h5", "--full", "model.h5", "--band", "1,300", "--points", "5", "--figure", "two.svg"]
    assert run(command) == 0
    assert [page.count('<g id="axes_') for page in (text, Path("two.svg").read_text())] == [2, 3]
    drawn = []
    monkeypatch.setattr(pair_figures, "pair_figure", lambda path, curves, *more: (
        path.write_bytes(b""), drawn.append((*more[:2], more[-1]))))  # fmt: skip
    assert run(["reduce", "job.toml", "--set", 'inputs=[[20, "z"], [12, "z"]]', "--set", 'output="r.h5"']) == 0
    assert run(["evaluate", "r.h5", "--band", "1,300", "--points", "5", "--figure", "f.png", "--json", "e.json"]) == 0
    figures = json.loads(Path("e.json").read_text())["figures"]
    assert figures == ["f_20z-20z.png", "f_20z-12z.png", "f_12z-12z.png"]
    assert all(Path(name).is_file() for name in figures)
    assert drawn == [("20:z", "20:z", "png"), ("20:z", "12:z", "png"), ("12:z", "12:z", "png")]
    assert "--pairs" not in capsys.readouterr().out
    monkeypatch.setattr(evaluate, "MOST_FIGURES", 2)
    draw = ["evaluate", "r.h5", "--band", "1,300", "--points", "5", "--figure", "g.svg"]
    assert run(draw) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("drawn: g_") == 2 and "the 2 largest of 3 responses are drawn; --pairs OUTPUT/INPUT,..." in said
    assert run([*draw, "--pairs", "12:z/20:z"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "drawn: g.svg"
    Path("g.svg").unlink()
    for arguments, says in (
        ([*draw, "--pairs", "12:x/20:z"], "found '12:x/20:z', expected output/input of r.h5, such as 20:z/20:z"),
        (["evaluate", "r.h5", "--pairs", "12:z"], "found '12:z', expected output/input of r.h5"),
    ):
        assert says in refused(capsys, *arguments)


def test_curves_show_their_peaks_and_units(linkage_folder, monkeypatch):
    """Three frequencies are tabulated, far from all resonances."""
    drawn = {}
    monkeypatch.setattr(pair_figures, "pair_figure", lambda path, curves, *names, **_: (
        path.write_bytes(b""), drawn.update(curves=curves, names=names)))  # fmt: skip
    assert run(["reduce", "job.toml"]) == 0
    command = ["evaluate", "result.h5", "--full", "model.h5", "--band", "1,300", "--points", "3", "--figure", "f.png"]
    assert run(command) == 0
    (_, f, H), (_, full_f, full) = drawn["curves"]
    assert full_f.tolist() == [1.0, 150.5, 300.0] and set(full_f) <= set(f)
    assert np.abs(H).max() > 100 * np.abs(full).max()
    assert drawn["names"][:2] == ("20:z", "20:z")
    (label, error_f, error), = drawn["names"][2]
    assert label.endswith("measured") and error_f.tolist() == full_f.tolist()
    assert error == pytest.approx(np.abs(H[np.isin(f, full_f)] - full) / np.abs(full))


def test_figures_are_named_in_any_case_of_letters(linkage_folder, monkeypatch, capsys):
    """By one rule for all commands; pictures of pairs are drawn above."""
    monkeypatch.setattr(pair_figures, "pair_figure", lambda path, *more: path.write_bytes(
        b"\x89PNG" if more[-1] == "png" else b""))  # fmt: skip
    assert run(["reduce", "job.toml"]) == 0
    for name, begins, command in (
        ("a.PNG", b"\x89PNG", "evaluate result.h5 --band 1,300 --points 5"),
        ("b.Pdf", b"%PDF", "response model.h5 --band 1,300 --points 5 --frame buckens --tolerance 0.1"),
        ("c.PNG", b"\x89PNG", "modes model.h5 --count 7"),
    ):
        assert run([*command.split(), "--figure", name]) == 0
        assert Path(name).read_bytes().startswith(begins)
        capsys.readouterr()
        assert run([*command.split(), "--figure", f"{name}.jpg"]) == 2
        assert f"figure {name}.jpg: expected a name that ends in .png" in capsys.readouterr().err


def test_pairs_worth_a_figure():
    H = np.zeros((2, 2, 2), dtype=complex)
    H[:, 0, 0], H[:, 1, 1], H[:, 0, 1], H[:, 1, 0] = 1.0, 3.0, 2.0, 2.0
    assert pairs_to_show(H, ("a", "b"), ("a", "b"), 9) == [(0, 0), (0, 1), (1, 1)]
    assert pairs_to_show(H, ("a", "b"), ("a", "c"), 9) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert pairs_to_show(H, ("a", "b"), ("a", "b"), 2) == [(0, 1), (1, 1)]
    H[:, 0, 1] = H[:, 1, 0] = 1e-14
    assert pairs_to_show(H, ("a", "b"), ("a", "b"), 9) == [(0, 0), (1, 1)]
    names = FileNames()
    found = [names.of(name) for name in ("output 3:z/a b", "output_3z_A_b", "c", "output_3z_a_b_2")]
    assert found == ["output_3z_a_b", "output_3z_A_b_2", "c", "output_3z_a_b_2_2"]
