"""The sign of a stiffness of stress, and how far from equilibrium with its state it may be."""

from contextlib import contextmanager

import numpy as np
import pytest
from solid_meshes import mesh, model_of, stiffness

import hpcred
from hpcred import InputError
from hpcred.body import Preload
from hpcred.body.loaded_states import LUMPED, sign_of_stress_stiffness
from hpcred.fe import Material
from hpcred.fe.element_rules import FULL

STEEL = Material(name="steel", young=2.1e11, poisson=0.3)


@contextmanager
def pulled(comm, cells, force=250.0):
    """A bar of bricks that is clamped at x = 0, the stiffness of its stress under a force, and where this acts."""
    points, elements = mesh("hexahedron", cells=(cells, 1, 1), size=(0.1 * cells, 0.04, 0.03), distortion=0.0)
    held = np.flatnonzero(points[:, 0] < 1e-6)
    K = stiffness("hexahedron", FULL, points, elements, STEEL.young, STEEL.poisson)
    target = f"{len(points)}:x"
    with (
        model_of("hexahedron", "hpcred", "hexahedron", points, elements, STEEL, comm, K, held) as plain,
        plain.with_inputs([(len(points), "x")]) as model,
        hpcred.preloaded(model, Preload(forces={target: force})) as loaded,
    ):
        stress = loaded.K.copy()
        stress.axpy(-1.0, model.K)
        yield model, stress, target
        stress.destroy()


@pytest.mark.mpi
@pytest.mark.parametrize(("sign", "force"), [(1.0, 250.0), (-1.0, 250.0), (1.0, 0.5)])  # squares far from 1
def test_a_stiffness_that_is_off_by_less_than_the_limit(comm, sign, force):
    """K_sigma is linear in the load, so that of a K_sigma the share |a - 1| of its forces is left."""
    assert LUMPED == 0.02
    with pulled(comm, 4, force) as (model, stress, target):
        for factor in (1.0, 0.985, 1.015):
            assert sign_of_stress_stiffness(model, sign * factor * stress, target, force, "x.full") == sign
        for factor, left in ((0.97, "3.0e-02"), (1.03, "3.0e-02"), (0.5, "5.0e-01")):
            with pytest.raises(InputError, match=rf"x.full: .* equilibrium with the state .* \({left} of its forces"):
                sign_of_stress_stiffness(model, sign * factor * stress, target, force, "x.full")


@pytest.mark.mpi
def test_a_body_of_nodes_beside_its_support_tells_no_sign(comm):
    with pulled(comm, 1) as (model, stress, target), pytest.raises(InputError, match="its forces act on supports only"):
        sign_of_stress_stiffness(model, stress, target, 250.0, "x.full")


@pytest.mark.mpi
def test_a_cable_of_nodes_that_turn_one_of_which_slides(comm):
    """A cable along y under a force P at its free end has P / L (I - e e^T) in each piece beyond node 4, which takes
    the force, as it cannot move along y; entries of seven digits, and nodes that turn."""
    count, P, L, slides = 8, 1e6, 0.25, 4
    node, direction = np.repeat(np.arange(1, count + 1), 6), np.tile(np.arange(6), count)
    free = (node > 1) & ((node != slides) | (direction != 1))
    position = np.stack([0.3 + 0 * node, L * node, -0.2 + 0 * node], axis=1)
    piece = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([1.0, 0.0, 1.0, 0.0, 0.0, 0.0])) * P / L
    S = np.zeros((6 * count, 6 * count))
    for k in range(slides - 1, count - 1):
        S[6 * k : 6 * k + 12, 6 * k : 6 * k + 12] += piece
    S *= 1 + 1e-7 * np.random.default_rng(1).normal(size=S.shape)
    half = S * np.where((direction[:, None] == 2) | (direction == 2), 0.5, 1.0)  # along z
    eye, dofs, name = np.eye(free.sum()), hpcred.Dofs(node[free], direction[free], position[free]), f"{count}:y"
    with hpcred.SecondOrderModel.from_scipy(eye, eye, comm=comm, dofs=dofs) as model:
        for matrix, sign in ((S, 1.0), (-S, -1.0), (half, 0.0)):
            with hpcred.SecondOrderModel.from_scipy(matrix[free][:, free], eye, comm=comm) as stress:
                if sign:
                    assert sign_of_stress_stiffness(model, stress.K, name, P, "x.full") == sign
                else:
                    with pytest.raises(InputError, match=r"\(3.5e-01 of its forces are left"):
                        sign_of_stress_stiffness(model, stress.K, name, P, "x.full")
