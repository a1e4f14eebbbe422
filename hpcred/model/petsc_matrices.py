"""Take over K, M and D that another program assembled in PETSc, and bring them to one nonzero pattern.

Matrices that fit already are not copied but referenced.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from xxhash import xxh3_128

from ..fe.dofs import Dofs, check_labels
from ..linalg.csr import diagonal_matrix
from ..parallel.exchange import exchange
from ..parallel.failures import InputError, agreed, watched
from ..parallel.lookup import repeated_key
from ..parallel.petsc import MPI, PETSc, free_dropped
from ..parallel.sums import anywhere

ROWS_OF_A_NODE = (1, 2, 3, 6)


def taken(matrices: dict[str, PETSc.Mat], held, name: str) -> tuple[dict[str, PETSc.Mat], np.ndarray]:
    """Return references to K, M and D as models need them, and the rows (local, from 0) of this rank that stay.
    Collective.

    AIJ on one structurally symmetric pattern with a full diagonal, without the rows and columns `held` (global, from 0,
    of any rank). Raises InputError.
    """
    for key, mat in matrices.items():  # on all ranks alike; there is no communicator yet to agree on
        if not isinstance(mat, PETSc.Mat):
            raise InputError(f"{name}: found {type(mat).__name__} for {key}, expected an assembled PETSc.Mat")
    comm = matrices["K"].comm.tompi4py()
    watched(comm)
    with agreed(comm):
        _check_layout(matrices, name)
    mats = {key: as_aij(mat, f"{name}: {key}") for key, mat in matrices.items()}
    rows, size = mats["K"].getLocalSize()[0], mats["K"].getSize()[0]
    free = np.setdiff1d(np.arange(rows), _held_rows(comm, mats["K"], held, name))
    remaining = comm.allreduce(len(free))
    if remaining < comm.size:
        raise InputError(
            f"{name}: {size} rows of which {size - remaining} are held cannot be distributed over {comm.size} "
            f"ranks; start at most {remaining} ranks"
        )
    if remaining < size:
        first = mats["K"].getOwnershipRange()[0]
        keep = PETSc.IS().createGeneral((first + free).astype(PETSc.IntType), comm=mats["K"].comm)
        mats = {key: mat.createSubMatrix(keep, keep) for key, mat in mats.items()}
    mats = on_one_pattern(mats)
    free_dropped(comm)
    return mats, free


def _check_layout(matrices, name):
    """Refuse matrices that are not square, not assembled, or not spread over the ranks alike."""
    K = matrices["K"]
    for key, mat in matrices.items():
        if not mat.assembled:
            raise InputError(f"{name}: {key} is not assembled; call {key}.assemble() before")
        rows, columns = mat.getSize()
        if rows != columns:
            raise InputError(f"{name}: found {rows} x {columns} for {key}, expected a square matrix")
        if rows != K.getSize()[0]:
            raise InputError(f"{name}: found {rows} rows of {key}, but K has {K.getSize()[0]}; expected the same")
        if MPI.Comm.Compare(mat.comm.tompi4py(), K.comm.tompi4py()) not in (MPI.IDENT, MPI.CONGRUENT):
            raise InputError(f"{name}: {key} lies on other ranks than K; expected one communicator")
        here, there = mat.getOwnershipRange(), K.getOwnershipRange()
        if here != there or mat.getOwnershipRangeColumn() != there:
            raise InputError(
                f"{name}: this rank has the rows {here} and the columns {mat.getOwnershipRangeColumn()} of {key}, but "
                f"the rows {there} of K; expected one layout of rows and columns"
            )


def as_aij(mat, what):
    """Return a reference to an AIJ matrix, or a copy as AIJ of another storage type (SBAIJ, BAIJ, nest, ...)."""
    if mat.getType() in ("seqaij", "mpiaij"):
        return copy(mat)
    try:
        return mat.convert("aij", PETSc.Mat())
    except PETSc.Error as error:
        raise InputError(
            f"{what}: found a matrix of type {mat.getType()}, which PETSc cannot convert to aij"
        ) from error


def _held_rows(comm, mat, held, name):
    """Return the rows (local, from 0) of this rank among those that any rank names."""
    with agreed(comm):
        rows = np.asarray([] if held is None else held)
        if rows.size and (rows.ndim != 1 or rows.dtype.kind not in "iu"):
            raise InputError(f"{name}: held: found {rows.dtype} {rows.shape}, expected row numbers (rows,)")
        rows = rows.astype(np.int64).ravel()
        wrong = rows[(rows < 0) | (rows >= mat.getSize()[0])]
        if wrong.size:
            raise InputError(f"{name}: held: found the row {wrong[0]}, expected rows from 0 to {mat.getSize()[0] - 1}")
    ranges = np.asarray(mat.getOwnershipRanges())
    owner = np.searchsorted(ranges, rows, side="right") - 1
    return np.unique(exchange(comm, owner, [rows])[0]) - ranges[comm.rank]


def on_one_pattern(mats, others=()):
    """Return the matrices where they have one pattern that serves, else copies on the union of all. Collective.

    An unsymmetric D brings the pattern of its transpose; `others` bring theirs, and those of their transposes.
    """
    K = mats["K"]
    comm = K.comm.tompi4py()
    patterns = list(mats.values())
    for mat in ([mats["D"]] if "D" in mats else []) + list(others):
        patterns += [mat, mat.transpose(PETSc.Mat())]
    signs = [_signature(mat) for mat in patterns]
    full = all(diagonal for _, diagonal in signs)
    if all(comm.allgather(full and len({sign for sign, _ in signs}) == 1)):
        return mats
    union = diagonal_matrix(K, np.zeros(K.getLocalSize()[0]))
    for mat in patterns:
        zeros = mat.duplicate(copy=False)  # axpy leaves at once where the factor is zero
        zeros.zeroEntries()
        union.axpy(1.0, zeros, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    result = {}
    for key, mat in mats.items():
        result[key] = union.duplicate(copy=True)
        result[key].axpy(1.0, mat, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        result[key].assemble()
    return result


def _signature(mat):
    """Return a short sign of the pattern of this rank, and whether each of its rows has an entry on the diagonal."""
    indptr, indices, _ = mat.getValuesCSR()
    rows = np.repeat(np.arange(*mat.getOwnershipRange()), np.diff(indptr))
    sign = xxh3_128(indptr)
    sign.update(indices)
    return sign.digest(), np.count_nonzero(rows == indices) == len(indptr) - 1


def labels_of(K: PETSc.Mat, nodes, numbers, dofs, name: str) -> Dofs | None:
    """Return labels of the rows of this rank: `dofs`, or from nodes with the same number of rows each, one after the
    other.

    `nodes` (nodes of this rank, 3) in m, or None; `numbers` (nodes,), or None for numbers from 1 in the order of the
    rows. Collective. Raises InputError.
    """
    comm = K.comm.tompi4py()
    rows, block = K.getLocalSize()[0], K.getBlockSize()
    if len(set(comm.allgather(dofs is not None))) > 1:
        raise InputError(f"{name}: dofs: found them on some ranks only, expected them on all or none")
    # labels of each row, or none
    if not anywhere(comm, nodes is not None or numbers is not None):
        with agreed(comm):
            check_labels(dofs, rows, name)
        return dofs
    with agreed(comm):
        if dofs is not None:
            raise InputError(f"{name}: found `nodes` or `numbers` beside `dofs`, expected one of them")
        # coordinates of nodes, each with the same number of rows
        position = np.asarray(nodes)
        numeric = position.dtype.kind in "iuf" and np.isfinite(position).all()
        if position.ndim != 2 or position.shape[1] != 3 or not numeric:
            raise InputError(
                f"{name}: nodes: found an array {position.shape} of {position.dtype}, expected finite coordinates "
                "(nodes, 3)"
            )
        position = position.astype(float)
        if numbers is not None:
            numbers = np.asarray(numbers)
            if numbers.shape != position.shape[:1] or numbers.dtype.kind not in "iu" or (numbers < 1).any():
                raise InputError(
                    f"{name}: numbers: found {numbers.dtype} {numbers.shape}, expected a whole number from 1 for each "
                    f"of the {len(position)} nodes of this rank"
                )
    # how many rows a node has is told by the block size, or by the counts of all ranks
    counts = comm.allgather((len(position), rows))
    total = sum(count for count, _ in counts), sum(count for _, count in counts)
    per_node = block if block > 1 else total[1] // total[0] if total[0] else 0
    wrong = next((rank for rank, (count, own_rows) in enumerate(counts) if count * per_node != own_rows), None)
    if per_node not in ROWS_OF_A_NODE or wrong is not None:
        wrong = wrong or 0
        raise InputError(
            f"{name}: nodes: found {counts[wrong][0]} nodes for {counts[wrong][1]} rows of block size {block} on rank "
            f"{wrong}, expected 3 or 6 rows a node on each rank; leave out ghosts, nodes of other ranks, or give `dofs`"
        )
    if numbers is None:
        numbers = 1 + (comm.exscan(len(position)) or 0) + np.arange(len(position))
    elif (twice := repeated_key(comm, numbers.astype(np.int64))) is not None:
        raise InputError(f"{name}: numbers: found the node {twice} twice, expected numbers that differ")
    direction = np.tile(np.arange(per_node, dtype=np.int8), len(position))
    return Dofs(np.repeat(numbers.astype(np.int64), per_node), direction, np.repeat(position, per_node, axis=0))


def decoupled(indptr: np.ndarray, indices: np.ndarray, values, first: int) -> np.ndarray:
    """Return the rows (local, from 0) without a number other than zero beside the diagonal, in any of the matrices."""
    rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    beside = (indices != rows + first) & np.any([data != 0 for data in values], axis=0)
    coupled = np.zeros(len(indptr) - 1, bool)
    coupled[rows[beside]] = True
    return np.flatnonzero(~coupled)
