"""The second matrix in .full files of buckling analyses, of either sign, against the stiffness of own stresses."""

import numpy as np
import pytest
from ansys_files import write_full, write_rst
from helpers import to_dense
from solid_meshes import mass, mesh, model_of, stiffness

import hpcred
from hpcred.fe.element_rules import FULL
from hpcred.model.rotation import spin_softening
from hpcred.parallel.failures import InputError

STEEL = hpcred.fe.Material(name="STEEL", young=2.1e11, poisson=0.3)
JOB = """
model = "model.h5"
inputs = [[14, "z"]]
geometric_stiffness = [{state = "%s", value = %r, file = "buckle.full"}]
[[basis]]
kind = "modes"
count = 5
"""
POINTS, ELEMENTS = mesh("hexahedron", cells=(5, 1, 1), size=(0.5, 0.04, 0.03), distortion=0.0)
POINTS = POINTS + [0.1, 0.0, 0.0]  # from the axis
CLAMPED = np.flatnonzero(POINTS[:, 0] < 0.1001)
K = stiffness("hexahedron", FULL, POINTS, ELEMENTS, 2.1e11, 0.3)
M = mass("hexahedron", POINTS, ELEMENTS, 7850.0)


def body(comm):
    """A clamped bar of five bricks."""
    return model_of("hexahedron", "hpcred", "hexahedron", POINTS, ELEMENTS, STEEL, comm, K, CLAMPED, M)


def stress_stiffness(model, preload):
    """K_sigma (n, n) of a preload, of the free rows."""
    with hpcred.preloaded(model, preload) as loaded:
        change = to_dense(loaded.K) - to_dense(model.K)
    return change - to_dense(spin_softening(model, np.array(preload.omega)))


def put_file(comm, folder, model, S, elastic=1.0, name="buckle.full", length=1.0):
    """A file with all rows, held ones decoupled, and its nodes."""
    size = 3 * len(POINTS)
    held = (3 * CLAMPED[:, None] + np.arange(3)).ravel()
    free = np.setdiff1d(np.arange(size), held)
    matrices = {"K": np.eye(size), "M": np.zeros((size, size))}
    stiff = to_dense(model.K)
    if comm.rank == 0:
        matrices["K"][np.ix_(free, free)] = elastic * stiff
        matrices["M"][np.ix_(free, free)] = S
        nodes = [(n, 3) for n in range(1, len(POINTS) + 1)]
        write_full(folder / name, matrices, nodes, held=held, item4=1)
        rows = np.zeros((len(POINTS), 7))
        rows[:, 0], rows[:, 1:4] = np.arange(1, len(POINTS) + 1), POINTS / length
        write_rst(folder / "buckle.rst", rows)
    comm.Barrier()


def put_job(comm, folder, state, value):
    if comm.rank == 0:
        (folder / "job.toml").write_text(JOB % (state, value))
    comm.Barrier()
    return folder / "job.toml"


@pytest.mark.mpi
@pytest.mark.parametrize("state, value, preload, sign", [
    ("wz^2", 9e4, {"omega": (0.0, 0.0, 300.0)}, 1.0),
    ("ay", 50.0, {"acceleration": (0.0, 50.0, 0.0)}, 1.0), ("14:z", -7.0, {"forces": {"14:z": -7.0}}, -1.0),
])  # fmt: skip
@pytest.mark.costly
def test_the_sign_follows_from_the_equilibrium_of_the_state(comm, folder, state, value, preload, sign):
    """Of loads that are not axial too."""
    with body(comm) as plain, plain.with_inputs([(14, "z")]) as model:
        S = stress_stiffness(model, hpcred.body.Preload(**preload))
        put_file(comm, folder, model, sign * S)
        hpcred.write_model(folder / "model.h5", model)
        with hpcred.reduce(model, [hpcred.Modes(count=5)]) as rom:
            wanted = hpcred.geometric_stiffness(model, rom.columns).of([state])[0]
    hpcred.reduce_job(put_job(comm, folder, state, value), comm=comm)
    found = hpcred.read_result(folder / "result.h5", comm).geometric_stiffness
    scale = np.abs(wanted).max()
    assert found.states == (state,)
    assert np.diag(found.matrices[0]) == pytest.approx(np.diag(wanted), abs=1e-5 * scale)
    assert np.abs(found.matrices[0]) == pytest.approx(np.abs(wanted), abs=1e-5 * scale)


def test_units_of_the_file(comm, folder):
    """In mm, kg and ms forces are in kN and stiffnesses in GN/m."""
    with body(comm) as model:
        S = stress_stiffness(model, hpcred.body.Preload(omega=(0.0, 0.0, 300.0)))
        put_file(comm, folder, model, S / 1e6, 1e-6, length=1e-3)
        hpcred.write_model(folder / "model.h5", model)
        put_job(comm, folder, "wz^2", 9e4)
        change = 'geometric_stiffness=[{state = "wz^2", value = 9e4, file = "buckle.full", units = "mm,kg,ms"}]'
        hpcred.reduce_job(folder / "job.toml", overrides=[change])
        found = hpcred.read_result(folder / "result.h5").geometric_stiffness.matrices[0]
        with model.with_inputs([(14, "z")]) as loaded, hpcred.reduce(loaded, [hpcred.Modes(count=5)]) as rom:
            wanted = hpcred.geometric_stiffness(loaded, rom.columns).of(["wz^2"])[0]
    assert np.abs(found) == pytest.approx(np.abs(wanted), abs=1e-5 * np.abs(wanted).max())


@pytest.mark.mpi
@pytest.mark.costly
def test_matrices_of_other_states_and_bodies_are_refused(comm, folder):
    with body(comm) as model:
        S = stress_stiffness(model, hpcred.body.Preload(omega=(0.0, 0.0, 300.0)))
        hpcred.write_model(folder / "model.h5", model)

        def says(text, state="wz^2", value=9e4, more="", **options):
            put_file(comm, folder, model, S, **options)
            job = put_job(comm, folder, state, value)
            change = [f'geometric_stiffness=[{{state = "{state}", value = {value}, file = "buckle.full"{more}}}]']
            with pytest.raises(InputError, match=text):
                hpcred.reduce_job(job, comm=comm, overrides=change)
            assert not (folder / "result.h5").exists()

        says(r"not in equilibrium with the state 'wz\^2' of 180000 .5.0e-01 of its forces are left.", value=1.8e5)
        says("not in equilibrium with the state 'ax' of 90000", state="ax")
        says("not in equilibrium with the state 'wx wy' of 90000", state="wx wy")
        says("found another stiffness matrix than that of model.h5 .by 1.0e-02., expected", elastic=1.01)
        says("opposite: .*buckle.full has the stiffness of the stress, which", more=', opposite = "model.h5"')
        with pytest.raises(InputError, match="buckling analysis, whose second matrix is stress stiffening and no mass"):
            hpcred.readers.load_export(folder / "buckle.full", comm)
