"""Name the nodes at which the motions that K lets happen without force are not the rigid motions of the node list.

A node whose rows are in other axes, or whose coordinates are others, makes K resist the rigid motions R of the nodes.
If K is that of a free body, R + E d meets no force, with a change d of the motion of these nodes alone: K E d = - K R
is solved for all nodes in whose rows there is a force, which are these nodes and their neighbours.
"""

from __future__ import annotations

import numpy as np

from ...fe.dofs import SCALAR
from ...linalg.blocks import local_rows, times
from ...parallel.decisions import decided
from .motions import rigid_motions

MOST_ROWS = 600  # in which forces are compared, on one rank
MOST_NODES = 1 / 3  # of all may differ, or nothing is said
SOLVED = 1e-5  # of the forces that may be left
DIFFERS = 1e-4  # of the largest change of a node
NULL = 1e-10  # singular value, relative to the largest
ROUNDS = 60  # of reweighting
NAMED = 5


def nodes_that_differ(model, support) -> str | None:
    """Return a sentence that names them, or None where K is not that of a free body, or they are many. Collective."""
    comm, dofs = model.comm, model.dofs
    motions = rigid_motions(model, support.centre)
    forces = times(model.K, motions)
    # the rows of all nodes that meet a force
    limit = np.repeat(support.round_off, 3)
    with local_rows(forces) as view:
        rows = view.real.copy()
    sizes = np.abs(model.K.getDiagonal().getArray().real)
    met = np.abs(rows) > np.maximum(limit, DIFFERS**2) * np.maximum(sizes, np.finfo(float).tiny)[:, None]
    nodes = np.unique(np.concatenate(comm.allgather(np.unique(dofs.node[met.any(axis=1)])[: MOST_ROWS + 1])))
    mine = np.flatnonzero(np.isin(dofs.node, nodes) & (dofs.direction < SCALAR))
    if not 0 < comm.allreduce(len(mine)) <= MOST_ROWS:
        return None
    entries = [model.K.getRow(int(model.first_row + row)) for row in mine]
    resisted = np.any(comm.allgather(met.any(axis=0)), axis=0)
    given = comm.gather((
        model.first_row + mine, dofs.node[mine], rows[np.ix_(mine, resisted)],
        [(columns, values.real) for columns, values in entries],
    ))  # fmt: skip
    # translations do not depend on coordinates
    return decided(comm, _named, given, model.node_count, bool(resisted[:3].any()))


def _named(given, count, turned):
    """Return the sentence from what the ranks have of the rows: their numbers, nodes, forces, and entries of K; of
    `count` nodes; `turned`: whether axes differ, or else places; local."""
    row, node, forces = (np.concatenate([part[k] for part in given]) for k in range(3))
    entries = [entry for part in given for entry in part[3]]
    # K E by the symmetry of K, on all rows that it reaches
    reached = np.unique(np.concatenate([row, *[columns for columns, _ in entries]]))
    K = np.zeros((len(reached), len(row)))
    for k, (columns, values) in enumerate(entries):
        K[np.searchsorted(reached, columns), k] = values
    right = np.zeros((len(reached), forces.shape[1]))
    right[np.searchsorted(reached, row)] = -forces
    # rows and columns of about one size
    unit = 1 / np.sqrt(np.maximum(np.abs(K[np.searchsorted(reached, row), np.arange(len(row))]), 1e-300))
    sizes = np.abs(K * unit).sum(axis=1)
    scale = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > 0)[:, None]
    size = np.maximum(np.linalg.norm(right * scale, axis=0), 1e-300)
    change, null = _solutions(K * unit * scale, right * scale / size)
    left = K * unit * scale @ change - right * scale / size
    if np.linalg.norm(left, axis=0).max() > SOLVED:
        return None  # supports resist
    places = [np.flatnonzero(node == number) for number in np.unique(node)]
    change = unit[:, None] * _on_few(change, null, places) * size
    # nodes whose motion changes
    sizes = np.array([np.linalg.norm(change[place]) for place in places])
    differ = np.flatnonzero(sizes > DIFFERS * sizes.max())
    if len(differ) > MOST_NODES * count:  # without the others nothing is known of these
        return None
    numbers = [str(int(np.unique(node)[k])) for k in differ]
    listed = ", ".join(numbers[:NAMED]) + (f" and {len(numbers) - NAMED} more" if len(numbers) > NAMED else "")
    many, why = len(numbers) > 1, "in other axes" if turned else "those of another place"
    return (
        f"K is that of a free body, whose motions without force are rigid ones of all nodes but {listed}: the rows of "
        f"{'these nodes' if many else 'this node'} are {why} than the list of nodes says"
        + ("; give all rows in the axes of the coordinates" if turned else "; check the coordinates")
    )


def _solutions(matrix, right):
    """Return the smallest least-squares solution, and the null vectors (columns, k) of a matrix."""
    left, values, turn = np.linalg.svd(matrix, full_matrices=False)
    there = values > NULL * values[0]
    return turn[there].T @ ((left[:, there].T @ right) / values[there, None]), turn[~there].T


def _on_few(change, null, places):
    """Return the solution change + null c that is zero at most places, by reweighted least squares."""
    if not null.shape[1]:
        return change
    found = change
    for _ in range(ROUNDS):
        sizes = np.array([np.linalg.norm(found[place]) for place in places])
        weights = np.zeros(len(change))
        for place, size in zip(places, sizes, strict=True):
            weights[place] = 1 / np.sqrt(size + 1e-8 * sizes.max())
        c = np.linalg.lstsq(weights[:, None] * null, -weights[:, None] * change, rcond=None)[0]
        found = change + null @ c
    return found
