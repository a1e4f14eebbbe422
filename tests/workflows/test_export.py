"""A result file in every other format, on any number of ranks, and what each says of what it cannot hold."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from helpers import MODES_JOB, block_with_ends, interface_model, names, refused
from mpi4py import MPI

import hpcred as package
from hpcred import Buckens, Modes
from hpcred.cli.main import run
from hpcred.files.outputs import kind_of
from hpcred.parallel.failures import InputError
from hpcred.report import mode_pictures
from hpcred.workflows.export import export_result
from hpcred.writers import read_sid
from hpcred.writers.registry import WRITERS

STRUCTURAL = """kind = "structural"
loss_factor = 0.02
"""


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.costly
def test_all_formats_without_more(reduced_linkage, comm, monkeypatch):
    result = reduced_linkage()
    monkeypatch.setattr(mode_pictures, "FRAMES", 4)
    for export in WRITERS.all():
        kind = export.name
        if export.needs == "superelement" or kind == "webp":  # pictures like those of gif
            continue
        report = export_result(result, kind, modes=[2] if kind == "svg" else None)
        path = result.with_name("result" + export.suffix)
        assert report["output"] == str(path) and path.stat().st_size > 1000
        if export.needs == "body":
            assert report["nodes"] == [1, 20] and report["coordinates"] == 6
            assert "an approximation" in report["remarks"][0]
        if export.needs == "reduced":
            assert report["inputs"] == report["outputs"] == ["20:z", "1:x"] and report["coordinates"] == 6
            assert "unstable" not in str(report["remarks"])
    assert result.with_suffix(".png").read_bytes()[:4] == b"\x89PNG"
    assert result.with_suffix(".png").stat().st_size > 20_000
    assert export_result(str(result), "sid", result.with_name("x.SID_FEM"), nodes=[7, 1])["nodes"] == [7, 1]
    assert [node.node for node in read_sid(result.with_name("x.SID_FEM")).nodes] == [7, 1]


@pytest.mark.mpi
@pytest.mark.costly
def test_structural_damping_is_carried_or_refused(reduced_linkage, comm):
    """D is zero then, so that a file without the loss factor would be undamped without a word."""
    head, tail = MODES_JOB.split('kind = "rayleigh"\nalpha = 2.0\nbeta = 1e-5\n')
    result = reduced_linkage(head + STRUCTURAL + tail)
    before = names(result.parent, comm)
    for kind in ("sid", "exudyn", "mbdyn", "mbsim", "statespace-mat", "fmu"):
        with pytest.raises(InputError, match=r"result.h5: damping: .*loss factor 0.02.*'modal' and ratio = 0.01"):
            export_result(result, kind)
    assert names(result.parent, comm) == before
    for kind, read in (("npz", np.load), ("matlab", scipy.io.loadmat)):
        file = read(export_result(result, kind)["output"])
        assert np.ravel(file["loss_factor"])[0] == 0.02 and not file["D"].any()


def test_the_help_names_all_formats(capsys):
    assert run(["export", "--help"]) == 0
    words = capsys.readouterr().out.replace(",", " ").replace(".", " ").replace(";", " ").split()
    assert {entry.name for entry in WRITERS.own} | {"simpack", "simulink", "paraview"} <= set(words)


@pytest.mark.mpi
def test_exports_are_refused_on_all_ranks(reduced_linkage, comm):
    result = reduced_linkage()
    before = names(result.parent, comm)
    for arguments, says in (
        ({"kind": "sidd"}, "--format: found 'sidd', expected one of sid, matlab, npz, exudyn"),
        ({"kind": "sid", "nodes": [99]}, "node 99 does not exist; nodes have the numbers of the finite-element"),
        ({"kind": "sid", "nodes": [1, 1]}, "expected at least one node, and each once"),
        ({"kind": "sid", "nodes": []}, "expected at least one node, and each once"),
        ({"kind": "vtk", "nodes": [1]}, "'vtk' shows all nodes"),
        ({"kind": "vtk", "modes": [1]}, "--modes: 'vtk' shows all shapes or none"),
        ({"kind": "gif", "modes": [7]}, "result.h5: modes: found 7, expected numbers from 1 to 6"),
        ({"kind": "statespace-npz", "nodes": [1]}, "'statespace-npz' has inputs and outputs, and no nodes"),
        ({"kind": "abaqus", "nodes": [1]}, "'abaqus' has the interface nodes of the job"),
        ({"kind": "nastran"}, r'result.h5: found pseudo-modal coordinates.*coordinates = "interface"'),
        ({"kind": "npz", "path": result}, "which this run reads; choose another name"),
        ({"kind": "npz", "path": result.parent / "nowhere/x.npz"}, "nowhere does not exist"),
    ):
        with pytest.raises(InputError, match=says):
            export_result(result, **arguments)
    assert names(result.parent, comm) == before


@pytest.mark.mpi
def test_superelements_are_written_with_the_files_beside_them(folder, comm):
    package.write_result(folder / "arm.h5", interface_model(damping=10.0))
    beside = {"nastran-op4": ["arm_external.pch"], "ansys": ["arm_ansys_K.mtx", "arm_ansys_M.mtx", "arm_ansys_D.mtx"]}
    kinds = {export.name for export in WRITERS.all() if export.needs == "superelement"}
    for kind in sorted(kinds - {"openfast"}):  # of one interface node
        report = export_result(folder / "arm.h5", kind)
        assert report["coordinates"] == 17 and report["nodes"] == [101, 205]
        assert report["files"] == [str(folder / name) for name in beside.get(kind, [])]
        assert names(folder, comm) == sorted(
            {folder / "arm.h5", *map(Path, [report["output"], *report["files"]])}
        )
        comm.Barrier()
        if comm.rank == 0:
            for name in [report["output"], *report["files"]]:
                Path(name).unlink()
        comm.Barrier()
    with pytest.raises(InputError, match="found a name that ends in .pch, expected .op4"):
        export_result(folder / "arm.h5", "nastran-op4", folder / "x.pch")
    assert names(folder, comm) == [folder / "arm.h5"]


def test_files_beside_a_superelement_replace_their_own_kind_and_say_so(folder, capsys):
    package.write_result(folder / "arm.h5", interface_model(damping=10.0))
    for _ in range(2):
        run(["export", str(folder / "arm.h5"), "--format", "ansys"])
    said = capsys.readouterr().err
    assert said.count("arm_ansys.inp existed and was replaced") == 1
    for key in "KMD":
        assert said.count(f"arm_ansys_{key}.mtx exists and will be replaced") == 1
    sparse = "%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 5.0\n"
    (folder / "rod_M.mtx").write_text(sparse)  # of the full model
    with pytest.raises(InputError, match="rod_M.mtx: found a Matrix Market file there, .* not replaced by Matrix"):
        export_result(folder / "arm.h5", "ansys", folder / "rod.inp")
    assert (folder / "rod_M.mtx").read_text() == sparse
    assert sorted(path.name for path in folder.glob("rod*")) == ["rod_M.mtx"]


def test_interface_nodes_by_name(folder, capsys):
    with block_with_ends(MPI.COMM_SELF) as model, package.reduce(model, [Modes(count=3)], Buckens()) as rom:
        package.write_result(folder / "result.h5", rom, model)
    numbers = {item.name: item.node for item in model.interfaces}
    result = str(folder / "result.h5")
    left, right = numbers["left"], numbers["right"]
    for words, expected in (("right", [right]), (f"right, 1,{left}", [right, 1, left])):
        assert run(["export", result, "--nodes", words]) == 0
        assert [node.node for node in read_sid(folder / "result.SID_FEM").nodes] == expected
    capsys.readouterr()
    assert run(["export", result, "--nodes", "middle"]) == 2
    known = "no interface or node set of this name; interfaces: left, right; node sets: none"
    assert f"node 'middle': {known}" in capsys.readouterr().err


def test_a_body_without_coordinates_is_no_body(reduced_linkage, folder):
    with package.linkage() as labelled, labelled.with_fields(dofs=None) as model:
        package.write_model(folder / "plain.h5", model)
    result = reduced_linkage(
        MODES_JOB.replace("model.h5", "plain.h5").replace('[frame]\nkind = "buckens"\n', "")
        .replace('[[20, "z"], [1, "x"]]', "[1]")
        .replace('"modes"\nindex = [7, 8, 9, 10, 11, 12]', '"krylov"\nfrequency = 9.0')
    )  # fmt: skip
    with pytest.raises(InputError, match="no floating-frame quantities: the model had no node coordinates.*"
                       "; formats without nodes: statespace-mat, statespace-npz, fmu$"):
        export_result(result, "sid")
    with pytest.raises(InputError, match="no basis with node coordinates"):
        export_result(result, "vtk")


def test_a_result_without_interface_needs_nodes(reduced_linkage):
    result = reduced_linkage(MODES_JOB.replace('[[20, "z"], [1, "x"]]', "[1]"))
    with pytest.raises(InputError, match="no interface nodes, since no input or output belongs to a node.* fmu$"):
        export_result(result, "npz")
    assert "inputs that belong to no node are left out: dof 1" in export_result(result, "sid", nodes=[3])["remarks"]


def test_a_two_sided_result_has_inputs_and_outputs(reduced_linkage):
    """It has no floating frame, and is written where none is needed."""
    result = reduced_linkage(
        MODES_JOB.replace('[[20, "z"], [1, "x"]]', '[[20, "z"]]\noutputs = [[7, "z"]]\nprojection = "two_sided"')
        .replace('"modes"\nindex = [7, 8, 9, 10, 11, 12]', '"krylov"\nfrequency = 30.0')
    )  # fmt: skip
    for kind in ("statespace-mat", "statespace-npz", "fmu"):
        report = export_result(result, kind)
        assert report["inputs"] == ["20:z"] and report["outputs"] == ["7:z"]
    with pytest.raises(InputError, match="no floating-frame quantities"):
        export_result(result, "sid")


def test_nodes_without_rotations_are_said(folder):
    with package.solid((3, 2, 2), inputs=3) as model:
        package.write_model(folder / "solid.h5", model)
    (folder / "solid.toml").write_text(
        'model = "solid.h5"\noutput = "solid_result.h5"\n[[basis]]\nkind = "static_correction"'
    )
    assert run(["reduce", str(folder / "solid.toml")]) == 0
    report = export_result(folder / "solid_result.h5", "sid")
    assert report["remarks"] == [
        "no rotational dofs at nodes 19: psi is zero there",
        "no geometric stiffness: loads and rotations do not change the stiffness",
    ]
    assert read_sid(report["output"]).nodes[0].objects["psi"].structure == 0


@pytest.mark.mpi
def test_a_reduction_in_python_can_be_exported(folder, comm):
    """By write_result, without a job."""
    with (
        package.linkage(comm) as model,
        package.reduce(model, [Modes(index=(7, 8))], Buckens()) as rom,
    ):
        package.write_result(folder / "result.h5", rom, model)
    assert export_result(folder / "result.h5", "npz")["nodes"] == [20]


def test_the_ending_of_a_name_is_that_of_its_format(linkage_folder, capsys):
    assert run(["reduce", "job.toml"]) == 0
    for words, says in (
        (["--format", "sid", "-o", "y.fmu"], "y.fmu: found a name that ends in .fmu, expected .sid_fem"),
        (["--format", "png", "-o", "x.jpg"], "x.jpg: found a name that ends in .jpg, expected .png of --format png"),
        (["-o", "a.txt"], "output a.txt: found a name that ends in .txt, expected one of .sid_fem, .mat, .npz, .fem"),
        (["-o", "a"], "output a: found a name that ends in nothing, expected one of .sid_fem, "),
        (["--format", "matlb"], "(did you mean 'matlab'?)"),
    ):
        assert says in refused(capsys, "export", "result.h5", *words)
    for name, kind, more in (
        ("a.uff", "universal file", []), ("a.txt", "SID file", ["--format", "sid"]), ("a.npz", "zip archive", []),
    ):  # fmt: skip
        assert run(["export", "result.h5", "-o", name, *more]) == 0
        assert kind_of(name).startswith(kind)
