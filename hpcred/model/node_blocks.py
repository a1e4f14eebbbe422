"""Arrange the rows of a model in blocks with the same number of rows for every node, for algebraic multigrid."""

from __future__ import annotations

import numpy as np

from ..fe.corner_nodes import corner_interpolation
from ..linalg.blocks import times
from ..linalg.csr import diagonal_matrix, without_products
from ..parallel.failures import InputError
from ..parallel.lookup import look_up, sort_over_ranks
from ..parallel.petsc import PETSc
from .rigid_body.motions import rigid_motions
from .rigid_body.support import support_of


class NodeBlocks:
    """`size`: rows of a block, 6 where most nodes can turn, else 3. `motions`: the six rigid-body motions as a block
    (n', 6). `free`: how many of them meet no force. `corners`: an interpolation from the corners of
    quadratic elements (n', n_c), and the motions of these (n_c, 6); or None.

    `expansion`: a matrix (n', n) of unit entries that puts the rows of the model, which has n, into whole blocks of
    nodes, each on one rank; None where they are so already. Rows that are missing, of nodes that are held in some
    directions, are those that no entry leads to. Collective. Raises InputError without nodes.
    """

    def __init__(self, model):
        if model.dofs is None:
            raise InputError(
                f"solver.kind: {model.name} has no node coordinates, which multigrid needs; convert it with --nodes, "
                "or take 'direct'"
            )
        direction = model.dofs.direction
        turning = model.comm.allreduce(int(np.isin(direction, (3, 4, 5)).sum()))
        self.size = 6 if 3 * turning >= model.size else 3
        self.motions = rigid_motions(model)
        self.free = support_of(model).free.shape[1]
        self.expansion, blocks = self._expansion(model)
        self.contraction = None
        if self.expansion is not None:
            self.motions = times(self.expansion, self.motions)
            self.contraction = self.expansion.transpose(PETSc.Mat())
        nodes = np.where(blocks % 8 == 0, blocks // 8, -1)
        self.corners = corner_interpolation(model.comm, model.elements, nodes, self.size)
        if self.corners is not None:
            interpolation, injection = self.corners
            self.corners = interpolation, times(injection.transpose(PETSc.Mat()), self.motions)

    def expanded(self, matrix: PETSc.Mat, diagonal: float) -> PETSc.Mat:
        """Return a matrix in whole blocks, with `diagonal` in the rows that are missing; `matrix` itself where it has
        them, told its block size. Collective."""
        if self.expansion is None:
            matrix.setBlockSize(self.size)
            return matrix
        result = without_products(matrix.ptap(self.contraction))
        missing = self.contraction.createVecRight()
        here = self.contraction.createVecLeft()
        here.set(1.0)
        self.expansion.mult(here, missing)
        missing.scale(-diagonal)
        missing.shift(diagonal)
        fill = diagonal_matrix(result, missing.getArray(readonly=True))
        result.axpy(1.0, fill, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        result.setBlockSize(self.size)
        return result

    def _expansion(self, model):
        comm, dofs = model.comm, model.dofs
        block = dofs.node.astype(np.int64) * 8 + dofs.direction // self.size
        place = dofs.direction % self.size
        whole = len(block) % self.size == 0
        if whole:
            table, places = block.reshape(-1, self.size), place.reshape(-1, self.size)
            whole = bool((table == table[:, :1]).all() and (places == np.arange(self.size)).all())
            whole = whole and len(np.unique(table[:, 0])) == len(table)
        if all(comm.allgather(whole)):
            return None, block[:: self.size]
        # a block is where its first row is
        mine = np.unique(block)
        keys, ranks = sort_over_ranks(comm, mine, [np.full(len(mine), comm.rank)])
        first = np.concatenate([[True], keys[1:] != keys[:-1]]) if len(keys) else np.zeros(0, bool)
        _, (owner,) = look_up(comm, keys[first], [ranks[first]], mine)
        order = mine[owner == comm.rank]
        _, starts = np.unique(block, return_index=True)
        order = order[np.argsort(starts[owner == comm.rank])]  # as the rows are
        count = len(order)
        start = comm.exscan(count) or 0
        _, (number,) = look_up(comm, order, [start + np.arange(count)], block)
        rows, size = self.size * count, self.size * comm.allreduce(count)
        # its transpose has one entry a row
        indptr = np.arange(len(block) + 1, dtype=PETSc.IntType)
        columns = (self.size * number + place).astype(PETSc.IntType)
        sizes = ((model.local_rows, model.size), (rows, size))
        csr = (indptr, columns, np.ones(len(block)))
        return PETSc.Mat().createAIJ(sizes, csr=csr, comm=model.K.comm).transpose(PETSc.Mat()), order
