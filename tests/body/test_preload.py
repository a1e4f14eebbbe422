"""Models and reduced models under a constant load."""

import numpy as np
import pytest
from helpers import columns_of, face, few_on_ranks, gather, to_dense

import hpcred
from hpcred import Modes, SecondOrderModel, Tangent, preloaded
from hpcred.body import Preload
from hpcred.body.body import body_of, remarks
from hpcred.body.preload import reduced_at, warning_of_basis
from hpcred.body.units import in_units, sizes_of
from hpcred.model import units_of
from hpcred.model.rotation import spin_softening
from hpcred.parallel.failures import InputError
from hpcred.settings import texts
from hpcred.writers.sid import build_sid

CLAMP = Tangent("left")


def blade(comm, cells=(12, 2, 2), **more):
    with hpcred.solid(cells, (1.0, 0.02, 0.03), 3, False, comm, poisson=0.0, **more) as plain:
        return plain.with_interfaces([face("left", 0.0, kind="rigid"), face("right", 1.0, kind="rigid")])


@pytest.mark.mpi
@pytest.mark.parametrize("preload", few_on_ranks([
    Preload(omega=(50.0, 60.0, 80.0)), Preload(forces={"right:x": 4e3}), Preload(omega=(0.0, 0.0, 100.0)),
    Preload(acceleration=(-3000.0, 0.0, 0.0), angular_acceleration=(0.0, 0.0, 50.0)),
], 2))  # fmt: skip
@pytest.mark.costly
def test_modes_of_the_whole_and_of_the_reduced_body_agree(comm, preload):
    with blade(comm) as model, hpcred.reduce(model, [Modes(count=10)], CLAMP) as rom:
        stiffness = hpcred.geometric_stiffness(model, rom.columns, CLAMP)
        body = body_of(model, rom, geometric_stiffness=stiffness)
        found = reduced_at(body, preload).frequencies[:3]
        with preloaded(model, preload, CLAMP) as loaded:
            whole = hpcred.natural_modes(loaded, 3, CLAMP).frequencies
            assert loaded.symmetric and loaded.input_names == model.input_names and loaded.remarks == ()
    assert found == pytest.approx(whole, rel=1e-3)
    assert np.abs(whole / rom.frequencies[:3] - 1).max() > 3e-3


@pytest.mark.mpi
def test_spin_softening_is_that_of_all_nodes(comm):
    w = np.array([5.0, -7.0, 9.0])
    with hpcred.solid((3, 2, 1), None, 3, False, comm) as model:
        mat = spin_softening(model, tuple(w))
        found, mass = to_dense(mat), to_dense(model.M)
        mat.destroy()
    square = np.outer(w, w) - w @ w * np.eye(3)  # w x (w x u)
    assert found == pytest.approx(np.kron(mass[::3, ::3], square), abs=1e-12 * np.abs(found).max())


def test_a_column_that_buckles_has_no_frequency(comm):
    with blade(comm) as model, hpcred.reduce(model, [Modes(count=4)], CLAMP) as rom:
        body = body_of(model, rom, geometric_stiffness=hpcred.geometric_stiffness(model, rom.columns, CLAMP))
    stiff = (2 * np.pi * rom.frequencies[0]) ** 2 * 7850 * 0.02 * 0.03 / 1.8751041**4  # EI as the mesh has it
    buckles = np.pi**2 * stiff / 4
    assert reduced_at(body, Preload(forces={"right:x": -0.9 * buckles})).frequencies[0] < 0.5 * rom.frequencies[0]
    with pytest.raises(InputError, match=r"preload: the body has no stable state there: the lowest eigenvalue"):
        reduced_at(body, Preload(forces={"right:x": -1.3 * buckles}))
    with pytest.raises(InputError, match=r"found 'crank:x', expected nodes with states of load: .*left"):
        reduced_at(body, Preload(forces={"crank:x": 1.0}))
    assert reduced_at(body, Preload(forces={"left:x": 1.0})).frequencies == pytest.approx(rom.frequencies)


@pytest.mark.mpi
@pytest.mark.costly
def test_a_preload_counts_once(comm, folder):
    """In K, and no longer among the states; once more, or of a stiffened body, it is refused. A SID file has V^T f of
    it in ksigma, against numpy, in any units, and leaves spin softening to the program that turns the body."""
    preload = Preload(
        omega=(30.0, 40.0, 120.0), acceleration=(5.0, -6.0, 7.0), angular_acceleration=(70.0, 80.0, -90.0),
        forces={"right:x": 900.0, "right:rz": 20.0},
    )  # fmt: skip
    with blade(comm) as model, hpcred.reduce(model, [Modes(count=6)], CLAMP) as rom:
        stiffness = hpcred.geometric_stiffness(model, rom.columns, CLAMP, nodes=["right"])
        hpcred.write_result(folder / "r.h5", rom, model, geometric_stiffness=stiffness)
        V, M = gather(rom.columns), to_dense(model.M)
        arm = np.concatenate(comm.allgather(model.dofs.position))[::3]
        with model.with_inputs([("right", "x"), ("right", "rz")]) as pushed:
            push = columns_of(pushed.B) @ [900.0, 20.0]
        softening = spin_softening(model, preload.omega)
        soft = V.T @ to_dense(softening) @ V
    w, turn = np.array(preload.omega), np.array(preload.angular_acceleration)
    field = preload.acceleration + np.cross(turn, arm) + np.cross(w, np.cross(w, arm))
    force = V.T @ (push - M @ field.ravel())
    result = hpcred.read_result(folder / "r.h5", comm)
    found = result.at_preload(preload)
    assert found.prestress.forces == pytest.approx(force, abs=1e-9 * np.abs(force).max())
    assert found.prestress.softening == pytest.approx(soft, abs=1e-9 * np.abs(soft).max())
    assert found.geometric_stiffness.states == ("right:y", "right:z", "right:rx", "right:ry")
    sid, notes = build_sid(found.body(), "component")
    assert sid.objects["ksigma"].m0[:, 0] == pytest.approx(force, abs=1e-9 * np.abs(force).max())
    stressed = result.reduced.K + stiffness.sum(preload.values)
    assert sid.objects["Ke"].m0 == pytest.approx(stressed, abs=1e-9 * np.abs(stressed).max())
    assert any(note.startswith("at a preload: Ke has its stress and ksigma its forces") for note in notes)
    assert not any("softening" in note for note in notes) and "spin softening" in " ".join(remarks(found.body()))
    other, units = in_units(found.body(), units_of("mm,t,s")), units_of("mm,t,s")
    q = [np.linalg.solve(body.reduced.K, body.prestress.forces) for body in (found.body(), other)]
    assert q[1] * sizes_of(rom, units) == pytest.approx(q[0], rel=1e-9, abs=1e-12 * np.abs(q[0]).max())
    assert other.prestress.softening / other.reduced.K == pytest.approx(soft / found.reduced.K, rel=1e-6)
    with pytest.raises(InputError, match=r"preload: the body is at a preload already, and its stress would count"):
        found.at_preload(preload)
    with pytest.raises(InputError, match=r"preload: the body is stiffened \(Body.stiffened\) already"):
        reduced_at(result.body().stiffened(), preload)


@pytest.mark.mpi
@pytest.mark.parametrize("density", [7850.0, None])
def test_a_body_whose_matrices_lack_their_supports_is_told_what_is_missing(comm, density):
    """M between held and free dofs, in numpy, against what the elements at the supports have."""
    preload, origin = Preload(omega=(0.0, 0.0, 2.0), acceleration=(0.0, 0.0, 3.0)), np.array([-0.2, 0.0, 0.0])
    with hpcred.solid((6, 2, 2), (1.0, 0.2, 0.3), 3, False, comm) as free:
        steel = hpcred.fe.Material(name="steel", young=2.1e11, poisson=0.3, density=density)
        position, direction = (np.concatenate(comm.allgather(getattr(free.dofs, key)))
                               for key in ("position", "direction"))  # fmt: skip
        held, M = np.flatnonzero(position[:, 0] < 1e-9), to_dense(free.M)
        mine = held[(held >= free.first_row) & (held < free.first_row + free.local_rows)]
        with (
            SecondOrderModel.from_petsc(free.K, free.M, held=mine, dofs=free.dofs, elements=free.elements) as bare,
            bare.with_material(steel) as model, preloaded(model, preload, origin=origin) as loaded,
        ):  # fmt: skip
            (remark,) = loaded.remarks
    w = np.array(preload.omega)
    field = (preload.acceleration + np.cross(w, np.cross(w, position - origin)))[np.arange(len(M)), direction]
    left = np.setdiff1d(np.arange(len(M)), held)
    lost, whole = (np.abs(M[np.ix_(left, part)] @ field[part]).sum() for part in (held, left))
    size = f"({lost / whole:.2g} of all forces)" if density else "(how much that is needs densities)"
    count = np.count_nonzero(field[held])
    assert remark.startswith(f"preload: the inertia of the mass at {count} held dofs is not in M {size}")


@pytest.mark.mpi
def test_bodies_that_a_preload_does_not_fit(comm):
    with blade(comm, (4, 1, 1)) as model:
        with pytest.raises(InputError, match="preload: solid is a free body, whose rigid-body motions"):
            preloaded(model, Preload(omega=(0.0, 0.0, 1.0)))
        with pytest.raises(InputError, match="'crank' is no interface"):
            preloaded(model, Preload(forces={"crank:x": 1.0}), CLAMP)
        with pytest.raises(InputError, match="preload: solid has no direction 9:rx"):
            preloaded(model, Preload(forces={"9:rx": 1.0}), CLAMP)
        with hpcred.reduce(model, [Modes(count=2)], CLAMP) as rom:
            body = body_of(model, rom)
        with pytest.raises(InputError, match="preload: the result has no geometric stiffness; reduce with"):
            reduced_at(body, Preload(omega=(0.0, 0.0, 1.0)))


WRONG = [
    ("{omega = [0, 0]}", r"^preload.omega: found \[0, 0\], expected"),
    ("{omega = 300}", r"^preload.omega: found 300, expected"),
    ("{spin = [0, 0, 1]}", r"^preload.spin: unknown key; known are omega, acceleration, angular_acceleration, forces"),
    ("omega=300", r"^--preload: found 'omega=300', expected a table such as"),
    ('{forces = {"wz^2" = 1.0}}', r"preload.forces: found 'wz\^2', expected node and direction"),
    ('{forces = {"crank" = 1.0}}', r"found the state 'crank', expected one of"),
]


@pytest.mark.parametrize("text, says", WRONG)
def test_preloads_that_make_no_sense(text, says):
    with pytest.raises(InputError, match=says):
        texts.preload(text, "--preload")


@pytest.mark.parametrize("count, speed, far", [(6, 6.0, False), (6, 60.0, True), (20, 60.0, False)])
def test_a_preload_far_from_the_basis_is_warned_of(count, speed, far):
    """A slender beam that spins about its clamp, against the full model under the load."""
    load = Preload(omega=(0.0, 0.0, speed))
    with (
        hpcred.solid((20, 1, 1), (10.0, 0.08, 0.02), 1, young=2.8e10, poisson=0.0, density=1200.0) as beam,
        hpcred.reduce(beam, [Modes(count=count)]) as rom, preloaded(beam, load) as spun,
        hpcred.reduce(spun, [Modes(count=1)]) as exact,
    ):  # fmt: skip
        body = body_of(beam, rom, geometric_stiffness=hpcred.geometric_stiffness(beam, rom.columns))
        found = reduced_at(body, load)
        error = found.frequencies[0] / exact.frequencies[0] - 1
        assert error > 0.01 if far else abs(error) < 1e-3
        told = warning_of_basis(body, load)
        assert bool(told) == far and (told in found.record.warnings) == far
        assert not far or error < float(told.partition(" Hz, is ")[2].partition("%")[0]) / 100 < 10 * error
