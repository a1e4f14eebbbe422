"""Estimate from a few products with vectors whether a matrix is symmetric, and whether it is positive."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from ..parallel.decisions import decided
from ..parallel.petsc import PETSc
from .blocks import local_rows, random_block

OF_DIAGONAL = 1e-3  # that a pair of entries is compared with where it is smaller
AT_ONCE = 10**6  # entries that are compared
STEPS = 30
ENOUGH = 1e-12  # norm of a Lanczos vector that is round-off: the space is complete


def symmetry_defect(mat: PETSc.Mat, skew=False) -> float:
    """Return the largest |a_ij - a_ji| / max(|a_ij|, |a_ji|, 1e-3 (a_ii a_jj)^(1/2)); of |a_ij + a_ji| for `skew`.
    Collective.

    Entry by entry, so that neither units nor the mesh nor stiff parts elsewhere hide a difference. Round-off in entries
    that nearly cancel is some 1e-15 of the diagonal, which stands for them there.
    """
    # the transposed matrix is freed before the entries are copied a second time: each copy is as large as the matrix
    transposed = mat.transpose(PETSc.Mat())
    starts, places, theirs = transposed.getValuesCSR()
    transposed.destroy()
    indptr, indices, ours = mat.getValuesCSR()
    ours, theirs = ours.real, -theirs.real if skew else theirs.real
    # both on one pattern
    if not (np.array_equal(indptr, starts) and np.array_equal(indices, places)):
        shape = (len(indptr) - 1, mat.getSize()[1])
        A, At = csr_array((ours, indices, indptr), shape), csr_array((theirs, places, starts), shape)
        pattern = (abs(A) + abs(At)).tocoo()
        pattern.data[:] = 1.0
        indptr, indices = pattern.tocsr().indptr, pattern.col
        ours, theirs = (np.asarray(matrix[pattern.row, pattern.col]).ravel() for matrix in (A, At))
    root = mat.getDiagonal()
    root.setArray(np.sqrt(np.abs(root.getArray(readonly=True).real)))
    roots, of_columns = root.getArray(readonly=True).real, entries_of(root, indices)
    largest = 0.0
    for start in range(0, len(ours), AT_ONCE):  # what is made of all at once takes as much memory as the matrix
        here = slice(start, start + AT_ONCE)
        difference = np.abs(ours[here] - theirs[here])
        unequal = np.flatnonzero(difference > 0)  # round-off may make half of all differ
        rows = np.searchsorted(indptr, start + unequal, side="right") - 1
        scale = np.maximum(np.abs(ours[here][unequal]), np.abs(theirs[here][unequal]))
        scale = np.maximum(scale, OF_DIAGONAL * roots[rows] * of_columns(indices[here][unequal]))
        largest = max(largest, (difference[unequal] / scale).max(initial=0.0))
    return float(max(mat.comm.tompi4py().allgather(largest)))


def entries_of(vector: PETSc.Vec, columns: np.ndarray):
    """Return a function of some of the global places `columns` that returns the entries of a distributed vector there.
    Collective; the function is not."""
    first, last = vector.getOwnershipRange()
    # those of other ranks, which are few
    others = np.unique(columns[(columns < first) | (columns >= last)])
    chosen = PETSc.IS().createGeneral(others.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    local = PETSc.Vec().createSeq(len(others), comm=PETSc.COMM_SELF)
    scatter = PETSc.Scatter().create(vector, chosen, local, None)
    scatter.scatter(vector, local)
    values = np.concatenate([vector.getArray(readonly=True).real, local.getArray().real])
    for owned in (scatter, chosen, local):
        owned.destroy()

    def entries(places):
        own = (places >= first) & (places < last)
        return values[np.where(own, places - first, last - first + np.searchsorted(others, places))]

    return entries


def extreme_quotients(matrix: PETSc.Mat, symmetric=True) -> tuple[float, float]:
    """The smallest and the largest x^T A x / x^T |D| x that a Lanczos process finds, D the diagonal of A. Collective.

    Both are quotients of vectors, so that a negative one is proof; what is hidden in a dense spectrum is not found.
    Entries of D that are zero count as the smallest other one. The scaling makes all units of rows alike, and round-off
    of entries that belong to a positive semidefinite matrix stays relative to 1. An A that is not `symmetric` has the
    quotients of its symmetric part.
    """
    comm = matrix.comm.tompi4py()
    # scaled by the diagonal, so that units and stiff entries do not hide the others
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
    # Lanczos for the symmetric part, without reorthogonalisation: only the ends are wanted
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
