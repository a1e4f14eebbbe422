"""Read nodes, angles of nodal axes and elements of an ANSYS archive (.cdb, of CDWRITE).

The blocks NBLOCK and EBLOCK, whose second line is the Fortran format of their fields, ET or ETBLOCK, the types of
elements, components (CMBLOCK) and materials are read. Each rank looks for them in its range of bytes, then all share
the lines of blocks.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...fe.materials import ElementProperties, Material, material_of
from ...files.system_errors import open_input, read_bytes
from ...files.text import LARGEST_LABEL, Piece, line_number, pieces, require_file, shown
from ...files.text_numbers import labels, number_in, numbers, ragged, whole
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import sort_over_ranks
from ...parallel.petsc import MPI
from ..fixed_width import Field, fields_of_format, separated
from ..nodes.table import elements_of, finite, in_ranges, require_elements_once
from ..parts import used_properties

COMMAND = re.compile(
    rb"(?im)^[ \t]*(?:(?P<block>[NE]BLOCK)\b|(?P<types>ETBLOCK)\b|(?P<type>ET[ \t]*,)"
    rb"|(?P<end>-1[ \t]*\r?$|N[ \t]*,[ \t]*(?:R5\.\d|UNBL)[ \t]*,[ \t]*LOC[ \t]*,[ \t]*-1)"
    rb"|(?P<node>N[ \t]*,[ \t]*(?:R5\.\d[ \t]*,[ \t]*LOC[ \t]*,|\d))"
    rb"|(?P<change>(?:NSCA|NGEN|NSYM|NDEL|NUMM|NUMC|NREF|FILL|QUAD|MOVE|TRAN|UPGE|EGEN|ESYM|ENSY)[A-Z]*[ \t]*,"
    rb"|NMOD[A-Z]*[ \t]*,[^,\n]*(?:,[ \t]*){1,3}[^,\s])|(?P<turn>(?:NROT|NMOD|NANG|NORA|NORL)[A-Z]*\b)"
    rb"|(?P<set>CMBLOCK[ \t]*,)|(?P<data>(?:KEYO\w*|MPDATA|MP|UIMP|TB)[ \t]*,))[^\n]*"
)
START = re.compile(rb"(?im)^[ \t]*(/COM|/PREP7|/NOPR|/BATCH|/TITLE|NUMOFF|NBLOCK|ET[ \t]*,)")
HEAD = 11  # fields of an element in front of its nodes; the second is its type, the ninth how many nodes follow
MATERIAL, TYPE, COUNT, NUMBER = 0, 1, 8, 10
FIRST = 8  # nodes in the first line of an element
SOLIDS = {45, 46, 64, 65, 73, 92, 95, 148, 185, 186, 187, 190, 285}
SHELLS = {28, 41, 42, 43, 63, 82, 91, 93, 99, 143, 150, 181, 182, 183, 281}
BEAMS = {1, 3, 4, 8, 10, 23, 44, 180, 188, 189}
CONSTANTS = {"EX": "young", "NUXY": "poisson", "PRXY": "poisson", "DENS": "density", "ALPX": "expansion"}
ORTHOTROPIC = {"EY", "EZ", "NUYZ", "NUXZ", "PRYZ", "PRXZ", "GXY", "GYZ", "GXZ"}
HARMLESS = ("SDAM", "DENS", "THER")  # tables that change no stiffness, by their first letters
OTHER = re.compile(rb"(?m)^(?![ \t\d-]*\r?$)")  # the first line that has no numbers
KINDS = {"NODE": "node", "NODES": "node", "ELEM": "element", "ELEMENT": "element", "ELEMENTS": "element"}
AT_ONCE = 2**20  # bytes
OPTIONS = (2, 3, 6)  # of SOLID185 to 187: integration, layers, mixed formulation


@dataclass(frozen=True)
class Block:
    """The lines start..stop (bytes) of an NBLOCK or EBLOCK, their fields, and how many the file announces."""

    name: str
    line: int
    announced: int | None
    fields: list[Field]
    start: int
    stop: int


class Archive(NamedTuple):
    """Node numbers, coordinates, angles in degrees and elements of this rank, with their properties; remarks on
    materials; node numbers by name of the set."""

    label: np.ndarray
    position: np.ndarray
    angles: np.ndarray
    elements: dict[str, np.ndarray]
    properties: ElementProperties | None
    remarks: list[str]
    sets: dict[str, np.ndarray]


def begins(start: bytes) -> bool:
    """Test whether a text that starts so may be an archive: it has a command that stands above the blocks."""
    return b"\0" not in start and bool(START.search(start))


def read(path, comm, turned=False) -> Archive:
    """Return the contents of an archive; `turned`: also of one that turns the axes of nodes by commands, which are not
    followed. Collective. Raises InputError.

    Elements: node numbers (elements, nodes) by kind; those of other types than solids, shells and beams are left out.
    """
    path = Path(path)
    with agreed(comm):
        require_file(path)
        # the commands, wherever the ranks find them; they say where the blocks are
        heads = [(piece.start + match.start(), match.lastgroup, match[0].decode("latin-1").strip())
                 for piece in pieces(path, comm) for match in COMMAND.finditer(piece.text)]  # fmt: skip
    heads = sum(comm.allgather(heads), [])
    heads = [head for head in heads if not (turned and head[1] == "turn")]
    # the blocks of numbers, each rank its share of the lines
    blocks, types = decided(comm, _blocks, path, heads), decided(comm, _types, path, heads)
    nodes, elements, counts = [(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))], {}, []
    tables = {}
    with agreed(comm):
        for block in blocks:
            if block.name == "NBLOCK":
                own = [_nodes(piece, block.fields) for piece in pieces(path, comm, block.start, block.stop)]
                nodes += own
                counts.append(sum(len(of_piece[0]) for of_piece in own))
            else:
                counts.append(_elements(path, comm, block, types, elements, tables))
    # a block may say how many entries it has
    totals = comm.allreduce(np.array(counts, dtype=np.int64))
    for block, total in zip(blocks, totals, strict=True):
        if block.announced is not None and block.announced != total:
            raise InputError(
                f"{path}, line {block.line}: found {total} entries of {block.name}, but it announces "
                f"{block.announced}; the file is damaged"
            )
    # materials, and components of nodes and elements
    elements = elements_of(comm, elements)
    tables = {kind: np.concatenate([np.zeros((0, 3), np.int64), *tables.get(kind, [])]) for kind in elements}
    require_elements_once(path, comm, [table[:, 0] for table in tables.values()])
    properties, remarks = _properties(comm, path, heads, types, tables)
    commands = [(position, line) for position, kind, line in heads if kind == "set"]
    label, position, angles = map(np.concatenate, zip(*nodes, strict=True))
    sets = read_components(path, comm, commands, label, elements, {kind: table[:, 0] for kind, table in tables.items()})
    return Archive(label, position, angles, elements, properties, remarks, sets)


def _properties(comm, path, heads, types, tables):
    """Return the properties of the elements, and remarks; `tables` (elements, 3) by kind: number, and the numbers of
    type and material in the file."""
    if not tables:
        return None, []
    commands = [[word.strip() for word in line.split("!")[0].split(",")] for _, kind, line in heads if kind == "data"]
    materials, options, remarks = material_and_options([[words[0].upper(), *words[1:]] for words in commands])
    # numbers of the file give way to places in ascending order
    for column, known in enumerate((types, materials), 1):
        place = {number: k for k, number in enumerate(sorted(known))}
        for table in tables.values():
            distinct, back = np.unique(table[:, column], return_inverse=True)
            table[:, column] = np.array([place.get(number, -1) for number in distinct.tolist()], int)[back]
    names = [_type_name(type_, own | options.get(number, {})) for number, (type_, own) in sorted(types.items())]
    materials = [materials[number] for number in sorted(materials)]
    return used_properties(comm, "ANSYS", names, materials, tables), [f"{path}: {remark}" for remark in remarks]


def _blocks(path, heads):
    """Return the Blocks of the commands that were found (byte, kind, line), in order."""
    blocks = []
    with open_input(path) as file:
        for index, (position, kind, line) in enumerate(heads):
            if kind == "node":
                raise _refusal(path, position, "nodes as single commands, expected the blocks of CDWRITE,DB,file,cdb")
            if kind == "turn":
                raise _refusal(path, position, f"'{shown(line.encode())}', which gives nodes axes of their own that "
                               "only ANSYS knows; let it write CDWRITE,DB,file,cdb, which has the angles")  # fmt: skip
            if kind == "change":
                raise _refusal(path, position, f"'{shown(line.encode())}', which changes nodes in ANSYS; let it write "
                               "CDWRITE,DB,file,cdb, which has them as they are then")  # fmt: skip
            if kind != "block":
                continue
            words = [word.strip() for word in line.split(",")]
            name, number = words[0].upper(), line_number(path, position)
            if name == "EBLOCK" and not (len(words) > 2 and words[1] == "19" and words[2].upper() == "SOLID"):
                continue  # other forms of elements: pictures show those of the usual form
            file.seek(position)
            file.readline()
            fields = fields_of_format(file.readline(), f"{path}, line {number + 1}")
            end = heads[index + 1] if index + 1 < len(heads) else None
            if end is None or end[1] != "end":
                raise _refusal(path, position, f"no end of {name}; the file is cut off or damaged")
            if name == "NBLOCK" and not _fits(fields, words):
                raise _refusal(path, position, f"an NBLOCK of {len(fields)} fields, expected 3 integers (1 of "
                               "NBLOCK,3) and 3 to 6 numbers")  # fmt: skip
            if name == "EBLOCK" and not (len(fields) == HEAD + FIRST and all(field.whole for field in fields)):
                raise _refusal(path, position, f"an EBLOCK of {len(fields)} fields, expected 19 integers")
            counts = [word for word in words[3:] if word]
            if not all(word.isdigit() and word.isascii() for word in counts):
                raise _refusal(path, position, f"'{shown(line.encode())}', expected whole numbers behind SOLID")
            # the short NBLOCK of Workbench has the highest number that a node may have, and not how many there are
            announced = int(counts[-1]) if len(counts) == 2 else None
            blocks.append(Block(name, number, announced, fields, file.tell(), end[0]))
    if not any(block.name == "NBLOCK" for block in blocks):
        raise InputError(f"{path}: found no nodes, expected an NBLOCK as CDWRITE,DB,file,cdb writes it")
    return blocks


def _refusal(path, position, found):
    return InputError(f"{path}, line {line_number(path, position)}: found {found}")


def _fits(fields, words):
    """Test whether an NBLOCK has node number, perhaps two more integers, x, y, z and perhaps angles."""
    count = {"6": 3, "3": 1}.get("".join(words[1:2]))
    whole_numbers = [field.whole for field in fields]
    return count is not None and whole_numbers in [[True] * count + [False] * k for k in range(3, 7)]


def _types(path, heads):
    """Return numbers of ANSYS' element types (185 of SOLID185), and key options, by the type numbers that elements
    name."""
    types = {}
    for index, (position, kind, line) in enumerate(heads):
        words = [word.strip() for word in line.split("!")[0].split(",")]
        if kind == "type" and len(words) > 2 and words[1].isdecimal() and len(words[1]) < 12:
            digits = re.search(r"\d{1,9}$", words[2])
            if digits:
                types[int(words[1])] = int(digits[0]), {}
        elif kind == "types":
            types |= _types_of_block(path, position, heads[index + 1 : index + 2])
    return types


def _types_of_block(path, position, after):
    """Return the types in the lines of an ETBLOCK: number, type, key options."""
    if not after or after[0][1] != "end":
        raise _refusal(path, position, "no end of ETBLOCK; the file is cut off or damaged")
    _, _, *lines = read_bytes(path, position, after[0][0]).splitlines() or [b""]
    rows = [line.split() for line in lines if line.strip()]
    if not all(len(row) > 1 and row[0].isdigit() and row[1].isdigit() for row in rows):
        raise _refusal(path, position, "an ETBLOCK with other lines than number, type and key options")
    return {int(key): (int(type_), {k: value.decode("latin-1") for k, value in enumerate(options, 1)})
            for key, type_, *options in rows}  # fmt: skip


def _nodes(piece, fields):
    """Return labels, coordinates and angles of the lines of an NBLOCK; what is left out at the end is zero."""
    table, lines = numbers(separated(piece, fields, fill=True), len(fields), commas=False)
    label = labels(piece, table[:, 0], lines)
    reals = table[:, sum(field.whole for field in fields) :]
    reals = np.hstack([reals, np.zeros((len(table), 6 - reals.shape[1]))])
    finite(piece, reals, lines)
    return label, reals[:, :3], reals[:, 3:]


def _elements(path, comm, block, types, elements, tables):
    """Add the elements of this rank to `elements`, and number, type and material to `tables`, by kind; returns how many
    there are of any kind."""
    own = b"".join(piece.text for piece in pieces(path, comm, block.start, block.stop))
    if not own:
        return 0
    low = next(piece.start for piece in pieces(path, comm, block.start, block.stop))
    with open_input(path) as file:
        file.seek(low + len(own))
        beyond = b"".join(file.readline() for _ in range(3) if file.tell() < block.stop)
    piece = Piece(path, own + beyond, low)
    # all numbers, and of each line how many nodes an element that begins there would have
    values, counts, lines = ragged(separated(piece, block.fields), commas=False, expected="integers")
    whole(piece, values, np.repeat(lines, counts), "a number of an element", -LARGEST_LABEL, LARGEST_LABEL)
    values = values.astype(np.int64)
    place = np.cumsum(counts) - counts
    mine = int(np.count_nonzero(lines < own.count(b"\n") + (not own.endswith(b"\n"))))
    nodes = np.where(counts > HEAD, values[np.minimum(place + COUNT, len(values) - 1)], 0)
    below = -(-np.maximum(nodes - FIRST, 0) // (HEAD + FIRST))  # lines that follow the first
    after = np.arange(len(counts)) + 1 + below
    until = np.append(place, len(values))
    fits = (nodes > 0) & (counts == HEAD + np.minimum(nodes, FIRST)) & (after <= len(counts))
    fits[fits] &= until[after[fits]] - place[fits] == HEAD + nodes[fits]
    # an element takes one to three lines: of the three ways to begin one leads from element to element
    for first in range(1 if low == block.start else 3):  # the lines at the top may belong to the rank before
        heads = followed(after, first)
        heads = heads[heads < mine]
        if fits[heads].all():
            break
    else:
        first, heads = 0, followed(after, 0)
    piece.require(fits[heads], lines[heads], "an element of 11 numbers, then its nodes")
    # numbers of elements, types and nodes are positive
    table = values[np.minimum(place[heads, None] + np.arange(HEAD + 20), len(values) - 1)]
    here = np.arange(HEAD + 20) < HEAD + np.minimum(nodes[heads], 20)[:, None]
    here[:, [k for k in range(HEAD) if k not in (TYPE, NUMBER)]] = False  # keys of the geometry may be negative
    positive = ~((table < 0) & here).any(axis=1)
    piece.require(positive, lines[heads], "numbers of nodes, of an element and its type, from 0 on")
    # elements of one type and number of nodes together
    for number in np.unique(table[:, TYPE]):
        for count in np.unique(table[table[:, TYPE] == number, COUNT]):
            some = table[(table[:, TYPE] == number) & (table[:, COUNT] == count)]
            nodes = some[:, HEAD:][:, : min(count, 20)]
            for kind, mask, places in kinds_of(types.get(int(number), (None,))[0], nodes):
                elements.setdefault(kind, []).append(nodes[mask][:, places])
                tables.setdefault(kind, []).append(some[mask][:, [NUMBER, TYPE, MATERIAL]])
    return len(heads)


def followed(after: np.ndarray, first: int) -> np.ndarray:
    """Return the places on the way first, after[first], after[after[first]], ..., ascending, up to the end."""
    size = len(after)
    jump = np.append(np.minimum(after, size), size)
    path = np.array([first] if first < size else [], dtype=np.int64)
    while len(path):
        ahead = jump[path]
        ahead = ahead[ahead < size]
        if not len(ahead):
            break
        path, jump = np.concatenate([path, ahead]), jump[jump]
    return np.sort(path)


def kinds_of(type_: int | None, nodes: np.ndarray):
    """Yield kinds (see fe.elements), which elements of one type are of that kind, and the places of its nodes;
    repeated nodes make wedges."""
    count, every = nodes.shape[1], np.ones(len(nodes), bool)
    if type_ in BEAMS and count >= 2:
        yield ("line3", every, [0, 1, 2]) if type_ == 189 and count >= 3 else ("line", every, [0, 1])
    elif type_ in SHELLS and count in (3, 4, 6, 8):
        triangle = nodes[:, 2] == nodes[:, 3] if count in (4, 8) else every
        corner = [0, 1, 2] if count in (3, 4) else [0, 1, 2, 4, 5, 7] if count == 8 else list(range(6))
        yield ("triangle" if len(corner) == 3 else "triangle6"), triangle, corner
        if count in (4, 8):
            yield ("quad" if count == 4 else "quad8"), ~triangle, list(range(count))
    elif type_ in SOLIDS and count in (4, 10):
        yield ("tetra" if count == 4 else "tetra10"), every, list(range(count))
    elif type_ in SOLIDS and count in (8, 20):
        top = (nodes[:, 4:7] == nodes[:, 5:8]).all(axis=1)  # M = N = O = P
        side = nodes[:, 2] == nodes[:, 3]  # K = L
        wedge = side & ~top & (nodes[:, 6] == nodes[:, 7])
        plain = ~top & ~wedge & ~side
        for some, kind, corner in (
            (top & side, "tetra", [0, 1, 2, 4]), (top & ~side, "pyramid", [0, 1, 2, 3, 4]),
            (wedge, "wedge", [0, 1, 2, 4, 5, 6]),
            (plain, "hexahedron" if count == 8 else "hexahedron20", list(range(count))),
        ):  # fmt: skip
            if some.any() and (nodes[some][:, corner] > 0).all():
                yield kind, some, corner
            elif some.any():  # without some of the nodes in the middle of edges
                yield "hexahedron", some, list(range(8))


def material_and_options(commands) -> tuple[dict[int, Material], dict[int, dict[int, str]], list[str]]:
    """Return materials by number, key options by number of the type, and sentences on tables of temperatures.

    `commands`: lines of words between commas, the first in capitals.
    """
    known, reasons, options, tables = {}, {}, {}, {}
    for name, *words in commands:
        if name.startswith("KEYO"):
            if len(words) > 2 and words[0].isdecimal() and words[1].isdecimal():
                options.setdefault(int(words[0]), {})[int(words[1])] = words[2]
            continue
        label, number, value, many = _constant(name, words + [""] * 8)
        if not number.isdecimal():
            continue
        data, reason = known.setdefault(int(number), {}), reasons.setdefault(int(number), [])
        if name == "TB":
            reason += [] if label[:4] in HARMLESS else [f"found TB,{label}"]
        elif label in ORTHOTROPIC:
            reason.append(f"found {label}")
        elif key := CONSTANTS.get(label):
            constant = number_in(value)
            if constant is None:
                reason.append(f"found {label} '{value}', expected a number")
            elif not (many and key in data):
                data[key] = constant
            if many:
                tables.setdefault(int(number), set()).add(label)
    remarks = [f"{', '.join(sorted(labels))} of the material {number} have several temperatures; the first one counts"
               for number, labels in sorted(tables.items())]  # fmt: skip
    return {number: _material(number, data, reasons[number]) for number, data in known.items()}, options, remarks


def _constant(name, words) -> tuple[str, str, str, bool]:
    """Return the label of a constant, the number of the material, the value, and whether it is one of a table."""
    if name == "MPDATA":
        length, words = ("1", words) if not words[0].upper().startswith("R5") else (words[1], words[2:])
        label, number, place, value, second = words[:5]
        many = length not in ("", "1") or place not in ("", "1") or bool(second)
    elif name == "UIMP":
        number, label, _, _, value = words[:5]
        many = False
    else:  # MP, whose further values are coefficients of powers of the temperature, and TB
        label, number, value = words[:3]
        many = name == "MP" and any(words[3:7])
    return label.upper(), number, value, many


def _material(number, known, reasons) -> Material:
    """Return the material of a number from what is known of it; without Poisson's ratio ANSYS takes 0.3."""
    name = f"MAT {number}"
    if not reasons and "young" not in known:
        reasons = ["found no EX"]
    if reasons:
        rest = {key: value for key, value in known.items() if key not in ("young", "poisson")}
        return material_of(name, **rest, reason="; ".join(dict.fromkeys(reasons)))
    return material_of(name, **({"poisson": 0.3} | known))


def _type_name(number: int, options: dict[int, str]) -> str:
    """Return the name of an element type, with its key options where they change its stresses: SOLID186 KEYOPT(2)=1."""
    family = "SOLID" if number in SOLIDS else "SHELL" if number in SHELLS else "BEAM"
    options_of_type = [f"KEYOPT({key})={options[key]}" for key in OPTIONS if options.get(key, "0") not in ("", "0")]
    return " ".join([f"{family}{number}", *options_of_type])


# Components of nodes and elements (CMBLOCK), such as the named selections of Workbench: a line CMBLOCK,NAME,NODE,count,
# a Fortran format, and numbers, of which a negative one ends a range that the one before it begins.


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
