"""The sign of a stiffness of stress, and how far from equilibrium with its state it may be."""

from contextlib import contextmanager

import numpy as np
import pytest
from solid_meshes import mesh, model_of, stiffness

import hpcred
from hpcred import InputError, Material, Preload
from hpcred.body.stress_equilibrium import SAME, sign_of_stress_stiffness
from hpcred.model.element_rules import FULL

STEEL = Material(name="steel", young=2.1e11, poisson=0.3)
FORCE = 250.0  # N, so that squares of forces are far from 1


@contextmanager
def pulled(comm, cells):
    """A bar of bricks that is clamped at x = 0, the stiffness of its stress under a force, and where this acts."""
    points, elements = mesh("hexahedron", cells=(cells, 1, 1), size=(0.1 * cells, 0.04, 0.03), distortion=0.0)
    held = np.flatnonzero(points[:, 0] < 1e-6)
    K = stiffness("hexahedron", FULL, points, elements, STEEL.young, STEEL.poisson)
    target = f"{len(points)}:x"
    with (
        model_of("hexahedron", "hpcred", "hexahedron", points, elements, STEEL, comm, K, held) as plain,
        plain.with_inputs([(len(points), "x")]) as model,
        hpcred.preloaded(model, Preload(forces={target: FORCE})) as loaded,
    ):
        stress = loaded.K.copy()
        stress.axpy(-1.0, model.K)
        yield model, stress, target
        stress.destroy()


@pytest.mark.mpi
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stiffness_that_is_off_by_less_than_the_limit(comm, sign):
    """K_sigma is linear in the load, so that of a K_sigma the share |a - 1| of its forces is left."""
    assert SAME == 0.02
    with pulled(comm, 4) as (model, stress, target):
        for factor in (1.0, 0.985, 1.015):
            assert sign_of_stress_stiffness(model, sign * factor * stress, target, FORCE, "x.full") == sign
        for factor, left in ((0.97, "3.0e-02"), (1.03, "3.0e-02"), (0.5, "5.0e-01")):
            with pytest.raises(InputError, match=rf"x.full: .* equilibrium with the state .* \({left} of its forces"):
                sign_of_stress_stiffness(model, sign * factor * stress, target, FORCE, "x.full")


@pytest.mark.mpi
def test_a_body_of_nodes_beside_its_support_tells_no_sign(comm):
    with pulled(comm, 1) as (model, stress, target), pytest.raises(InputError, match="its forces act on supports only"):
        sign_of_stress_stiffness(model, stress, target, FORCE, "x.full")
