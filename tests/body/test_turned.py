"""Quantities of a body in other coordinates z, q = X z, against those of the basis V X."""

import numpy as np
import pytest
from helpers import block_from, gather

import hpcred
from hpcred import Modes
from hpcred.body import GeometricStiffness
from hpcred.body.floating_frame import floating_frame


@pytest.mark.mpi
@pytest.mark.parametrize("count", [2, 4])  # columns of X, rectangular and square
def test_a_floating_frame_in_other_coordinates_is_that_of_another_basis(comm, count):
    X = np.random.default_rng(count).normal(size=(4, count))
    with hpcred.solid((2, 1, 1), None, 2, True, comm) as model, hpcred.reduce(model, [Modes(count=4)]) as rom:
        block = block_from(model.K, gather(rom.columns) @ X)
        found, wanted = floating_frame(model, rom.columns).in_coordinates(X), floating_frame(model, block)
        block.destroy()
    for key in ("Ct", "Cr", "N", "S", "Me", "Oe", "Gr"):
        expected = getattr(wanted, key)
        assert getattr(found, key) == pytest.approx(expected, abs=1e-12 * np.abs(expected).max()), key


@pytest.mark.parametrize("count", [2, 4])
def test_geometric_stiffness_in_other_coordinates_has_the_same_energy(count):
    rng = np.random.default_rng(count)
    X, z, matrices = rng.normal(size=(4, count)), rng.normal(size=count), rng.normal(size=(2, 4, 4))
    stiffness = GeometricStiffness(("ax", "wz^2"), matrices + matrices.transpose(0, 2, 1), np.zeros(3))
    turned = stiffness.in_coordinates(X)
    assert turned.states == stiffness.states
    assert z @ turned.matrices @ z == pytest.approx(X @ z @ stiffness.matrices @ (X @ z), rel=1e-12)
