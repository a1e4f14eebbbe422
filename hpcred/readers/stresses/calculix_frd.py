"""Read displacements and stresses at nodes from a result file of CalculiX (.frd) in text; each rank reads a share.

A block of results has a head (100C) with the number of nodes and the form, the name of the field (-4), its components
(-5), a line a node (-1) and an end (-3).
"""

import re
from typing import NamedTuple

import numpy as np

from ...files.system_errors import damaged_file, mapped
from ...files.text import end_to_end, pieces
from ...files.text_numbers import labels, numbers, whole
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ..fixed_width import fields_of_format, separated

HEAD = re.compile(rb"(?m)^ {2}100C[^\n]*\n")
NAME = re.compile(rb" -4  (\S+) +\d+ +\d+[ \t]*\r?\n(?: -5[^\n]*\n)*")
COUNT, FORM = slice(24, 36), slice(74, 75)  # places in the head
FIELDS = {b"DISP": 3, b"STRESS": 6}  # components of a line
TEXT = (b"0", b"1")


class Block(NamedTuple):
    """A field of `count` nodes in the bytes start..stop; `wide`: the columns of a node number."""

    name: bytes
    count: int
    wide: int
    start: int
    stop: int


def read(path, comm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes (s,), displacements (steps, s, 3) and stresses (steps, s, 6) of this rank.

    Collective. Raises InputError.
    """
    blocks = decided(comm, _blocks, path)
    node, fields = None, {name: [] for name in FIELDS}
    with agreed(comm):
        for block in blocks:
            label, values = _values(path, comm, block)
            node = label if node is None else node
            if len(label) != len(node) or (label != node).any():
                raise InputError(f"{path}: found steps with results of different nodes, expected those of all nodes")
            fields[block.name].append(values)
    total = comm.allreduce(len(node))
    if total != blocks[0].count:
        raise damaged_file(path, f"results of {total} nodes, expected {blocks[0].count}", "cut off or damaged")
    return node, *(np.stack(fields[name]) for name in FIELDS)


def _blocks(path) -> list[Block]:
    """Return the blocks of displacements and stresses in their order. Raises InputError."""
    blocks = []
    with mapped(path) as data:
        # blocks end with a line -3, and what is not asked for is passed over
        at = 0
        while match := HEAD.search(data, at):
            name = NAME.match(data, match.end())
            end = data.find(b"\n -3", match.end())
            if name is None or end < 0:
                raise damaged_file(path, f"no whole block of results at byte {match.start()}", "cut off or damaged")
            at = end + 1
            if name[1] not in FIELDS:
                continue
            line = match[0]
            if line[FORM] not in TEXT:
                raise InputError(f"{path}: found binary results, expected text; ask for *NODE FILE and *EL FILE, not "
                                 "for *NODE OUTPUT")  # fmt: skip
            if not line[COUNT].strip().isdigit():
                raise InputError(f"{path}: found '{line.decode('latin-1').strip()}', expected a number of nodes")
            blocks.append(Block(name[1], int(line[COUNT]), 5 if line[FORM] == b"0" else 10, name.end(), at))
        if data[at:].rstrip()[-4:] != b"9999":
            raise damaged_file(path, "no end (9999)", "cut off")
    # each step has displacements and then stresses, of the same nodes
    names = [block.name for block in blocks]
    if not names or names != [*FIELDS] * (len(names) // 2):
        raise InputError(f"{path}: found {names.count(b'DISP')} fields of displacements and {names.count(b'STRESS')} "
                         "of stresses, expected both in each step, as the deck of `hpcred recover --deck` asks for")
    if len({block.count for block in blocks}) > 1:
        raise InputError(f"{path}: found steps with results of different numbers of nodes")
    return blocks


def _values(path, comm, block):
    """Return nodes and components of this rank."""
    count = FIELDS[block.name]
    fields = fields_of_format(b"(I3,I%d,%dE12.5)" % (block.wide, count), str(path))

    def decode(piece):
        table, lines = numbers(separated(piece, fields), 2 + count, commas=False)
        whole(piece, table[:, 0], lines, "the key -1 of a node", -1, -1)
        return labels(piece, table[:, 1], lines), table[:, 2:]

    return end_to_end(pieces(path, comm, block.start, block.stop), decode)
