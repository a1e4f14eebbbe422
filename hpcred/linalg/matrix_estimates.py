"""Estimate from a few products with vectors whether a matrix is symmetric, and whether it is positive."""

from __future__ import annotations

import numpy as np

from ..parallel.decisions import decided
from ..parallel.petsc import PETSc
from .blocks import local_rows, random_block

STEPS = 30
ENOUGH = 1e-12  # norm of a Lanczos vector that is round-off: the space is complete


def symmetry_defect(mat: PETSc.Mat, skew=False) -> float:
    """||A - A^T||_F / ||A||_F: for random x with unit variance, E ||(A - A^T) x||^2 is the square. That of A + A^T for
    `skew`. Collective."""
    random = PETSc.Random().create(mat.comm)
    random.setFromOptions()
    random.setInterval((-(3**0.5), 3**0.5))
    x, y = mat.createVecs()
    z = y.duplicate()
    defect = 0.0
    for _ in range(2):
        x.setRandom(random)
        mat.mult(x, y)
        mat.multTranspose(x, z)
        y.axpy(1.0 if skew else -1.0, z)
        defect = max(defect, y.norm())
    norm = mat.norm(PETSc.NormType.FROBENIUS)
    return float(defect / norm) if norm else 0.0


def extreme_quotients(matrix: PETSc.Mat, symmetric=True) -> tuple[float, float]:
    """The smallest and the largest x^T A x / x^T |D| x that a Lanczos process finds, D the diagonal of A. Collective.

    Both are quotients of vectors, so that a negative one is proof; what is hidden in a dense spectrum is not found.
    Entries of D that are zero count as the smallest other one. The scaling makes all units of rows alike, and round-off
    of entries that belong to a positive semidefinite matrix stays relative to 1. An A that is not `symmetric` has the
    quotients of its symmetric part.
    """
    comm = matrix.comm.tompi4py()
    scale, first = matrix.getDiagonal(), random_block(matrix, 1)
    sizes = np.abs(scale.getArray(readonly=True).real)
    least = min(comm.allgather(sizes[sizes > 0].min(initial=np.inf)))
    if not np.isfinite(least):
        least = 1.0
    scale.setArray(1 / np.sqrt(np.where(sizes > 0, sizes, least)))
    before, now, after = matrix.createVecRight(), matrix.createVecRight(), matrix.createVecLeft()
    product, transposed = now.duplicate(), now.duplicate()
    with local_rows(first) as rows:
        now.setArray(rows[:, 0])
    now.normalize()
    before.set(0.0)
    diagonal, beside = [], [0.0]
    for _ in range(min(STEPS, matrix.getSize()[0])):
        product.pointwiseMult(now, scale)
        matrix.mult(product, after)
        if not symmetric:
            matrix.multTranspose(product, transposed)
            after.axpby(0.5, 0.5, transposed)
        after.pointwiseMult(after, scale)
        diagonal.append(after.dot(now).real)
        after.axpy(-diagonal[-1], now)
        after.axpy(-beside[-1], before)
        beside.append(after.norm())
        if not beside[-1] > ENOUGH * max(np.abs(diagonal).max(), max(beside)):
            break
        before, now, after = now, after, before
        now.scale(1 / beside[-1])
    return decided(comm, _ends, diagonal, beside[1 : len(diagonal)])


def _ends(diagonal, beside):
    values = np.linalg.eigvalsh(np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1))
    return float(values[0]), float(values[-1])
