"""Node coordinates: an Abaqus .inp or a text table enters, the labels of the rows of this rank leave."""

from pathlib import Path

import numpy as np

from ..model.dofs import DIRECTIONS, Dofs
from ..model.elements import NODES, abaqus_kind, in_vtk_order
from ..parallel.exchange import exchange
from ..parallel.failures import InputError, agreed
from .text import numbers, pieces, require_file


def read_dofs(comm, size: int, starts: np.ndarray, nodes, dofs=None, name="model") -> Dofs:
    """Labels of this rank's rows. Collective. Raises InputError where nodes and rows do not fit.

    `starts` (ranks,): first row of each rank. `nodes`: .inp file, or text lines of node, x, y, z in the order of
    the rows. `dofs`: text lines of node, direction (1 to 6), one a row of the matrices; without it every node has
    the same number of dofs (1 to 3 displacements, or 6).
    """
    with agreed(comm):
        for path in filter(None, (nodes, dofs)):
            require_file(path)
    table = _read_nodes(comm, nodes)
    count = comm.allreduce(len(table))
    rows = (starts[1:].tolist() + [size])[comm.rank] - starts[comm.rank]
    if dofs is not None:
        return _by_label(comm, size, starts, table, dofs)
    per_node = size // count if count and size % count == 0 else 0
    if per_node not in (1, 2, 3, 6):
        raise InputError(
            f"{name}: found {count} nodes in {nodes} for {size} rows, expected 3 or 6 rows a node; "
            "give the node and direction of every row by --dofs"
        )
    place = (comm.exscan(len(table)) or 0) + np.arange(len(table))
    # a node goes to every rank that has rows of it
    first, last = ((np.searchsorted(starts, row, side="right") - 1)
                   for row in (place * per_node, (place + 1) * per_node - 1))  # fmt: skip
    twice = np.flatnonzero(last > first)
    owner = np.concatenate([first, last[twice]])
    order = np.concatenate([place, place[twice]])
    table = np.concatenate([table, table[twice]])
    place, *columns = exchange(comm, owner, [order, *table.T])
    columns = np.array(columns).T[np.argsort(place)]
    mine = np.arange(rows) + starts[comm.rank]
    index = mine // per_node - (mine[0] // per_node if rows else 0)
    return Dofs(columns[index, 0].astype(np.int64), (mine % per_node).astype(np.int8), columns[index, 1:].copy())


def _by_label(comm, size, starts, table, path):
    """Each row names its node; nodes and rows meet on the rank of the node number modulo the number of ranks."""
    with agreed(comm):
        rows = [numbers(text, 2, path) for text in pieces(path, comm, 0)]
        rows = np.concatenate(rows) if rows else np.zeros((0, 2))
        if rows.size and not np.isin(rows[:, 1], np.arange(1, 7)).all():
            raise InputError(f"{path}: found a direction that is none of 1 to 6 ({', '.join(DIRECTIONS)})")
    total = comm.allreduce(len(rows))
    if total != size:
        raise InputError(f"{path}: found {total} lines, expected one for each of the {size} rows")
    place = (comm.exscan(len(rows)) or 0) + np.arange(len(rows))
    label, x, y, z = exchange(comm, (table[:, 0] % comm.size).astype(int), list(table.T))
    order = np.argsort(label)
    label, points = label[order], np.array([x, y, z]).T[order]
    node, direction, place = exchange(
        comm, (rows[:, 0] % comm.size).astype(int), [rows[:, 0].copy(), rows[:, 1].copy(), place]
    )
    with agreed(comm):
        found = np.searchsorted(label, node)
        missing = np.append(label, np.nan)[found] != node
        if missing.any():
            raise InputError(f"{path}: node {int(node[missing][0])} has no coordinates")
    owner = np.searchsorted(starts, place, side="right") - 1
    place, node, direction, *point = exchange(comm, owner, [place, node, direction, *points[found].T])
    order = np.argsort(place)
    return Dofs(node[order].astype(np.int64), (direction[order] - 1).astype(np.int8), np.array(point).T[order].copy())


def _read_nodes(comm, path):
    """Lines (node, x, y, z) of this rank, in global order."""
    with agreed(comm):
        if Path(path).suffix.lower() == ".inp":
            parts = [numbers(text, 4, path) for start, stop, _ in _sections(path, "node")
                     for text in pieces(path, comm, start, stop)]  # fmt: skip
        else:
            parts = [numbers(text, 4, path) for text in pieces(path, comm, 0)]
        table = np.concatenate(parts) if parts else np.zeros((0, 4))
        if not np.isfinite(table).all():
            raise InputError(f"{path}: found a node coordinate that is NaN or Inf")
    if not comm.allreduce(len(table)):
        raise InputError(f"{path}: found no nodes, expected lines of node, x, y, z")
    if Path(path).suffix.lower() == ".inp":
        table = _sorted_by_label(comm, table)
    return table


def read_elements(comm, path) -> dict:
    """Node numbers (elements, nodes) by kind from the *Element sections of an Abaqus .inp; the part of this rank.

    Kinds that are not known are left out. Collective. Raises InputError.
    """
    found = {}
    with agreed(comm):
        for start, stop, keys in _sections(path, "element"):
            kind = abaqus_kind(keys.get("type", ""))
            if kind is not None:
                for text in pieces(path, comm, start, stop, continued=True):
                    found.setdefault(kind, []).append(numbers(text, NODES[kind] + 1, path)[:, 1:].astype(np.int64))
    kinds = sorted(set().union(*comm.allgather(set(found))))
    return {kind: in_vtk_order(kind, np.concatenate([np.zeros((0, NODES[kind]), np.int64), *found.get(kind, [])]))
            for kind in kinds}  # fmt: skip


def _sections(path, keyword):
    """Byte ranges (start, stop) of the data lines below each *keyword of an Abaqus .inp, and its parameters."""
    sections, begin, position = [], None, 0
    with open(path, "rb") as file:
        for line in file:
            if line[:1] == b"*":
                if begin is not None:
                    sections.append((*begin, position))
                    begin = None
                name, *parameters = line[1:].decode(errors="replace").lower().split(",")
                if line[:2] != b"**" and name.strip() == keyword:
                    pairs = (item.partition("=") for item in parameters)
                    begin = position + len(line), {key.strip(): value.strip() for key, _, value in pairs}
            position += len(line)
    if begin is not None:
        sections.append((*begin, position))
    return [(start, stop, keys) for start, keys, stop in sections]


def _sorted_by_label(comm, table):
    """The lines in ascending order of the node number over all ranks."""
    top = comm.allreduce(float(table[:, 0].max(initial=0.0)), op=max)
    owner = np.minimum((table[:, 0] / (top + 1) * comm.size).astype(int), comm.size - 1)
    columns = np.array(exchange(comm, owner, list(table.T))).T.reshape(-1, 4)
    return columns[np.argsort(columns[:, 0], kind="stable")]
