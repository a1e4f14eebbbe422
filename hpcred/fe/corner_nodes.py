"""Interpolate from the nodes at the corners of quadratic elements to those in the middles of their edges.

As the first step of multigrid this is p-multigrid (Ronquist & Patera, J. Sci. Comput. 2(4), 1987): aggregates of nodes
serve linear elements well, and quadratic ones badly.
"""

from __future__ import annotations

import numpy as np

from ..parallel.lookup import look_up, number_over_ranks, sort_over_ranks
from ..parallel.petsc import PETSc
from ..parallel.shares import row_range
from .shape_functions import EDGES


def corner_interpolation(comm, elements, nodes: np.ndarray, size: int):
    """Return matrices (n', n_c) that interpolate from the corners, and that put these in their rows; or None without
    middle nodes. Collective.

    `elements`: node numbers by kind, of this rank; `nodes` (k,): of the blocks of `size` rows of this rank, no number
    twice, -1 for blocks that are not of the translations of a node. A node in the middle of an edge has the mean motion
    of its ends; it is a corner where one of them has no rows, for that may be held, or follow a reference node.
    """
    # each middle node once, with the ends of an edge that has it
    corners, middles, ends = _nodes_by_place(elements)
    corners, _ = number_over_ranks(comm, corners)
    middles, *ends = sort_over_ranks(comm, middles, list(ends.T))
    first = np.concatenate([[True], middles[1:] != middles[:-1]]) if len(middles) else np.zeros(0, bool)
    # middles among the blocks: no corner of another element, and with rows at both ends
    named = np.flatnonzero(nodes >= 0)
    at_corner, _ = look_up(comm, corners, [], nodes[named])
    known, pairs = look_up(comm, middles[first], [end[first] for end in ends], nodes[named])
    known &= ~at_corner
    pairs = np.stack(pairs, axis=1)
    there, _ = look_up(comm, nodes[named[~known]], [], pairs.ravel())
    known &= there.reshape(-1, 2).all(axis=1)
    if not comm.allreduce(int(known.sum())):
        return None
    # all other blocks are kept, and numbered over the ranks
    kept = np.ones(len(nodes), bool)
    kept[named[known]] = False
    number = np.cumsum(kept) - kept + (comm.exscan(int(kept.sum())) or 0)
    _, (place,) = look_up(comm, nodes[named[~known]], [number[named[~known]]], pairs[known].ravel())
    columns = np.stack([number, number], axis=1)
    columns[~kept] = place.reshape(-1, 2)
    count = comm.allreduce(int(kept.sum()))
    start, stop = row_range(comm, count)
    sizes = [(size * len(nodes), size * comm.allreduce(len(nodes))), (size * (stop - start), size * count)]
    single = (columns[:, 0] == columns[:, 1])[:, None]  # a corner, or the edge of a collapsed element
    shares = np.where(single, (1.0, 0.0), (0.5, 0.5)), np.where(kept[:, None], (1.0, 0.0), (0.0, 0.0))
    return tuple(_in_blocks(comm, columns, values, size, sizes) for values in shares)


def _in_blocks(comm, columns, values, size, sizes):
    """Return a matrix with `values` (k, 2) times the unit matrix in blocks of rows, where they are not zero."""
    used = np.repeat(values != 0, size, axis=0)
    places = size * np.repeat(columns, size, axis=0) + np.tile(np.arange(size), len(columns))[:, None]
    indptr = np.concatenate([[0], np.cumsum(used.sum(axis=1))]).astype(PETSc.IntType)
    csr = (indptr, places[used].astype(PETSc.IntType), np.repeat(values, size, axis=0)[used])
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=comm)


def _nodes_by_place(elements):
    """Return nodes at corners, in middles, and at the ends (k, 2) of the edges of these."""
    corners, middles, ends = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros((0, 2), np.int64)]
    for kind, table in elements.items():
        edges = np.array(EDGES.get(kind, ()), dtype=int).reshape(-1, 2)
        count = table.shape[1] - len(edges)
        corners.append(table[:, :count].ravel())
        middles.append(table[:, count : count + len(edges)].ravel())
        ends.append(np.sort(table[:, edges], axis=2).reshape(-1, 2))
    return [np.concatenate(tables).astype(np.int64) for tables in (corners, middles, ends)]
