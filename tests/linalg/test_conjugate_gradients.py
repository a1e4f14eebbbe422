"""Conjugate gradients with a diagonal for preconditioner, against numpy, and what is not positive definite."""

import numpy as np
import pytest

from hpcred.linalg.conjugate_gradients import EnergyBound, NegativeCurvature, conjugate_gradients
from hpcred.parallel.petsc import MPI

SCALES = pytest.mark.parametrize("scale", [1e-20, 1.0, 1e20])


def run(A, b, inverse, most=100, energy=None):
    """x of A x = b, and the iterations of each column; all on this rank."""
    def multiply(p, q):
        q[...] = A @ p

    def precondition(r, z):
        z[...] = inverse[:, None] * r

    x, r = np.zeros_like(b), b.copy()
    targets = 1e-12 * np.linalg.norm(b, axis=0)
    iterations = conjugate_gradients(MPI.COMM_SELF, multiply, precondition, r, x, targets, most, energy)
    return x, r, iterations


@SCALES
def test_columns_of_any_size_are_solved_in_as_many_steps_as_there_are_eigenvalues(scale):
    rng = np.random.default_rng(1)
    Q = np.linalg.qr(rng.standard_normal((30, 30)))[0]
    A = Q * np.repeat([1.0, 3.0, 20.0], 10) @ Q.T
    b = scale * rng.standard_normal((30, 4)) * [1.0, 1e8, 0.0, 1e-8]
    x, r, iterations = run(A, b, np.ones(30))
    assert np.allclose(x, np.linalg.solve(A, b), rtol=1e-10, atol=1e-11 * scale * 1e-8)
    assert np.abs(b - A @ x - r).max() <= 1e-13 * np.abs(b).max()
    assert iterations.tolist() == [3, 3, 0, 3]


@SCALES
@pytest.mark.parametrize("sign, words", [(1, "the matrix"), (-1, "the approximate inverse")])
def test_what_is_not_positive_definite_is_refused_whatever_the_size_of_the_load(scale, sign, words):
    b = scale * np.ones((4, 1))
    with pytest.raises(NegativeCurvature, match=f"{words} is not positive definite"):
        run(np.diag([1.0, 1.0, 1.0, -30.0]), b, sign * np.ones(4))


@SCALES
def test_the_energy_of_an_error_is_bounded_from_above_where_no_eigenvalue_is_below_one(scale):
    """Gauss-Radau quadrature against the errors themselves."""
    rng = np.random.default_rng(2)
    Q = np.linalg.qr(rng.standard_normal((40, 40)))[0]
    A = Q * np.geomspace(1.02, 6.0, 40) @ Q.T
    b = scale * rng.standard_normal((40, 3)) * [1.0, 1e6, 0.0]
    x = np.linalg.solve(A, b)
    whole = np.einsum("ij,ij->j", x, b)[:2]
    for most in range(1, 6):
        energy = EnergyBound(3, 0.0)
        error = x - run(A, b, np.ones(40), most, energy)[0]
        left = np.einsum("ij,ij->j", error, A @ error)[:2]
        assert np.allclose(energy.taken[:2] + left, whole, rtol=1e-12)
        assert (left <= energy.left[:2]).all() and (energy.left[:2] <= 20 * left).all()
        assert energy.taken[2] == 0


def test_a_column_ends_where_its_energy_is_small_by_itself():
    A, b = np.diag(np.append(np.ones(20), np.geomspace(1.0, 30.0, 20))), np.ones((40, 2))
    b[20:, 1] = 0.0
    share = 1e-2
    energy = EnergyBound(2, share)
    x, _, iterations = run(A, b, np.ones(40), energy=energy)
    error = np.linalg.solve(A, b) - x
    assert energy.small.all() and iterations[1] == 1 < iterations[0] < 10
    assert (np.einsum("ij,ij->j", error, A @ error) <= share * energy.taken).all()


def test_an_eigenvalue_below_one_does_not_end_the_steps():
    """Its bound is none: what a step takes is more than the bound then."""
    A, b = np.diag(np.append(np.full(20, 1.1), np.full(20, 0.1))), np.ones((40, 1))
    energy = EnergyBound(1, 0.1)
    x = run(A, b, np.ones(40), energy=energy)[0]
    assert np.allclose(A @ x, b, rtol=1e-8)
