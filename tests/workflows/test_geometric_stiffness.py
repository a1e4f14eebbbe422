"""Geometric stiffness by job files."""

import json
import shutil

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.linalg
from calculix_runs import input_lines, run_calculix
from helpers import block_with_ends, refused, to_dense
from solid_meshes import mesh

import hpcred
from hpcred.cli.main import run
from hpcred.parallel.failures import InputError

JOB = """
model = "model.h5"
geometric_stiffness = true
body_origin = [0.01, 0.0, 0.0]
[frame]
kind = "buckens"
[[interface]]
name = "left"
nodes = {box = [[-1e-6, -1.0, -1.0], [1e-6, 1.0, 1.0]]}
[[interface]]
name = "right"
nodes = {box = [[0.059999, -1.0, -1.0], [0.060001, 1.0, 1.0]]}
[[basis]]
kind = "modes"
count = 4
"""


@pytest.mark.mpi
def test_a_job_makes_what_python_does(comm, folder):
    with block_with_ends(comm) as model:
        hpcred.write_model(folder / "model.h5", model)
        with hpcred.reduce(model, [hpcred.Modes(count=4)], hpcred.Buckens()) as rom:
            wanted = hpcred.geometric_stiffness(model, rom.columns, hpcred.Buckens(), origin=(0.01, 0.0, 0.0))
    if comm.rank == 0:
        (folder / "job.toml").write_text(JOB)
    comm.Barrier()
    hpcred.reduce_job(folder / "job.toml", comm=comm)
    found = hpcred.read_result(folder / "result.h5", comm).geometric_stiffness
    assert hpcred.info(folder / "result.h5", comm=comm)["geometric_stiffness"] == list(wanted.states)
    assert found.states == wanted.states and found.origin.tolist() == [0.01, 0.0, 0.0]
    sizes = np.abs(wanted.matrices).max(axis=(1, 2), keepdims=True)
    assert (np.abs(np.abs(found.matrices) - np.abs(wanted.matrices)) < 1e-6 * sizes).all()


@pytest.mark.mpi
def test_bodies_without_stresses_are_refused_before_the_reduction(comm, folder):
    with hpcred.linkage(comm) as model:
        hpcred.write_model(folder / "model.h5", model)
    if comm.rank == 0:
        (folder / "job.toml").write_text(JOB)
    comm.Barrier()
    with pytest.raises(InputError, match=r"^geometric stiffness: model.h5: stress: found line, expected solids"):
        hpcred.reduce_job(folder / "job.toml", comm=comm, overrides=['inputs=[[20, "z"]]', "interface=[]"])
    assert not (folder / "result.h5").exists()


def test_commands_at_a_preload(folder, capsys):
    """modes, response, evaluate and export have the same stiffening."""
    with hpcred.solid((6, 1, 1), (0.06, 0.004, 0.003), 3, False) as model:
        hpcred.write_model(folder / "model.h5", model)
    model, result = str(folder / "model.h5"), str(folder / "result.h5")
    job = JOB.replace('"buckens"', '"chord"\nnodes = [1, 25, 3]').replace("count = 4", "count = 20")
    (folder / "job.toml").write_text(job.replace("body_origin = [0.01, 0.0, 0.0]", ""))
    hpcred.reduce_job(folder / "job.toml")
    preload = "{omega = [0, 0, 6000], acceleration = [0, 500, 0]}"
    numbers = folder / "numbers.json"
    assert run(["modes", model, "--frame", "chord:1,25,3", "--preload", preload, "--json", str(numbers)]) == 0
    whole = np.array(json.loads(numbers.read_text())["frequencies_hz"])
    assert run(["modes", model, "--frame", "chord:1,25,3", "--json", str(numbers)]) == 0
    plain = np.array(json.loads(numbers.read_text())["frequencies_hz"])
    assert run(["evaluate", result, "--band", "0,100", "--preload", preload, "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert "pseudo-frequencies at the preload (Hz): " in capsys.readouterr().out
    assert found["pseudo_frequencies_hz"][:4] == pytest.approx(whole[:4], rel=2e-3)
    assert np.abs(whole / plain - 1)[:4].max() > 0.02
    arguments = ["response", model, "--frame", "chord:1,25,3", "--frequencies", "0,50", "--inputs", "13:z"]
    assert run([*arguments, "--preload", preload, "--json", str(numbers)]) == 0
    loaded = json.loads(numbers.read_text())["norm"]
    assert run([*arguments, "--json", str(numbers)]) == 0
    assert np.abs(np.array(loaded) / json.loads(numbers.read_text())["norm"] - 1).max() > 0.01
    assert run(["export", result, "--format", "npz", "-o", str(folder / "k.npz"), "--preload", preload]) == 0
    note = "K has the stress of the preload ay = 500, wz^2 = 3.6e+07"
    assert f"note: {note}" in capsys.readouterr().out
    assert run(["export", result, "--format", "fmu", "-o", str(folder / "k.fmu"), "--preload", preload]) == 0
    assert f"note: {note}" in capsys.readouterr().out
    with np.load(folder / "k.npz") as arrays:
        assert note in str(arrays["comment"])
        squares = scipy.linalg.eigvalsh(arrays["K"], arrays["M"])
    assert np.sqrt(squares[:4]) / 2 / np.pi == pytest.approx(found["pseudo_frequencies_hz"][:4], rel=1e-9)


def test_preloads_that_a_command_does_not_take(folder, capsys):
    with (
        hpcred.solid((2, 1, 1), None, 3, False) as model,
        hpcred.reduce(model, hpcred.Modes(count=8), hpcred.Buckens()) as rom,
    ):
        rom.save(folder / "r.h5")
        hpcred.write_model(folder / "m.h5", model)
    result, model = str(folder / "r.h5"), str(folder / "m.h5")
    says = refused(capsys, "evaluate", result, "--full", model, "--preload", "{omega = [0, 0, 1]}")
    assert "--preload: cannot be combined with --full, which is without load" in says
    says = refused(capsys, "evaluate", result, "--preload", "{omega = [0, 0, 1]}")
    assert "preload: the result has no geometric stiffness; reduce with geometric_stiffness = true" in says
    assert "is a free body" in refused(capsys, "modes", model, "--preload", "{omega = [0, 0, 1]}")


TABLES = """
model = "m.h5"
geometric_stiffness = [
    {state = "wz^2", value = 9e4, stresses = "spin.dat"},
    {state = "ax", value = -100.0, stresses = "pull.dat"},
]
[[basis]]
kind = "modes"
count = 6
"""


@pytest.mark.ccx
@pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx")
@pytest.mark.parametrize(("type_", "kind"), [("C3D20", "hexahedron20"), ("C3D8I", "hexahedron"), ("C3D10", "tetra10")])
def test_files_of_calculix(folder, comm, type_, kind):
    """Stresses that it prints, and its stiffness under the load: as by hpcred's own stresses."""
    points, elements = mesh(kind, cells=(8, 1, 1), size=(0.8, 0.06, 0.02), distortion=0.0)
    points += [0.1, -0.03, -0.01]
    lines = [*input_lines(type_, points, elements), "*BOUNDARY"]
    lines += [f"{n}, 1, 3" for n in np.flatnonzero(points[:, 0] < 0.1001) + 1]
    run_calculix(folder, "m", [*lines, "*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "10"])
    spin = ["*STEP", "*STATIC", "*DLOAD", "EALL, CENTRIF, 9e4, 0., 0., 0., 0., 0., 1."]
    pull = ["*STEP", "*STATIC", "*DLOAD", "EALL, GRAV, 100., 1., 0., 0."]  # a body that is accelerated against x
    printed = ["*EL PRINT, ELSET=EALL", "S"]
    for name, load in (("spin", spin), ("pull", pull)):
        run_calculix(folder, name, [*lines, *load, *printed])
    stored = ["*END STEP", "*STEP, PERTURBATION", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "10"]
    run_calculix(folder, "loaded", [*lines, *spin, *stored])
    hpcred.convert(folder / "m.inp", folder / "m.h5", inputs=[(int(points[:, 0].argmax()) + 1, "z")])
    (folder / "job.toml").write_text(TABLES)
    hpcred.reduce_job(folder / "job.toml")
    printed = hpcred.read_result(folder / "result.h5").geometric_stiffness
    change = 'geometric_stiffness=[{state = "wz^2", value = 9e4, file = "loaded.inp"}]'
    hpcred.reduce_job(folder / "job.toml", overrides=[change, 'output="difference.h5"'])
    difference = hpcred.read_result(folder / "difference.h5").geometric_stiffness
    # of two bending modes; others stretch and twist, with the stiffness of the displacements of the load
    wanted = with_signs(printed.matrices[0], folder / "result.h5", folder / "difference.h5")
    assert difference.matrices[0, :2, :2] == pytest.approx(wanted[:2, :2], rel=1e-2, abs=1e-3)
    if type_ != "C3D8I":  # whose internal modes hpcred does not have
        hpcred.reduce_job(folder / "job.toml", overrides=["geometric_stiffness=true", 'output="own.h5"'])
        own = hpcred.read_result(folder / "own.h5").geometric_stiffness
        for state in ("wz^2", "ax"):
            wanted = with_signs(own.of([state])[0], folder / "own.h5", folder / "result.h5")
            # M of the free dofs has no part of the held ones, whose inertia CalculiX' loads contain
            assert printed.of([state])[0] == pytest.approx(wanted, abs=6e-4 * np.abs(wanted).max())


def with_signs(matrix, path, other):
    """A matrix (m, m) of one result in the coordinates of another, whose modes may have other signs."""
    bases = []
    for name in (path, other):
        with h5py.File(name) as file:
            bases.append(file["basis/V"][...])
    signs = np.sign((bases[0] * bases[1]).sum(axis=1))
    return matrix * np.outer(signs, signs)


@pytest.mark.mpi
@pytest.mark.parametrize("units", ["m, kg, s", "mm, t, s (N, MPa)"])
@pytest.mark.costly
def test_a_matrix_that_is_the_stiffness_of_the_stress(comm, folder, units):
    """By its name in a file with K and M, for a transverse load too; here of a .mat file, in the units from which the
    model was converted."""
    length = 1e3 if units[:2] == "mm" else 1.0
    preload = hpcred.body.Preload(forces={"36:y": 1e3, "33:x": 2e3})
    with hpcred.solid((8, 1, 1), (0.8, 0.02, 0.03), 3, False, comm) as model:
        hpcred.write_model(folder / "model.h5", model.with_fields(converted_from=units))
        frame = hpcred.Chord((1, 33, 3))
        basis = hpcred.Modes(count=4)
        with hpcred.preloaded(model, preload, frame) as loaded, hpcred.reduce(model, basis, frame) as rom:
            matrices = {"M": to_dense(model.M), "K": to_dense(model.K), "KDGG": to_dense(loaded.K) - to_dense(model.K)}
            wanted = hpcred.geometric_stiffness(model, rom.columns, frame, nodes=[36, 33]).sum(preload.forces)
        places = length * model.dofs.position
        nodes = np.concatenate(comm.allgather(np.hstack([model.dofs.node[:, None], places])))[::3]
    if comm.rank == 0:
        scipy.io.savemat(folder / "d.mat", {**{key: item / length for key, item in matrices.items()}, "nodes": nodes})
        table = 'geometric_stiffness = [{state = "36:y", value = 1.0, file = "d.mat", matrix = "KDGG"}]'
        job = JOB.replace("geometric_stiffness = true", table).replace("body_origin = [0.01, 0.0, 0.0]", "")
        job = job.replace("0.059999", "0.799999").replace("0.060001", "0.800001")
        (folder / "job.toml").write_text(job.replace('"buckens"', '"chord"\nnodes = [1, 33, 3]'))
    comm.Barrier()
    hpcred.reduce_job(folder / "job.toml", comm=comm)
    found = hpcred.read_result(folder / "result.h5", comm).geometric_stiffness.matrices[0]
    assert np.abs(found) == pytest.approx(np.abs(wanted), abs=1e-6 * np.abs(wanted).max())


REFUSED = [
    ('[{state = "wz^2", value = 1.0, stresses = "no.dat"}]', "no.dat"),
    ('[{state = "ay", value = 1.0, file = "model.h5"}]', "geometric_stiffness: 'ay': a difference of matrices holds"),
    ('[{state = "crank:x", value = 1.0, stresses = "model.h5"}]', "'crank' is no interface of model.h5"),
    ('[{state = "500:x", value = 1.0, stresses = "model.h5"}]', "node 500 does not exist in model.h5"),
    ('[{state = "ay", value = 1.0, file = "model.h5", matrix = "KDGG"}]', "whose K has no other name"),
    ('[{state = "ay", value = 1.0, stresses = "model.h5", matrix = "KDGG"}]', "matrix: belongs to `file`"),
    ('[{state = "wz^2", value = 1.0}]', "expected one of `stresses` and `file`"),
    ('[{state = "wz^2", value = 1.0, file = "model.h5", units = "mm,t,s"}]', "a model of hpcred, which is in SI"),
    ('[{state = "wz^2", stresses = "spin.dat"}]', r"geometric_stiffness\[0\].value: missing"),
]


@pytest.mark.parametrize("value, says", REFUSED)
def test_tables_of_states_that_do_not_fit(comm, folder, value, says):
    with block_with_ends(comm) as model:
        hpcred.write_model(folder / "model.h5", model)
    (folder / "job.toml").write_text(JOB)
    with pytest.raises(InputError, match=says):
        hpcred.reduce_job(folder / "job.toml", overrides=[f"geometric_stiffness={value}"])


def test_a_two_sided_projection_has_none(comm, folder):
    with hpcred.solid((3, 2, 2), None, 3, False, comm) as model, model.with_outputs([(5, "x")]) as measured:
        hpcred.write_model(folder / "model.h5", measured)
    (folder / "job.toml").write_text(JOB)
    with pytest.raises(InputError, match="geometric_stiffness: a two-sided projection has no displacements of second"):
        hpcred.reduce_job(folder / "job.toml", overrides=['projection="two_sided"', "interface=[]"])
