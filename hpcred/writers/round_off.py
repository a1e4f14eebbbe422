"""Leave out round-off beside the diagonal of a matrix, which programs would take for entries."""

import numpy as np

BESIDE, FROM_ONE = 1e-12, 1e-11  # what counts as round-off: of the sizes of two coordinates, and of a unit diagonal


def without_round_off(matrix: np.ndarray) -> np.ndarray:
    """Return the identity or the diagonal matrix (m, m) that a matrix is but for round-off, or else the matrix."""
    diagonal = np.diag(matrix)
    sizes = np.sqrt(np.abs(diagonal))  # of each coordinate: displacements, angles and modes differ much
    if (np.abs(matrix - np.diag(diagonal)) > BESIDE * np.outer(sizes, sizes)).any():
        return matrix
    return np.eye(len(matrix)) if np.abs(diagonal - 1).max(initial=0.0) <= FROM_ONE else np.diag(diagonal)
