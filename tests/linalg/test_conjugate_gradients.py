"""Conjugate gradients with a diagonal for preconditioner, against numpy, and what is not positive definite."""

import numpy as np
import pytest

from hpcred.linalg.conjugate_gradients import NegativeCurvature, conjugate_gradients
from hpcred.parallel.petsc import MPI

SCALES = pytest.mark.parametrize("scale", [1e-20, 1.0, 1e20])


def run(A, b, inverse, most=100):
    """x of A x = b, and the iterations of each column; all on this rank."""
    def multiply(p, q):
        q[...] = A @ p

    def precondition(r, z):
        z[...] = inverse[:, None] * r

    x, r = np.zeros_like(b), b.copy()
    targets = 1e-12 * np.linalg.norm(b, axis=0)
    iterations = conjugate_gradients(MPI.COMM_SELF, multiply, precondition, r, x, targets, most)
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
