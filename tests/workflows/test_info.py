"""What `info` says of node sets, and of everything that hpcred writes."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import block_with_ends, dense_model, gather, refused, said
from mpi4py import MPI
from pictures import undrawn

import hpcred as package
from hpcred.cli.main import run
from hpcred.model.rigid_body.modes import rigid_motions
from hpcred.report import mode_pictures
from hpcred.workflows.export import export_result
from hpcred.writers.registry import WRITERS


@pytest.mark.mpi
def test_node_sets_are_counted_over_all_ranks(comm, folder):
    with package.crank(1000, comm) as model:
        sizes = {name: comm.allreduce(len(part)) for name, part in model.sets.items()}
        package.write_model(folder / "model.h5", model)
    assert package.describe_file(folder / "model.h5", comm=comm)["sets"] == sizes and min(sizes.values()) > 10


def test_many_node_sets_are_cut_off_with_a_word(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with package.crank(500) as model:
        for count in (20, 23):
            sets = {f"S{k:02d}": np.arange(1, k + 2) for k in range(count)}
            with model.with_fields(sets=sets) as marked:
                package.write_model("model.h5", marked)
            text = said(capsys, "info", "model.h5", "--json", "i.json")
            assert "S00 1 S01 2" in text and "S19 20" in text and "S20" not in text
            assert ("and 3 more node sets" in text) == (count == 23)
            assert json.loads(Path("i.json").read_text())["sets"] == {name: len(part) for name, part in sets.items()}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A folder with a result of a body with two interfaces, in both coordinates, in every format, and more."""
    folder = tmp_path_factory.mktemp("info")
    with block_with_ends(MPI.COMM_SELF) as model:
        package.write_model(folder / "model.h5", model)
        for name, coordinates in (("body", "modal"), ("arm", "interface")):
            with package.reduce(model, [package.CraigBampton(count=3)], package.Buckens(),
                                coordinates=coordinates) as rom:  # fmt: skip
                package.write_result(folder / f"{name}.h5", rom, model)
        jacket = block_with_ends(MPI.COMM_SELF, clamped=True)
        rom = package.reduce(jacket, [package.CraigBampton(count=3)], coordinates="interface")
        package.write_result(folder / "jacket.h5", rom, jacket)
        with pytest.MonkeyPatch.context() as patch:
            for key, value in (("FIRST", 1), ("FRAMES", 4), ("MOVING_DOTS", 20)):
                patch.setattr(mode_pictures, key, value)
            undrawn(patch, ["svg", "pdf"])
            body, arm, jacket = (package.read_result(folder / f"{name}.h5") for name in ("body", "arm", "jacket"))
            for export in WRITERS.all():
                of = arm if export.needs == "superelement" else body
                export_result(jacket if export.name == "openfast" else of, export.name)
            undrawn(patch)
            package.report_file([folder / "body.h5"], output=folder / "page.html", csv=folder / "tables")
        package.evaluate_result(folder / "body.h5", frequencies=(10.0, 20.0, 30.0), output=folder / "h.csv")
    return folder


WORDS = {
    "arm.h5": ["hpcred result", "coordinates 15", "of these rigid body 6", "left 85 averaging 12 0 0.01 0.015"],
    "arm.pch": ["Nastran DMIG", "K arm.pch, matrix KAAX"], "arm_external.op4": ["Nastran OP4", "matrix KXX: 15 x 15"],
    "arm_external.pch": ["beside OP4", "left 85, right 86"], "arm_simscape.mat": ["K 15 x 15"],
    "jacket_ExtPtfm.dat": ["ExtPtfm of OpenFAST", "coordinates 9"],
    "arm_abaqus.inp": ["user element of Abaqus", "interface nodes left 85, right 86"],
    "arm_ansys.inp": ["MATRIX50", "interface nodes left 85, right 86"], "arm_ansys_K.mtx": ["Market", "15 x 15"],
    "body.SID_FEM": ["SID file", "mass 0.2826", "interface nodes 85, 86"], "body.mat": ["phi 2 x 3 x 9"],
    "body.fem": ["MBDyn", "coordinates 9", "interface nodes left, right", "mass 0.2826"],
    "body_mbsim.hdf5": ["MBSim", "stiffness matrix 9 x 9"],
    "body.fmu": ["FMI 2.0", "model body", "inputs force_left_x, force", "states 18", "platforms linux64"],
    "body.uff": ["universal file", "nodes 84", "elements hexahedron 36", "shapes pseudo-mode 1: 25680.7 Hz, p"],
    "body.vtu": ["points 84", "cells 36", "pseudo_mode_1_25680.7_Hz"],
    "body.npz": ["NumPy arrays", "phi 2 x 3 x 9", "mass 1,"], "body_exudyn.npz": ["NumPy arrays"],
    "body_statespace.npz": ["A 18 x 18"], "body_statespace.mat": ["A 18 x 18"],
    "body.gif": ["GIF picture", "pixels", "frames 4"], "body.webp": ["WEBP picture", "frames 4"],
    "body.png": ["PNG picture", "pixels"], "body.svg": ["SVG picture"], "body.pdf": ["PDF file"],
    "page.html": ["HTML report", "about body"], "tables/frequencies_body.csv": ["columns number,", "rows 9"],
    "h.csv": ["columns f_hz, re_left:x/left:x", "rows 3"],
}  # fmt: skip


def test_info_of_all_that_is_written_for_others(written, monkeypatch, capsys):
    monkeypatch.chdir(written)
    known = {name.removeprefix("body").removeprefix("arm").removeprefix("jacket") for name in WORDS}
    assert {export.suffix for export in WRITERS.all()} <= known
    for name, expected in WORDS.items():
        text = said(capsys, "info", name)
        assert all(part in text for part in expected), text
    for name in list(WORDS)[::4]:
        assert "convert it first" in refused(capsys, "info", name, "--below", "3")


def test_products_of_inertia_of_a_sid_file_have_their_names(tmp_path):
    """Three that differ, from the mass matrix."""
    with package.solid((2, 1, 1), size=(0.4, 0.1, 0.15)) as model:
        node = int(model.dofs.node[0])
        with package.reduce(model.with_inputs([(node, "z")]), [package.Modes(count=2)]) as rom:
            package.write_result(tmp_path / "r.h5", rom, model)
        R, M = gather(rigid_motions(model)), dense_model(model)[1]
    package.export_result(tmp_path / "r.h5", "sid", tmp_path / "r.SID_FEM")
    J = (R.T @ M @ R)[3:, 3:]
    found = package.describe_file(tmp_path / "r.SID_FEM")["inertia_xx_yy_zz_xy_xz_yz"]
    assert found == pytest.approx([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]], rel=1e-9)
    assert abs(J[0, 2]) > 1.1 * abs(J[0, 1]) > 1.1 * abs(J[1, 2])


@pytest.mark.parametrize("name", ["body.fmu", "body.fem", "body.vtu", "body.uff", "body.npz", "body.png"])
def test_half_a_file_is_refused_or_half_described(written, tmp_path, monkeypatch, capsys, name):
    """Never a traceback."""
    monkeypatch.chdir(tmp_path)
    content = (written / name).read_bytes()
    Path(name).write_bytes(content[: len(content) // 2])
    capsys.readouterr()
    assert run(["info", name]) in (0, 2)
    assert "Traceback" not in capsys.readouterr().err


def test_files_in_toml_are_told_apart(linkage_folder, capsys):
    Path("s.toml").write_text('job = "job.toml"')
    Path("y.toml").write_text('body = "result.h5"\nend = 1.0')
    Path("m.toml").write_text('[[body]]\nname = "a"\nresult = "result.h5"\n')
    for words, says in (
        (["s.toml"], "s.toml: found a sweep, which `hpcred sweep` reads"),
        (["y.toml"], "y.toml: found a simulation, which `hpcred simulate` reads"),
        (["m.toml"], "m.toml: found a machine, which `hpcred assemble` reads"),
        (["job.toml", "--modes", "3"], "job.toml: a job is shown and drawn with its interfaces; modes"),
        (["job.toml", "--figure", "f.png"], "job.toml has no [[interface]] to draw"),
    ):
        assert says in refused(capsys, "info", *words)


def test_details_of_a_model_are_refused_before_anything_is_printed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with package.linkage() as model:
        package.write_model("model.h5", model)
    assert run(["info", "model.h5", "--details"]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and "expected 'hpcred-result'" in printed.err


def test_details_of_a_result_have_each_table_once(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    package.write_model("model.h5", package.crank(600))
    Path("job.toml").write_text(
        'model = "model.h5"\noutput = "result.h5"\nframe = {kind = "buckens"}\nbasis = [{kind = "modes", count = 8}]\n'
        'interface = [{name = "crank", nodes = {set = "BIG_EYE"}}]\n'
    )
    assert run(["reduce", "job.toml"]) == 0
    for more in ((), ("--details",)):
        assert said(capsys, "info", "result.h5", *more).count("Interfaces, and where their reference nodes are") == 1
