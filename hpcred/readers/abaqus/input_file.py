"""Read nodes, elements and sets of Abaqus input files (.inp), at their positions in the assembly.

Each rank looks for keywords in its range of bytes; rank 0 walks through the keywords (parts, instances, includes), and
all ranks share the data lines. *Node, *Element, *Nset, *Elset, *Part, *Instance, *Assembly, *Include, *System, and
materials with *Solid Section are read; other keywords that change nodes, or directions of dofs, are refused.
"""

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...fe.elements import NODES, abaqus_kind, abaqus_nodes_more, in_vtk_order
from ...fe.materials import ElementProperties
from ...files.included import Included
from ...files.system_errors import open_input, read_bytes
from ...files.text import (
    BYTE_ORDER_MARK,
    CONTROL,
    Piece,
    first_line,
    line_number,
    pieces,
    refuse_packed,
    require_file,
    shown,
    without_comments,
)
from ...files.text_numbers import labels, padded, ragged
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up, sort_over_ranks
from ..nodes.table import GROUP, LARGEST_COORDINATE, NodeTable, elements_of, finite, require_elements_once
from .materials import materials_of, names_of, number_of, properties_of
from .sets import read_sets, scopes_of

KEYWORD = re.compile(rb"(?m)^[ \t]*\*(?!\*)")
GOES_ON = re.compile(rb",[ \t\r]*(\n|$)")
LABEL_FIELD = rb"[ \t]*(?:\d*|[^,\n]+\.\d+)[ \t]*"  # 7, Part-1.5 or nothing
NO_LABELS = re.compile(rb"(?m)^(?!(?:%b,)*%b\r?$)[^\n]+$" % (LABEL_FIELD, LABEL_FIELD))
EMPTY_FIELD = re.compile(rb",(?=[ \t]*,)")
REDIRECTED = re.compile(rb"(?m)^[ \t]*>[ \t]*\*\*.*$")
TYPE = re.compile(r"\w+")  # of elements
WITH_NORMAL = 7  # numbers of a node
REFUSED = {
    **dict.fromkeys(("ngen", "nfill", "ncopy", "nmap", "import", "imperfection", "symmetricmodelgeneration"),
                    ("makes or moves nodes", "nodes in *Node")),
    **dict.fromkeys(("elgen", "elcopy"), ("makes elements", "elements in *Element")),
}  # fmt: skip
SCOPES = {"part", "endpart", "assembly", "endassembly", "instance", "endinstance"}  # where a *System ends
# what CalculiX leaves out with its data lines, as all that it does not know
UNKNOWN_TO_CALCULIX = {*SCOPES, "system", *REFUSED}
WITH_FILES = {"include", "node", "element", "nset", "elset"}  # their input= is followed
TOLERATED = {"nset", "input", "system"}  # parameters of *Node


@dataclass(frozen=True)
class Section:
    """A keyword at the byte `position` of a file, its parameters, and the bytes start..stop of its data lines."""

    path: Path
    position: int
    keyword: str
    parameters: dict
    start: int
    stop: int

    def refusal(self, text: str) -> InputError:
        return InputError(f"{self.path}, line {line_number(self.path, self.position)}: {text}")

    def has_data(self) -> bool:
        return bool(data_lines(self))


@dataclass(frozen=True)
class Placement:
    """x -> a + R (x + translation - a), with R the rotation about an axis through a."""

    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))
    point: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))

    def __call__(self, position):
        return self.point + (position + self.translation - self.point) @ self.rotation.T


@dataclass(frozen=True)
class Block:
    """The data lines of a *Node, *Element, *Nset, *Elset or *Solid Section.

    The `system` in which its nodes are given, where these then stand, and which of the `groups` of labels they are of;
    `prefix`: what Abaqus puts before the names of sets.
    """

    section: Section
    path: Path
    start: int
    stop: int | None
    system: Placement
    placement: Placement
    group: str
    prefix: str = ""


@dataclass
class Mesh:
    """The mesh of an input file; each rank has a share.

    `nodes` ascending by number over the ranks; `elements`: node numbers (elements, nodes) by kind, but for kinds that
    are not known, with their `keys` (elements,), see sets, and `properties`; `sets`: node numbers by name, and
    `element_sets`: keys by name in small letters. `sections`: all keywords, the same on all ranks; `counts`: so many
    elements of all ranks have the type of this name, in capitals. `remarks` on materials.
    """

    nodes: NodeTable
    elements: dict[str, np.ndarray]
    sets: dict[str, np.ndarray]
    sections: list[Section]
    counts: dict[str, int]
    properties: ElementProperties | None = None
    remarks: list[str] = field(default_factory=list)
    keys: dict[str, np.ndarray] = field(default_factory=dict)
    element_sets: dict[str, np.ndarray] = field(default_factory=dict)


def begins(start: bytes) -> bool:
    """Test whether a text that starts so is an input file: its first line that is no comment is a keyword."""
    return first_line(REDIRECTED.sub(b"", start))[:1] == b"*"


def read(path, comm, calculix=False, surfaces=False, steps=True) -> Mesh:
    """Return the mesh of an input file. Collective. Raises InputError.

    `calculix`: whether it is read as CalculiX does. Then matrices are in global directions in spite of *Transform;
    what stands on a line behind the nodes of an element does not count, nor do keywords that CalculiX does not know
    (one without a name is among them, if it has no data lines), and a node may have no coordinates, which are zero; no
    keyword goes on in the next line; lines of >** above the first keyword are comments. `surfaces`: whether the
    internal sets of elements that surfaces name are read as well. `steps`: whether the file is read beyond its first
    *Step, with the files that it includes there.
    """
    sections = _sections(Path(path), comm, calculix, steps)
    if calculix:
        sections = [section for section in sections if section.keyword not in UNKNOWN_TO_CALCULIX]
        for section in sections:
            if section.keyword == "nset":
                section.parameters.pop("elset", None)  # a parameter that it does not know
    # one rank walks through parts and instances, and says which data lines are in the model
    blocks = decided(comm, _blocks, path, sections, calculix)
    materials, remarks = decided(comm, materials_of, sections, data_lines)
    groups = sorted({block.group for block in blocks})
    nodes, elements, sets, solids = (
        [block for block in blocks if block.section.keyword in keywords]
        for keywords in (("node",), ("element",), ("nset", "elset"), ("solidsection",))
    )
    # all ranks share these lines
    named, unread = {}, set()
    nodes = _nodes(path, comm, nodes, named, 1 if calculix else 2)
    elements, keys, types, tables, counts = _elements(comm, elements, groups, named, unread, calculix)
    _require_nodes(path, comm, nodes, elements)
    require_elements_once(path, comm, keys.values())
    # sets that sections and surfaces name are read although they are internal
    wanted = {name for block in solids for name in names_of(block)}
    for block in sets:
        if block.section.keyword == "nset" and (elset := block.section.parameters.get("elset")) is not None:
            wanted |= {scope + elset.lower() for scope in scopes_of(block)}
    if surfaces:
        of_surfaces = [section for section in sections if section.keyword == "surface"]
        wanted |= {line[0].strip('"').lower() for section in of_surfaces for line in data_lines(section)}
    sets, members, remarks_on_sets = read_sets(path, comm, sets, groups, named, elements, keys, wanted, unread)
    program = "CalculiX" if calculix else "Abaqus"
    properties = properties_of(comm, program, solids, materials, types, tables, keys, members) if elements else None
    return Mesh(nodes, elements, sets, sections, counts, properties, [*remarks, *remarks_on_sets], keys, members)


def _sections(path, comm, calculix, steps):
    """Return all keywords of a file and of those it includes, in order; without `steps` up to the first. Collective."""
    included, result = Included(path), []

    def follow(file, above, refusal):
        """Put the keywords of a file into the result; returns whether to go on behind it."""
        with agreed(comm):
            name = included.add(file, above, refusal)
        if name not in included.own:
            included.own[name] = _own_sections(file, comm, calculix)
        for section in included.own[name]:
            if section.keyword == "step" and not steps:
                return False
            if section.keyword != "include":
                result.append(section)
            if section.keyword != "include" and not (section.keyword in WITH_FILES and "input" in section.parameters):
                continue
            with agreed(comm):
                target = _file_named(section)
                if section.keyword != "include":
                    included.add(target, (*above, name), section.refusal)
            if section.keyword == "include" and not follow(target, (*above, name), section.refusal):
                return False
        return True

    follow(path, (), InputError)
    return result


def _own_sections(path, comm, calculix):
    """Return the keywords of one file. Collective."""
    with agreed(comm):
        require_file(path)
        refuse_packed(path)
        starts = [piece.start + match.start() for piece in pieces(path, comm) for match in KEYWORD.finditer(piece.text)]
    positions = sum(comm.allgather(starts), [])
    return decided(comm, _keywords, path, positions, calculix)


def _file_named(section):
    """Return the file that a keyword names in place of its data lines, or None. Raises InputError."""
    name, keyword = section.parameters.get("input"), section.keyword
    if keyword == "include" and not name:
        raise section.refusal("found *Include without a file, expected input=FILE")
    if name is None or keyword not in WITH_FILES:
        return None
    file = section.path.parent / name
    if not file.is_file():
        statement = "*Include of " if keyword == "include" else "input="
        raise section.refusal(f"found {statement}{file}, which is no file")
    if section.has_data():
        statement = "*Include" if keyword == "include" else "a keyword with input="
        raise section.refusal(f"found data lines below {statement}, expected them in that file only")
    return file


def _keywords(path, positions, calculix):
    """Return the Sections of a file from the bytes where its keywords begin, which go on behind a comma in Abaqus."""
    sections, size = [], path.stat().st_size
    with open_input(path) as file:
        head = file.read(positions[0] if positions else size).removeprefix(BYTE_ORDER_MARK)
        head = REDIRECTED.sub(b"", head) if calculix else head
        if first_line(head):
            above = shown(first_line(head))
            raise InputError(f"{path}: found '{above}' above the first keyword, expected a keyword such as *Node")
        for position, stop in zip(positions, [*positions, size][1:], strict=True):
            file.seek(position)
            line = file.readline()
            while not calculix and line.rstrip().endswith(b",") and file.tell() < stop:
                line = line.rstrip() + file.readline()
            text = line.decode("latin-1").strip().lstrip("*").strip()
            keyword, *parameters = ["", *_fields(text)] if text[:1] in ("", ",") else _fields(text)
            pairs = (parameter.partition("=") for parameter in parameters)
            values = {_word(key): value.strip().strip("\"'") for key, _, value in pairs if key.strip()}
            sections.append(Section(path, position, _word(keyword), values, file.tell(), stop))
            _require_keyword(sections[-1], line, calculix)
    return sections


def _require_keyword(section, line, calculix):
    """Refuse a damaged line of a keyword."""
    if CONTROL.search(line):
        raise section.refusal(f"found '{shown(line)}', expected a keyword without control characters")
    if line.count(b'"') % 2:
        raise section.refusal(f"found '{shown(line)}', expected a keyword with a second quote for each first one")
    if not section.keyword and not calculix:
        raise section.refusal("found a line with nothing behind its asterisk, expected a keyword")
    if not section.keyword and section.has_data():
        raise section.refusal(
            "found data lines below a line with nothing behind its asterisk, expected a keyword above them"
        )


def _fields(line):
    """Return the parts of a line between commas; commas in quotes do not count."""
    return re.findall(r'(?:"[^"]*"|[^",])+', line)


def _word(text):
    """Return a keyword or parameter without blanks and in one case."""
    return re.sub(r"[ \t\r\n]", "", text.lower())  # of ASCII: other blanks are signs like others


def data_lines(section):
    """Return the few data lines of a keyword, without comments and blank lines, as lists of fields."""
    text = without_comments(read_bytes(section.path, section.start, section.stop))
    lines = ([word.strip().decode("latin-1") for word in line.split(b",")] for line in text.splitlines())
    return [fields for fields in lines if fields != [""]]


def _numbers(section, fields, count):
    """Return `count` numbers of a data line; what is left out is zero."""
    while fields and not fields[-1]:
        fields = fields[:-1]
    values = [number_of(text) if text else 0.0 for text in fields]
    if len(fields) > count or None in values:
        raise section.refusal(f"found the data line '{', '.join(fields)}', expected {count} numbers")
    if any(abs(value) > LARGEST_COORDINATE for value in values):
        raise section.refusal(f"found the data line '{', '.join(fields)}', expected numbers of a body's size")
    return np.array(values + [0.0] * (count - len(fields)))


def _blocks(path, sections, calculix):
    """Return the data lines of nodes and elements that are in the model, each with its place."""
    parts, blocks, instances = {}, [], {}
    scope, name, placement, system = "model", "", Placement(), Placement()
    for section in sections:
        keyword, values = section.keyword, section.parameters
        # what would give the nodes other places, numbers or directions than are read here
        if keyword in REFUSED:
            makes, lines = REFUSED[keyword]
            raise section.refusal(
                f"found *{keyword.capitalize()}, which {makes}; write the input file with all {lines} lines, or give "
                "the nodes as lines of node, x, y, z"
            )
        if keyword == "transform" and not calculix:
            raise section.refusal(
                "found *Transform, which turns the directions of dofs; take the matrices from a model without it"
            )
        if keyword == "node" and calculix and values.get("system", "r").lower() != "r":
            raise section.refusal(
                f"found *Node with system={values['system']}, which CalculiX does not know; its matrices belong to x, "
                "y, z as they are written"
            )
        # *System holds until the next part, assembly or instance begins
        if keyword == "system":
            system = _system(section)
        elif keyword in SCOPES:
            system = Placement()
        # a part is kept, and placed by each *Instance of it; its blocks stand under the instance's name
        if keyword == "part":
            scope, name = "part", values.get("name", "").lower()
            parts[name] = []
        elif keyword == "assembly":
            scope = "assembly"
        elif keyword == "instance":
            scope, name, placement = "instance", values.get("name", ""), _placement(section)
            instances[name.lower()] = name
            part = values.get("part", "").lower()
            if part not in parts or "instance" in values or "library" in values:
                raise section.refusal(f"found an *Instance of '{part}', expected one of a *Part above")
            for inner, own_system in parts[part]:
                blocks.append(_block(inner, own_system, placement, f"instance {name}", f"{name}."))
        elif keyword in ("endpart", "endassembly", "endinstance"):
            scope = "assembly" if keyword == "endinstance" else "model"
        elif keyword in ("node", "element", "nset", "elset", "solidsection"):
            if scope == "part":
                parts[name].append((section, system))
            elif scope == "instance":
                blocks.append(_block(section, system, placement, f"instance {name}", f"{name}."))
            else:
                of = instances.get(values.get("instance", "").lower()) if keyword in ("nset", "elset") else None
                blocks.append(_block(section, system, Placement(), f"instance {of}" if of else f"the {scope}"))
    if parts and not instances:
        raise InputError(f"{path}: found a *Part but no *Instance of one, expected an assembly, or nodes without parts")
    return blocks


def _block(section, system, placement, group, prefix=""):
    start, stop, path = section.start, section.stop, section.path
    if file := _file_named(section):
        path, start, stop = file, 0, None
    if section.keyword == "node":
        unknown = sorted(set(section.parameters) - TOLERATED)
        kind = section.parameters.get("system", "r").lower()
        if unknown or kind not in ("r", "c"):
            wrong = f"the parameter {unknown[0]}" if unknown else f"system={kind.upper()}"
            raise section.refusal(
                f"found *Node with {wrong}, expected rectangular (system=R) or cylindrical (system=C) coordinates"
            )
    return Block(section, path, start, stop, system, placement, group, prefix)


def _system(section):
    """From the system of *System to that of the part: by its origin a, b on its x axis, and c in its x, y plane.

    Without c, z is that of the part, and b counts without its z; without b, only the origin is another.
    """
    lines = data_lines(section)
    if len(lines) > 2:
        raise section.refusal(f"found {len(lines)} lines below *System, expected the points a and b, and c")
    values = _numbers(section, lines[0], 6) if lines else np.zeros(6)
    a, x = values[:3], values[3:] - values[:3]
    if len(lines) < 2 and not (any(lines[0][3:] if lines else ()) and values.any()):
        return Placement(a)
    if len(lines) < 2:
        x[2], z = 0.0, np.array([0.0, 0.0, 1.0])
    else:
        z = np.cross(x, _numbers(section, lines[1], 3) - a)
    if not x.any() or not z.any():
        raise section.refusal("found *System with its points on a line, expected an origin a, b on x, and c beside it")
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    return Placement(a, a, np.stack([x, np.cross(z, x), z], axis=1))


def _placement(section):
    """Return the translation, and then the rotation about the axis from a to b, of the data lines of an *Instance."""
    lines = data_lines(section)
    if len(lines) > 2:
        raise section.refusal(f"found {len(lines)} lines below *Instance, expected a translation and a rotation")
    translation = _numbers(section, lines[0], 3) if lines else np.zeros(3)
    if len(lines) < 2:
        return Placement(translation)
    values = _numbers(section, lines[1], 7)
    a, b, angle = values[:3], values[3:6], np.deg2rad(values[6])
    length = np.linalg.norm(b - a)
    if not length:
        raise section.refusal("found a rotation of *Instance about two equal points, expected an axis from a to b")
    x, y, z = (b - a) / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return Placement(translation, a, rotation)


def _nodes(path, comm, blocks, named, least):
    """Return the nodes of all blocks, ascending, each once; fills `named`. `least`: how many numbers a line has."""
    groups = sorted({block.group for block in blocks})
    with agreed(comm):
        # the lines of all blocks, placed as their instance is
        tables = [(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.int64))]
        for block in blocks:
            for piece in pieces(block.path, comm, block.start, block.stop):
                label, position = _node_lines(piece, block, least)
                _name(named, block, "nset", label)
                position = block.placement(block.system(position))
                tables.append((label, position, np.full(len(label), groups.index(block.group))))
        label, position, group = (np.concatenate(columns) for columns in zip(*tables, strict=True))
    # ascending over the ranks, so that equal numbers meet
    label, x, y, z, group = sort_over_ranks(comm, label, [*position.T, group])
    position = np.array([x, y, z]).T
    if not comm.allreduce(len(label)):
        raise InputError(f"{path}: found no nodes, expected *Node lines of node, x, y, z")
    with agreed(comm):
        # a number twice is another node in another instance, and may be repeated in one
        again = np.flatnonzero(label[1:] == label[:-1]) + 1
        mixed = again[group[again] != group[again - 1]]
        if mixed.size:
            names = " and ".join(groups[group[k]] for k in (mixed[0] - 1, mixed[0]))
            raise InputError(
                f"{path}: found the node {label[mixed[0]]} in {names}; rows of the matrices cannot be told apart, "
                "since Abaqus numbers the nodes of an assembly anew; write the input file without parts and "
                "assemblies, or give tables of nodes and dofs in the numbers that Abaqus uses"
            )
        moved = again[(position[again] != position[again - 1]).any(axis=1)]
        if moved.size:
            places = " and ".join(str(position[k].tolist()) for k in (moved[0] - 1, moved[0]))
            raise InputError(f"{path}: found the node {label[moved[0]]} at {places}, expected one place a node")
    once = np.ones(len(label), bool)
    once[again] = False
    return NodeTable.as_given(comm, label[once], position[once])


def _node_lines(piece, block, least):
    """Return labels and Cartesian coordinates in the system of the part; what is left out, and a normal, is zero."""
    filled = Piece(piece.path, EMPTY_FIELD.sub(b",0", piece.text), piece.start)
    values, counts, lines = ragged(filled, blanks=False, expected="node, x, y, z")
    piece.require((counts >= least) & (counts <= WITH_NORMAL), lines,
                  f"node, x, y, z and a normal ({least} to {WITH_NORMAL} numbers a line)")  # fmt: skip
    table = padded(values, counts, WITH_NORMAL)
    finite(piece, table[:, 1:], lines)
    label = labels(piece, table[:, 0], lines)
    position = table[:, 1:4]
    if block.section.parameters.get("system", "r").lower() == "c":  # radius, angle in degrees, z
        radius, angle = position[:, 0].copy(), np.deg2rad(position[:, 1])
        position[:, 0], position[:, 1] = radius * np.cos(angle), radius * np.sin(angle)
    return label, position


def _name(named, block, kind, numbers):
    """Keep the numbers of a *Node or *Element that names a set."""
    if name := block.section.parameters.get(kind):
        named.setdefault((kind, block.prefix + name), []).append(numbers)


def _elements(comm, blocks, groups, named, unread, calculix):
    """Return node numbers (elements of this rank, nodes) and keys (elements,), see abaqus_sets, by kind; names of types
    and tables (elements, 3) of number, type and no material; the number of all elements by type. Fills `named`, and
    `unread` with names of sets of elements of no known type."""
    nodes_by_kind, keys, counts, types, tables = {}, {}, Counter(), [], {}
    with agreed(comm):
        for block in blocks:
            if "type" not in block.section.parameters:
                raise block.section.refusal("found *Element without type=, expected the type of its elements")
            name = block.section.parameters["type"]
            if not TYPE.fullmatch(name):
                raise block.section.refusal(f"found type={name}, expected the type of elements")
            # elements of other types are only looked at for whether they are whole
            kind = abaqus_kind(name)
            if kind is None:
                _require_labels(block, comm)
                if name := block.section.parameters.get("elset"):
                    unread.add((block.prefix + name).lower())
                continue
            if name.upper() not in types:
                types.append(name.upper())
            # the form of the lines
            width = NODES[kind] + 1
            middle = name.upper() == "S8R5"  # which may name the node that it has in its middle
            line = first_line(read_bytes(block.path, block.start, block.start + 4096))
            surplus = (calculix or middle) and len(line.replace(b",", b" ").split()) > width
            extra = 0 if calculix else abaqus_nodes_more(name)
            for piece in pieces(block.path, comm, block.start, block.stop, continued=not surplus):
                lines = _with_more_nodes(piece, width, extra) if extra else _element_lines(piece, width, surplus)
                # nodes, keys and tables of this rank
                nodes_by_kind.setdefault(kind, []).append(lines[:, 1:])
                keys.setdefault(kind, []).append(GROUP * groups.index(block.group) + lines[:, 0])
                counts[name.upper()] += len(lines)
                table = [lines[:, 0], np.full(len(lines), types.index(name.upper())), np.full(len(lines), -1)]
                tables.setdefault(kind, []).append(np.stack(table, axis=1))
                _name(named, block, "elset", keys[kind][-1])
    elements = {kind: in_vtk_order(kind, nodes) for kind, nodes in elements_of(comm, nodes_by_kind).items()}
    keys = {kind: np.concatenate([np.zeros(0, np.int64), *keys.get(kind, [])]) for kind in elements}
    tables = {kind: np.concatenate([np.zeros((0, 3), np.int64), *tables.get(kind, [])]) for kind in elements}
    return elements, keys, types, tables, dict(sum(comm.allgather(counts), Counter()))


def _require_labels(block, comm):
    """Refuse lines of elements that are not drawn which are no numbers, or names of instances with numbers."""
    for piece in pieces(block.path, comm, block.start, block.stop):
        text = without_comments(piece.text)
        if match := NO_LABELS.search(text):
            raise piece.refusal(text.count(b"\n", 0, match.start()), "numbers of an element and its nodes")


def _require_nodes(path, comm, nodes, elements):
    """Raise InputError where an element stands on a node that the file does not have."""
    for kind, corners in elements.items():
        wanted = np.unique(corners)
        there, _ = look_up(comm, nodes.label, [], wanted)
        with agreed(comm):
            if not there.all():
                raise InputError(
                    f"{path}: found the node {wanted[~there][0]} in elements ({kind}), but no place of it; expected a "
                    "*Node line for each node"
                )


def _with_more_nodes(piece, width, extra):
    """As _element_lines, of elements that may name `extra` nodes, 0 or none, in their line or behind a last comma."""
    filled = Piece(piece.path, EMPTY_FIELD.sub(b",0", piece.text), piece.start)
    values, counts, lines = ragged(filled, blanks=False, expected=f"{width} to {width + extra} numbers an element")
    first, total = np.arange(len(counts)), counts
    if (counts < width).any() or GOES_ON.search(filled.text):
        first, total = _lines_joined(filled, lines, counts, width, extra)
    fits = (total >= width) & (total <= width + extra)
    piece.require(fits, lines[first], f"{width} to {width + extra} numbers an element")
    place = np.arange(len(values)) - np.repeat(np.cumsum(total) - total, total)
    line = np.repeat(lines, counts)
    labels(piece, values[place < width], line[place < width], "the number of an element or node")
    labels(piece, values[place >= width], line[place >= width], "the number of a node", 0)
    return values[place < width].reshape(-1, width).astype(np.int64)


def _lines_joined(piece, lines, counts, width, extra):
    """Return for each element the first of its lines, and the total of their numbers."""
    text = without_comments(piece.text).split(b"\n")
    goes_on = [text[line].rstrip().endswith(b",") for line in lines]
    first, total = [], []
    for k, count in enumerate(counts.tolist()):
        if first and (total[-1] < width or (goes_on[k - 1] and total[-1] + count <= width + extra)):
            total[-1] += count
        else:
            first.append(k)
            total.append(count)
    return np.array(first, np.int64), np.array(total, np.int64)


def _element_lines(piece, width, surplus=False):
    """Return the `width` numbers of elements and their nodes, of whole lines each, or with `surplus` at their begin."""
    values, counts, lines = ragged(piece, blanks=False, expected=f"{width} numbers an element")
    if surplus:
        piece.require(counts >= width, lines, f"at least {width} numbers an element")
        place = np.arange(len(values)) - np.repeat(np.cumsum(counts) - counts, counts)
        values, counts = values[place < width], np.full(len(counts), width)
    piece.require(counts <= width, lines, f"{width} numbers an element")
    ends = np.cumsum(counts)
    line = np.searchsorted(ends, np.arange(width, values.size + 1, width))
    wrong = np.flatnonzero(ends[line] % width) if values.size else line
    if wrong.size or values.size % width:
        bad = line[wrong[0]] if wrong.size else len(lines) - 1
        raise piece.refusal(lines[bad], f"{width} numbers an element")
    labels(piece, values, np.repeat(lines, counts), "the number of an element or node")
    return values.reshape(-1, width).astype(np.int64)
