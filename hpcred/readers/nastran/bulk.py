"""Read points, elements and constraint cards of input files of Nastran and OptiStruct (.bdf, .dat, .fem).

Grid and scalar points, coordinate systems, elements, materials of solids, and the cards that determine which dofs have
no row (see sets) are read. Each rank reads its share of the lines; the cards of systems, constraints and materials,
which are few, are collected on all ranks.
"""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...fe.elements import NODES
from ...fe.materials import MATERIAL, ElementProperties, Material, material_of
from ...files.included import Included
from ...files.system_errors import open_input, read_bytes
from ...files.text import Piece, first_bytes, first_line, line_number, pieces, records, refuse_packed, require_file
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up, require_once, sort_over_ranks
from ..nodes.table import LARGEST_COORDINATE, elements_of, in_ranges, require_elements_once
from ..nodes.table import VERTICAL_FIRST as VTK
from ..parts import used_properties
from .cards import CARD, Card, components, lines_of, reals, wholes
from .points import CYLINDRICAL, HELD, RECTANGULAR, SPHERICAL, Points, System

MARK = re.compile(
    rb"(?mi)^[ \t]*(?:(?P<begin>BEGIN\b[^\n$]*)|(?P<end>ENDDATA\b)|(?P<cend>CEND\b)|"
    rb"INCLUDE[ \t]*(?:(?P<quote>['\"])|(?P<bare>[^'\"\n$ \t]+)))"
)
SECTION = re.compile(rb"(?mi)^[ \t]*BEGIN[ \t]+SUPER[ \t=]*(\d+)")
LONGEST_NAME = 4096  # bytes of a file's name in quotes, perhaps over several lines
CASE = re.compile(rb"(?mi)^[ \t]*(?P<word>SPC|MPC)(?:[ \t]*\([^)\n]*\))?[ \t]*=[ \t]*(?P<number>\d+)|^[ \t]*SUBCASE\b")
SYSTEMS = {"R": RECTANGULAR, "C": CYLINDRICAL, "S": SPHERICAL}
SMALL = re.compile(
    rb"CORD[12][RCS]|GRDSET|SPC|SPC1|SPCADD|MPC|MPCADD|RBE1|RBE2|RBE3|RBAR|RBAR1|RROD|RTRPLT1?|RSPLINE|RSSCON|RJOINT|"
    rb"PARAM|[ABCQ]SET1?|SET[13]?|OMIT1?|SUPORT1?|SPOINT|EPOINT|SEQGP|CSUPER|SESET|SEBULK|EXTRN|"
    rb"PSOLID|MAT(?:1|2|3|8|9|10|11|S1)"
)
# number of the field of the first node, and nodes by kind, the largest first
ELEMENTS = {
    "CTETRA": (2, ("tetra10", "tetra")), "CHEXA": (2, ("hexahedron20", "hexahedron")),
    "CPENTA": (2, ("wedge15", "wedge")), "CPYRAM": (2, ("pyramid",)), "CPYRA": (2, ("pyramid",)),
    "CQUAD4": (2, ("quad",)), "CQUADR": (2, ("quad",)), "CTRIA3": (2, ("triangle",)), "CTRIAR": (2, ("triangle",)),
    "CQUAD8": (2, ("quad8", "quad")), "CTRIA6": (2, ("triangle6", "triangle")), "CSHEAR": (2, ("quad",)),
    "CBAR": (2, ("line",)), "CBEAM": (2, ("line",)), "CROD": (2, ("line",)), "CTUBE": (2, ("line",)),
    "CBEND": (2, ("line",)), "CONROD": (1, ("line",)), "CBUSH": (2, ("line",)),
}  # fmt: skip
START = re.compile(
    rb"(?mi)^[ \t]*(?:SOL[ ,]|CEND\b|BEGIN[ \t]+(?:BULK|SUPER)|NASTRAN[ ,]|PARAM[ ,]|"
    rb"INCLUDE[ \t]*['\"]|INCLUDE[ \t]+\S|(?:GRID|DMIG|SPOINT|CORD[12][RCS]|GRDSET|MAT[1-9]|PSOLID|PSHELL|"
    rb"PBARL?|PBEAML?|" + "|".join(ELEMENTS).encode() + rb")[ ,*\t])"
)
WITH_NODES = {"CONM2": (1,), "CONM1": (1,), "CELAS1": (2, 4), "CELAS2": (2, 4), "CBUSH": (2, 3), "CDAMP1": (2, 4),
              "CDAMP2": (2, 4), "CMASS1": (2, 4), "CMASS2": (2, 4), "CVISC": (2, 3)}  # fmt: skip
ANY_ELEMENT = re.compile(rb"C(?!ORD[12][RCS]$|SET1?$|SUPER$|REEP$|LOAD$|YJOIN$)[A-Z]+[0-9]*")
GRID = re.compile(rb"GRID")
SET_CARDS = {"SET1": 1, "SET3": 2, "SET": 2}  # of sets, and where their numbers begin
SET = re.compile(rb"(?mi)^[ \t]*SET[ \t]+(?P<number>\d{1,9})[ \t]*=(?P<list>(?:[^\n]*,[ \t\r]*\n)*[^\n]*)")
OF_ELEMENTS = re.compile(
    rb"(?mi)^[ \t]*(?:STRE|STRESS|STRA|STRAIN|ELST|ELSTRESS|ELFO|ELFORCE|FORC|FORCE|GPFORCE|GPSTRESS|GPSTRAIN|ESE|EKE|"
    rb"EDE|FLUX)[ \t]*(?:\([^)\n]*\)[ \t]*)?=[ \t]*(?P<number>\d{1,9})[ \t\r]*$"
)
NUMBER = re.compile("[0-9]{1,10}")
FLUID = -1
SAME = 1e-2  # relative difference of G and E / (2 (1 + NU)) that rounding explains


@dataclass
class Deck:
    """The contents of the bulk data; grids are those of this rank, as `Points` but in the systems of the file.

    `properties` of the `elements`. `cards`: the few other ones, on all ranks. `case`: the numbers that the case control
    gives by SPC and MPC, and its SETs, or None where there is no case control. `other`: node numbers of what has nodes
    and is no element of `elements`, `unknown`: names of elements of which it is not known where the nodes stand.
    `superelement`: number of the section that was read, None for the whole file.
    `point_mass`: the sum of CONM2, as written. `sets`: numbers of points by name, and `remarks` on them.
    """

    path: Path
    label: np.ndarray
    system: np.ndarray
    coordinates: np.ndarray
    displacement: np.ndarray
    held: np.ndarray
    cards: list[Card]
    case: dict | None
    elements: dict[str, np.ndarray]
    properties: ElementProperties | None
    other: np.ndarray
    unknown: set
    point_mass: float
    sets: dict[str, np.ndarray]
    remarks: list[str]
    superelement: int | None = None

    @property
    def mass_unit(self) -> float:
        """PARAM,WTMASS: what masses of the input file are multiplied by."""
        cards = [card for card in self.cards if card.name == "PARAM" and card.text(0) == "WTMASS"]
        return cards[0].real(1, "WTMASS") if cards else 1.0


def begins(start: bytes) -> bool:
    """Test whether a text that starts so is an input file of Nastran."""
    return first_line(start)[:1] != b"*" and b"\0" not in start and START.search(start) is not None


def beside(path) -> list[Path]:
    """Return the other files of the same name in the folder of a file, in any case of letters."""
    path = Path(path)
    return [file for file in sorted(path.parent.iterdir())
            if file.stem.lower() == path.stem.lower() and file != path and file.is_file()]  # fmt: skip


def companions(path) -> list[Path]:
    """Return the input files beside a file, that of an external superelement first."""
    suffixes = (".pch", ".bdf", ".dat", ".nas", ".fem", ".blk", ".asm")
    files = [file for file in beside(path) if file.suffix.lower() in suffixes and begins(first_bytes(file))]
    return sorted(files, key=lambda file: suffixes.index(file.suffix.lower()))


class Section(NamedTuple):
    """A section BEGIN SUPER: the number of its superelement, and its bytes."""

    number: int
    start: int
    stop: int


def sections_of(path, comm) -> list[Section | None]:
    """Return the sections BEGIN SUPER of a file, where there are several, which have points of their own; else None for
    the whole. Collective."""
    with agreed(comm):
        first_bytes(path)
        refuse_packed(path)
        size = Path(path).stat().st_size
        mine = [(piece.start + match.start(), int(match[1]))
                for piece in records(path, comm, 0, size, re.compile(rb"(?m)^"))
                for match in SECTION.finditer(piece.text)]  # fmt: skip
    marks = sorted(sum(comm.allgather(mine), []))
    ends = [*(start for start, _ in marks[1:]), size]
    sections = [Section(number, start, end) for (start, number), end in zip(marks, ends, strict=True)] if marks else []
    return sections if len(sections) > 1 else [None]


def read_deck(path, comm, section=None) -> Deck:
    """Read an input file and those that it includes, or the bytes of one of its sections_of. Collective. Raises
    InputError."""
    path = Path(path)
    segments, case = segments_of(path, comm) if section is None else ([(str(path), *section[1:])], None)
    grids, cards, elements, other, unknown, point_mass = [_grids(Piece(path, b"", 0))], [], {}, [], set(), 0.0
    numbers = {}
    # each rank reads its share of the lines: grids and elements by columns, small cards one by one
    with agreed(comm):
        for file, start, stop in segments:
            for piece in records(file, comm, start, stop, CARD):
                lines = lines_of(piece, ANY_ELEMENT)
                for name in np.unique(lines.name):
                    _elements(lines.of(name.decode()), name.decode(), elements, numbers, other, unknown)
                table, number = lines.of("CONM2").table(4)
                point_mass += float(reals(piece, table[:, 3], number, "a mass").sum())
                grids.append(_grids(piece))
                cards += lines_of(piece, SMALL).listed()
    # the small cards are few, and each rank needs all of them
    cards = sum(comm.allgather(cards), [])
    with agreed(comm):
        # GRDSET fills the fields that grids leave empty
        defaults = _defaults(cards)
        label, system, displacement, own_hold, xyz, held = map(np.concatenate, zip(*grids, strict=True))
        system = np.where(system < -1, defaults[0], system)
        displacement = np.where(displacement < -1, defaults[1], displacement)
        held[~own_hold] = defaults[2]
    # elements and sets name points, so they come after all points are known
    elements = elements_of(comm, elements)
    sets, remarks = read_point_sets(path, comm, label, cards, case["SET"] if case else ())
    deck = Deck(
        path, label, system, xyz, displacement, held, cards, case, elements, None,
        np.concatenate([np.zeros(0, np.int64), *other]), set().union(*comm.allgather(unknown)),
        comm.allreduce(point_mass), sets, remarks, section and section.number,
    )  # fmt: skip
    tables = {kind: np.concatenate([np.zeros((0, 3), np.int64), *numbers.get(kind, [])]) for kind in elements}
    require_elements_once(path, comm, [table[:, 0] for table in tables.values()])
    with agreed(comm):
        # the materials of the elements, by their properties
        deck.properties = properties_of(comm, cards, list(ELEMENTS), tables, deck.mass_unit)
    return deck


def segments_of(path, comm):
    """Return bytes of bulk data (file, start, stop), in order, and what the case control says. Collective."""
    included, bulk, of_case = Included(path), [], []

    def follow(file, including=(), above=(), to=bulk):
        """Append the bytes of a file, and where it includes others theirs, to `to`; those before its BEGIN to the case
        control."""
        with agreed(comm):
            name = included.add(file, above, lambda text: InputError(f"{including[-1]}: {text}"))
        if name not in included.own:
            included.own[name] = _spans_of(file, comm, main=not including)
        spans, begin = included.own[name]
        for start, stop, target in spans:
            here = of_case if start < begin else bulk if begin >= 0 else to
            if start < stop:
                here.append((str(file), start, stop))
            if target is not None:
                with agreed(comm):
                    target = _included(file, target, including)
                follow(target, (*including, file), (*above, name), here)
        return begin

    begin = follow(path)
    with agreed(comm):
        return bulk, _case(of_case) if begin >= 0 else None


def _spans_of(path, comm, main):
    """Return bytes of case control and bulk data (start, stop) of one file, each with the name of what is included
    behind it or None, and where the bulk data begin, -1 where no BEGIN says so. Collective."""
    with agreed(comm):
        require_file(path)
        refuse_packed(path)
        # the marks BEGIN, CEND, ENDDATA and INCLUDE, wherever the ranks find them
        mine = [(piece.start + match.start(), piece.start + match.end(), match.groupdict())
                for piece in pieces(path, comm) for match in MARK.finditer(piece.text)]  # fmt: skip
    marks = sum(comm.allgather(mine), [])
    # one section of bulk data, with its end
    begin = [mark for mark in marks if mark[2]["begin"]]
    with agreed(comm):
        if len(begin) > 1:
            raise InputError(
                f"{path}: found {len(begin)} sections of bulk data, expected one: superelements as parts have numbers "
                "of their own; give the matrices of one with its own input file"
            )
        if not begin and any(mark[2]["cend"] for mark in marks) and main:
            raise InputError(f"{path}: found CEND but no BEGIN BULK, expected bulk data")
        if begin and b"BULK" in begin[0][2]["begin"].upper() and not any(mark[2]["end"] for mark in marks):
            raise InputError(f"{path}: found BEGIN BULK but no ENDDATA; the file is cut off, or lacks that last line")
        first = begin[0][0] if begin else -1
        # spans between the marks; what stands before CEND (executive control) and behind ENDDATA is not read
        at = max((high for _, high, groups in marks if groups["cend"] and high < first), default=0)
        spans, size = [], path.stat().st_size
        for low, high, groups in marks:
            if low < at or groups["cend"] or (groups["end"] and low < first):
                continue
            if groups["end"]:
                size = low
                break
            if groups["begin"]:
                spans.append((at, low, None))
                at = high
                continue
            name = groups["bare"]
            if groups["quote"]:
                name, high = _name_in_quotes(path, high, groups["quote"])
            spans.append((at, low, name))
            with open_input(path) as text:
                text.seek(high)
                at = high + len(text.readline())
    return [*spans, (at, size, None)], first


def _name_in_quotes(path, start, quote):
    """Return the name from the byte `start` to the next quote, perhaps on a later line, and the byte of that."""
    name, end, _ = read_bytes(path, start, start + LONGEST_NAME).partition(quote)
    if not end:
        raise InputError(f"{path}, line {line_number(path, start)}: found an INCLUDE without its second quote")
    return b"".join(line.strip() for line in name.splitlines()), start + len(name)


def _included(path, name, including):
    """Return the file of an INCLUDE, beside the main or the including one, else in any case of letters."""
    name = name.decode("latin-1").strip().replace("\\", "/")
    for folder in dict.fromkeys([path.parent, *(file.parent for file in including)]):
        file = folder / name
        if not file.is_file() and file.parent.is_dir():
            file = next((beside for beside in file.parent.iterdir() if beside.name.lower() == file.name.lower()), file)
        if file.is_file():
            return file
    raise InputError(f"{path}: found INCLUDE '{name}', which is no file in {path.parent}; put it there")


def _case(segments):
    """Return numbers of SPC and MPC of the case control, more than one where subcases differ, and its sets."""
    text = b"".join(read_bytes(*segment) for segment in segments)
    asked = [(match["word"].decode().upper(), int(match["number"])) for match in CASE.finditer(text) if match["word"]]
    return {**{key: {number for word, number in asked if word == key} for key in ("SPC", "MPC")},
            "SET": sets_of_case(text)}  # fmt: skip


def _grids(piece):
    """Return label, CP, CD, whether PS is given, coordinates and PS of GRID cards; -2 where a system is left out."""
    lines = lines_of(piece, GRID)
    table, number = lines.table(7)
    if (long := lines.beyond(8)).size:
        raise piece.refusal(int(long[0]), "a grid point of at most eight fields")
    label = wholes(piece, table[:, 0], number, "the number of a grid point", 1)
    system, displacement = (_system(piece, table[:, k], number) for k in (1, 5))
    xyz = np.stack([reals(piece, table[:, k], number, "a coordinate") for k in (2, 3, 4)], axis=1)
    held = components(piece, table[:, 6], number, "the supports of a grid point")
    return label, system, displacement, table[:, 6] != b"", xyz, held


def _system(piece, fields, number):
    empty, fluid = fields == b"", fields == b"-1"
    value = wholes(piece, np.where(empty | fluid, b"0", fields), number, "the number of a coordinate system")
    return np.where(empty, -2, np.where(fluid, FLUID, value))


def _elements(lines, name, elements, numbers, other, unknown):
    """Nodes of the elements of one name in a piece go to `elements`, or to `other`; see elements_by_number."""
    if name in WITH_NODES:
        table, _ = lines.table(max(WITH_NODES[name]) + 1)
        for k in WITH_NODES[name]:
            digits = np.char.isdigit(table[:, k])
            other.append(table[digits, k].astype(np.int64))
    if name not in ELEMENTS:
        if name not in WITH_NODES:
            unknown.add(name)
        return
    elements_by_number(lines, name, elements, numbers)


def elements_by_number(lines, name, elements, numbers):
    """Nodes of the elements of one name in a piece go to `elements`; number, place of the name among
    ELEMENTS, and number of the property, go to `numbers`; both by kind."""
    first, kinds = ELEMENTS[name]
    table, number = lines.table(first + NODES[kinds[0]])
    nodes = table[:, first:]
    left = np.ones(len(nodes), bool)
    for kind in kinds:
        full = left & np.char.isdigit(nodes[:, : NODES[kind]]).all(axis=1)
        if full.any():
            labels = wholes(lines.piece, nodes[full, : NODES[kind]].ravel(), np.repeat(number[full], NODES[kind]),
                            "the number of a node", 1).reshape(-1, NODES[kind])  # fmt: skip
            elements.setdefault(kind, []).append(labels[:, VTK.get(kind, slice(None))])
            own = wholes(lines.piece, table[full, 0], number[full], "the number of an element", 1)
            property_ = np.zeros(len(own), np.int64)
            if first == 2:
                property_ = wholes(lines.piece, table[full, 1], number[full], "the number of a property", empty=0)
                property_ = np.where(property_ == 0, own, property_)  # left out, it is that of the element
            row = [own, np.full(len(own), list(ELEMENTS).index(name)), property_]
            numbers.setdefault(kind, []).append(np.stack(row, axis=1))
        left &= ~full


def _defaults(cards):
    """Return CP, CD and PS of GRDSET."""
    card, *repeated = [card for card in cards if card.name == "GRDSET"] or [None]
    if card is None:
        return 0, 0, np.zeros(6, bool)
    if repeated:
        raise repeated[0].error("found a second one, expected one for all points")
    return card.whole(1, "CP", 0), card.whole(5, "CD", 0), card.directions(6)


def points_of(deck: Deck, comm) -> Points:
    """Return all grid and scalar points, ascending, without marks but those of permanent supports. Collective."""
    with agreed(comm):
        spans = [span for card in deck.cards * (comm.rank == 0) if card.name == "SPOINT"
                 for span in zip(*card.points(0), strict=True)]  # fmt: skip
        scalars = np.unique(np.concatenate([np.zeros(0, np.int64), *(np.arange(a, b + 1) for a, b in spans)]))
        if (deck.displacement == FLUID).any():
            raise InputError(
                f"{deck.path}: found the fluid point {deck.label[deck.displacement == FLUID][0]} (CD = -1), expected a "
                "structure without fluid"
            )
    label = np.concatenate([deck.label, scalars])
    padded = [np.concatenate([column, np.zeros(len(scalars), column.dtype)]) for column in (
        deck.system, deck.displacement, *deck.coordinates.T, *deck.held.T)]  # fmt: skip
    require_once(comm, label, lambda twice: f"{deck.path}: found the point {twice} more than once, expected each point "
                                            "once")  # fmt: skip
    # points in order of their numbers, spread evenly over the ranks
    label, scalar, system, displacement, x, y, z, *held = sort_over_ranks(
        comm, label, [np.arange(len(label)) >= len(deck.label), *padded]
    )
    if not comm.allreduce(len(label)):
        raise InputError(f"{deck.path}: found no points, expected GRID cards")
    coordinates, scalar = np.stack([x, y, z], axis=1), scalar.astype(bool)
    # coordinates become basic ones
    systems = systems_of(comm, deck, label, system, coordinates)
    with agreed(comm):
        if unknown := {*system[~scalar].tolist(), *displacement[~scalar].tolist()} - set(systems):
            raise InputError(
                f"{deck.path}: found points in the coordinate system {min(unknown)}, which no CORD card defines"
            )
        position = np.zeros((len(label), 3))
        for number in np.unique(system):
            mine = (system == number) & ~scalar
            position[mine] = systems[number].to_basic(coordinates[mine])
        far = ~(np.abs(position) <= LARGEST_COORDINATE).all(axis=1)
        if far.any():
            raise InputError(f"{deck.path}: found the point {label[far][0]} at {position[far][0].tolist()}, expected "
                             "finite coordinates")  # fmt: skip
    # what the deck holds for good
    marks = np.where(np.stack(held, axis=1), HELD, 0).astype(np.uint8)
    return Points.in_systems(label, position, scalar, marks, displacement, systems)


def systems_of(comm, deck, label, system, coordinates):
    """Return all coordinate systems by number. Collective."""
    with agreed(comm):
        # CORD1 cards are defined by points, which other ranks may have
        definitions = _definitions(deck.cards)
        wanted = [point for *_, points in definitions for point in points if isinstance(point, int)]
        mine = np.flatnonzero(np.isin(label, np.array(wanted, dtype=np.int64)))
        own = {int(label[k]): (int(system[k]), coordinates[k].tolist()) for k in mine}
    grids = {point: described for grids_of_rank in comm.allgather(own) for point, described in grids_of_rank.items()}
    with agreed(comm):
        # all definitions; a second one of a number must be equal
        systems, open_ = {0: System()}, {}
        for card, number, points in definitions:
            if missing := [point for point in points if isinstance(point, int) and point not in grids]:
                raise card.error(f"found the point {missing[0]}, which no GRID card defines")
            described = SYSTEMS[card.name[5]], [grids[point] if isinstance(point, int) else point for point in points]
            if number == 0 or (number in open_ and str(open_[number][:2]) != str(described)):
                raise card.error(f"found the coordinate system {number} a second time, expected one definition")
            open_[number] = *described, card
        # systems are defined in others, so each pass resolves those whose references are known
        while open_:
            ready = [number for number, (_, points, _) in open_.items() if all(ref in systems for ref, _ in points)]
            if not ready:
                number, (_, points, card) = next(iter(open_.items()))
                missing = next(ref for ref, _ in points if ref not in systems)
                raise card.error(
                    f"found the coordinate system {number} defined in {missing}, which no card defines, or by itself"
                )
            for number in ready:
                kind, points, card = open_.pop(number)
                basic = [systems[ref].to_basic(np.asarray(point, float)[None])[0] for ref, point in points]
                systems[number] = System.from_points(kind, *basic)
                if systems[number] is None:
                    raise card.error(f"found three points on a line for the coordinate system {number}")
        return systems


def _definitions(cards):
    """Return card, number and three points (a grid point, or system and coordinates) of each system."""
    definitions = []
    for card in cards:
        if card.name.startswith("CORD2"):
            reference = card.whole(1, "the system of reference", 0)
            values = [card.real(k, "a coordinate") for k in range(2, 11)]
            points = [(reference, values[k : k + 3]) for k in (0, 3, 6)]
            definitions.append((card, card.whole(0, "the number of the system"), points))
        elif card.name.startswith("CORD1"):
            for start in (0, 4) if card.text(4) else (0,):  # a card may define two
                points = [card.whole(start + k, "a grid point") for k in (1, 2, 3)]
                definitions.append((card, card.whole(start, "the number of the system"), points))
    return definitions


# Give solids of Nastran their materials: CTETRA, CHEXA, CPENTA name a PSOLID, which names a MAT1.


def properties_of(comm, cards, names, tables: dict, mass_unit: float) -> ElementProperties | None:
    """Return the properties of elements, None where there are none; `cards` with PSOLID and the materials.

    `tables` (elements, 3) by kind: number of the element, place of its type in `names`, and number of its property,
    which its material replaces here. `mass_unit`: what densities are multiplied by. Collective.
    """
    if not tables:
        return None
    # materials by number; one with a stress-strain curve keeps its density and says why it has no stiffness
    materials = {}
    for card in cards:
        if card.name.startswith("MAT") and card.name[3:].isdigit():
            materials.setdefault(card.whole(0, "the number of a material"), _material(card, mass_unit))
    for card in cards:
        number = card.text(0)
        if card.name == "MATS1" and number.isdigit() and (linear := materials.get(int(number))):
            materials[int(number)] = Material(name=linear.name, density=linear.density, expansion=linear.expansion,
                                              reason="found MATS1")  # fmt: skip
    # the place of the material that each PSOLID names
    order = {number: place for place, number in enumerate(materials)}
    of_property = {}
    for card in cards:
        if card.name == "PSOLID":
            place = order.get(card.whole(1, "the number of a material", 0), -1)
            of_property.setdefault(card.whole(0, "the number of a property"), place)
    known = np.array(sorted(of_property), np.int64)
    places = np.array([*(of_property[number] for number in known.tolist()), -1])
    # in the tables, the number of the property gives way to the place of its material
    for table in tables.values():
        at = np.searchsorted(known, table[:, MATERIAL])
        there = np.append(known, -1)[at] == table[:, MATERIAL]
        table[:, MATERIAL] = places[np.where(there, at, -1)]
    return used_properties(comm, "Nastran", names, list(materials.values()), tables)


def _material(card, mass_unit) -> Material:
    """Return the material of a card, without constants where it is no MAT1."""
    name = f"{card.name} {card.text(0)}"
    if card.name != "MAT1":
        return Material(name=name, reason=f"found {card.name}")
    young, shear, poisson, density, expansion = (
        card.real(k, constant) if card.text(k) else None for k, constant in (
            (1, "Young's modulus"), (2, "the shear modulus"), (3, "Poisson's ratio"), (4, "a density"),
            (5, "a coefficient of expansion")))  # fmt: skip
    rest = {"density": None if density is None else density * mass_unit, "expansion": expansion}
    if young and shear and poisson is None:
        poisson = young / (2 * shear) - 1
    elif shear and poisson is not None and not young:
        young = 2 * (1 + poisson) * shear
    elif young and shear and abs(2 * (1 + poisson) * shear / young - 1) > SAME:
        return material_of(name, **rest, reason=f"found E {young:g}, G {shear:g} and NU {poisson:g}, which do not fit")
    if not young or poisson is None:
        return material_of(name, **rest, reason="found a MAT1 without two of E, G and NU")
    return material_of(name, young=young, poisson=poisson, **rest)


# Sets of points have numbers in place of names. SET of the case control is "SET 5", the cards SET1, SET3 and SET (of
# OptiStruct) are "SET1 5", "SET3 5" and "SET 5". SET3 and OptiStruct's SET say what their numbers are; other sets are
# of points if each that is listed by itself is a point of the file, and if the case control does not ask for results
# of elements in them.


class PointSet(NamedTuple):
    """A set as it is written: the numbers that are listed by themselves, and all ranges."""

    name: str
    single: list[int]
    ranges: list[tuple[int, int]]


def read_point_sets(path, comm, label, cards, of_case) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return numbers of points by name of the set, each once over all ranks, and remarks. Collective.

    `label`: points of this rank; `cards` and sets `of_case` control are the same on all ranks.
    """
    definitions = [*of_case, *_of_cards(cards)]
    names, sets, left = Counter(definition.name for definition in definitions), {}, []
    label = np.unique(sort_over_ranks(comm, label)[0])
    for definition in definitions:
        there, _ = look_up(comm, label, [], np.array(definition.single, np.int64))
        if names[definition.name] > 1 or not definition.ranges or not there.all():
            left.append(definition.name)
            continue
        inside = label[in_ranges(label, definition.ranges)]
        if comm.allreduce(len(inside)):
            sets[definition.name] = inside
    left = list(dict.fromkeys(left))
    remark = (f"{path}: {', '.join(left[:5])}{', ...' * (len(left) > 5)}: no sets of points alone, or more than one of "
              "that number; they are left out")  # fmt: skip
    return sets, [remark] if left else []


def sets_of_case(text: bytes) -> list[PointSet]:
    """Return the sets of a case control but for those of elements and of all; without ranges where one is no list of
    numbers."""
    text = re.sub(rb"\$[^\n]*", b"", text)
    asked = {int(match["number"]) for match in OF_ELEMENTS.finditer(text)}
    sets = [(int(match["number"]), match["list"].decode("latin-1")) for match in SET.finditer(text)]
    return [PointSet(f"SET {number}", *_numbers_of_set(re.split(r"[,\s]+", words.strip(", \t\r\n"))))
            for number, words in sets if number not in asked and words.strip().upper() != "ALL"]  # fmt: skip


def _of_cards(cards):
    for card in cards:
        if card.name in SET_CARDS and (card.name == "SET1" or card.text(1) == "GRID"):
            first = SET_CARDS[card.name] + (card.name == "SET" and card.text(2) == "LIST")
            words = [word for word in card.fields[first:] if word]
            yield PointSet(f"{card.name} {card.text(0)}", *_numbers_of_set(words))


def _numbers_of_set(words) -> tuple[list[int], list[tuple[int, int]]]:
    """Return numbers by themselves and ranges of a list with THRU and EXCEPT, whose numbers end with one that is not in
    the range before it; nothing of what is no such list."""
    single, ranges, excepted = [], [], 0
    words = [word.upper() for word in reversed(words)]
    while words:
        word = words.pop()
        if word == "EXCEPT" and ranges:
            excepted = ranges[-1][1]
            continue
        if not NUMBER.fullmatch(word):
            return [], []
        first = last = int(word)
        if words[-1:] == ["THRU"]:
            if len(words) < 2 or not NUMBER.fullmatch(words[-2]) or int(words[-2]) < first:
                return [], []
            last = int(words[-2])
            del words[-2:]
        if excepted and ranges[-1][0] <= first and last <= excepted:
            low, high = ranges.pop()
            ranges += [(low, first - 1), (last + 1, high)]
            continue
        excepted = 0
        single += [first] if first == last else []
        ranges.append((first, last))
    return single, [bounds for bounds in ranges if bounds[0] <= bounds[1]]
