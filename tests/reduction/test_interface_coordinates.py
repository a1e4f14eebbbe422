"""The transformation to interface coordinates, in numpy, and bases that cannot move an interface."""

from types import SimpleNamespace

import numpy as np
import pytest

from hpcred import InputError
from hpcred.reduction.interface_coordinates import transformation

INTERFACES = [SimpleNamespace(name="left"), SimpleNamespace(name="right")]


def matrices(size):
    rng = np.random.default_rng(3)
    A = rng.standard_normal((size, size))
    return rng.standard_normal((12, size)), np.eye(size), A @ A.T + np.eye(size)


def test_coordinates_are_the_motions_of_the_interfaces_and_modes_with_these_held():
    motion, M, K = matrices(16)
    motion[3:6] *= 1e3  # angles and displacements have units of their own
    T = transformation(motion, M, K, INTERFACES)
    assert np.abs(motion @ T - np.eye(12, 16)).max() < 1e-11
    small_M, small_K = T.T @ M @ T, T.T @ K @ T
    assert np.abs(small_M[12:, 12:] - np.eye(4)).max() < 1e-12
    assert np.abs(small_K[:12, 12:]).max() < 1e-11 * np.abs(small_K).max()
    eigenvalues = np.diag(small_K)[12:]
    assert np.abs(small_K[12:, 12:] - np.diag(eigenvalues)).max() < 1e-11 * eigenvalues.max()
    assert (np.diff(eigenvalues) > 0).all()


@pytest.mark.parametrize("row, words", [(4, "'left' in direction ry"), (8, "'right' in direction z")])
def test_a_direction_that_nothing_moves_is_named(row, words):
    motion, M, K = matrices(16)
    motion[row] = 0.0
    with pytest.raises(InputError, match=rf"interface {words} by itself \(1 of 12 directions are missing\)"):
        transformation(motion, M, K, INTERFACES)


def test_missing_directions_are_counted():
    motion, M, K = matrices(16)
    motion[9] = 2.0 * motion[8]
    with pytest.raises(InputError, match=r"'right' in direction (z|rx) by itself \(1 of 12"):
        transformation(motion, M, K, INTERFACES)
    motion, M, K = matrices(9)
    with pytest.raises(InputError, match=r"basis of 9 vectors .* \(3 of 12"):
        transformation(motion, M, K, INTERFACES)
