"""Make the coarser level of a multigrid level by smoothed aggregation of nodes.

GAMG of PETSc finds the aggregates, and the interpolation from their near null vectors, the rigid-body motions. It is
smoothed here by the inverses of the blocks of nodes, in which translations and rotations have each their scale (Vanek,
Mandel & Brezina, Computing 56, 1996).
"""

from __future__ import annotations

import numpy as np

from ..parallel.decisions import decided
from ..parallel.petsc import MPI, PETSc
from ..parallel.sums import summed
from .blocks import independent
from .csr import without_products
from .options import temporary_options

DEPENDENT_NEAR_NULL = 1e-12  # squared norm of a combination of unit near null vectors that is round-off
DEPENDENT = 1e-10  # eigenvalue of the block of a node with a unit diagonal that is round-off
OVERSHOOT = 4 / 3  # of the step that smooths, over the largest eigenvalue
DENSE = 1 / 3  # of the rows of a level on the coarser one: so many would make it dearer than the level
AT_ONCE = 2**13  # nodes whose rows are copied at a time
SLAB = 2**16  # rows of a rank whose products are held at a time
STUCK = 0.7  # of the rows on the coarser level: aggregates of one node


def node_inverses(matrix: PETSc.Mat) -> PETSc.Mat:
    """Return the inverses of the diagonal blocks of nodes, but for motions that meet nothing in them. Collective."""
    size, (first, last) = matrix.getBlockSize(), matrix.getOwnershipRange()
    local, blocks = matrix.getDiagonalBlock(), np.zeros(((last - first) // size, size, size))
    for low in range(0, len(blocks), AT_ONCE):
        chunk = blocks[low : low + AT_ONCE]
        chunk[...] = _node_blocks(local, size * low, size * (low + len(chunk)), size)
    diagonal = np.einsum("bii->bi", blocks)
    scale = np.divide(1.0, np.sqrt(np.abs(diagonal)), out=np.zeros_like(diagonal), where=diagonal > 0)
    scale = scale[:, :, None] * scale[:, None]
    eigenvalues, vectors = np.linalg.eigh((blocks + blocks.transpose(0, 2, 1)) / 2 * scale)
    inverse = np.divide(1.0, eigenvalues, out=np.zeros_like(eigenvalues), where=eigenvalues > DEPENDENT)
    inverse = (vectors * inverse[:, None]) @ vectors.transpose(0, 2, 1) * scale
    indptr = (size * np.arange(last - first + 1)).astype(PETSc.IntType)
    columns = first + size * np.repeat(np.arange((last - first) // size), size)[:, None] + np.arange(size)
    csr = (indptr, columns.astype(PETSc.IntType).ravel(), inverse.ravel())
    return PETSc.Mat().createAIJ(matrix.getSizes(), csr=csr, comm=matrix.comm)


def _node_blocks(local, first, last, size):
    """Return the diagonal blocks of nodes of the rows first .. last - 1 of a matrix of this rank."""
    rows = PETSc.IS().createStride(last - first, first, 1, comm=PETSc.COMM_SELF)
    principal = local.createSubMatrix(rows, rows)
    indptr, column, values = principal.getValuesCSR()
    principal.destroy()
    row = np.repeat(np.arange(last - first), np.diff(indptr))
    same = row // size == column // size
    row, column = row[same], column[same]
    blocks = np.zeros(((last - first) // size, size, size))
    blocks[row // size, row % size, column % size] = values[same].real
    return blocks


def aggregates(matrix, near_null: np.ndarray, prefix: str, threshold: float, aggressive: bool):
    """Return an interpolation from aggregates of nodes, and the near null vectors of the coarser level. Collective.

    `near_null` (rows, k): rows of this rank. `threshold`: entries of the graph of nodes below this share of the
    diagonal ones are weak. `aggressive`: aggregates of neighbours of neighbours. None where the nodes do not join.
    Raises PETSc.Error.
    """
    comm, vectors = matrix.comm.tompi4py(), []
    for _ in range(2):
        factor, eigenvalues = decided(comm, independent, summed(comm, near_null.T @ near_null), DEPENDENT_NEAR_NULL)
        near_null = near_null @ (factor / np.sqrt(eigenvalues))
    for column in near_null.T:
        vectors.append(matrix.createVecRight())
        vectors[-1].setArray(column)
    matrix.setNearNullSpace(PETSc.NullSpace().create(vectors=vectors, comm=matrix.comm))
    pc = PETSc.PC().create(matrix.comm)
    pc.setOptionsPrefix(prefix)
    pc.setType("gamg")
    pc.setGAMGLevels(2)  # no option: newer versions refuse -pc_mg_levels of GAMG
    pc.setOperators(matrix)
    asked = {
        "pc_gamg_threshold": threshold, "pc_gamg_aggressive_coarsening": int(aggressive),
        # what PETSc 3.18, which knows neither, does: independent sets at a distance of two nodes, from nodes with few
        # neighbours on; the defaults of later versions take shells half as many iterations again
        "pc_gamg_aggressive_square_graph": False, "pc_gamg_mis_k_minimum_degree_ordering": True,
    }  # fmt: skip
    forced = {
        "pc_gamg_agg_nsmooths": 0, "pc_gamg_coarse_eq_limit": 1, "mg_levels_pc_type": "none",
        "pc_gamg_use_parallel_coarse_grid_solver": True, "mg_levels_ksp_type": "richardson",
        "mg_coarse_pc_type": "none", "mg_coarse_ksp_type": "preonly",
    }  # fmt: skip
    with temporary_options(prefix, asked, forced):
        pc.setFromOptions()
        pc.setUp()
    matrix.setNearNullSpace(PETSc.NullSpace())  # which the matrix, that of a model, would keep
    if pc.getMGLevels() < 2:
        return None
    interpolation = pc.getMGInterpolation(1)
    del pc  # goes with it
    interpolation = without_products(interpolation)
    coarse = []
    for vector in vectors:
        coarse.append(interpolation.createVecRight())
        interpolation.multTranspose(vector, coarse[-1])
    near_null = np.stack([vector.getArray(readonly=True).real for vector in coarse], axis=1)
    return interpolation, near_null


def smoothed(matrix, inverses, largest: float, interpolation):
    """Return the interpolation P - w D^-1 A P; `largest`: eigenvalue of D^-1 A. Collective."""
    product = without_products(matrix.matMult(interpolation))
    result = without_products(inverses.matMult(product))
    del product
    result.scale(-OVERSHOOT / largest)
    result.axpy(1.0, interpolation, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    return result


def coarse(matrix, interpolation) -> PETSc.Mat:
    """Return P^T A P, by slabs of rows: A P of all of them takes twice the memory of A for a while. Collective."""
    first, last = matrix.getOwnershipRange()
    slabs = matrix.comm.tompi4py().allreduce(-(-(last - first) // SLAB), op=MPI.MAX)
    if slabs == 1:
        return without_products(matrix.ptap(interpolation))
    result, ends = None, np.linspace(first, last, slabs + 1).astype(int)
    for low, high in zip(ends[:-1], ends[1:], strict=True):
        product = without_products(_rows(matrix, low, high).matMult(interpolation))
        rows = without_products(_rows(interpolation, low, high).transposeMatMult(product))
        if result is None:
            result = rows
        else:
            result.axpy(1.0, rows, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        del product, rows
    return without_products(result)


def _rows(matrix, low, high):
    """Return the rows low .. high - 1 that this rank has of a matrix, as a matrix. Collective."""
    first, last = matrix.getOwnershipRangeColumn()
    rows = PETSc.IS().createStride(high - low, low, 1, comm=matrix.comm)
    columns = PETSc.IS().createStride(last - first, first, 1, comm=matrix.comm)
    return matrix.createSubMatrix(rows, columns)
