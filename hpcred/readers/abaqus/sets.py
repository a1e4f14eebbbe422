"""Make node sets from the *Nset and *Elset blocks and the elements of an Abaqus input file.

A set of elements becomes the set of their nodes, "elements of NAME". Sets in an instance are named as in Abaqus,
INSTANCE.NAME; internal sets of Abaqus/CAE are left out.
"""

import re
from dataclasses import dataclass, field

import numpy as np

from ...files.text import Piece, pieces, shown, without_comments
from ...files.text_numbers import labels, ragged, refuse_empty_fields, require_commas
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up, sort_over_ranks
from ...parallel.petsc import MPI

WORD = re.compile(rb'"[^"\n]*"|[^\s,][^,\n]*[A-Za-z_][^,\n]*|[A-Za-z_][^,\n]*')
IN_INSTANCE = re.compile(r".+\.(\d{1,18})")
GROUP = 2**32  # keys of elements: GROUP times the number of their instance, plus their own
NOTHING = np.zeros(0, np.int64)


@dataclass
class Members:
    """The part of one set on a rank: numbers of nodes, or keys of elements, and names of sets that belong to it.

    `parts`: of each such name the ways to write it in full. `hidden`: whether it is an internal one of Abaqus/CAE.
    """

    name: str
    numbers: list[np.ndarray] = field(default_factory=list)
    parts: set[tuple[str, ...]] = field(default_factory=set)
    hidden: bool = False


def read_sets(path, comm, blocks, groups, named, elements, keys, wanted=()) -> tuple[dict, dict]:
    """Return node numbers by name of the set, each once over all ranks, ascending; and such keys of elements by the
    names, in small letters, of the sets of elements, internal ones only where `wanted`. Collective. Raises InputError.

    `blocks` of *Nset and *Elset; `groups`: the instances, in the order of their numbers in keys. `named`: numbers of
    this rank by ("nset" or "elset", name), of *Node and *Element with such a parameter. `elements`, `keys`: node
    numbers (elements of this rank, nodes) and keys (elements,) by kind.
    """
    found = {}
    with agreed(comm):
        for block in blocks:
            _read_block(comm, block, GROUP * groups.index(block.group), found, wanted)
        for (kind, name), numbers in named.items():
            _members(found, kind, name).numbers += numbers
    sets, members = {}, {}
    for (kind, key), (name, numbers, hidden) in _with_their_parts(path, comm, found).items():
        numbers = np.unique(sort_over_ranks(comm, numbers)[0])
        if kind == "elset":
            members[key] = numbers
        if hidden:
            continue
        if kind == "elset":
            name = f"elements of {name}"
            of_kinds = (look_up(comm, numbers, [], keys[key])[0] for key in elements)
            nodes = [part[inside].ravel() for part, inside in zip(elements.values(), of_kinds, strict=True)]
            numbers = np.unique(sort_over_ranks(comm, np.concatenate([NOTHING, *nodes]))[0])
        if comm.allreduce(len(numbers)):
            sets[name] = numbers
    return sets, members


def _members(found, kind, name):
    return found.setdefault((kind, name.lower()), Members(name))


def _read_block(comm, block, offset, found, wanted):
    """Put what the data lines of this rank say into `found`."""
    kind, given = block.section.keyword, block.section.parameters
    name = given.get(kind)
    if not name:
        raise block.section.refusal(f"found *{kind.capitalize()} without a name, expected {kind}=NAME")
    hidden = "internal" in given and not (kind == "elset" and (block.prefix + name).lower() in wanted)
    if hidden or (kind == "nset" and "elset" in given):
        return  # the nodes of a set of elements are there under its own name
    members = _members(found, kind, block.prefix + name)
    members.hidden |= "internal" in given
    offset = offset if kind == "elset" else 0
    if "generate" in given:  # few lines, perhaps of very many numbers: each rank takes its share of all
        for piece in pieces(block.path, MPI.COMM_SELF, block.start, block.stop):
            members.numbers.append(offset + _ranges(piece)[comm.rank :: comm.size])
        return
    for piece in pieces(block.path, comm, block.start, block.stop):
        text = without_comments(piece.text)
        words = [word.decode("latin-1").strip().strip('"') for word in WORD.findall(text)]
        fields = WORD.sub(b"1", text)
        refuse_empty_fields(piece, fields)
        require_commas(piece, fields)
        plain = Piece(piece.path, WORD.sub(b" ", text).replace(b",", b" "), piece.start)
        values, counts, lines = ragged(plain, expected="whole numbers")
        numbers = labels(plain, values, np.repeat(lines, counts), "a number")
        inside = [int(match[1]) for match in map(IN_INSTANCE.fullmatch, words) if match]
        members.numbers.append(offset + np.concatenate([numbers, np.array(inside, np.int64)]))
        words = [word.lower() for word in words if not IN_INSTANCE.fullmatch(word)]
        members.parts |= {(word, block.prefix.lower() + word) for word in words}


def _ranges(piece):
    """Return the numbers of lines of first, last, step; a step that is left out is 1."""
    values, counts, lines = ragged(piece, blanks=False, expected="first, last and step of numbers")
    piece.require((counts == 2) | (counts == 3), lines, "first, last and step of numbers")
    values = labels(piece, values, np.repeat(lines, counts), "a number")
    parts = [NOTHING]
    rows = np.split(values, np.cumsum(counts)[:-1]) if len(lines) else []
    for line, row in zip(lines, rows, strict=True):
        if row[0] > row[1]:
            raise piece.refusal(line, "first, last and step of numbers, the first not above the last")
        parts.append(np.arange(row[0], row[1] + 1, row[2] if len(row) == 3 else 1))
    return np.concatenate(parts)


def _with_their_parts(path, comm, found):
    """Return (name, numbers of this rank, if hidden) of every set of any rank, with those of sets in it."""
    table, hidden = {}, set()
    for part in comm.allgather({key: (members.name, members.parts, members.hidden) for key, members in found.items()}):
        for key, (name, parts, internal) in part.items():
            table.setdefault(key, (name, set()))[1].update(parts)
            hidden |= {key} if internal else set()
    result = {}
    for key in sorted(table):
        reached, new = {key}, {key}
        while new:
            new = {item for one in new for item in _named_in(path, one, table)} - reached
            reached |= new
        arrays = [array for item in sorted(reached) if item in found for array in found[item].numbers]
        result[key] = table[key][0], np.concatenate([NOTHING, *arrays]), key in hidden
    return result


def _named_in(path, key, table):
    """Yield the keys of the sets that a set names, which may be without elements of known kinds, but not nodes."""
    kind, (name, parts) = key[0], table[key]
    for words in sorted(parts):
        there = [(kind, word) for word in words if (kind, word) in table]
        if kind == "nset" and not there:
            found = shown(words[0].encode("latin-1"))
            raise InputError(
                f"{path}: found the set '{found}' in the set of nodes '{name}', expected one of the sets of nodes of "
                "the file that has a name of its own"
            )
        yield from there
