"""Damped modes of full models against a dense eigensolver, and what is refused."""

from contextlib import closing

import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse
from helpers import damped, few_on_ranks, gather
from shared_data import shared

import hpcred
from hpcred.parallel.petsc import is_complex

TARGET = 20e3  # Hz, among the modes of the block


def dense_poles(M, D, K):
    """All poles with imaginary parts of at least 0."""
    size = len(M)
    A = np.block([[np.zeros((size, size)), np.eye(size)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    poles = np.linalg.eigvals(A)
    return poles[poles.imag >= 0]


def nearest(poles, to, count):
    return poles[np.argsort(np.abs(poles - to))][:count]


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.costly
@pytest.mark.parametrize("unsymmetric", [False, True])
def test_against_a_dense_eigensolver(comm, unsymmetric):
    """Dashpots that make some modes over-critical, and a gyroscopic pair; residuals by shapes in all dofs."""
    with hpcred.solid((3, 1, 2), comm=comm) as block:
        model, K, M, D, _ = damped(block, unsymmetric)
    targets = (0.0, TARGET) if is_complex() else (0.0,)
    with model:
        for target in targets:
            exact = nearest(dense_poles(M, D, K), 2j * np.pi * target, 5)
            with closing(hpcred.damped_modes(model, 5, target=target)) as found:
                assert found.poles == pytest.approx(exact, rel=1e-8)
                assert found.residuals.max() < 1e-8 and not found.warnings
                assert found.damping_ratios == pytest.approx(-exact.real / np.abs(exact), rel=1e-6)
                pairs = gather(found.shapes)
            shapes = pairs[:, 0::2] + 1j * pairs[:, 1::2]
            force = (M @ shapes) * found.poles**2 + (D @ shapes) * found.poles + K @ shapes
            assert np.linalg.norm(force, axis=0).max() < 1e-6 * np.linalg.norm(K @ shapes, axis=0).min()


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_a_free_chain_is_shifted(unit):
    """K is singular: its rigid-body motion comes with the others, in any unit of time."""
    n = 12
    K = scipy.sparse.diags([np.r_[1.0, 2 * np.ones(n - 2), 1.0], -np.ones(n - 1), -np.ones(n - 1)], [0, 1, -1])
    squares = (2 * np.sin(np.arange(1, 3) * np.pi / (2 * n))) ** 2
    exact = -0.05 * squares + 1j * np.sqrt(squares - (0.05 * squares) ** 2)
    model = hpcred.SecondOrderModel.from_scipy(unit**2 * K, scipy.sparse.identity(n), 0.1 * unit * K)
    with model, closing(hpcred.damped_modes(model, 4)) as found:
        poles = found.poles / unit
        assert poles[np.abs(poles) > 1e-3][:2] == pytest.approx(exact, rel=1e-7)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("equal, count", few_on_ranks([(12, 16), (5, 5)]))
@pytest.mark.costly
def test_equal_poles_are_all_found(comm, equal, count):
    """Equal damped oscillators below others: one Krylov sequence ends before round-off brings the second mode."""
    omega = np.r_[np.full(equal, 1.0), np.linspace(3.0, 100.0, 100)]
    size = len(omega)
    load = np.eye(size)[:, [2]]
    with (
        hpcred.SecondOrderModel.from_scipy(np.diag(omega**2), np.eye(size), np.diag(0.02 * omega), inputs=load,
                                           comm=comm) as model,
        closing(hpcred.damped_modes(model, count)) as found,
    ):  # fmt: skip
        exact = omega[:count] * (-0.01 + 1j * np.sqrt(1 - 1e-4))
        assert found.poles == pytest.approx(exact, rel=1e-7) and not found.warnings
        pairs = gather(found.shapes)
    shapes = pairs[:, 0::2] + 1j * pairs[:, 1::2]
    assert np.linalg.matrix_rank(shapes / np.linalg.norm(shapes, axis=0), tol=1e-3) == count


def test_close_poles_far_below_the_others(comm):
    """Two equal stiff chains in soft bearings that push each other across: their rigid motions, in closed form, and the
    first bending of both, which the cross stiffness hardly parts."""
    n, k, bearing, across = 200, 1e9, 1e3, 4.0
    chain = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    chain[0, 0] = chain[-1, -1] = k + bearing
    K = scipy.linalg.block_diag(chain, chain)
    K[n // 2, n + n // 2], K[n + n // 2, n // 2] = across, -across
    M, D, load = 1e-3 * np.eye(2 * n), 1e-5 * np.eye(2 * n), np.eye(2 * n)[:, [3]]
    with (
        hpcred.SecondOrderModel.from_scipy(K, M, D, inputs=load, comm=comm, circulatory=True) as model,
        closing(hpcred.damped_modes(model, 4)) as found,
    ):
        rigid = [np.roots([1e-3 * n, 1e-5 * n, 2 * bearing + sign * 1j * across]) for sign in (1, -1)]
        rigid = np.concatenate([roots[roots.imag > 0] for roots in rigid])
        poles = found.poles[:2]
        assert poles[np.argsort(poles.real)] == pytest.approx(rigid[np.argsort(rigid.real)], rel=1e-4)
        assert len(found.poles) == 4 and max(found.residuals) < 1e-5


def test_a_frame_and_rayleigh_damping():
    """Damping ratios of modes in a chord frame are those of (40)."""
    with hpcred.linkage() as model:
        frame, damping = hpcred.Chord(nodes=(1, 7, 14)), hpcred.Rayleigh(2.0, 1e-5)
        with (
            closing(hpcred.natural_modes(model, 4, frame)) as undamped,
            closing(hpcred.damped_modes(model, 4, frame, damping)) as found,
        ):
            omega = 2 * np.pi * undamped.frequencies
            assert np.abs(found.poles) == pytest.approx(omega, rel=1e-7)
            assert found.damping_ratios == pytest.approx(1.0 / omega + 5e-6 * omega, rel=1e-6)


def test_the_shaft_of_the_nlevp_collection():
    """A rotor on bearings with one damper, whose M is singular (NLEVP "shaft"), against the pencil in SciPy."""
    mats = scipy.io.loadmat(shared("real/shaft.mat"))
    M, D, K = (mats[key].toarray() for key in "MDK")
    size = len(M)
    A = np.block([[np.zeros((size, size)), np.eye(size)], [-K, -D]])
    inverse = scipy.linalg.eigvals(np.linalg.solve(A, scipy.linalg.block_diag(np.eye(size), M)))
    poles = 1 / inverse[np.abs(inverse) > 1e-12 * np.abs(inverse).max()]
    poles = poles[poles.imag >= 0]
    model = hpcred.SecondOrderModel.from_scipy(K, M, D)
    with model, closing(hpcred.damped_modes(model, 8)) as found:
        assert found.poles == pytest.approx(nearest(poles, 0.0, 8), rel=1e-6)
        assert found.residuals.max() < 1e-6


@pytest.mark.parametrize(
    "arguments, says",
    [
        ({"count": 0}, "count: found 0, expected at least 1"),
        ({"count": 99}, "count: 99 modes asked for, model has 3"),
        ({"frame": hpcred.Buckens()}, "frame: found the Buckens frame"),
        ({"damping": hpcred.Structural(0.02)}, "damping: found kind 'structural', expected viscous damping"),
        ({"damping": hpcred.ModalDamping(ratio=0.02)}, "damping: found kind 'modal'"),
        ({"damping": hpcred.Caughey((0.0, 1e-6, 1e-12))}, "damping: found kind 'caughey'"),
        ({"target": -1.0}, "target: found -1"),
        ({"target": 5.0}, "target: found 5 Hz, which needs a complex build"),
    ],
)
def test_refusals(arguments, says):
    if is_complex() and "complex build" in says:
        pytest.skip("a complex build has targets")
    model = hpcred.SecondOrderModel.from_scipy(scipy.sparse.identity(3), scipy.sparse.identity(3))
    with model, pytest.raises(hpcred.InputError, match=says):
        hpcred.damped_modes(model, **arguments)
