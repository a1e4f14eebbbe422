"""Read nodes and elements of result files of CalculiX (.frd), text or binary (*NODE OUTPUT).

A block of nodes (2C) and one of elements (3C) precede all results. Their headers have the counts and the form: 0 and 1
are texts with fields of 5 or 10 columns for a number, 2 and 3 are binary, with coordinates of four and eight bytes.
"""

import re
from dataclasses import dataclass

import numpy as np

from ...fe.elements import NODES
from ...files.system_errors import damaged_file, mapped, read_numbers
from ...files.text import Piece, end_to_end, pieces, records, refuse_packed, require_file
from ...files.text_numbers import labels, numbers, ragged, whole
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import require_once
from ...parallel.shares import row_range
from ..fixed_width import fields_of_format, separated
from ..nodes.table import LARGEST_COORDINATE, VERTICAL_FIRST, NodeTable, elements_of, finite

HEAD = re.compile(rb"(?m)^ {4}([23])C {18}([ \d]{12}) {37}(\d)[ \t]*\r?\n")
ELEMENT = re.compile(rb"(?m)^ -1")
SHARE = 2**14  # binary elements that one rank reads at a time, at least
SHORT, LONG, SINGLE, DOUBLE = range(4)
KINDS = {1: "hexahedron", 2: "wedge", 3: "tetra", 4: "hexahedron20", 5: "wedge15", 6: "tetra10", 7: "triangle",
         8: "triangle6", 9: "quad", 10: "quad8", 11: "line", 12: "line3"}  # fmt: skip
LONGEST = 4 + max(NODES[kind] for kind in KINDS.values())  # words of a binary element


@dataclass
class Results:
    """Nodes ascending by number and elements (node numbers by kind) of this rank; `rough`: places have six digits."""

    nodes: NodeTable
    elements: dict[str, np.ndarray]
    rough: bool

    def notes(self, path) -> list[str]:
        """Return a remark on places of few digits."""
        return [f"{path}: its places have 6 digits only, in which rigid-body motions of the nodes meet forces; give "
                "the input file, or results of *NODE OUTPUT in place of *NODE FILE"] * self.rough  # fmt: skip


@dataclass(frozen=True)
class Block:
    """`count` nodes or elements of a form in the bytes start..stop; `shares`: where those of binary elements begin."""

    count: int
    form: int
    start: int
    stop: int
    shares: tuple[int, ...] = ()


def begins(start: bytes) -> bool:
    """Test whether a file that starts so has results of CalculiX."""
    return start.startswith(b"    1C")


def read(path, comm) -> Results | None:
    """Read the mesh of a file; None if it has no nodes, as after a run that only writes matrices. Collective."""
    blocks = decided(comm, _blocks, path)
    if 2 not in blocks:
        return None
    with agreed(comm):
        label, position = _nodes(path, comm, blocks[2])
        elements = _elements(path, comm, blocks[3]) if 3 in blocks else {}
        wrong = ~(np.abs(position) <= LARGEST_COORDINATE).all(axis=1)
        if wrong.any():
            raise InputError(f"{path}: found the node {label[wrong][0]} at {position[wrong][0].tolist()}, expected "
                             "finite coordinates")  # fmt: skip
    counts = [comm.allreduce(len(label)), comm.allreduce(sum(len(nodes_of) for (nodes_of,) in elements.values()))]
    for kind, count, block in zip(("nodes", "elements"), counts, (blocks[2], blocks.get(3)), strict=True):
        if block and count != block.count:
            raise damaged_file(path, f"{count} {kind}, expected {block.count}", "cut off or damaged")
    require_once(comm, label, lambda twice: f"{path}: found the node {twice} more than once, expected one place a node")
    nodes, elements = NodeTable.ascending(comm, label, position), elements_of(comm, elements, VERTICAL_FIRST)
    return Results(nodes, elements, blocks[2].form in (SHORT, LONG))


def _blocks(path) -> dict[int, Block]:
    """Return the blocks of nodes (2) and elements (3). Raises InputError."""
    blocks = {}
    require_file(path)
    refuse_packed(path, "results of CalculiX")
    with mapped(path) as data:

        def damaged(at, expected):
            where = f"at byte {at} of {len(data)}"
            return damaged_file(path, f"no {expected} {where}", "cut off or damaged")

        at = 0
        # blocks stand behind one another, headed by lines; other heads of the file are one line each
        while data[at : at + 5] in (b"    1", b"    2", b"    3"):
            line = data[at : data.find(b"\n", at) + 1]
            if line[4:5] == b"1":
                at += len(line)
                if not line:
                    raise damaged(len(data), "end of a line")
                continue
            match = HEAD.fullmatch(line)
            key = int(line[4:5])
            if match is None or key in blocks or int(match[3]) > DOUBLE:
                raise damaged(at, "head of one block of nodes, and one of elements behind it,")
            at, count, form, shares = at + len(line), int(match[2]), int(match[3]), ()
            # where the block ends: text by a line of its own, binary nodes by their number
            if form in (SHORT, LONG):
                stop = data.find(b"\n -3", at - 1) + 1
                end = data.find(b"\n", stop) + 1
                if not stop or data[stop:end].strip() != b"-3":
                    raise damaged(at, "end (-3) of the block that begins")
            elif key == 2:
                end = stop = at + count * (28 if form == DOUBLE else 16)
            else:
                # elements have different lengths, so these are walked through
                shares = _shares(data, at, count, damaged)
                end = stop = shares[-1]
            if stop > len(data):
                raise damaged(len(data), "whole block of nodes or elements")
            blocks[key], at = Block(count, form, at, stop, shares), end
        # results or the end of the file follow, else something was cut out
        if data[at : at + 5] not in (b"  100", b" 9999", b"    4") and data[at:].strip() != b"9999":
            raise damaged(at, "block of nodes, elements or results")
    if 3 in blocks and 2 not in blocks:
        raise damaged_file(path, "elements but no nodes")
    return blocks


def _shares(data, at, count, damaged):
    """Return bytes where each SHARE-th of so many binary elements begins, and where the last one ends."""
    shares, done, ahead = [], 0, 1
    while done < count:
        words = np.frombuffer(data[at : at + 4 * LONGEST * ahead][: (len(data) - at) // 4 * 4], "<i4")
        size, same = _alike(words, min(ahead, count - done))
        if not same:
            raise damaged(at, "element of a known type")
        shares += range(at + 4 * size * (-done % SHARE), at + 4 * size * same, 4 * size * SHARE)
        at, done, ahead = at + 4 * size * same, done + same, min(2 * same + 1, SHARE)
    return (*shares, at)


def _alike(words, most):
    """Return how many words each of the first elements has, and how many of them, at most so many, are of one type."""
    kind = KINDS.get(int(words[1])) if len(words) > 1 else None
    if kind is None:
        return 0, 0
    size = 4 + NODES[kind]
    types = words[1 : 1 + size * most : size]
    return size, int((types == types[0]).argmin() if (types != types[0]).any() else len(types))


def _nodes(path, comm, block):
    """Return numbers and places of the nodes of this rank, in any order."""
    if block.form in (SINGLE, DOUBLE):
        kind = np.dtype([("number", "<i4"), ("place", "<f8" if block.form == DOUBLE else "<f4", 3)])
        low, high = row_range(comm, block.count)
        table = read_numbers(path, kind, high - low, block.start + low * kind.itemsize)
        label = table["number"].astype(np.int64)
        _require_numbers(path, label)
        return label, table["place"].astype(float)
    fields = fields_of_format(b"(I3,I%d,3E12.5)" % (5 if block.form == SHORT else 10), str(path))

    def decode(piece):
        table, lines = numbers(separated(piece, fields), 5, commas=False)
        whole(piece, table[:, 0], lines, "the key -1 of a node", -1, -1)
        label = labels(piece, table[:, 1], lines)
        finite(piece, table[:, 2:], lines)
        return label, table[:, 2:]

    return end_to_end(pieces(path, comm, block.start, block.stop), decode)


def _require_numbers(path, values):
    if (values < 1).any():
        raise damaged_file(path, f"the node number {values.min()}, expected positive ones")


def _elements(path, comm, block):
    """Return node numbers of the elements of this rank by kind, as the only array of a list."""
    if block.form in (SHORT, LONG):
        lines = records(path, comm, block.start, block.stop, ELEMENT)
        types, values = end_to_end(lines, lambda piece: _elements_of_text(piece, block.form))
    else:
        low, high = (block.shares[k] for k in row_range(comm, len(block.shares) - 1))
        types, values = _binary_elements(path, low, high)
    owner, kinds = np.repeat(types, _sizes(types)), {key: KINDS[key] for key in np.unique(types).tolist()}
    return {kind: [values[owner == key].reshape(-1, NODES[kind])] for key, kind in kinds.items()}


def _sizes(types):
    """Return how many nodes elements of these types have."""
    known = np.zeros(max(KINDS) + 1, np.int64)
    known[list(KINDS)] = [NODES[kind] for kind in KINDS.values()]
    return known[types]


def _binary_elements(path, low, high):
    """Return types of the elements in the bytes low..high, and their nodes one after the other."""
    words = read_numbers(path, "<i4", (high - low) // 4, low).astype(np.int64)
    heads, at, ahead = [np.zeros(0, np.int64)], 0, 1
    while at < len(words):
        size, same = _alike(words[at:], ahead)
        heads.append(at + size * np.arange(same))
        at, ahead = at + size * same, 2 * same + 1
    heads = np.concatenate(heads)
    values = np.delete(words, (heads[:, None] + np.arange(4)).ravel())
    _require_numbers(path, values)
    return words[heads + 1], values


def _elements_of_text(piece, form):
    """Return types of elements, and their nodes one after the other."""
    width, most = (5, 15) if form == SHORT else (10, 10)
    heads = Piece(piece.path, re.sub(rb"(?m)^ -2.*$", b"", piece.text), piece.start)
    below = Piece(piece.path, re.sub(rb"(?m)^ -1.*$", b"", piece.text), piece.start)
    table, at = numbers(separated(heads, fields_of_format(b"(I3,I%d,3I5)" % width, str(piece.path))), 5, commas=False)
    whole(piece, table[:, 0], at, "the key -1 of an element", -1, -1)
    types = whole(piece, table[:, 2], at, "the type of an element", 1, max(KINDS))
    nodes = fields_of_format(b"(I3,%dI%d)" % (most, width), str(piece.path))
    values, counts, lines = ragged(separated(below, nodes), commas=False, expected="nodes of an element")
    keys = np.cumsum(counts) - counts
    whole(piece, values[keys], lines, "the key -2 of the nodes of an element", -2, -2)
    have = np.bincount(np.searchsorted(at, lines), counts - 1, len(at) + 1)[1:]
    expected = _sizes(types)
    if (wrong := have != expected).any():
        k = np.flatnonzero(wrong)[0]
        raise piece.refusal(int(at[k]), f"an element with {expected[k]} nodes in the lines below")
    values, lines = np.delete(values, keys), np.repeat(lines, counts - 1)
    return types, labels(piece, values, lines)
