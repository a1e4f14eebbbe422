"""Stress modes and surfaces in exports that have a place for them, and beside those that have none."""

import fmpy
import numpy as np
import pytest
import scipy.io
from fmpy.validation import validate_fmu
from helpers import block_with_ends, refused

import hpcred
from hpcred import Buckens, Krylov, Modes
from hpcred.body.body import body_of
from hpcred.cli.main import run
from hpcred.files import result_file
from hpcred.model.interfaces.nodes import Interface, Nodes
from hpcred.parallel.failures import InputError
from hpcred.workflows import export
from hpcred.workflows.export import export_result

ORDER = ("xx", "yy", "zz", "xy", "yz", "zx")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A result of a connecting rod of solids with stress modes, and one without; its first and its last node are
    interface nodes, and the small eye is another."""
    folder = tmp_path_factory.mktemp("rod")
    with (
        hpcred.crank(600) as bare,
        bare.with_interfaces([Interface(name="small", nodes=Nodes(set="SMALL_EYE"))]) as rod,
        rod.with_inputs([(1, "all"), "small"]) as model,
        hpcred.reduce(model, [Modes(index=(7, 8, 9)), Krylov(frequency=0.0)], Buckens()) as rom,
    ):
        stress = hpcred.stress_modes(model, rom.columns)
        hpcred.write_result(folder / "rod.h5", rom, model, stress=stress)
        hpcred.write_result(folder / "bare.h5", rom, model)
    return folder


def exported_to(folder, name, kind, **options):
    return export_result(folder / "rod.h5", kind, folder / name, nodes=["small", 1], options=options)


def test_arrays_have_stress_modes_and_their_nodes(made, tmp_path):
    """As in the result, in other units in theirs, where stresses of the same motion are MPa."""
    modes = hpcred.read_result(made / "rod.h5").stress_modes()
    for name, kind, read in (("a.npz", "npz", np.load), ("a.mat", "matlab", scipy.io.loadmat)):
        file = read(exported_to(made, name, kind)["output"])
        assert np.array_equal(file["stress"], modes.stress)
        assert np.array_equal(file["stress_nodes"].ravel(), modes.node)
    other = np.load(export_result(made / "rod.h5", "npz", tmp_path / "mm.npz", nodes=[1], units="mm,t,s")["output"])
    si = np.load(export_result(made / "rod.h5", "npz", tmp_path / "si.npz", nodes=[1])["output"])
    # q = K^-1 B u of a force of 1 N; displacements in mm, stresses in MPa
    q, Q = (np.linalg.solve(file["K"], file["B"][:, 0]) for file in (si, other))
    assert other["phi"][0] @ Q == pytest.approx(1e3 * si["phi"][0] @ q)
    found, wanted = np.tensordot(Q, other["stress"], 1), np.tensordot(q, si["stress"], 1)
    assert found == pytest.approx(1e-6 * wanted, abs=1e-9 * 1e-6 * np.abs(wanted).max())
    bare = np.load(export_result(made / "bare.h5", "npz", tmp_path / "bare.npz")["output"])
    assert "stress" not in bare and "stress_nodes" not in bare


def test_stresses_of_large_models_are_left_out(made, tmp_path, monkeypatch):
    """They would be on one rank. Those of some nodes are there, however large the model is."""
    count = hpcred.read_result(made / "rod.h5").stress_nodes
    for module in (result_file, export):
        monkeypatch.setattr(module, "LARGE", 100)
    report = export_result(made / "rod.h5", "npz", tmp_path / "a.npz")
    told = f"the stresses of {count} nodes are left out, more than 33: keep those of some in result.h5, stress = [...]"
    assert "stress" not in np.load(report["output"]) and any(item.startswith(told) for item in report["remarks"])
    report = export_result(made / "rod.h5", "exudyn", tmp_path / "e.npz")
    assert "no stresses: the result has no stress modes, or those of too many nodes" in report["remarks"]
    for module in (result_file, export):
        monkeypatch.setattr(module, "LARGE", 3 * count)  # nodes, of more dofs
    assert "stress" in np.load(export_result(made / "rod.h5", "npz", tmp_path / "b.npz")["output"])


@pytest.mark.mpi
@pytest.mark.costly
def test_reduced_models_in_python_take_stresses_and_geometric_stiffness(comm, folder):
    clamp, preload = hpcred.Tangent("left"), hpcred.body.Preload(acceleration=(9e3, 0.0, 0.0))
    with block_with_ends(comm, "rigid") as model:
        rom = hpcred.reduce(model, [Modes(count=4)], clamp)
        stress = hpcred.stress_modes(model, rom.columns)
        geometric = hpcred.geometric_stiffness(model, rom.columns, clamp, origin=(0.01, 0.0, 0.0))
        rom.export(folder / "a.npz", stress=stress, geometric_stiffness=geometric, units="mm,t,s")
        rom.export(folder / "p.npz", geometric_stiffness=geometric, preload=preload)
    every = np.concatenate(comm.allgather(stress.stress), axis=1)
    if comm.rank == 0:
        file = np.load(folder / "a.npz")
        size = 1e3 / np.sqrt(1e3)  # of a coordinate, mm t^1/2 a m kg^1/2
        assert file["stress"] == pytest.approx(every / size / 1e6, rel=1e-9)
        assert file["geometric_states"].tolist() == list(geometric.states)
        place = geometric.states.index("ax")  # N/m by m/s^2 is 1e-3 N/mm by 1e3 mm/s^2
        change = np.load(folder / "p.npz")["K"] - rom.K
        assert change == pytest.approx(9e3 * geometric.matrices[place], abs=1e-9 * np.abs(rom.K).max())
        share = file["geometric_stiffness"][place] / (geometric.matrices[place] / 1e3)
        assert share == pytest.approx(file["K"][0, 0] / rom.K[0, 0])
    comm.Barrier()


@pytest.mark.peers("exudyn")
def test_exudyn_shows_the_stresses_of_its_mesh_nodes(made):
    """At the nodes of the surface and at an interface node of the mesh; those that are not of the mesh have none."""
    import exudyn
    from exudyn.FEM import ObjectFFRFreducedOrderInterface

    report = exported_to(made, "rod_exudyn.npz", "exudyn")
    assert not any("stress" in remark for remark in report["remarks"])
    result = hpcred.read_result(made / "rod.h5")
    modes, surface = result.stress_modes(), result.surface()
    interface = ObjectFFRFreducedOrderInterface()
    interface.LoadFromFile(str(made / "rod_exudyn.npz"))
    mbs = exudyn.SystemContainer().AddSystem()
    q = 1e-4 * np.cos(np.arange(1, result.reduced.size + 1))
    own = interface.AddObjectFFRFreducedOrder(mbs, positionRef=[0, 0, 0])
    mbs.SetNodeParameter(own["nGenericODE2"], "initialCoordinates", q.tolist())
    mbs.Assemble()
    whole = np.tensordot(q, modes.stress, 1)[:, [0, 1, 2, 4, 5, 3]]
    places = {0: None, 1: 1, interface.nNodes - 1: surface.nodes[-1], interface.nNodes - 7: surface.nodes[-7]}
    for place, node in places.items():
        kind = exudyn.OutputVariableType.StressLocal
        found = np.array(mbs.GetObjectOutputSuperElement(own["oFFRFreducedOrder"], kind, place))
        wanted = np.zeros(6) if node is None else whole[np.searchsorted(modes.node, node)]
        assert found == pytest.approx(wanted, rel=1e-9, abs=1e-9 * np.abs(whole).max())
        assert (node is None) == (not wanted.any())


@pytest.mark.peers("fmpy")
def test_stresses_of_chosen_nodes_are_outputs_of_an_fmu(made):
    """A step of a force, at the end of which they are those of the coordinates; with their unit, and by FMPy."""
    report = exported_of_fmu(made, "rod.fmu", stress="12:xx, 17")
    assert report["outputs"] == report["inputs"]  # those of the result
    path = made / "rod.fmu"
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    units = {item.name: item.unit for item in description.modelVariables if "stress" in item.name}
    names = ["stress_12_xx", *(f"stress_17_{item}" for item in ORDER)]
    assert units == dict.fromkeys(names, "Pa") | {name.replace("stress", "stress_rate"): "Pa/s" for name in names}
    result = hpcred.read_result(made / "rod.h5")
    size, modes = result.reduced.size, result.stress_modes([12, 17])
    ran = fmpy.simulate_fmu(str(path), fmi_type="CoSimulation", stop_time=1e-3, output_interval=1e-4,
                            start_values={"force_small_z": 10.0},
                            output=[*names, *(f"q[{k + 1}]" for k in range(size))])  # fmt: skip
    q = np.array([ran[f"q[{k + 1}]"] for k in range(size)]).T
    wanted = np.column_stack([q @ modes.stress[:, 0, 0], q @ modes.stress[:, 1]])
    found = np.array([ran[name] for name in names]).T
    assert found == pytest.approx(wanted, rel=1e-9, abs=1e-9 * np.abs(wanted).max()) and np.abs(wanted[-1]).min() > 0
    listed = exported_of_fmu(made, "list.fmu", stress=["17:zz", 12])
    assert listed["format"] == "fmu"
    with pytest.raises(InputError, match=r"fmu.stress: found '17:q', expected a node, such as 20, or one of its comp"):
        exported_of_fmu(made, "x.fmu", stress="17:q")
    with pytest.raises(InputError, match="rod.h5: no stress of node 99999"):
        exported_of_fmu(made, "x.fmu", stress=99999)
    with pytest.raises(InputError, match="bare.h5: no stress modes; reduce with stress = true"):
        export_result(made / "bare.h5", "fmu", made / "x.fmu", options={"stress": "1"})


def test_a_stress_of_the_model_has_the_name_that_others_have(tmp_path):
    with (
        hpcred.solid((3, 2, 2), inputs=1) as model,
        model.with_outputs([hpcred.outputs.StressOutput(node=20, stress="xx"), (20, "z")]) as measured,
    ):
        hpcred.reduce(measured, [Modes(count=3)]).export(tmp_path / "s.fmu")
    found = [item.name for item in fmpy.read_model_description(str(tmp_path / "s.fmu")).modelVariables
             if item.causality == "output"]  # fmt: skip
    assert found == ["stress_20_xx", "displacement_20_z", "stress_rate_20_xx", "velocity_20_z"]


def exported_of_fmu(folder, place, **options):
    return export_result(folder / "rod.h5", "fmu", folder / place, options=options)


def test_an_fmu_is_named_by_its_result_or_by_an_option_and_has_an_identity_of_its_own(made, tmp_path):
    """Two bodies of the same numbers are told apart, and a file is always the same."""
    found = []
    for place, options in (("a.fmu", {}), ("b.fmu", {"name": "left rod"}), ("c.fmu", {"name": "left rod"})):
        exported_of_fmu(made, place, **options)
        description = fmpy.read_model_description(str(made / place))
        found.append((description.modelName, description.coSimulation.modelIdentifier, description.guid))
    assert [name for name, _, _ in found] == ["rod", "left rod", "left rod"]
    assert [word for _, word, _ in found] == ["rod", "left_rod", "left_rod"]
    assert found[0][2] != found[1][2] and found[1][2] == found[2][2]
    assert (made / "b.fmu").read_bytes() == (made / "c.fmu").read_bytes()


@pytest.mark.parametrize("kind, suffix", [("sid", ".SID_FEM"), ("mbdyn", ".fem")])
def test_the_surface_is_written_beside_formats_without_a_place_for_it(made, tmp_path, kind, suffix):
    """Closed, with the volume of the rod by its mass, in the body frame; in the units of the file."""
    report = export_result(made / "rod.h5", kind, tmp_path / f"part{suffix}", nodes=[1], options={"surface": True},
                           units="mm,t,s")  # fmt: skip
    assert report["files"] == [str(tmp_path / "part.obj")]
    lines = [line.split() for line in (tmp_path / "part.obj").read_text().splitlines()[1:]]
    points = np.array([line[1:] for line in lines if line[0] == "v"], float)
    corners = points[np.array([line[1:] for line in lines if line[0] == "f"], int) - 1]
    surface = hpcred.read_result(made / "rod.h5").surface()
    assert points == pytest.approx(1e3 * surface.points, abs=1e-6) and len(corners) == len(surface.triangles)
    volume = np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    steel = hpcred.read_result(made / "rod.h5").floating_frame.mass / 7850.0
    assert volume * 1e-9 == pytest.approx(steel, rel=1e-6)
    assert "files" not in export_result(made / "rod.h5", kind, tmp_path / f"plain{suffix}", nodes=[1])
    assert not (tmp_path / "plain.obj").exists()


def test_a_surface_that_is_not_there_and_one_of_another_kind_are_refused(made, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with hpcred.linkage() as model, hpcred.reduce(model, [Modes(index=(7, 8))], Buckens()) as rom:
        hpcred.write_result("beams.h5", rom, model)
        assert body_of(model, rom).surface is None
    said = refused(capsys, "export", "beams.h5", "--format", "mbdyn", "--set", "mbdyn.surface=true")
    assert "surface: the result has no faces of shells or solids, no basis, or too many dofs; leave it out" in said
    (tmp_path / "part.obj").write_text("v 0 0 0\n")
    with pytest.raises(InputError, match=r"part.obj: found a file of another kind there, which is not repl"):
        export_result(made / "rod.h5", "sid", tmp_path / "part.SID_FEM", nodes=[1], options={"surface": True})
    (tmp_path / "part.obj").unlink()
    for _ in range(2):  # one of hpcred's is replaced
        line = ["export", str(made / "rod.h5"), "-o", "part.SID_FEM", "--nodes", "1", "--set", "sid.surface=true"]
        assert run(line) == 0
    assert "part.obj exists and will be replaced" in capsys.readouterr().err
