"""Assemble sparse matrices by rows from entries (row, column, value)."""

from __future__ import annotations

from copy import copy

import numpy as np

from ..parallel.exchange import exchange
from ..parallel.memory import give_back
from ..parallel.petsc import PETSc, free_dropped

MANY = 1 / 3  # of the entries of a matrix that are zero are worth another one for products


def compress(entries: dict, first: int, last: int, columns: int, repeats: dict | None = None):
    """CSR of the rows first..last-1 on the union pattern of square matrices, with duplicates summed.

    `entries`: name -> (rows, columns, values) with global numbers from 0, emptied on the way. Returns indptr
    (rows + 1,), indices (nonzeros,) and a dict name -> values (nonzeros,). `repeats` takes, by name, how many
    entries stood at a place that others have, and how many places had one entry only.
    """
    names, keys, data = list(entries), {}, {}
    pattern = np.arange(last - first) * (columns + 1) + first  # the diagonal is always present, as PETSc wants it
    for name in names:
        i, j, data[name] = entries.pop(name)
        key = np.asarray(i, dtype=np.int64) - first  # 32-bit row numbers of PETSc overflow in the product
        key *= int(columns)
        key += j
        del i, j
        keys[name] = key
        pattern = np.union1d(pattern, key)
    values = {}
    for name in names:
        place = np.searchsorted(pattern, keys.pop(name))
        values[name] = np.bincount(place, weights=data.pop(name), minlength=pattern.size)
        if repeats is not None:
            count = np.bincount(place)
            repeats[name] = len(place) - np.count_nonzero(count), np.count_nonzero(count == 1)
    rows, indices = np.divmod(pattern, columns)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=last - first))])
    return indptr, indices, values


def assembled(like: PETSc.Mat, i, j, values) -> PETSc.Mat:
    """A matrix in the layout of another one from entries in rows of this rank, duplicates summed. Collective."""
    first, last = like.getOwnershipRange()
    indptr, indices, summed = compress({"": (i, j, values)}, first, last, like.getSize()[1])
    csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), summed[""])
    return PETSc.Mat().createAIJ(like.getSizes(), csr=csr, comm=like.comm)


def sum_of_entries(like: PETSc.Mat, i, j, values) -> PETSc.Mat:
    """The same from entries in rows of any rank. Collective."""
    owner = np.searchsorted(like.getOwnershipRanges()[1:], i, side="right")
    return assembled(like, *exchange(like.comm.tompi4py(), owner, [i, j, values]))


def diagonal_matrix(like: PETSc.Mat, values) -> PETSc.Mat:
    """A diagonal matrix in the layout of another one, from the entries of the rows of this rank. Collective."""
    first, last = like.getOwnershipRange()
    indptr, indices = np.arange(last - first + 1), np.arange(first, last)
    csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), values)
    return PETSc.Mat().createAIJ(like.getSizes(), csr=csr, comm=like.comm)


def sparse_rows(like: PETSc.Mat, triplets, width) -> PETSc.Mat:
    """A matrix with the rows of another one from (rows of this rank, columns, values), with columns that ascend from
    one to the next; `width`: how many columns this rank owns, and all. Collective."""
    size, total = like.getSizes()[0]
    rows, columns, values = (np.concatenate(arrays) for arrays in zip(*triplets, strict=True))
    order = np.argsort(rows, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=size))])
    csr = (starts.astype(PETSc.IntType), columns[order].astype(PETSc.IntType), values[order])
    return PETSc.Mat().createAIJ(((size, total), width), csr=csr, comm=like.comm)


def without_zeros(mat: PETSc.Mat) -> PETSc.Mat:
    """The matrix without its stored zeros where they are many, else another reference to it. Collective.

    The mass of a solid is on the pattern of its stiffness, where two entries of three are zero.
    """
    indptr, indices, values = mat.getValuesCSR()
    kept = np.flatnonzero(values)
    counts = mat.comm.tompi4py().allreduce(np.array([kept.size, values.size]))
    if counts[0] > (1 - MANY) * counts[1]:
        return copy(mat)
    ends = np.searchsorted(kept, indptr).astype(PETSc.IntType)
    sizes = mat.getSizes()
    return PETSc.Mat().createAIJ(sizes, csr=(ends, indices[kept], values[kept]), comm=mat.comm)


def without_products(mat: PETSc.Mat) -> PETSc.Mat:
    """Return a copy of a product of matrices, which is destroyed with what PETSc keeps to make it again: its factors,
    rows of them from other ranks, and intermediate products, in all more than the matrix. Collective."""
    alone = mat.duplicate(copy=True)
    mat.destroy()
    free_dropped(alone.comm)
    give_back()
    return alone


def absolute(mat: PETSc.Mat) -> PETSc.Mat:
    """Return |A| entry by entry. Collective."""
    indptr, indices, values = mat.getValuesCSR()
    return PETSc.Mat().createAIJ(mat.getSizes(), csr=(indptr, indices, np.abs(values)), comm=mat.comm)


def diagonal_of(mat) -> np.ndarray:
    """Return the real parts of the diagonal entries of this rank's rows."""
    return mat.getDiagonal().getArray(readonly=True).real.copy()
