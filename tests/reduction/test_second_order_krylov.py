"""Moments with general damping, high orders, and what the proportional method cannot do."""

import numpy as np
import pytest
from helpers import close, damped, second_order_moments

import hpcred
from hpcred import GivenDamping, Krylov, SecondOrderKrylov
from hpcred.reduction.components.second_order_krylov import _next_state

POINTS = [
    {"frequency": 700.0, "order": 2},
    {"frequency": 300.0, "decay": 500.0, "order": 1},
    {"decay": 2000.0, "order": 2},
    {"s": (100.0, 4000.0), "order": 0},
    {"frequency": 0.0, "order": 2},
]


@pytest.mark.mpi
@pytest.mark.parametrize("unsymmetric", [False, True])
@pytest.mark.parametrize("point", POINTS)
def test_second_order_moments_match(solid, point, unsymmetric):
    """order + 1 moments; twice as many where V^T A V keeps the symmetry of the full model."""
    model, K, M, D, B = damped(solid, unsymmetric)
    component = SecondOrderKrylov(**point)
    count = (component.order + 1) * (1 if unsymmetric else 2)
    # light damping makes imaginary parts that are small beside the real ones
    keep_all = hpcred.reduce(model, [component], damping=GivenDamping(), deflation_tolerance=1e-13)
    with model, keep_all as rom:
        assert rom.size == component.columns(3, 0)
        for s in (component.point, component.point.conjugate()):
            full = second_order_moments(K, M, D, B, B.T, s, count)
            small = second_order_moments(rom.K, rom.M, rom.D, rom.B, rom.C, s, count)
            assert max(close(a, b) for a, b in zip(full, small, strict=True)) < 1e-9


@pytest.mark.mpi
def test_high_orders_do_not_collapse(solid):
    """The bare recurrence has turned into the dominant modes long before order 9."""
    model, K, M, D, B = damped(solid)
    with model, hpcred.reduce(model, [SecondOrderKrylov(700.0, order=9)], damping=GivenDamping()) as rom:
        assert rom.size >= 50
        frequencies = np.linspace(10.0, 4000.0, 60)
        full = hpcred.frequency_response(model, frequencies, damping=GivenDamping())
        assert hpcred.relative_error(full, hpcred.frequency_response(rom, frequencies)).max() < 1e-8


@pytest.mark.mpi
def test_without_damping_both_krylov_methods_span_the_same(solid):
    with (
        hpcred.reduce(solid, [Krylov(700.0, 2)]) as a,
        hpcred.reduce(solid, [SecondOrderKrylov(700.0, order=2)]) as b,
    ):
        assert np.allclose(a.frequencies, b.frequencies, rtol=1e-6)


def test_states_stay_orthonormal_where_a_new_one_is_nearly_in_their_span():
    """One projection leaves round-off of the size of the state in what is left of it: here 1e-16 of 1e-9."""
    rng = np.random.default_rng(1)
    made = rng.standard_normal((16, 5)) + 1j * rng.standard_normal((16, 5))
    states = np.linalg.qr(made)[0]
    new = states[:, :4] @ rng.standard_normal((4, 2)) + 1e-9 * states[:, 4:] @ rng.standard_normal((1, 2))
    new[:, 1] += 1e-3 * made[:, 1]
    upper, lower, found = _next_state(new[:8], new[8:], states[:, :4])
    assert found.shape == (16, 5) and np.array_equal(found[:, 4:], np.concatenate([upper, lower]))
    assert np.abs(found.conj().T @ found - np.eye(5)).max() < 1e-14
    assert np.abs(states[:, 4] - found @ (found.conj().T @ states[:, 4])).max() < 1e-6


@pytest.mark.slow
def test_discrete_dampers_need_second_order_krylov():
    """21,660 dofs with two strong dampers: at no larger size, orders of magnitude between the methods."""
    with hpcred.solid((20, 18, 18), inputs=2) as solid:
        D = solid.K.duplicate(copy=True)
        D.scale(1e-8)
        for row in (solid.size - 2, solid.size - 3 * 19 * 19 + 1):
            D.setValue(row, row, 2e6, addv=True)
        D.assemble()
        model = solid.with_damping_matrix(D)
    with model:
        frequencies = np.linspace(200, 6000, 7)
        full = hpcred.frequency_response(model, frequencies, damping=GivenDamping())
        errors, sizes = {}, {}
        for name, basis in (
            ("second order", [SecondOrderKrylov(2000.0, order=2), SecondOrderKrylov(4500.0, order=2)]),
            ("proportional", [Krylov(2000.0, 5), Krylov(4500.0, 5)]),
        ):
            with hpcred.reduce(model, basis, damping=GivenDamping()) as rom:
                sizes[name] = rom.size
                errors[name] = hpcred.relative_error(full, hpcred.frequency_response(rom, frequencies)).max()
    assert sizes["second order"] <= sizes["proportional"] == 24
    assert errors["second order"] < 1e-2 * errors["proportional"]
