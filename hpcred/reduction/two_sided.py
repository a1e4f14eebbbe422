"""Bi-orthogonal bases for the two-sided projection: W^T M V = I."""

import numpy as np

from ..linalg.blocks import inner
from ..parallel.decisions import decided
from ..parallel.failures import ComputationError

LOST = 1e-10  # singular value of W^T M V below which a pair of directions cannot be made bi-orthogonal


def biorthogonal(left, right, run) -> float:
    """Change the mass-orthonormal bases W and V so that W^T M V = I; returns max |W^T M V - I|. Collective.

    Directions of one space that are M-orthogonal to the other one are dropped and reported; where the spaces have
    different sizes, the larger loses the difference.
    """
    product = run.times_mass(right.columns)
    u, values, vt = decided(run.model.comm, np.linalg.svd, inner(left.columns, product))
    product.destroy()
    kept = int((values > LOST).sum())
    if kept == 0:
        raise ComputationError("the input and the output subspace are M-orthogonal: no two-sided model exists")
    scale = 1.0 / np.sqrt(values[:kept])
    run.note("bi-orthogonal pairs", max(left.size, right.size), kept)
    left.multiply(u[:, :kept] * scale)
    right.multiply(vt[:kept].T * scale)
    product = run.times_mass(right.columns)
    gram = inner(left.columns, product)
    product.destroy()
    return float(np.abs(gram - np.eye(kept)).max())
