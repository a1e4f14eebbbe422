"""Read nodes and elements of universal files (UFF, .unv).

The nodes of datasets 15, 781 and 2411, the elements of 780 and 2412 and the groups of 2467 and its like are read, and
of coordinate systems (18, 2420) which of them are the global one. A dataset is between two lines of -1.
"""

import os
import re
from bisect import bisect_left
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...fe.elements import NODES
from ...files.system_errors import damaged_file, open_input, read_bytes
from ...files.text import BYTE_ORDER_MARK, LARGEST_LABEL, Piece, end_to_end, pieces, records, refuse_packed, shown
from ...files.text_numbers import labels, ragged, whole
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import number_over_ranks, require_once, sort_over_ranks
from .table import NodeTable, elements_of, finite

MARK = re.compile(rb"(?m)^ {0,4}-1[ \t]*\r?$")
START = re.compile(rb"\s*-1[ \t]*\r?\n[ \t]*\d{1,5}[ \t]*(?:b[^\n]*)?\r?\n")
NUMBER = re.compile(rb"[ \t]*(\d{1,5})[ \t]*(?P<binary>b[^\n]*)?\r?\n?")
# numbers in the lines of a node: label, two systems and a colour, and the coordinates
NODE_LINES = {15: (7,), 781: (4, 3), 2411: (4, 3)}
ELEMENTS = (780, 2412)
# numbers of a member in the lines of a group, of which the first two are its kind and its number
GROUPS = {2417: 2, 2429: 2, 2430: 2, 2432: 2, 2435: 4, 2452: 4, 2467: 4, 2477: 4}
NODE, ELEMENT = 7, 8  # kinds of members
HEAD = re.compile(rb"[ \t]*(?P<number>\d{1,10})(?:[ \t]+-?\d{1,10}){5,6}[ \t]+(?P<count>\d{1,9})[ \t]*\r?\n?")
GLOBAL = np.array([0, 1])  # coordinate systems, where the file does not say otherwise
# kinds by the number of the finite element; those of WITH_SECTION have a line about the section before the nodes
KINDS = {
    11: "line", 21: "line", 22: "line", 23: "line3", 24: "line3", 41: "triangle", 42: "triangle6", 44: "quad",
    45: "quad8", 51: "triangle", 52: "triangle6", 54: "quad", 55: "quad8", 61: "triangle", 62: "triangle6", 64: "quad",
    65: "quad8", 91: "triangle", 92: "triangle6", 94: "quad", 95: "quad8", 111: "tetra", 112: "wedge", 113: "wedge15",
    115: "hexahedron", 116: "hexahedron20", 118: "tetra10",
}  # fmt: skip
WITH_SECTION = (11, 21, 22, 23, 24)
# places of the nodes in the file: round each face, corners and middles in turn; kinds that are not here are as in VTK
ORDER = {
    "line3": [0, 2, 1], "triangle6": [0, 3, 1, 4, 2, 5], "quad8": [0, 4, 1, 5, 2, 6, 3, 7],
    "tetra10": [0, 4, 1, 5, 2, 6, 7, 8, 9, 3],
    "wedge15": [0, 6, 1, 7, 2, 8, 12, 13, 14, 3, 9, 4, 10, 5, 11],
    "hexahedron20": [0, 8, 1, 9, 2, 10, 3, 11, 16, 17, 18, 19, 4, 12, 5, 13, 6, 14, 7, 15],
}  # fmt: skip
TO_VTK = {kind: np.argsort(places) for kind, places in ORDER.items()}
WITHOUT = "{}: sets are without the nodes of elements whose kinds are not read: {}{}"
DIGITS = 1e-5  # of coordinates, of which dataset 15 has six
ABOVE = 1000  # lines above the bytes of functions, of which there are 11


class Mesh(NamedTuple):
    """Nodes in the order of the file, node numbers of elements of this rank by kind, and those of sets by name, each
    once over all ranks."""

    nodes: NodeTable
    elements: dict[str, np.ndarray]
    sets: dict[str, np.ndarray]
    remarks: list[str]


def begins(start: bytes) -> bool:
    """Test whether a text that starts so is a universal file: a line of -1 and the number of a dataset."""
    return START.match(start) is not None


def read(path, comm) -> Mesh:
    """Return what a file has. Collective. Raises InputError."""
    sets = datasets(path, comm)
    with agreed(comm):
        nodes = [dataset for dataset in sets if dataset[0] in NODE_LINES]
        if not nodes:
            numbers = ", ".join(str(number) for number, *_ in sets)
            raise InputError(
                f"{path}: found 0 datasets of nodes (of the datasets {numbers or 'none'}), expected one of "
                "15, 781 or 2411"
            )
        systems = _global_systems(path, [dataset for dataset in sets if dataset[0] in (18, 2420)])
    table = _together(path, comm, [_node_table(path, comm, systems, *dataset) for dataset in nodes])
    elements, groups, remarks = {}, {}, []
    with agreed(comm):
        if comm.rank == 0:
            elements, numbers = _elements(path, [dataset for dataset in sets if dataset[0] in ELEMENTS])
            members = [group for dataset in sets if dataset[0] in GROUPS for group in _members(path, *dataset)]
            groups, remarks = _groups(path, members, elements, numbers)
    mine = {name: groups.get(name, np.zeros(0, np.int64)) for name in comm.bcast(list(groups))}
    return Mesh(
        table, elements_of(comm, elements, TO_VTK),
        {name: sort_over_ranks(comm, nodes_of_group)[0] for name, nodes_of_group in mine.items()}, remarks,
    )  # fmt: skip


def _node_table(path, comm, systems, number, start, stop) -> NodeTable:
    """Return the nodes of a dataset. Collective. Raises InputError."""
    widths = NODE_LINES[number]
    # a node begins where a line holds no point
    first = re.compile(rb"(?m)^") if len(widths) == 1 else re.compile(rb"(?m)^[ \t0-9+-]*\r?$")
    with agreed(comm):
        label, position = end_to_end(records(path, comm, start, stop, first),
                                     lambda piece: _nodes(piece, systems, number, widths))  # fmt: skip
    if not comm.allreduce(len(label)):
        raise InputError(f"{path}: found no nodes in the dataset {number}")
    require_once(comm, label, lambda twice: f"{path}: found the node {twice} more than once, expected each node once")
    return NodeTable.as_given(comm, label, position)


def _together(path, comm, tables) -> NodeTable:
    """Return the nodes of all tables in their order, those that several have once. Collective. Raises InputError for a
    node at two places."""
    if len(tables) == 1:
        return tables[0]
    first = np.cumsum([0, *(comm.allreduce(len(table.label)) for table in tables)])
    places = [table.place + start for table, start in zip(tables, first, strict=False)]
    label, position = (np.concatenate([getattr(table, key) for table in tables]) for key in ("label", "position"))
    label, place, *columns = sort_over_ranks(comm, label, [np.concatenate(places), *position.T])
    order = np.lexsort((place, label))  # equal labels are on one rank, here in the order of the file
    label, place, position = label[order], place[order], np.stack(columns, axis=1)[order]
    # the first of equal labels, of which the others say the same
    again = np.append(False, label[1:] == label[:-1])[: len(label)]
    bound = DIGITS * max(comm.allgather(np.abs(position).max(initial=0.0)))
    apart = again[1:] & (np.abs(np.diff(position, axis=0)).max(axis=1, initial=0.0) > bound)
    if moved := sum(comm.allgather(label[1:][apart].tolist()[:1]), []):
        raise InputError(f"{path}: found the node {moved[0]} at different places in two datasets of nodes, expected "
                         "one; keep one of the datasets")  # fmt: skip
    return NodeTable(label[~again], position[~again], number_over_ranks(comm, place[~again])[1])


def datasets(path, comm) -> list[tuple[int, int, int]]:
    """Return number, first and last byte of the lines of the datasets of a file. Collective. Raises InputError where
    something stands outside of them, or the file is cut off."""
    with agreed(comm):
        refuse_packed(path)
        mine = [piece.start + match.start() for piece in pieces(path, comm) for match in MARK.finditer(piece.text)]
    marks = sum(comm.allgather(mine), [])
    with agreed(comm):
        return _datasets(path, marks)


def _datasets(path, marks):
    listed, at, size = [], 0, os.path.getsize(path)  # at: the byte up to which all is understood
    with open_input(path) as file:
        while (place := bisect_left(marks, at)) < len(marks):
            _require_nothing(path, file, at, marks[place])
            file.readline()
            line = file.readline()
            match = NUMBER.fullmatch(line)
            if match is not None and match["binary"] and int(match[1]) not in (*NODE_LINES, *ELEMENTS):
                begin, at = file.tell(), _end_of_functions(path, file, line)
                listed.append((int(match[1]), begin, at))
                continue
            if match is None or match["binary"]:
                below = shown(line, 20)
                raise InputError(f"{path}: found '{below}' below a line of -1, expected the number of a dataset")
            if place + 1 == len(marks):
                raise damaged_file(path, f"{len(marks)} lines of -1, expected two a dataset", "cut off")
            listed.append((int(match[1]), file.tell(), marks[place + 1]))
            file.seek(marks[place + 1])
            file.readline()
            at = file.tell()
        _require_nothing(path, file, at, size)
    return listed


def _require_nothing(path, file, low, high):
    """Raise InputError where something stands outside of a dataset; leaves the file at `high`."""
    file.seek(low)
    if between := file.read(high - low).removeprefix(BYTE_ORDER_MARK).strip():
        raise InputError(
            f"{path}: found '{shown(between.splitlines()[0])}' outside of a dataset, expected two lines of -1 around "
            "each; the file is damaged"
        )


def _end_of_functions(path, file, line):
    """Return the byte behind a dataset of binary functions (58b), whose first line has its lines and bytes."""
    words = line.split()[1:]
    if len(words) < 4 or not all(word.isdigit() and len(word) < 16 for word in words[:4]) or int(words[2]) > ABOVE:
        raise InputError(f"{path}: found the binary dataset '{shown(line)}', expected its number of lines and bytes")
    lines = [file.readline() for _ in range(int(words[2]))]
    begin = file.tell()
    for count in (int(words[3]), *_bytes_of_function(lines)):
        file.seek(begin + count)
        while (end := file.readline()) and not end.strip():  # the last line may begin behind the last byte
            pass
        if end.strip() == b"-1":
            return file.tell()
    raise damaged_file(path, f"no line of -1 behind the binary dataset '{shown(line)}'", "cut off")


def _bytes_of_function(lines) -> list[int]:
    """Return how many bytes the numbers of a function take by the lines above, where they say it: pyuff writes the
    bytes wrongly."""
    words = lines[6].split()[:3] if len(lines) > 6 else []
    if len(words) < 3 or not all(word.isdigit() and len(word) < 16 for word in words):
        return []
    kind, count, even = map(int, words)
    return [count * ((2 if kind in (5, 6) else 1) + (not even)) * (4 if kind in (2, 5) else 8)]


def _global_systems(path, sets):
    """Return the numbers of the coordinate systems that are the global one."""
    known = dict.fromkeys(GLOBAL.tolist(), True)
    for number, start, stop in sets:
        lines = read_bytes(path, start, stop).splitlines()
        size, above, below = (4, 0, 2) if number == 18 else (6, 2, 4)  # lines of a system, above the first, of numbers
        for at in range(above, len(lines) - size + 1, size):
            try:
                head = [int(word) for word in lines[at].split()]
                values = [float(word) for line in lines[at + size - below : at + size]
                          for word in line.upper().replace(b"D", b"E").split()]  # fmt: skip
                if number == 18:  # origin, a point on the x axis, and one in the plane of x and z
                    x, z = np.array(values[3:6]), np.array(values[6:9])
                    along = x[0] > 0 and z[2] > 0 and not (x[1:].any() or z[1])
                    is_global = head[2] == 0 and values[:3] == [0, 0, 0] and along
                else:
                    is_global = values == [1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0]
                known[head[0]] = head[1] == 0 and is_global
            except (ValueError, IndexError):  # what cannot be read is not the global one
                return np.zeros(1, np.int64)
    return np.array([key for key, is_global in known.items() if is_global])


def _nodes(piece, systems, number, widths):
    """Return numbers and coordinates of the nodes of a piece; `systems`: those that are the global one."""
    values, counts, lines = ragged(piece, commas=False)
    wrong = np.flatnonzero(counts != np.resize(widths, len(counts)))
    if wrong.size or len(counts) % len(widths):
        bad = lines[wrong[0]] if wrong.size else lines[-1]
        raise piece.refusal(int(bad), f"lines of {' and '.join(map(str, widths))} numbers a node")
    table, lines = values.reshape(-1, 7), lines[:: len(widths)]
    finite(piece, table[:, 4:], lines)
    if number == 15:
        piece.require(np.isin(table[:, 1], systems), lines, "coordinates in the global system")
    piece.require(np.isin(table[:, 2], systems), lines, "displacements in the global system, in which the matrices "
                  "must be; if they are, give the nodes as lines of number, x, y, z")  # fmt: skip
    whole(piece, table[:, 1:4].ravel(), np.repeat(lines, 3), "two systems and a colour", 0)
    return labels(piece, table[:, 0], lines), table[:, 4:]


def _elements(path, sets):
    """Return parts of node numbers and of numbers of elements by kind, read on one rank: where an element begins is
    seen from the one before."""
    elements, numbers = {}, {}
    for number, start, stop in sets:
        piece = Piece(Path(path), read_bytes(path, start, stop), start)
        values, counts, lines = ragged(piece, commas=False)
        if not len(values):
            continue
        whole(piece, values, np.repeat(lines, counts), "the numbers of an element", -LARGEST_LABEL, LARGEST_LABEL)
        at = np.cumsum(counts) - counts
        # what each line would say if it were the first of an element
        kind, nodes = (np.where(counts > 5, values[np.minimum(at + k, len(values) - 1)], 0) for k in (1, 5))
        if number == 780:
            nodes = np.where(counts == 8, values[np.minimum(at + 7, len(values) - 1)], 0)
        skip = 1 + np.isin(kind, WITH_SECTION)
        following = np.arange(len(counts)) + skip + np.ceil(nodes / 8).astype(np.int64)
        heads, line, jumps = [], 0, following.tolist()
        while line < len(jumps):
            heads.append(line)
            line = jumps[line] if jumps[line] > line + 1 else len(jumps) + 1
        heads = np.array(heads, dtype=np.int64)
        wrong = heads[(nodes[heads] < 1) | (nodes[heads] > 1000)]
        if wrong.size or line != len(jumps):
            bad = wrong[0] if wrong.size else heads[-1]
            raise piece.refusal(int(lines[bad]), "number, kind and number of nodes of an element, and its nodes")
        first = np.minimum(heads + skip[heads], len(at) - 1)
        lengths = np.append(at, len(values))[np.minimum(following[heads], len(at))] - at[first]
        piece.require(lengths == nodes[heads], lines[heads], "as many nodes below as it says")
        for code, name in KINDS.items():
            mine = (kind[heads] == code) & (nodes[heads] == NODES[name])
            if mine.any():
                table = values[at[first[mine]][:, None] + np.arange(NODES[name])]
                whole(piece, table.ravel(), np.repeat(lines[heads[mine]], NODES[name]), "a node of an element", 1)
                elements.setdefault(name, []).append(table.astype(np.int64))
                numbers.setdefault(name, []).append(values[at[heads[mine]]].astype(np.int64))
    return elements, numbers


def _members(path, number, start, stop) -> list[tuple[str, int, np.ndarray]]:
    """Return name, number and members (n, 2), a kind and a number each, of the groups of a dataset."""
    lines = read_bytes(path, start, stop).splitlines(keepends=True)
    place = start + np.cumsum([0, *map(len, lines)])
    members, at, width = [], 0, GROUPS[number]
    while at < len(lines):
        head = HEAD.fullmatch(lines[at])
        count = int(head["count"]) if head else 0
        below = lines[at + 2 : at + 2 + -(-count * width // 8)]
        piece = Piece(Path(path), b"".join(below), int(place[min(at + 2, len(lines))]))
        values, counts, rows = ragged(piece, commas=False)
        if head is None or at + 1 == len(lines) or len(values) != count * width:
            raise Piece(Path(path), lines[at], int(place[at])).refusal(
                0, f"a group of the dataset {number}: its number, six more and that of its members, its name, and them"
            )
        table = whole(piece, values, np.repeat(rows, counts), "kind and number of a member of a group", 0)
        name = shown(lines[at + 1], 200) or f"group {int(head['number'])}"
        members.append((name, int(head["number"]), table.reshape(count, width)[:, :2]))
        at += 2 + len(below)
    return members


def _groups(path, members, elements, numbers) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return node numbers by name of the group, those of its elements among them, and remarks. Names that are there
    twice have the number of the group behind them."""
    kinds = [(np.concatenate(elements[kind]), np.concatenate(numbers[kind])) for kind in elements]
    names, sets, lacking = Counter(name for name, *_ in members), {}, []
    for name, number, table in members:
        name = name if names[name] == 1 else f"{name} {number}"
        of_elements = np.unique(table[table[:, 0] == ELEMENT, 1])
        inside = [np.isin(own, of_elements) for _, own in kinds]
        nodes = [rows[there].ravel() for (rows, _), there in zip(kinds, inside, strict=True)]
        nodes = np.unique(np.concatenate([table[table[:, 0] == NODE, 1], *nodes]))
        if sum(map(np.count_nonzero, inside)) < len(of_elements):
            lacking.append(name)
        if len(nodes):
            sets[name] = nodes
    return sets, [WITHOUT.format(path, ", ".join(lacking[:5]), ", ..." * (len(lacking) > 5))] if lacking else []
