"""Read displacements and stresses at nodes from ANSYS' result file (.rst); each rank reads a share of the elements.

A set of results has the displacements of all nodes, and for each element the stresses xx, yy, zz, xy, yz, zx at its
corners (ENS), of which the mean at a node is taken. Places of records count words from the start of the set, of the
table of its elements, or of the element.
"""

from collections.abc import Iterator

import numpy as np

from ...parallel.failures import InputError, agreed
from ...parallel.lookup import sort_over_ranks
from ...parallel.shares import row_range
from ..ansys.records import STANDARD, RecordFile
from ..ansys.rst import FILE, geometry_of

IN_ALL, SETS = 6, 8  # in the header: how many elements, and sets of results
INDEX, NODES = 10, 14  # in the header: where the places of the sets are, and where the node numbers are
ELEMENTS_OLD, ELEMENTS = 10, 28  # in the geometry: where the places of the elements are
NUMBER, CORNERS = 8, 10  # in the record of an element: its number, and where its nodes begin
COUNT, DISPLACEMENTS, STRESSES, DOFS, KINDS = 1, 10, 11, 19, 20  # in the header of a set
STRESS, SIX = 2, 6  # in the pointers of an element: where the stresses are; components
XYZ = [1, 2, 3]


def read(path, comm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes (s,), displacements (steps, s, 3) and mean stresses (steps, s, 6) of this rank.

    Collective. Raises InputError.
    """
    with agreed(comm):
        file = RecordFile(path, FILE)
        header, _ = file.record(STANDARD + 3)
        sets = [(place, file.record(place)[0]) for place in file.record(int(header[INDEX]))[0][: header[SETS]].tolist()]
        for _, results in sets:
            _require(file, results)
        if not sets:
            raise InputError(f"{path}: found no results, expected one load step a column")
        share = slice(*row_range(comm, int(sets[0][1][COUNT])))
        nodes = _nodes(file, header, share)
        local, sums, counts = _sums(file, sets, nodes, share)
    columns = [counts, *sums.reshape(len(local), -1).T]
    node, *columns = sort_over_ranks(comm, local, columns)
    label, start = np.unique(node, return_index=True)
    counts, *columns = (np.add.reduceat(column, start) if len(label) else column for column in columns)
    mean = (np.array(columns) / counts).reshape(len(sets), SIX, len(label)).transpose(0, 2, 1)
    with agreed(comm):
        numbers, _ = file.record(int(header[NODES]))
        order = np.argsort(numbers)
        place = order[np.searchsorted(numbers, label, sorter=order).clip(max=len(numbers) - 1)]
        if (numbers[place] != label).any():
            raise InputError(f"{path}: found stresses at nodes that the file does not have; it is damaged")
        moved = np.stack([_displacements(file, *results, place, len(numbers)) for results in sets])
    return label, moved, mean


def _require(file, header):
    """Raise InputError for a set of results without displacements or element results."""
    if len(header) <= KINDS + len(XYZ) or not header[DISPLACEMENTS] or not header[STRESSES]:
        raise InputError(
            f"{file.path}: found results without displacements or element results, expected both, as the deck of "
            "`hpcred recover --deck` asks for, in a file of less than 8 GB"
        )
    if header[KINDS : KINDS + len(XYZ)].tolist() != XYZ:
        raise InputError(f"{file.path}: found nodes without UX, UY and UZ, expected a body in space")


def _nodes(file, header, share) -> np.ndarray:
    """Return the nodes (e, most) of the elements of this rank, 0 where an element has fewer."""
    _, geometry = geometry_of(file, header)
    start = int(geometry[ELEMENTS]) or int(geometry[ELEMENTS_OLD])
    table = file.record(start)[0]
    width = len(table) // max(int(header[IN_ALL]), 1)  # words of a place
    places = table[::width][share].astype(np.int64)
    corners = np.zeros((len(places), 0), np.int64)
    for which, numbers in _alike(file, places + (start if width == 2 else 0)):
        nodes = numbers[:, CORNERS:]
        corners = np.pad(corners, ((0, 0), (0, max(0, nodes.shape[1] - corners.shape[1]))))
        corners[which, : nodes.shape[1]] = nodes
    return corners


def _sums(file, sets, nodes, share) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes (l,) with stresses of elements, their sums (l, steps, 6), and of how many elements (l,)."""
    local, place = np.unique(nodes, return_inverse=True)
    place = place.reshape(nodes.shape)
    sums, counts = np.zeros((len(local), len(sets), SIX)), np.zeros((len(sets), len(local)), np.int64)
    for k, (start, header) in enumerate(sets):
        start += int(header[STRESSES])
        # where the record of each element begins
        table = file.record(start)[0]
        width = len(table) // int(header[COUNT])
        places = start + table[::width][share].astype(np.int64)
        stress = np.zeros(len(places), np.int64)
        # from there, where its stresses begin; records of equal length are read together
        for which, pointers in _alike(file, places):
            if pointers.shape[1] <= STRESS:
                raise file.damaged(int(places[which[0]]), f"{pointers.shape[1]} pointers of an element")
            stress[which] = pointers[:, STRESS]
        # six components at each corner, added up at the nodes
        there = np.flatnonzero(stress > 0)
        for which, values in _alike(file, (places + stress)[there]):
            values = values.reshape(len(which), -1, SIX) if values.shape[1] % SIX == 0 else values[:, None]
            at = place[there[which], : values.shape[1]]
            if values.shape[2] != SIX or at.shape != values.shape[:2] or not local[at].all():
                raise InputError(f"{file.path}: found elements with other stresses than six components at corners, as "
                                 "those of shells and beams, expected solids")  # fmt: skip
            np.add.at(sums, (at, k), values)
            counts[k] += np.bincount(at.ravel(), minlength=len(local))
    # a mean over other elements in each step would be no motion of one body
    if (counts != counts[:1]).any():
        raise InputError(f"{file.path}: found load steps with stresses of different elements")
    used = counts[0] > 0
    return local[used], sums[used], counts[0][used]


def _displacements(file, start, header, place, count) -> np.ndarray:
    """Return the displacements (s, 3) of the nodes at some places among so many."""
    values, _ = file.record(start + int(header[DISPLACEMENTS]))
    dofs = int(header[DOFS])
    if len(values) != count * dofs:
        raise InputError(f"{file.path}: found {len(values)} displacements, expected {dofs} of {count} nodes")
    return values.reshape(count, dofs)[place, : len(XYZ)]


def _alike(file, places) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield which (k,) of the records at some places have one form, and their numbers (k, count)."""
    if not len(places):
        return
    heads = file.words_at(places, 2)
    forms, group = np.unique(heads, axis=0, return_inverse=True)
    for number, (length, flags) in enumerate(forms.tolist()):
        which = np.flatnonzero(group.ravel() == number)
        if file.is_plain(flags):
            words = file.words_at(places[which], length + 3)
            if (words[:, -1] != length).any():
                raise file.damaged(int(places[which][0]), "a record without its length at the end")
            numbers = file.decoded(words[:, 2:-1].ravel(), flags & 0xFFFFFFFF, int(places[which][0]))
            yield which, numbers.reshape(len(which), -1)
        else:
            for k in which.tolist():
                yield np.array([k]), file.record(int(places[k]))[0][None]
