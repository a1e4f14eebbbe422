"""Read components of nodes and elements of an ANSYS archive (CMBLOCK), such as the named selections of Workbench.

A block has a line CMBLOCK,NAME,NODE,count, a Fortran format, and numbers, of which a negative one ends a range that the
one before it begins.
"""

import re
from typing import NamedTuple

import numpy as np

from ...files.system_errors import open_input
from ...files.text import LARGEST_LABEL, line_number, pieces
from ...files.text_numbers import ragged, whole
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import sort_over_ranks
from ...parallel.petsc import MPI
from ..fixed_width import Field, fields_of_format, separated
from ..nodes.table import in_ranges

OTHER = re.compile(rb"(?m)^(?![ \t\d-]*\r?$)")  # the first line that has no numbers
KINDS = {"NODE": "node", "NODES": "node", "ELEM": "element", "ELEMENT": "element", "ELEMENTS": "element"}
AT_ONCE = 2**20  # bytes


class Component(NamedTuple):
    """The lines start..stop (bytes) of a component, their fields, and how many numbers it announces."""

    name: str
    kind: str
    line: int
    announced: int
    fields: list[Field]
    start: int
    stop: int


def read_components(path, comm, commands, label, elements, numbers) -> dict[str, np.ndarray]:
    """Return node numbers by name of the component, each once over all ranks; of elements as "elements of NAME".

    Collective. `commands`: (byte, line) of each CMBLOCK; `label`: nodes of this rank; `elements`, `numbers`: node
    numbers (elements of this rank, nodes) and their own numbers (elements,) by kind. Raises InputError.
    """
    sets, label = {}, np.unique(sort_over_ranks(comm, label)[0])
    for component in decided(comm, _components, path, commands):
        with agreed(comm):
            ranges = _ranges(path, component)
        if component.kind == "element":
            name = f"elements of {component.name}"
            nodes = [elements[kind][in_ranges(numbers[kind], ranges)].ravel() for kind in elements]
            nodes = np.concatenate([np.zeros(0, np.int64), *nodes])
            members = np.unique(sort_over_ranks(comm, nodes[nodes > 0])[0])
        else:
            name, members = component.name, label[in_ranges(label, ranges)]
        if comm.allreduce(len(members)):
            sets[name] = members
    return sets


def _components(path, commands) -> list[Component]:
    """Return the Components of the commands (byte, line). Raises InputError."""
    result, names = [], set()
    with open_input(path) as file:
        for position, text in commands:
            words = [word.strip().strip("'\"") for word in text.split("!")[0].split(",")]
            number = line_number(path, position)
            kind = KINDS.get(words[2].upper()) if len(words) > 3 else None
            if kind is None or not words[1] or not re.fullmatch("[0-9]{1,10}", words[3]):
                raise InputError(
                    f"{path}, line {number}: found '{text.strip()[:80]}', expected CMBLOCK, a name, NODE or ELEM, and "
                    "how many numbers follow"
                )
            if (words[1].upper(), kind) in names:
                raise InputError(f"{path}, line {number}: found a second component '{words[1]}', expected one")
            names.add((words[1].upper(), kind))
            file.seek(position)
            file.readline()
            fields = fields_of_format(file.readline(), f"{path}, line {number + 1}")
            if not all(field.whole for field in fields):
                raise InputError(f"{path}, line {number + 1}: found a format of other than whole numbers")
            start = file.tell()
            result.append(Component(words[1], kind, number, int(words[3]), fields, start, _end(file, start)))
    return result


def _end(file, start) -> int:
    """Return the byte where the first line without numbers begins."""
    at = start
    while text := file.read(AT_ONCE):
        text += file.readline()
        if match := OTHER.search(text):
            return at + match.start()
        at += len(text)
    return at


def _ranges(path, component) -> np.ndarray:
    """Return the first and last number (n, 2) of the ranges of a component. Raises InputError."""
    refusal, numbers = f"{path}, line {component.line}: found ", [np.zeros(0, np.int64)]
    for piece in pieces(path, MPI.COMM_SELF, component.start, component.stop):
        values, counts, lines = ragged(separated(piece, component.fields), commas=False, expected="whole numbers")
        wholes = whole(piece, values, np.repeat(lines, counts), "a number", -LARGEST_LABEL, LARGEST_LABEL)
        numbers.append(wholes.astype(np.int64))
    numbers = np.concatenate(numbers)
    if len(numbers) != component.announced:
        raise InputError(f"{refusal}{len(numbers)} numbers of the component '{component.name}', but it announces "
                         f"{component.announced}; the file is cut off or damaged")  # fmt: skip
    low, following = numbers[numbers > 0], np.append(numbers[1:], 0)[numbers > 0]
    high = np.where(following < 0, -following, low)
    if len(low) + np.count_nonzero(following < 0) != len(numbers) or (high < low).any():
        raise InputError(f"{refusal}a component '{component.name}' with a range that does not ascend, expected "
                         "positive numbers, and negative ones that end a range")  # fmt: skip
    return np.column_stack([low, high])
