"""Detect truncated matrices of formats without end mark, by rows that only one of K and M has.

A text that is cut after a line looks like a smaller matrix. In a complete one, each row with an entry has one on the
diagonal, and nodes with mass have stiffness. Single nodes may be without mass, but not some corners or edge midpoints
of solids and shells, nor many nodes after the last row of M. All functions are collective.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..fe.dofs import SCALAR
from ..fe.elements import NODES
from ..parallel.failures import InputError
from ..parallel.lookup import look_up, number_over_ranks
from .entries import STRIDE

TRANSLATIONS = 3  # the first directions of a node
MANY = 0.05  # of the nodes: so many without mass behind the last row of M are a cut
THIN = ("line", "line3")  # kinds of elements that may be springs
WHAT = {"K": "stiffness", "M": "mass"}
WAY_OUT = "export it again; if it is whole, give it in a format that has its size, such as Matrix Market"


class Rows:
    """The rows of this rank, from `first` on, that have an entry in a matrix, and those with one on the diagonal."""

    def __init__(self, first: int, last: int, rows, columns, values):
        there = values != 0
        self.touched, self.on_diagonal = (np.zeros(last - first, bool) for _ in range(2))
        self.touched[rows[there] - first] = True
        self.on_diagonal[rows[there & (rows == columns)] - first] = True


def refuse_cut(comm, parts, rows: dict[str, Rows], labels) -> list[str]:
    """Refuse open-ended matrices that lack rows; return warnings. `labels`: of rows here, or None. Collective."""
    for key in sorted(parts.open_ended & set(rows)):  # in one order on all ranks
        if bare := comm.allreduce(int((rows[key].touched & ~rows[key].on_diagonal).sum())):
            raise InputError(
                f"{parts.files[key]}: found {bare} rows of {key} with entries but none on the diagonal, expected one "
                f"in each row; the file is cut off or damaged: {WAY_OUT}"
            )
    if labels is None:
        return []
    if "K" in parts.open_ended and not parts.loose:
        only = _only(comm, labels, rows["M"], rows["K"])
        alone = (only.nodes & (labels % STRIDE != SCALAR)) | (only.behind & (labels % STRIDE < TRANSLATIONS))
        if count := comm.allreduce(len(np.unique(labels[alone] // STRIDE))):
            raise _lacks(comm, parts, "K", "M", count, labels[alone])
    if "M" not in parts.open_ended:
        return []
    only = _only(comm, labels, rows["K"], rows["M"])
    parted = labels[only.behind & ~only.nodes & (labels % STRIDE < TRANSLATIONS)]  # of the node at the cut
    if comm.allreduce(len(parted)):
        raise _lacks(comm, parts, "M", "K", 1, parted)
    silent = np.unique(labels[only.nodes if parts.all_massive else only.nodes & only.behind] // STRIDE)
    massive = np.unique(labels[rows["M"].touched] // STRIDE)
    for lost, there in zip(*(_of_solids(comm, parts.elements, nodes) for nodes in (silent, massive)), strict=True):
        if comm.allreduce(len(there)) and (count := comm.allreduce(len(lost))):
            raise _lacks(comm, parts, "M", "K", count, lost * STRIDE)
    behind = np.unique(labels[only.nodes & only.behind] // STRIDE)
    behind = np.setdiff1d(behind, np.concatenate(_of_solids(comm, parts.elements, behind)))
    count, total = (comm.allreduce(len(part)) for part in (behind, np.unique(labels // STRIDE)))
    if count > MANY * total:
        raise _lacks(comm, parts, "M", "K", count, behind * STRIDE)
    if not count:
        return []
    return [f"{parts.files['M']}: the last {count} nodes of K have no mass, which is so, or the file is cut off"]


class _Only(NamedTuple):
    """Rows that one matrix has and the other has not: those of `nodes` of which the other has no row, and those
    `behind` the last row of the other."""

    nodes: np.ndarray
    behind: np.ndarray


def _only(comm, labels, there: Rows, lacking: Rows) -> _Only:
    mine = there.touched & ~lacking.touched
    known, _ = number_over_ranks(comm, np.unique(labels[lacking.touched] // STRIDE))
    found, _ = look_up(comm, known, [], labels[mine] // STRIDE)
    nodes = mine.copy()
    nodes[mine] = ~found
    last = max(comm.allgather(int(labels[lacking.touched].max(initial=-1))))
    return _Only(nodes, mine & (labels > last))


def _of_solids(comm, elements, nodes):
    """Return the nodes that are corners of solids and shells, and those in the middle of edges."""
    found = []
    for corners in (False, True):
        parts = [part[:, : NODES[kind.rstrip("0123456789")] if corners else None].ravel()
                 for kind, part in elements.items() if kind not in THIN]  # fmt: skip
        known, _ = number_over_ranks(comm, np.unique(np.concatenate([np.zeros(0, np.int64), *parts])))
        found.append(look_up(comm, known, [], nodes)[0])
    inside, corner = found
    return nodes[corner], nodes[inside & ~corner]


def _lacks(comm, parts, key, other, count, labels) -> InputError:
    first = min(comm.allgather(int(labels.min(initial=np.iinfo(np.int64).max)))) // STRIDE
    return InputError(
        f"{parts.files[key]}: found no {WHAT[key]} at {count} nodes that have {WHAT[other]}, the first is {first}; the "
        f"file is cut off, or the two are of different models: {WAY_OUT}"
    )
