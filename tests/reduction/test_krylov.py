"""Moments of the reduced model against those of the full one; points at infinity and on eigenfrequencies."""

import numpy as np
import pytest
from helpers import block_with_ends, close, dense_model, few_on_ranks, moments

import hpcred
from hpcred import Buckens, CraigBampton, Krylov, Modes, SecondOrderKrylov
from hpcred.reduction import FixedInterfaceModes, Guyan

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("points", [[(0.0, 1)], [(700.0, 2)], [(300.0, 0), (2500.0, 1)]])
def test_moments_match_at_every_point_and_order(solid, points):
    K, M, B = dense_model(solid)
    with hpcred.reduce(solid, [Krylov(frequency, order) for frequency, order in points]) as rom:
        for frequency, order in points:
            shift = -((2 * np.pi * frequency) ** 2)
            full = moments(K, M, B, B.T, shift, 2 * (order + 1) + 1)
            small = moments(rom.K, rom.M, rom.B, rom.C, shift, 2 * (order + 1) + 1)
            for a, b in list(zip(full, small, strict=True))[:-1]:
                assert np.abs(a - b).max() < 1e-9 * np.abs(a).max()
            if len(points) == 1:
                assert np.abs(full[-1] - small[-1]).max() > 1e-8 * np.abs(full[-1]).max()  # not more than was asked


@pytest.mark.parametrize("point", [{"decay": 3000.0, "order": 1}, {"frequency": 300.0, "decay": 3000.0, "order": 1}])
def test_moments_of_the_proportional_method_off_the_imaginary_axis(solid, point):
    K, M, B = dense_model(solid)
    component = Krylov(**point)
    shift = component.point**2
    with hpcred.reduce(solid, [component]) as rom:
        full = moments(K + 0j, M, B, B.T, shift, 4)
        small = moments(rom.K + 0j, rom.M, rom.B, rom.C, shift, 4)
        assert max(close(a, b) for a, b in zip(full, small, strict=True)) < 1e-9


def test_markov_parameters_match_at_infinity(solid):
    K, M, B = dense_model(solid)
    with hpcred.reduce(solid, [Krylov(infinity=True, order=2)]) as rom:
        x, y = np.linalg.solve(M, B), rom.B
        for _ in range(6):
            assert close(B.T @ x, rom.C @ y) < 1e-9
            x, y = np.linalg.solve(M, K @ x), rom.K @ y


@pytest.mark.costly
def test_a_point_on_an_eigenfrequency_is_refused(linkage):
    with hpcred.reduce(linkage, [Modes(count=1)], Buckens()) as rom:
        exact = rom.frequencies[0]
    with pytest.raises(hpcred.InputError, match="eigenfrequency"):
        hpcred.reduce(linkage, [Krylov(exact, 1)], Buckens())
    hpcred.reduce(linkage, [Krylov(33.3047, 1)], Buckens()).close()


@pytest.mark.parametrize("component", few_on_ranks([
    Krylov(700.0, 2), Modes(count=5, dominant=2), SecondOrderKrylov(9000.0, order=1), CraigBampton(count=4),
    Krylov(0.0, 1), Krylov(9000.0, 1, 4e4), Modes(count=5), hpcred.StaticCorrection(),
    SecondOrderKrylov(decay=900.0, order=1), FixedInterfaceModes(count=4), Guyan(),
], 4), ids=lambda item: item.kind)  # fmt: skip
def test_the_number_of_columns_that_is_said_beforehand_is_that_of_the_basis(comm, component):
    """Room and memory are planned by it; loads and directions of the interface are independent here."""
    loads = [(20, direction) for direction in "xyz"]
    with block_with_ends(comm, clamped=True, cells=(4, 2, 2)) as block, block.with_inputs(loads) as model:
        found = component.columns(3, 0) + 6 * (component.per_direction or 0)
        with hpcred.reduce(model, [component], damping=hpcred.Rayleigh(2e4, 1e-5)) as rom:
            assert rom.size == found
