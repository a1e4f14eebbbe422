"""Make node sets from the *Nset and *Elset blocks and the elements of an Abaqus input file.

A set of elements becomes the set of their nodes, "elements of NAME"; *Nset with elset= has those nodes under its own
name. Sets in an instance are named as in Abaqus, INSTANCE.NAME; internal sets of Abaqus/CAE are left out.
"""

import re
from dataclasses import dataclass, field

import numpy as np

from ...files.text import Piece, pieces, shown, without_comments
from ...files.text_numbers import labels, ragged, refuse_empty_fields, require_commas
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up, sort_over_ranks
from ...parallel.petsc import MPI
from ..nodes.table import GROUP

WORD = re.compile(rb'"[^"\n]*"|[^\s,][^,\n]*[A-Za-z_][^,\n]*|[A-Za-z_][^,\n]*')
IN_INSTANCE = re.compile(r".+\.(\d{1,18})")
NOTHING = np.zeros(0, np.int64)


@dataclass
class Members:
    """The part of one set on a rank: numbers of nodes, or keys of elements, and sets that belong to it.

    `parts`: the kind of each such set ("nset" or "elset"), and the ways to write its name in full. `hidden`: whether it
    is an internal one of Abaqus/CAE.
    """

    name: str
    numbers: list[np.ndarray] = field(default_factory=list)
    parts: set[tuple[str, tuple[str, ...]]] = field(default_factory=set)
    hidden: bool = False


def read_sets(path, comm, blocks, groups, named, elements, keys, wanted, unread) -> tuple[dict, dict, list]:
    """Return node numbers by name of the set, each once over all ranks, ascending; such keys of elements by the
    names, in small letters, of the sets of elements, internal ones only where `wanted`; and remarks. Collective.

    `blocks` of *Nset and *Elset; `groups`: the instances, in the order of their numbers in keys. `named`: numbers of
    this rank by ("nset" or "elset", name), of *Node and *Element with such a parameter. `elements`, `keys`: node
    numbers (elements of this rank, nodes) and keys (elements,) by kind; `unread`: names, in small letters, of sets of
    *Element of other kinds. Raises InputError.
    """
    # members by name, of *Nset and *Elset and of the parameters of other keywords
    known = {}
    with agreed(comm):
        for block in blocks:
            _read_block(comm, block, GROUP * groups.index(block.group), known, wanted)
        for (kind, name), numbers in named.items():
            _members(known, kind, name).numbers += numbers
        for name in unread:
            _members(known, "elset", name)
    # sets name other sets, and sets of elements stand for the nodes of these
    sets, members, lacking = {}, {}, []
    for (kind, key), (name, numbers, of_elements, reached, hidden) in _with_their_parts(path, comm, known).items():
        if kind == "elset":
            members[key] = numbers = np.unique(sort_over_ranks(comm, numbers)[0])
        if hidden:
            continue
        if kind == "elset":
            name, numbers, of_elements = f"elements of {name}", NOTHING, numbers
        of_elements = np.unique(sort_over_ranks(comm, of_elements)[0])
        if count := comm.allreduce(len(of_elements)):
            of_kinds = [look_up(comm, of_elements, [], keys[key])[0] for key in elements]
            nodes = [corners[inside].ravel() for corners, inside in zip(elements.values(), of_kinds, strict=True)]
            numbers = np.concatenate([numbers, *nodes])
            count -= comm.allreduce(int(sum(inside.sum() for inside in of_kinds)))
        if count or reached & {("elset", other) for other in unread}:
            lacking.append(name)
        numbers = np.unique(sort_over_ranks(comm, numbers)[0])
        if comm.allreduce(len(numbers)):
            sets[name] = numbers
    # what is missing is said, with at most five names
    remark = (f"{path}: sets are without the nodes of elements whose types are not read: {', '.join(lacking[:5])}"
              f"{', ...' * (len(lacking) > 5)}")  # fmt: skip
    return sets, members, [remark] if lacking else []


def scopes_of(block) -> tuple[str, ...]:
    """Return what may stand before the name of a set that a block names, in small letters."""
    return "", block.prefix.lower(), f"{block.section.parameters.get('instance', '')}.".lower()


def _members(known, kind, name):
    return known.setdefault((kind, name.lower()), Members(name))


def _read_block(comm, block, offset, known, wanted):
    """Put what the data lines of this rank say into `known`."""
    kind, params = block.section.keyword, block.section.parameters
    name = params.get(kind)
    if not name:
        raise block.section.refusal(f"found *{kind.capitalize()} without a name, expected {kind}=NAME")
    # internal sets count only where something asks for them
    hidden = "internal" in params and not (kind == "elset" and (block.prefix + name).lower() in wanted)
    if hidden:
        return
    members = _members(known, kind, block.prefix + name)
    members.hidden |= "internal" in params
    # nodes of elements, ranges, or a list of numbers and names
    if kind == "nset" and "elset" in params:
        if block.section.has_data():
            raise block.section.refusal("found data lines below *Nset with elset=, which has the nodes of elements")
        members.parts.add(("elset", tuple(scope + params["elset"].lower() for scope in scopes_of(block))))
        return
    offset = offset if kind == "elset" else 0
    if "generate" in params:  # few lines, perhaps of very many numbers: each rank takes its share of all
        for piece in pieces(block.path, MPI.COMM_SELF, block.start, block.stop):
            members.numbers.append(offset + _ranges(piece)[comm.rank :: comm.size])
        return
    for piece in pieces(block.path, comm, block.start, block.stop):
        text = without_comments(piece.text)
        words = [word.decode("latin-1").strip().strip('"') for word in WORD.findall(text)]
        fields = WORD.sub(b"1", text)
        refuse_empty_fields(piece, fields)
        require_commas(piece, fields)
        # numbers alone remain to be read, and labels of instances such as Part-1.5
        plain = Piece(piece.path, WORD.sub(b" ", text).replace(b",", b" "), piece.start)
        if (whole := without_comments(plain.text)) != plain.text:  # a mark of comments behind a name is none
            pairs = zip(whole.split(b"\n"), plain.text.split(b"\n"), strict=True)
            raise piece.refusal(next(k for k, (a, b) in enumerate(pairs) if a != b), "numbers and names of sets")
        values, counts, lines = ragged(plain, expected="whole numbers")
        numbers = labels(plain, values, np.repeat(lines, counts), "a number")
        inside = [int(match[1]) for match in map(IN_INSTANCE.fullmatch, words) if match]
        members.numbers.append(offset + np.concatenate([numbers, np.array(inside, np.int64)]))
        words = [word.lower() for word in words if not IN_INSTANCE.fullmatch(word)]
        members.parts |= {(kind, tuple(scope + word for scope in scopes_of(block))) for word in words}


def _ranges(piece):
    """Return the numbers of lines of first, last, step; a step that is left out is 1."""
    values, counts, lines = ragged(piece, blanks=False, expected="first, last and step of numbers")
    piece.require((counts == 2) | (counts == 3), lines, "first, last and step of numbers")
    values = labels(piece, values, np.repeat(lines, counts), "a number")
    ranges = [NOTHING]
    rows = np.split(values, np.cumsum(counts)[:-1]) if len(lines) else []
    for line, row in zip(lines, rows, strict=True):
        if row[0] > row[1]:
            raise piece.refusal(line, "first, last and step of numbers, the first not above the last")
        ranges.append(np.arange(row[0], row[1] + 1, row[2] if len(row) == 3 else 1))
    return np.concatenate(ranges)


def _with_their_parts(path, comm, known):
    """Return of every set of any rank its name, numbers and keys of elements, the sets in it, and if it is hidden.

    Numbers and keys are those of this rank, with those of the sets in it; of a set of elements both are its keys.
    """
    table, hidden = {}, set()
    for here in comm.allgather({key: (members.name, members.parts, members.hidden) for key, members in known.items()}):
        for key, (name, members_of, internal) in here.items():
            table.setdefault(key, (name, set()))[1].update(members_of)
            hidden |= {key} if internal else set()
    result = {}
    for key in sorted(table):
        reached, new = {key}, {key}
        while new:
            new = {key_of_set for below in new for key_of_set in _named_in(path, below, table)} - reached
            reached |= new
        of_kind = {"nset": [NOTHING], "elset": [NOTHING]}
        for key_of_set in sorted(reached & set(known)):
            of_kind[key_of_set[0]] += known[key_of_set].numbers
        numbers, of_elements = (np.concatenate(of_kind[kind]) for kind in (key[0], "elset"))
        result[key] = table[key][0], numbers, of_elements, reached, key in hidden
    return result


def _named_in(path, key, table):
    """Yield the keys of the sets that a set names, which may be without elements of known kinds, but not nodes."""
    own, (name, named) = key[0], table[key]
    for kind, words in sorted(named):
        there = [(kind, word) for word in dict.fromkeys(words) if (kind, word) in table]
        if own == "nset" and not there:
            unknown = shown(words[0].encode("latin-1"))
            of = {"nset": "nodes", "elset": "elements"}[kind]
            raise InputError(
                f"{path}: found the set '{unknown}' in the set of nodes '{name}', expected one of the sets of {of} of "
                "the file that has a name of its own"
            )
        yield from there
