"""Motions of all nodes from reduced coordinates: against the simulation, the basis, and the full model in time."""

import json
import shutil
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
import scipy.linalg
import vtu_reading
from helpers import MODES_JOB, SIMULATION, block_with_ends, dense_model, names

import hpcred
from hpcred import Buckens, InputError, Krylov, Modes
from hpcred.cli.main import run
from hpcred.files.result_points import read_points

ALL = ("displacement", "velocity", "acceleration")


@pytest.fixture(scope="module")
def simulated_once(module_folder, comm):
    """A folder with result.h5, and simulation.h5 of the linkage on its supports."""
    if comm.rank == 0:
        (module_folder / "sim.toml").write_text(SIMULATION)
        (module_folder / "job.toml").write_text(MODES_JOB)
    with hpcred.linkage(comm) as model:
        hpcred.write_model(module_folder / "model.h5", model)
    assert run(["reduce", str(module_folder / "job.toml")]) == 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hpcred.workflows.simulate.has_matplotlib", lambda: False)  # no picture
        hpcred.simulate_file(module_folder / "sim.toml", overrides=["rotation=[0.1, -0.2, 0.3]"])
    return module_folder


@pytest.fixture
def simulated(simulated_once, folder, comm):
    """A copy of that folder."""
    if comm.rank == 0:
        shutil.copytree(simulated_once, folder, dirs_exist_ok=True)
    comm.Barrier()
    return folder


def arrays(path):
    with h5py.File(path) as file:
        return {key: file[key][...] for key in ("t", "nodes/number", "nodes/position", *ALL) if key in file}


def basis(path):
    """Displacements (m, k, 3) of the nodes of a result in ascending order, their numbers and places."""
    with h5py.File(path) as file:
        V, node, direction = file["basis/V"][...], file["dofs/node"][...], file["dofs/direction"][...]
        numbers, first, place = np.unique(node, return_index=True, return_inverse=True)
        phi = np.zeros((len(V), len(numbers), 3))
        moved = direction < 3
        phi[:, place[moved], direction[moved]] = V[:, moved]
        return phi, numbers, file["dofs/position"][...][first]


@pytest.mark.mpi
@pytest.mark.costly
def test_all_nodes_in_the_body_frame(simulated):
    report = hpcred.recover(simulated / "result.h5", simulated / "simulation.h5", simulated / "out.h5", quantities=ALL)
    phi, numbers, places = basis(simulated / "result.h5")
    found = arrays(simulated / "out.h5")
    with h5py.File(simulated / "simulation.h5") as file:
        t, q, rates = (file[key][...] for key in ("t", "elastic", "elastic_velocity"))
    assert np.array_equal(found["t"], t) and np.array_equal(found["nodes/number"], numbers)
    assert np.array_equal(found["nodes/position"], places)
    second = np.gradient(rates, t, axis=0, edge_order=2)
    for key, values in zip(ALL, (q, rates, second), strict=True):
        expected = np.einsum("tm,mki->tki", values, phi)
        assert found[key] == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())
    size = np.linalg.norm(found["displacement"], axis=2)
    i, k = np.unravel_index(size.argmax(), size.shape)
    assert report["largest_displacement_m"] == {"value": pytest.approx(size.max()), "node": numbers[k], "t_s": t[i]}
    assert report["instants"] == 21 and report["nodes"] == 20 and report["axes"] == "body"
    assert any("accelerations by differences of the velocities" in remark for remark in report["remarks"])
    assert not any("velocities by differences" in remark for remark in report["remarks"])
    assert not any("of the frame" in remark for remark in report["remarks"])
    assert hpcred.workflows.verify_file(simulated / "out.h5")["verified_datasets"] == 7
    said = hpcred.info(simulated / "out.h5")
    assert said["format"] == "hpcred recovered motion" and said["nodes"] == 20 and said["arrays"] == list(ALL)


@pytest.mark.mpi
@pytest.mark.costly
def test_places_of_the_simulation_in_inertial_axes(simulated):
    """Of observed nodes, displacements are those of simulation.h5, and rates the differences of places over time."""
    hpcred.recover(simulated / "result.h5", simulated / "simulation.h5", simulated / "out.h5", quantities=ALL,
                   inertial=True, nodes=[20, 1, 10, 7, 14])  # fmt: skip
    found = arrays(simulated / "out.h5")
    with h5py.File(simulated / "simulation.h5") as file:
        assert np.array_equal(found["nodes/number"], file["nodes/number"][...])
        assert found["displacement"] == pytest.approx(file["nodes/displacement"][...], abs=1e-13)
        places = file["nodes/position"][...]
    assert found["nodes/position"] + found["displacement"] == pytest.approx(places, abs=1e-13)
    for key, of in (("velocity", places), ("acceleration", found["velocity"])):
        expected = np.gradient(of, found["t"], axis=0, edge_order=2)
        assert found[key] == pytest.approx(expected, abs=0.1 * np.abs(expected).max())
        assert found[key] != pytest.approx(0.5 * expected, abs=0.1 * np.abs(expected).max())


@pytest.mark.mpi
@pytest.mark.costly
def test_tables_of_chosen_nodes_and_instants(simulated):
    hpcred.recover(simulated / "result.h5", simulated / "simulation.h5", simulated / "all.h5")
    hpcred.recover(simulated / "result.h5", simulated / "simulation.h5", simulated / "out.csv", nodes=[20, 1],
                   start=0.01, end=0.04, every=3)  # fmt: skip
    whole = arrays(simulated / "all.h5")
    table = np.genfromtxt(simulated / "out.csv", delimiter=",", names=True)
    assert table.dtype.names == ("t", *(f"displacement_{node}_{a}" for node in (1, 20) for a in "xyz"))
    assert table["t"] == pytest.approx(whole["t"][4:17:3])
    assert table["displacement_20_z"] == pytest.approx(whole["displacement"][4:17:3, 19, 2], rel=1e-9)
    assert hpcred.info(simulated / "out.csv")["rows"] == 5


@pytest.mark.mpi
@pytest.mark.parametrize("moved", [False, True])
def test_files_of_paraview(simulated, comm, moved):
    """The cells and places of the model, and what is written as HDF5; old files of the folder go."""
    from_to = (simulated / "result.h5", simulated / "simulation.h5")
    hpcred.recover(*from_to, simulated / "out.pvd", every=2)
    hpcred.recover(*from_to, simulated / "out.pvd", every=5, inertial=moved, single=moved)
    hpcred.recover(*from_to, simulated / "out.h5", every=5, inertial=moved)
    expected = arrays(simulated / "out.h5")
    sets = ElementTree.parse(simulated / "out.pvd").getroot().findall("Collection/DataSet")
    assert [float(item.get("timestep")) for item in sets] == expected["t"].tolist()
    assert names(simulated / "out_vtu", comm) == [simulated / item.get("file") for item in sets]
    for item, u in zip(sets, expected["displacement"], strict=True):
        mesh = vtu_reading.read(simulated / item.get("file"))
        assert mesh.point_data["node"].tolist() == expected["nodes/number"].tolist()
        assert mesh.point_data["displacement"] == pytest.approx(u, rel=1e-6, abs=1e-12)
        assert mesh.points == pytest.approx(expected["nodes/position"] + (u if moved else 0), rel=1e-6, abs=1e-6)
        ((code, cells),) = mesh.cells
        assert code == 3 and sorted(map(tuple, cells.tolist())) == [(k, k + 1) for k in range(19)]
        assert ("elastic" in mesh.point_data) == moved
        assert mesh.points.dtype == ("<f4" if moved else "<f8")
    hpcred.recover(*from_to, simulated / "one.vtu", start=0.025, end=0.025)
    one = vtu_reading.read(simulated / "one.vtu")
    assert one.point_data["displacement"].shape == (20, 3)


def test_a_folder_with_files_of_the_user_is_not_replaced(simulated, capsys):
    """Neither by recover nor by simulate, also with the inputs of the run in it; nothing else is written."""
    out, job = simulated / "out_vtu", simulated / "sim.toml"
    from_to = [str(simulated / name) for name in ("result.h5", "simulation.h5")]
    out.mkdir()
    for name, text in (("thesis.txt", "years"), ("out_vtu_0.vtu", "<VTKFile>"), ("q.h5", "")):
        (out / name).write_text(text)
        before = {path: path.read_bytes() for path in simulated.rglob("*") if path.is_file()}
        assert run(["recover", *from_to, "-o", str(simulated / "out.pvd")]) == 2
        assert f"out_vtu: found '{name}' in this folder" in capsys.readouterr().err
        assert run(["simulate", str(job), "--set", "paraview=true", "--set", "output=out.h5"]) == 2
        assert f"out_vtu: found '{name}' in this folder" in capsys.readouterr().err
        assert {path: path.read_bytes() for path in simulated.rglob("*") if path.is_file()} == before
        (out / name).unlink()
    assert run(["recover", *from_to, "-o", str(simulated / "out.pvd"), "--every", "20"]) == 0
    assert run(["recover", *from_to, "-o", str(simulated / "out.pvd"), "--keep"]) == 2
    assert run(["recover", *from_to, "-o", str(simulated / "a\udcff.pvd")]) == 2
    assert "signs that XML does not have" in capsys.readouterr().err


@pytest.mark.mpi
@pytest.mark.costly
def test_sets_and_interfaces(folder, comm):
    """A block whose face is a node set, and whose ends are interfaces; sets stand for their nodes."""
    with block_with_ends(comm) as model:
        model.sets["corner"] = np.array([1, 2]) if comm.rank == 0 else np.zeros(0, int)
        with hpcred.reduce(model, [Modes(index=(7, 8, 9)), Krylov(frequency=0.0)], Buckens()) as rom:
            hpcred.write_result(folder / "result.h5", rom, model)
    size = hpcred.read_result(folder / "result.h5").reduced.size
    q = np.random.default_rng(1).normal(size=(4, size))
    if comm.rank == 0:
        with h5py.File(folder / "q.h5", "w") as file:
            file["t"], file["q"] = np.arange(4.0), q
    comm.Barrier()
    hpcred.recover(folder / "result.h5", folder / "q.h5", folder / "out.h5", nodes=["right", "corner", 30])
    phi, numbers, _ = basis(folder / "result.h5")
    with h5py.File(folder / "out.h5") as file:
        assert file["nodes/number"][:3].tolist() == [1, 2, 30]
        assert file["interfaces/name"][...].tolist() == [b"right"]
        assert file["nodes/number"][3] == file["interfaces/number"][0]
        u, place = file["displacement"][...], file["nodes/position"][3]
    assert u[:, :3] == pytest.approx(np.einsum("tm,mki->tki", q, phi[:, [0, 1, 29]]), abs=1e-12 * abs(u).max())
    shape = hpcred.read_result(folder / "result.h5").body(["right"]).nodes[0]
    assert u[:, 3] == pytest.approx(q @ shape.phi.T) and np.array_equal(place, shape.position)
    hpcred.recover(folder / "result.h5", folder / "q.h5", folder / "out.csv", nodes=["left"])
    head = (folder / "out.csv").read_text().split("\n")[0]
    assert head == "t,displacement_left_x,displacement_left_y,displacement_left_z"


@pytest.mark.mpi
def test_nodes_whose_dofs_are_anywhere(folder, comm):
    """All x of a model first, then all y, all z: nodes are whole on one rank again, in ascending order."""
    with hpcred.solid((4, 2, 3), inputs=3, comm=comm) as model, hpcred.reduce(model, [Modes(count=5)]) as rom:
        hpcred.write_result(folder / "result.h5", rom, model)
    order = None
    if comm.rank == 0:
        with h5py.File(folder / "result.h5", "r+") as file:
            node, direction = file["dofs/node"][...], file["dofs/direction"][...]
            order = np.lexsort((-node, direction))
            for key in ("dofs/node", "dofs/direction", "dofs/position"):
                file[key][...] = file[key][...][order]
            file["basis/V"][...] = file["basis/V"][...][:, order]
            del file["checksums"], file.attrs["xxh3"]
    comm.Barrier()
    points = read_points(folder / "result.h5", comm)
    shapes = np.concatenate(comm.allgather(points.shapes.reshape(5, -1, 3)), axis=1)
    phi, numbers, places = basis(folder / "result.h5")
    with h5py.File(folder / "result.h5") as file:
        held = np.unique(file["held/node"][...]) if "held" in file else []
    there = np.isin(np.concatenate(comm.allgather(points.node)), numbers)
    assert (np.diff(np.concatenate(comm.allgather(points.node))) > 0).all()
    assert there.sum() == len(numbers) and (~there).sum() == len(set(held).difference(numbers))
    assert np.array_equal(shapes[:, there], phi) and not shapes[:, ~there].any()
    assert np.array_equal(np.concatenate(comm.allgather(points.position))[there], places)


def test_the_full_model_in_time(tmp_path, monkeypatch):
    """Recovered displacements of all nodes are those of the full model, by a sum of its own modes."""
    monkeypatch.chdir(tmp_path)
    with hpcred.solid((6, 2, 2), inputs=1) as model:
        K, M, B = dense_model(model)
        with hpcred.reduce(model, [Modes(count=12), Krylov(frequency=0.0)]) as rom:
            hpcred.write_result("result.h5", rom, model)
            Kr, Mr, Br = rom.K, rom.M, rom.B
    speed = 0.5 * np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)[0])
    t = np.linspace(0, 4 * np.pi / speed, 401)

    def response(K, M, b):
        """Displacements and velocities (nt, n) under b (1 - cos speed t) from rest: a sum of modes, exactly."""
        values, shapes = scipy.linalg.eigh(K, M)
        w, load = np.sqrt(values), shapes.T @ b / (values - speed**2)
        forced, free = np.cos(speed * t)[:, None], speed**2 / values * np.cos(np.outer(t, w))
        u = load * (1 - speed**2 / values - forced + free)
        rates = load * (speed * np.sin(speed * t)[:, None] - speed**2 / w * np.sin(np.outer(t, w)))
        return u @ shapes.T, rates @ shapes.T

    q, _ = response(Kr, Mr, Br[:, 0])
    head = ",".join(["t", *(f"q{k + 1}" for k in range(len(Kr)))])
    np.savetxt("q.csv", np.column_stack([t, q]), "%.16e", ",", header=head, comments="")
    report = hpcred.recover("result.h5", "q.csv", "out.h5", quantities=("displacement", "velocity"))
    assert any("velocities by differences of the coordinates" in remark for remark in report["remarks"])
    found, expected = arrays("out.h5"), response(K, M, B[:, 0])
    with h5py.File("result.h5") as file:
        node, direction = file["dofs/node"][...], file["dofs/direction"][...]
    place = np.searchsorted(found["nodes/number"], node)
    u = found["displacement"][:, place, direction]
    assert u == pytest.approx(expected[0], abs=1e-4 * np.abs(expected[0]).max())
    v = found["velocity"][:, place, direction]
    apart = np.abs(v - expected[1]).max(axis=1) / np.abs(expected[1]).max()
    # one-sided differences at both ends have twice the error of those between, h^2/3 and h^2/6 of the third derivative
    assert apart[1:-1].max() < 5e-3 and apart[[0, -1]].max() < 1e-2


STRESS_JOB = """
model = "model.h5"
output = "result.h5"
stress = true
write_basis = true
[[basis]]
kind = "modes"
count = 4
[[basis]]
kind = "krylov"
frequency = 0.0
"""


@pytest.mark.mpi
def test_stresses_over_time(folder, comm):
    """Linear in the coordinates, von Mises of each instant, and the largest of all; in ParaView's files too."""
    with hpcred.solid((4, 2, 3), inputs=3, comm=comm) as model:
        hpcred.write_model(folder / "model.h5", model)
    if comm.rank == 0:
        (folder / "job.toml").write_text(STRESS_JOB)
    comm.Barrier()
    assert run(["reduce", str(folder / "job.toml")]) == 0
    with h5py.File(folder / "result.h5") as file:
        S, nodes = file["basis/stress"][...], file["basis/stress_node"][...]
    q = np.random.default_rng(1).normal(size=(5, len(S)))
    if comm.rank == 0:
        with h5py.File(folder / "q.h5", "w") as file:
            file["t"], file["q"] = np.arange(5.0), q
    comm.Barrier()
    report = hpcred.recover(folder / "result.h5", folder / "q.h5", folder / "out.h5", stress=True)
    expected = np.einsum("tm,msc->tsc", q, S)
    with h5py.File(folder / "out.h5") as file:
        order = np.argsort(file["stress_node"][...])
        assert np.array_equal(file["stress_node"][...][order], np.sort(nodes))
        stress, mises = file["stress"][...][:, order], file["von_mises"][...][:, order]
    expected = expected[:, np.argsort(nodes)]
    assert stress == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())
    tensor = expected[..., [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
    deviator = tensor - np.trace(tensor, axis1=2, axis2=3)[..., None, None] / 3 * np.eye(3)
    size = np.sqrt(1.5 * (deviator**2).sum(axis=(2, 3)))
    assert mises == pytest.approx(size, rel=1e-10)
    i, k = np.unravel_index(size.argmax(), size.shape)
    largest = {"value": pytest.approx(size.max()), "node": np.sort(nodes)[k], "t_s": float(i)}
    assert report["largest_von_mises_pa"] == largest
    hpcred.recover(folder / "result.h5", folder / "q.h5", folder / "out.vtu", stress=True, start=2.0, end=2.0)
    mesh = vtu_reading.read(folder / "out.vtu")
    rows = np.searchsorted(mesh.point_data["node"], np.sort(nodes))
    assert mesh.point_data["von_mises"][rows] == pytest.approx(size[2], rel=1e-10)
    assert mesh.point_data["stress"].shape == (len(mesh.points), 6)
    some = np.sort(nodes)[[0, 7]].tolist()
    hpcred.recover(folder / "result.h5", folder / "q.h5", folder / "out.csv", stress=True, nodes=some)
    table = np.genfromtxt(folder / "out.csv", delimiter=",", names=True)
    assert table[f"von_mises_{some[1]}"] == pytest.approx(size[:, 7], rel=1e-9)
    assert table[f"stress_{some[1]}_yz"] == pytest.approx(expected[:, 7, 4], rel=1e-9)


def test_what_comes_off_stresses_of_temperatures_is_said(tmp_path):
    steel = hpcred.fe.Material(name="steel", young=2.1e11, poisson=0.3, expansion=1.2e-5)
    hot = hpcred.loads.Temperature(name="hot")
    with (
        hpcred.solid((2, 1, 1), inputs=1) as bare, bare.with_material(steel) as model,
        model.with_loads([hot]) as heated, hpcred.reduce(heated, [hpcred.StaticCorrection()]) as rom,
    ):  # fmt: skip
        modes = hpcred.stress_modes(heated, rom.columns)
        hpcred.write_result(tmp_path / "result.h5", rom, heated, stress=modes)
    names = ",".join(f"q{k + 1}" for k in range(len(modes.stress)))
    (tmp_path / "q.csv").write_text(f"t,{names}\n" + ",".join(["0"] * (len(modes.stress) + 1)) + "\n")
    for stress in (False, True):
        report = hpcred.recover(tmp_path / "result.h5", tmp_path / "q.csv", tmp_path / "out.csv", stress=stress)
        told = [remark for remark in report["remarks"] if remark.startswith("load 'hot': recovered stresses are those")]
        assert len(told) == stress


@pytest.mark.mpi
@pytest.mark.costly
def test_nodes_that_are_held_rest(folder, comm):
    """Their largest displacement is zero, at one of them."""
    with (
        block_with_ends(comm, "rigid") as model,
        hpcred.reduce(model, [hpcred.Modes(count=3)], hpcred.Tangent("left")) as rom,
    ):
        hpcred.write_result(folder / "result.h5", rom, model)
    if comm.rank == 0:
        with h5py.File(folder / "q.h5", "w") as file:
            file["t"], file["q"] = np.arange(2.0), np.ones((2, 3))
    comm.Barrier()
    report = hpcred.recover(folder / "result.h5", folder / "q.h5", folder / "out.h5", nodes=[1])
    assert report["largest_displacement_m"] == {"value": 0.0, "node": 1, "t_s": 0.0}


def test_on_the_command_line(simulated, monkeypatch, capsys):
    monkeypatch.chdir(simulated)
    capsys.readouterr()
    assert run(["recover", "result.h5", "simulation.h5", "-o", "out.csv", "--nodes", "1,20", "--from", "0.02", "--to",
                "0.03", "--quantities", "velocity,displacement", "--json", "out.json"]) == 0  # fmt: skip
    report, shown = json.loads(Path("out.json").read_text()), capsys.readouterr().out
    assert report["instants"] == 5 and report["nodes"] == 2
    assert "out.csv: 5 instants of 2 nodes" in shown and "velocity (m/s)" in shown
    first = Path("out.csv").read_text().split("\n")[0].split(",")
    assert first[1] == "displacement_1_x" and first[7] == "velocity_1_x" and len(first) == 13


@pytest.mark.parametrize("words, says", [
    (["simulation.h5", "--units", "mm,t,s"], "--units: belongs to --deck and --answers; what is recovered is in SI"),
    (["--deck", "calculix", "--input", "a.inp", "--nodes", "1"], "--nodes: belongs to MOTION; leave it out with"),
    (["--answers", "a.frd", "--stress", "--every", "2"], "--stress: belongs to MOTION; leave it out with --deck"),
    (["simulation.h5", "--answers", "a.frd"], "expected one of MOTION, --deck with --input, and --answers"),
    (["--deck", "calculix"], "--deck, --input: found one without the other"),
])  # fmt: skip
def test_options_that_do_not_belong_together_are_refused(words, says, capsys):
    assert run(["recover", "result.h5", "-o", "out", *words]) == 2
    assert says in " ".join(capsys.readouterr().err.split())


def test_an_empty_list_of_nodes_is_refused(simulated, monkeypatch, capsys):
    monkeypatch.chdir(simulated)
    Path("q.csv").write_text("t,q1,q2,q3,q4,q5,q6\n0,0,0,0,0,0,0\n")
    assert run(["recover", "result.h5", "q.csv", "-o", "out.csv", "--nodes", ""]) == 2
    assert "--nodes: found an empty text" in capsys.readouterr().err


@pytest.fixture
def coordinates(simulated_once, tmp_path, monkeypatch):
    """A function that writes coordinates (nt, m) of the linkage as q.csv, and recovers from them."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(simulated_once / "result.h5", tmp_path)

    def make(q, t=None, output="out.h5", **keywords):
        t = np.arange(len(q)) / 100 if t is None else t
        head = ",".join(["t", *(f"q{k + 1}" for k in range(q.shape[1]))])
        np.savetxt("q.csv", np.column_stack([t, q]), "%.16e", ",", header=head, comments="")
        return hpcred.recover("result.h5", "q.csv", output, **keywords)

    return make


@pytest.mark.parametrize("message, more", [
    (r"q.csv: found 5 coordinates, expected 6 of the result; the motion is that of another body",
     {"q": np.ones((3, 5))}),
    (r"q.csv: q is not finite at instant 2 of 3, expected finite numbers",
     {"q": np.array([[1.0] * 6, [np.nan] * 6, [1.0] * 6])}),
    (r"q.csv: found t = 0.5 s after 1 s, expected instants that ascend", {"t": [0, 1, 0.5]}),
    (r"q.csv: found 2 instants and no velocities, which differences give from 3 on",
     {"q": np.ones((2, 6)), "quantities": ["velocity"]}),
    (r"q.csv: no instant from 5 to inf s, found 0 to 0.02 s", {"start": 5.0}),
    (r"node 99 does not exist; nodes have the numbers of the finite-element program", {"nodes": [1, 99]}),
    (r"node 'bearing': no interface or node set of this name; interfaces: none; node sets: none",
     {"nodes": ["bearing"]}),
    (r"q.csv: it does not have the motion of the body frame, which places in inertial axes need", {"inertial": True}),
    (r"output out.vtu: found 3 instants, and a .vtu has one; choose .pvd", {"output": "out.vtu"}),
    (r"output out.txt: found a name that ends in .txt, expected one of .pvd, .vtu, .csv, .h5", {"output": "out.txt"}),
    (r"output result.h5: this is result.h5, which this run reads", {"output": "result.h5"}),
    (r"quantities: found 'speed', expected displacement, velocity, acceleration", {"quantities": ["speed"]}),
    (r"quantities: found none", {"quantities": []}),
    (r"every: found 0, expected at least 1", {"every": 0}),
    (r"--first: belongs to a solution of Exudyn; q.csv is none", {"first": 7}),
    (r"result.h5: no stress modes; reduce with stress = true, or let the finite-element program", {"stress": True}),
])  # fmt: skip
def test_what_is_refused(coordinates, message, more):
    with pytest.raises(InputError, match=message):
        coordinates(**{"q": np.ones((3, 6)), **more})
    assert sorted(path.name for path in Path().iterdir() if path.name.startswith("out")) == []


def test_a_large_table_is_refused(coordinates, monkeypatch):
    monkeypatch.setattr("hpcred.files.recovered_file.LARGEST_TABLE", 3000)
    with pytest.raises(InputError, match=r"output out.csv: 3 instants of 60 numbers, about 3.29e-06 GB of text; "
                                         r"expected at most 3e-06 GB: choose nodes or fewer instants"):  # fmt: skip
        coordinates(np.ones((3, 6)), output="out.csv")


def test_a_motion_of_another_basis_is_refused(simulated, monkeypatch):
    monkeypatch.chdir(simulated)
    assert run(["reduce", "job.toml", "--set", "basis.0.index=[7, 8, 9, 10, 11, 13]"]) == 0
    with pytest.raises(InputError, match=r"simulation.h5: the motion is that of another result, with another basis"):
        hpcred.recover("result.h5", "simulation.h5", "out.h5")


def test_a_result_without_basis_or_nodes_is_refused(linkage_folder):
    from helpers import reduce_linkage

    reduce_linkage(Path(), "write_basis = false\n" + MODES_JOB)
    np.savetxt("q.csv", np.ones((3, 7)) * np.arange(1, 4)[:, None], "%g", ",", comments="",
               header="t,q1,q2,q3,q4,q5,q6")  # fmt: skip
    with pytest.raises(InputError, match=r"result.h5: no basis with node coordinates; reduce a model with nodes"):
        hpcred.recover("result.h5", "q.csv", "out.h5")
