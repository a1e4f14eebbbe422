"""Find the places and the rows of the nodes of elements, and read distributed columns at these rows.

Each rank has the elements that `model.elements` has there; their nodes may have rows on any rank. Nothing is gathered:
nodes meet by number (parallel.lookup), values come by a sparse product.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..linalg.blocks import Block, create_dense, local_rows, multiply_dense, times
from ..parallel.lookup import look_up
from ..parallel.petsc import PETSc
from .dofs import require_dofs
from .elements import NODES
from .shape_functions import SOLIDS


@dataclass(frozen=True)
class ElementRows:
    """Elements of one kind of this rank: `nodes` (e, k) by number, their `position` (e, k, 3) in m, NaN for nodes that
    have no displacement in the model (neither a row nor a held one), and global `rows` (e, k, 3), from 0, of their
    displacements in x, y, z, -1 where there is none, as in held directions."""

    nodes: np.ndarray
    position: np.ndarray
    rows: np.ndarray

    @property
    def placed(self) -> np.ndarray:
        """Which elements have a place for each of their nodes (e,)."""
        return np.isfinite(self.position).all(axis=(1, 2))

    def take(self, chosen) -> ElementRows:
        return ElementRows(self.nodes[chosen], self.position[chosen], self.rows[chosen])


def element_rows(model) -> dict[str, ElementRows]:
    """Return the solid elements of this rank, by kind, without kinds that no rank has.

    Collective. Raises InputError for a model without nodes.
    """
    require_dofs(model, "a field on its elements")
    there = set().union(*model.comm.allgather({kind for kind in SOLIDS if len(model.elements.get(kind, ()))}))
    result = {}
    for kind in sorted(there):
        nodes = np.asarray(model.elements.get(kind, np.zeros((0, NODES[kind]))), dtype=np.int64)
        numbers, place = np.unique(nodes, return_inverse=True)
        position, rows = node_rows(model, numbers)
        place = place.reshape(nodes.shape)
        result[kind] = ElementRows(nodes, position[place], rows[place])
    return result


def node_rows(model, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions (k, 3) in m of nodes, NaN where they have no displacement in the model, and the global rows
    (k, 3) of x, y, z, -1 where they have none. `numbers` (k,) of this rank, any. Collective."""
    # displacements of this rank by 3 node + direction; held ones have a place and no row
    keys, row, place = [], [], []
    for dofs in (model.dofs, model.held):
        if dofs is not None:
            moved = np.flatnonzero(dofs.direction < 3)
            keys.append(3 * dofs.node[moved].astype(np.int64) + dofs.direction[moved])
            row.append(model.first_row + moved if dofs is model.dofs else np.full(len(moved), -1))
            place.append(dofs.position[moved])
    keys, row, place = (np.concatenate(arrays) for arrays in (keys, row, place))
    # what other ranks have of the nodes that this one asks for
    wanted = (3 * np.asarray(numbers, dtype=np.int64)[:, None] + np.arange(3)).ravel()
    there, (row, *place) = look_up(model.comm, keys, [row, *place.T.astype(float)], wanted)
    there, row = there.reshape(-1, 3), np.where(there, row, -1).reshape(-1, 3)
    position = np.where(there[..., None], np.stack(place, axis=-1).reshape(-1, 3, 3), np.nan)
    first = there.argmax(axis=1)  # the position is the same in all directions
    return position[np.arange(len(position)), first], row


class ValuesAtRows:
    """Values of distributed columns at chosen rows, on the rank that asks for them. Collective.

    `rows` (any shape): global rows from 0 that this rank asks for, with repetitions; values at rows -1 are 0.
    """

    def __init__(self, model, rows: np.ndarray):
        wanted, back = np.unique(rows, return_inverse=True)
        self._back = back.reshape(np.shape(rows))
        there = wanted >= 0
        counts = np.concatenate([[0], np.cumsum(there)]).astype(PETSc.IntType)
        csr = (counts, wanted[there].astype(PETSc.IntType), np.ones(there.sum()))
        sizes = ((len(wanted), None), (model.local_rows, model.size))
        self._matrix = PETSc.Mat().createAIJ(sizes, csr=csr, comm=model.K.comm)

    def of(self, block: Block) -> np.ndarray:
        """Return the values of the active columns (*shape of rows, columns), real. Collective."""
        with local_rows(times(self._matrix, block)) as values:
            return values.real[self._back]

    def added(self, values: np.ndarray) -> np.ndarray:
        """Return the sums (rows of this rank, c) over all ranks of values (*shape of rows, c) at their rows.
        Collective."""
        count = values.shape[-1]
        mine = np.zeros((self._matrix.getLocalSize()[0], count))
        np.add.at(mine, self._back.ravel(), values.reshape(-1, count))
        return added_up(self._matrix.transpose(PETSc.Mat()), mine)


def added_up(adding: PETSc.Mat, values: np.ndarray) -> np.ndarray:
    """Return the products (rows of this rank, c) of a sparse matrix of ones and values (l, c) of this rank.
    Collective."""
    factors = PETSc.Mat().createDense(((len(values), None), (None, values.shape[1])), comm=adding.comm)
    factors.setUp()
    factors.getDenseArray()[...] = values
    factors.assemble()
    sums = create_dense(adding, values.shape[1])
    multiply_dense(adding, factors, sums)
    return sums.getDenseArray().real.copy()
