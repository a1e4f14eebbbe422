"""Models and reduced models under a constant load."""

import numpy as np
import pytest
from helpers import face, to_dense

import hpcred
from hpcred import Modes, Preload, Tangent, preloaded
from hpcred.body.body import body_of
from hpcred.body.preload import reduced_at
from hpcred.model.rotation import spin_softening
from hpcred.parallel.failures import InputError
from hpcred.settings.preload_text import preload_of

CLAMP = Tangent("left")


def blade(comm, cells=(12, 2, 2), **more):
    with hpcred.solid(cells, (1.0, 0.02, 0.03), 3, False, comm, poisson=0.0, **more) as plain:
        return plain.with_interfaces([face("left", 0.0, kind="rigid"), face("right", 1.0, kind="rigid")])


@pytest.mark.mpi
@pytest.mark.parametrize("preload", [
    Preload(omega=(0.0, 0.0, 100.0)), Preload(omega=(50.0, 60.0, 80.0)), Preload(forces={"right:x": 4e3}),
    Preload(acceleration=(-3000.0, 0.0, 0.0), angular_acceleration=(0.0, 0.0, 50.0)),
])  # fmt: skip
def test_modes_of_the_whole_and_of_the_reduced_body_agree(comm, preload):
    with blade(comm) as model, hpcred.reduce(model, [Modes(count=10)], CLAMP) as rom:
        stiffness = hpcred.geometric_stiffness(model, rom.columns, CLAMP)
        body = body_of(model, rom, geometric_stiffness=stiffness)
        found = reduced_at(body, preload).frequencies[:3]
        with preloaded(model, preload, CLAMP) as loaded:
            whole = hpcred.natural_modes(loaded, 3, CLAMP).frequencies
            assert loaded.symmetric and loaded.input_names == model.input_names
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
        preload_of(text)
