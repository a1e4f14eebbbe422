"""Couple the sets of rigid interfaces to their reference nodes.

The coupled dofs of a set follow the six dofs of its reference node, q = T p; M, D, K become T^T A T, and G T = I.
"""

from __future__ import annotations

import numpy as np

from ...fe.dofs import Dofs
from ...linalg.csr import sparse_rows
from .motion import coupled_rows, members, rigid_rows
from .nodes import SIX


def couple(model):
    """Return the model in which the dofs of rigid sets follow their reference nodes, and T (n, n^) with q = T q^.

    The dofs of the reference nodes come last. Without rigid sets the model itself, and None. Collective.
    """
    rigid = [interface for interface in model.interfaces if interface.definition.kind == "rigid"]
    if not rigid:
        return model, None
    T, dofs = _coupling(model, rigid)
    return model.in_coordinates(model.operator.map(lambda mat: mat.ptap(T)), T, dofs), T


def _coupling(model, rigid):
    """Return T (n, n^), and the labels of the rows of this rank of q^."""
    comm, last = model.comm, model.comm.rank == model.comm.size - 1
    follow = np.zeros(model.local_rows, bool)
    entries = []
    for interface in rigid:
        rows, direction, position = coupled_rows(model, interface.definition, members(model, interface.definition))
        follow[rows] = True
        places = [SIX.index(name) for name in interface.directions]
        entries.append((rows, places, rigid_rows(direction, position - np.array(interface.position))[:, places]))
    free = np.flatnonzero(~follow)
    kept = comm.allreduce(len(free))
    triplets = [(free, (comm.exscan(len(free)) or 0) + np.arange(len(free)), np.ones(len(free)))]
    counts = [len(places) for _, places, _ in entries]
    for (rows, places, E), count, end in zip(entries, counts, np.cumsum(counts), strict=True):
        columns = kept + end - count + np.arange(count)
        triplets.append((np.repeat(rows, len(places)), np.tile(columns, len(rows)), E.ravel()))
    T = sparse_rows(model.K, triplets, (len(free) + (sum(counts) if last else 0), kept + sum(counts)))
    dofs = model.dofs.take(free)
    if last:
        number, position = ([getattr(interface, key) for interface in rigid] for key in ("node", "position"))
        places = np.concatenate([places for _, places, _ in entries])
        added = Dofs(np.repeat(number, counts), places, np.repeat(position, counts, axis=0))
        pairs = [(getattr(dofs, key), getattr(added, key)) for key in ("node", "direction", "position")]
        dofs = Dofs(*(np.concatenate(pair).astype(pair[0].dtype) for pair in pairs))  # the same on all ranks
    return T, dofs
