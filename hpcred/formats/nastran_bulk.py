"""Input files of Nastran and OptiStruct (.bdf, .dat, .fem): a file enters, its points, their sets and elements leave.

Read are the grid and scalar points, coordinate systems, elements as far as pictures need them, and the cards that tell
which dofs have no row: supports, rigid elements, multi-point constraints, ASET and OMIT. Each rank reads its share of
the lines; the cards of systems and constraints, which are few, are collected on all ranks.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..model.elements import NODES
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up, number_over_ranks, repeated_key, sort_over_ranks
from .nastran_cards import CARD, components, lines_of, number_of, reals, whole_of, wholes
from .nastran_points import (
    CYLINDRICAL,
    DEPENDENT,
    HELD,
    OMITTED,
    RECTANGULAR,
    SPHERICAL,
    SUPPORTED,
    TINY,
    Points,
    System,
)
from .node_table import LARGEST_COORDINATE
from .text import first_bytes, first_line, line_number, records, refuse_packed, require_file

START = re.compile(
    rb"(?mi)^[ \t]*(?:SOL[ ,]|CEND\b|BEGIN[ \t]+(?:BULK|SUPER)|NASTRAN[ ,]|PARAM[ ,]|"
    rb"(?:GRID|DMIG|SPOINT|CORD[12][RCS]|GRDSET)[ ,*])"
)
MARK = re.compile(
    rb"(?mi)^[ \t]*(?:(?P<begin>BEGIN\b[^\n$]*)|(?P<end>ENDDATA\b)|(?P<cend>CEND\b)|"
    rb"INCLUDE[ \t]*(?:(?P<quote>['\"])|(?P<bare>[^'\"\n$ \t]+)))"
)
LONGEST_NAME = 4096  # bytes of a file's name in quotes, perhaps over several lines
CASE = re.compile(rb"(?mi)^[ \t]*(?P<word>SPC|MPC)(?:[ \t]*\([^)\n]*\))?[ \t]*=[ \t]*(?P<number>\d+)|^[ \t]*SUBCASE\b")
SYSTEMS = {"R": RECTANGULAR, "C": CYLINDRICAL, "S": SPHERICAL}
SMALL = re.compile(
    rb"CORD[12][RCS]|GRDSET|SPC|SPC1|SPCADD|MPC|MPCADD|RBE1|RBE2|RBE3|RBAR|RBAR1|RROD|RTRPLT1?|RSPLINE|RSSCON|RJOINT|"
    rb"[ABCQ]SET1?|OMIT1?|SUPORT1?|SPOINT|EPOINT|SEQGP|CSUPER|SESET|SEBULK|EXTRN"
)
UNTOLD = ("RROD", "RTRPLT", "RTRPLT1", "RSPLINE", "RSSCON", "RJOINT", "EPOINT", "SEQGP", "CSUPER", "SESET", "SEBULK")
# number of the field of the first node, and nodes by kind, the largest first
ELEMENTS = {
    "CTETRA": (2, ("tetra10", "tetra")), "CHEXA": (2, ("hexahedron20", "hexahedron")),
    "CPENTA": (2, ("wedge15", "wedge")), "CPYRAM": (2, ("pyramid",)), "CPYRA": (2, ("pyramid",)),
    "CQUAD4": (2, ("quad",)), "CQUADR": (2, ("quad",)), "CTRIA3": (2, ("triangle",)), "CTRIAR": (2, ("triangle",)),
    "CQUAD8": (2, ("quad8", "quad")), "CTRIA6": (2, ("triangle6", "triangle")), "CSHEAR": (2, ("quad",)),
    "CBAR": (2, ("line",)), "CBEAM": (2, ("line",)), "CROD": (2, ("line",)), "CTUBE": (2, ("line",)),
    "CBEND": (2, ("line",)), "CONROD": (1, ("line",)), "CBUSH": (2, ("line",)),
}  # fmt: skip
SOLID = ("tetra", "tetra10", "hexahedron", "hexahedron20", "wedge", "wedge15", "pyramid")
# Nastran numbers the vertical edges before those of the top
VTK = {"hexahedron20": [*range(12), *range(16, 20), *range(12, 16)], "wedge15": [*range(9), 12, 13, 14, 9, 10, 11]}
WITH_NODES = {"CONM2": (1,), "CONM1": (1,), "CELAS1": (2, 4), "CELAS2": (2, 4), "CBUSH": (2, 3), "CDAMP1": (2, 4),
              "CDAMP2": (2, 4), "CMASS1": (2, 4), "CMASS2": (2, 4), "CVISC": (2, 3)}  # fmt: skip
ANY_ELEMENT = re.compile(rb"C(?!ORD[12][RCS]$|SET1?$|SUPER$|REEP$|LOAD$|YJOIN$)[A-Z]+[0-9]*")
FLUID = -1
ANALYSIS = 16  # in the analysis set: what is not named is omitted


@dataclass(frozen=True)
class Card:
    """A card of which there are few: its fields without the empty ones at the end, and where it stands."""

    name: str
    fields: tuple[str, ...]
    file: str
    start: int
    line: int

    def error(self, sentence: str) -> InputError:
        """An InputError that names the line."""
        line = line_number(self.file, self.start) + self.line
        return InputError(f"{self.file}, line {line}: {self.name}: {sentence}")

    def text(self, k: int) -> str:
        """The field k, from 0 behind the name; empty where there is none."""
        return self.fields[k] if k < len(self.fields) else ""

    def whole(self, k: int, what: str, empty: int | None = None) -> int:
        """The whole number in the field k."""
        return whole_of(self.text(k), self.error, what, empty)

    def real(self, k: int, what: str) -> float:
        """The number in the field k, 0 where it is empty."""
        return number_of(self.text(k), self.error, what, 0.0)

    def directions(self, k: int) -> np.ndarray:
        """Which of the directions 1 to 6 (6,) the field k names."""
        if not set(self.text(k)) <= set("0123456"):
            raise self.error(f"found the directions '{self.text(k)}', expected digits of 1 to 6")
        return np.array([str(d) in self.text(k) for d in range(1, 7)])


@dataclass
class Deck:
    """What the bulk data say; grids are those of this rank, as `Points` but in the systems of the file.

    `cards`: the few other ones, on all ranks. `case`: the numbers that the case control
    gives by SPC and MPC, or None where there is no case control. `other`: node numbers of what has nodes and is no
    element of `elements`, `unknown`: names of elements of which it is not known where the nodes stand.
    """

    path: Path
    label: np.ndarray
    system: np.ndarray
    coordinates: np.ndarray
    displacement: np.ndarray
    held: np.ndarray
    cards: list[Card]
    case: dict | None
    elements: dict[str, np.ndarray] = field(default_factory=dict)
    other: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    unknown: set = field(default_factory=set)


def begins(start: bytes) -> bool:
    """Whether a text that starts so is an input file of Nastran."""
    return first_line(start)[:1] != b"*" and b"\0" not in start and START.search(start) is not None


def companions(path) -> list[Path]:
    """Input files of the same name beside a file, in any case of letters, that of an external superelement first."""
    path = Path(path)
    suffixes = (".pch", ".bdf", ".dat", ".nas", ".fem", ".blk", ".asm")
    found = [file for file in sorted(path.parent.iterdir())
             if file.stem.lower() == path.stem.lower() and file.suffix.lower() in suffixes and file != path
             and begins(first_bytes(file))]  # fmt: skip
    return sorted(found, key=lambda file: suffixes.index(file.suffix.lower()))


def read_deck(path, comm) -> Deck:
    """Read an input file and those that it includes. Collective. Raises InputError."""
    path = Path(path)
    segments, case = _segments(path, comm)
    grids, cards, elements, other, unknown = [], [], {}, [], set()
    with agreed(comm):
        for file, start, stop in segments:
            for piece in records(file, comm, start, stop, CARD):
                found = lines_of(piece, ANY_ELEMENT)
                for name in np.unique(found.name):
                    _elements(found.of(name.decode()), name.decode(), elements, other, unknown)
                grids.append(_grids(lines_of(piece, re.compile(rb"GRID"))))
                cards += [Card(name, tuple(fields), str(file), piece.start, line)
                          for name, fields, line in lines_of(piece, SMALL).listed()]  # fmt: skip
    cards = sum(comm.allgather(cards), [])
    kinds = sorted(set().union(*comm.allgather(set(elements))))
    unknown = set().union(*comm.allgather(unknown))
    with agreed(comm):
        defaults = _defaults(cards)
        columns = [np.concatenate([grid[k] for grid in grids] or [np.zeros(0, np.int64)]) for k in range(4)]
        xyz = np.concatenate([np.zeros((0, 3)), *(grid[4] for grid in grids)])
        held = np.concatenate([np.zeros((0, 6), bool), *(grid[5] for grid in grids)])
        label, system, displacement, no_hold = columns
        system = np.where(system < -1, defaults[0], system)
        displacement = np.where(displacement < -1, defaults[1], displacement)
        held[no_hold == 0] = defaults[2]
    return Deck(
        path, label, system, xyz, displacement, held, cards, case,
        {kind: np.concatenate([np.zeros((0, NODES[kind]), np.int64), *elements.get(kind, [])]) for kind in kinds},
        np.concatenate([np.zeros(0, np.int64), *other]), unknown,
    )  # fmt: skip


def _segments(path, comm, including=()):
    """Bytes of bulk data (file, start, stop), in order, and what the case control says. Collective."""
    with agreed(comm):
        require_file(path)
        refuse_packed(path)
        size = path.stat().st_size
        mine = [(piece.start + match.start(), piece.start + match.end(), match.groupdict())
                for piece in records(path, comm, 0, size, re.compile(rb"(?m)^")) for match in MARK.finditer(piece.text)]
    marks = sum(comm.allgather(mine), [])
    begin = [mark for mark in marks if mark[2]["begin"]]
    with agreed(comm):
        if len(begin) > 1:
            raise InputError(
                f"{path}: found {len(begin)} sections of bulk data, expected one: superelements as parts have numbers "
                "of their own; give the matrices of one with its own input file"
            )
        if not begin and any(mark[2]["cend"] for mark in marks) and not including:
            raise InputError(f"{path}: found CEND but no BEGIN BULK, expected bulk data")
        if begin and b"BULK" in begin[0][2]["begin"].upper() and not any(mark[2]["end"] for mark in marks):
            raise InputError(f"{path}: found BEGIN BULK but no ENDDATA; the file is cut off")
        case = _case(path, begin[0][0]) if begin and not including else None
    at = begin[0][1] if begin else 0
    result = []
    for low, high, groups in marks:
        if low < at or groups["begin"]:
            continue
        if groups["end"]:
            size = low
            break
        if groups["cend"]:
            continue
        result.append((str(path), at, low))
        with agreed(comm):
            name = groups["bare"]
            if groups["quote"]:
                name, high = _name_in_quotes(path, high, groups["quote"])
            file = _included(path, name, including)
        result += _segments(file, comm, (*including, path))[0]
        with open(path, "rb") as text:
            text.seek(high)
            at = high + len(text.readline())
    return [item for item in [*result, (str(path), at, size)] if item[1] < item[2]], case


def _name_in_quotes(path, start, quote):
    """The name from the byte `start` to the next quote, perhaps on a later line, and the byte where that stands."""
    with open(path, "rb") as file:
        file.seek(start)
        name, end, _ = file.read(LONGEST_NAME).partition(quote)
    if not end:
        raise InputError(f"{path}, line {line_number(path, start)}: found an INCLUDE without its second quote")
    return b"".join(line.strip() for line in name.splitlines()), start + len(name)


def _included(path, name, including):
    """The file of an INCLUDE: beside the main file or the including one, in any case of letters where none has that."""
    name = name.decode("latin-1").strip().replace("\\", "/")
    for folder in dict.fromkeys([path.parent, *(file.parent for file in including)]):
        file = folder / name
        if not file.is_file() and file.parent.is_dir():
            file = next((item for item in file.parent.iterdir() if item.name.lower() == file.name.lower()), file)
        if file.is_file():
            if file.resolve() in [item.resolve() for item in (path, *including)]:
                raise InputError(f"{path}: found INCLUDE of {file}, which includes itself")
            return file
    raise InputError(f"{path}: found INCLUDE '{name}', which is no file in {path.parent}; put it there")


def _case(path, stop):
    """Numbers of SPC and MPC of the case control; more than one where subcases differ."""
    with open(path, "rb") as file:
        text = file.read(stop)
    text = text[text.upper().rfind(b"CEND") + 4 if b"CEND" in text.upper() else 0 :]
    found = {"SPC": set(), "MPC": set()}
    for match in CASE.finditer(text):
        if match["word"]:
            found[match["word"].decode().upper()].add(int(match["number"]))
    return found


def _grids(lines):
    """Label, CP, CD, whether PS is given, coordinates and PS of GRID cards; -2 where a system is left out."""
    table, number = lines.table(7)
    piece = lines.piece
    if (more := lines.beyond(8)).size:
        raise piece.refusal(int(more[0]), "a grid point of at most eight fields")
    label = wholes(piece, table[:, 0], number, "the number of a grid point", 1)
    system, displacement = (_system(piece, table[:, k], number) for k in (1, 5))
    xyz = np.stack([reals(piece, table[:, k], number, "a coordinate") for k in (2, 3, 4)], axis=1)
    held = components(piece, table[:, 6], number, "the supports of a grid point")
    return label, system, displacement, (table[:, 6] != b"").astype(np.int64), xyz, held


def _system(piece, fields, number):
    empty, fluid = fields == b"", fields == b"-1"
    value = wholes(piece, np.where(empty | fluid, b"0", fields), number, "the number of a coordinate system")
    return np.where(empty, -2, np.where(fluid, FLUID, value))


def _elements(lines, name, elements, other, unknown):
    """Nodes of the elements of one name in a piece go to `elements`, or to `other`."""
    if name in WITH_NODES:
        table, _ = lines.table(max(WITH_NODES[name]) + 1)
        for k in WITH_NODES[name]:
            digits = np.char.isdigit(table[:, k])
            other.append(table[digits, k].astype(np.int64))
    if name not in ELEMENTS:
        if name not in WITH_NODES:
            unknown.add(name)
        return
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
        left &= ~full


def _defaults(cards):
    """CP, CD and PS of GRDSET."""
    card, *more = [card for card in cards if card.name == "GRDSET"] or [None]
    if card is None:
        return 0, 0, np.zeros(6, bool)
    if more:
        raise more[0].error("found a second one, expected one for all points")
    return card.whole(1, "CP", 0), card.whole(5, "CD", 0), card.directions(6)


def points_of(deck: Deck, comm) -> Points:
    """All grid and scalar points, ascending by number, without marks but those of permanent supports.

    Collective. Raises InputError.
    """
    with agreed(comm):
        scalars = _scalars(deck.cards) if comm.rank == 0 else np.zeros(0, np.int64)
        if (deck.displacement == FLUID).any():
            raise InputError(
                f"{deck.path}: found the fluid point {deck.label[deck.displacement == FLUID][0]} (CD = -1), expected a "
                "structure without fluid"
            )
    label = np.concatenate([deck.label, scalars])
    count, extra = len(deck.label), len(scalars)
    padded = [np.concatenate([part, np.zeros(extra, part.dtype)]) for part in (
        deck.system, deck.displacement, *deck.coordinates.T, *deck.held.T)]  # fmt: skip
    twice = repeated_key(comm, label)
    if twice is not None:
        raise InputError(f"{deck.path}: found the point {twice} more than once, expected each point once")
    label, scalar, system, displacement, x, y, z, *held = sort_over_ranks(
        comm, label, [np.arange(len(label)) >= count, *padded]
    )
    if not comm.allreduce(len(label)):
        raise InputError(f"{deck.path}: found no points, expected GRID cards")
    systems = _systems(comm, deck, label, system, np.stack([x, y, z], axis=1))
    with agreed(comm):
        position = np.zeros((len(label), 3))
        for number in np.unique(system):
            mine = (system == number) & ~scalar
            position[mine] = _known(deck, systems, number).to_basic(np.stack([x, y, z], axis=1)[mine])
        far = ~(np.abs(position) <= LARGEST_COORDINATE).all(axis=1)
        if far.any():
            raise InputError(f"{deck.path}: found the point {label[far][0]} at {position[far][0].tolist()}, expected "
                             "finite coordinates")  # fmt: skip
        turned = np.flatnonzero((displacement != 0) & ~scalar)
        axes = np.zeros((len(turned), 3, 3))
        for number in np.unique(displacement[turned]):
            mine = displacement[turned] == number
            axes[mine] = _known(deck, systems, number).directions(position[turned[mine]])
        axes[np.abs(axes) < TINY] = 0.0
        same = (axes == np.eye(3)).all(axis=(1, 2))
    marks = np.where(np.stack(held, axis=1), HELD, 0).astype(np.uint8)
    return Points(label, position, scalar.astype(bool), marks, turned[~same], axes[~same])


def _known(deck, systems, number):
    if number not in systems:
        raise InputError(f"{deck.path}: found points in the coordinate system {number}, which no CORD card defines")
    return systems[number]


def _scalars(cards):
    """Numbers of the scalar points."""
    found = []
    for card in cards:
        if card.name == "SPOINT":
            low, high = _ranges(card, 0)
            found += [np.arange(a, b + 1) for a, b in zip(low, high, strict=True)]
    return np.unique(np.concatenate([np.zeros(0, np.int64), *found]))


def _ranges(card, first):
    """Lowest and highest numbers of a list of points that may say THRU."""
    words = [word for word in card.fields[first:] if word]
    low, high = [], []
    k = 0
    while k < len(words):
        number = whole_of(words[k], card.error, "a point")
        last = number
        if k + 2 < len(words) and words[k + 1] == "THRU":
            last = whole_of(words[k + 2], card.error, "a point")
            k += 2
            if k + 1 < len(words) and words[k + 1] in ("BY", "EXCEPT"):
                raise card.error(f"found '{words[k + 1]}' behind THRU, which is not read; list the points")
        if last < number:
            raise card.error(f"found {number} THRU {last}, expected ascending numbers")
        low.append(number)
        high.append(last)
        k += 1
    return low, high


def _systems(comm, deck, label, system, coordinates):
    """All coordinate systems by number. Collective."""
    with agreed(comm):
        wanted = [card.whole(start + k, "a grid point") for card in deck.cards if card.name.startswith("CORD1")
                  for start in _halves(card) for k in (1, 2, 3)]  # fmt: skip
        mine = np.flatnonzero(np.isin(label, np.array(wanted, dtype=np.int64)))
        own = {int(label[k]): (int(system[k]), coordinates[k]) for k in mine}
    grids = {}
    for part in comm.allgather(own):
        grids |= part
    with agreed(comm):
        systems, open_ = {0: System()}, _definitions(deck, grids)
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


def _halves(card):
    """Fields where the systems of a CORD1 card begin: it may define two."""
    return (0, 4) if card.text(4) else (0,)


def _definitions(deck, grids):
    """Kind, three points (system, coordinates) and card of the systems by number."""
    found = {}

    def define(card, number, points):
        item = (SYSTEMS[card.name[5]], points, card)
        if number == 0 or number in found and (found[number][0] != item[0] or str(found[number][1]) != str(points)):
            raise card.error(f"found the coordinate system {number} a second time, expected one definition")
        found[number] = item

    for card in deck.cards:
        if card.name.startswith("CORD2"):
            reference = card.whole(1, "the system of reference", 0)
            values = [card.real(k, "a coordinate") for k in range(2, 11)]
            define(card, card.whole(0, "the number of the system"),
                   [(reference, values[k : k + 3]) for k in (0, 3, 6)])  # fmt: skip
        elif card.name.startswith("CORD1"):
            for start in _halves(card):
                points = [card.whole(start + k, "a grid point") for k in (1, 2, 3)]
                missing = [point for point in points if point not in grids]
                if missing:
                    raise card.error(f"found the point {missing[0]}, which no GRID card defines")
                define(card, card.whole(start, "the number of the system"),
                       [(grids[point][0], grids[point][1].tolist()) for point in points])  # fmt: skip
    return found


def mark_sets(deck: Deck, comm, points: Points) -> str | None:
    """Mark the dofs that supports, rigid elements, constraints, ASET and OMIT remove. Collective. Raises InputError.

    Returns why this cannot be told, or None.
    """
    with agreed(comm):
        reason, removed = _removed(deck)
    if reason:
        return reason
    analysis = np.zeros(points.marks.shape, bool)
    chosen = False
    for low, high, directions, mark in removed:
        at = np.concatenate([np.arange(np.searchsorted(points.label, a), np.searchsorted(points.label, b, side="right"))
                             for a, b in zip(low, high, strict=True)] or [np.zeros(0, np.int64)])  # fmt: skip
        at = at.astype(np.int64)
        which = np.where(points.scalar[at][:, None], np.arange(6) == 0, directions)
        if mark == ANALYSIS:
            analysis[at] |= which
            chosen = True
        else:
            points.marks[at] |= np.where(which, mark, 0).astype(np.uint8)
    if chosen:
        supported = points.marks & SUPPORTED > 0
        points.marks[points.there() & ~analysis & ~supported & (points.marks == 0)] |= OMITTED
    return None


def _removed(deck):
    """Ranges of points, directions (6,) and marks of all dofs that a card removes; or why they are not known."""
    rows = [(*([card.whole(k, "a point")],) * 2, card.directions(k + 1), ANALYSIS)
            for card in deck.cards if card.name == "EXTRN" for k in range(0, len(card.fields), 2) if card.text(k)]
    if rows:  # what an external superelement says of its rows
        return None, rows
    untold = next((card for card in deck.cards if card.name in UNTOLD), None)
    if untold is not None:
        return f"{untold.name} in {untold.file}, whose dofs are not known from the input file alone", []
    chosen = {}
    for key in ("SPC", "MPC"):
        chosen[key] = _chosen(deck, key)
        if chosen[key] is None:
            return f"more than one set of {key} in {deck.path}, and no word on which one was used", []
    found = []
    for card in deck.cards:
        name = card.name
        if name in ("SPC", "SPC1") and card.whole(0, "the number of the set") in chosen["SPC"]:
            if name == "SPC":
                found += [([card.whole(k, "a point")] * 2, card.directions(k + 1), HELD)
                          for k in (1, 4) if card.text(k)]  # fmt: skip
            else:
                found.append((*_ranges(card, 2), card.directions(1), HELD))
        elif name == "MPC" and card.whole(0, "the number of the set") in chosen["MPC"]:
            found.append(([card.whole(1, "a point")] * 2, card.directions(2), DEPENDENT))
        elif name.startswith("RB"):
            found += _dependent(card)
        elif name in ("ASET1", "BSET1", "CSET1", "QSET1", "OMIT1"):
            found.append((*_ranges(card, 1), card.directions(0), OMITTED if name == "OMIT1" else ANALYSIS))
        elif name in ("ASET", "BSET", "CSET", "QSET", "OMIT", "SUPORT", "SUPORT1"):
            mark = OMITTED if name == "OMIT" else SUPPORTED if name.startswith("SUP") else ANALYSIS
            for k in range(name == "SUPORT1", len(card.fields), 2):
                if card.text(k):
                    found.append(([card.whole(k, "a point")] * 2, card.directions(k + 1), mark))
    return None, [item if len(item) == 4 else ([item[0][0]], [item[0][1]], *item[1:]) for item in found]


def _chosen(deck, key):
    """Numbers of the sets of SPC or MPC that are in force, or None where that is not known."""
    numbers = {card.whole(0, "the number of the set") for card in deck.cards if card.name in (key, f"{key}1")}
    added = {card.whole(0, "the number of the set"): {whole_of(word, card.error, "a set") for word in card.fields[1:]
                                                      if word} for card in deck.cards if card.name == f"{key}ADD"}
    if deck.case is not None:
        wanted = deck.case[key]
        if len(wanted) > 1:
            return None
    else:
        wanted = set(added) or numbers
        if len(wanted) > 1:
            return None
    return set().union(*(added.get(number, {number}) for number in wanted))


def _dependent(card):
    """Ranges, directions and mark of the dependent dofs of a rigid element."""
    words, name = list(card.fields), card.name
    every = np.ones(6, bool)

    def pairs(start):
        found = []
        k = start
        while k + 1 < len(words) and words[k] and words[k].isdecimal():
            found.append(([card.whole(k, "a point")] * 2, card.directions(k + 1), DEPENDENT))
            k += 2
        return found

    if name == "RBE2":
        points = words[3:-1] if "." in words[-1] else words[3:]
        low = [whole_of(word, card.error, "a point") for word in points if word]
        return [(low, low, card.directions(2), DEPENDENT)]
    if name == "RBE3":
        if "UM" in words:
            return pairs(words.index("UM") + 1)
        return [([card.whole(2, "the reference point")] * 2, card.directions(3), DEPENDENT)]
    if name == "RBE1":
        if "UM" not in words:
            raise card.error("found no UM, expected the dependent dofs behind it")
        found, k = [], words.index("UM") + 1
        while k < len(words):  # three pairs a line, the first field of a line further down is empty
            if words[k] and words[k].isdecimal() and k + 1 < len(words):
                found.append(([card.whole(k, "a point")] * 2, card.directions(k + 1), DEPENDENT))
                k += 1
            k += 1
        return found
    a, b = card.whole(1, "a point"), card.whole(2, "a point")
    if name == "RBAR1":
        return [([b] * 2, card.directions(3) if card.text(3) else every, DEPENDENT)]
    if card.text(5) or card.text(6):
        return [([a] * 2, card.directions(5), DEPENDENT), ([b] * 2, card.directions(6), DEPENDENT)]
    return [([a] * 2, ~card.directions(3), DEPENDENT), ([b] * 2, ~card.directions(4), DEPENDENT)]


def hold_rotations_of_solids(deck: Deck, comm, points: Points) -> bool:
    """Mark rotations of points of nothing but solids, and points of nothing, as AUTOSPC does. Collective.

    Returns whether that can be told.
    """
    if deck.unknown:
        return False
    solid, other = ([part.ravel() for kind, part in deck.elements.items() if (kind in SOLID) == which]
                    for which in (True, False))  # fmt: skip
    rigid = [whole_of(word, card.error, "a point") for card in deck.cards if card.name.startswith("RB")
             for word in card.fields[1:] if word.isdecimal()] if comm.rank == 0 else []  # fmt: skip
    other += [deck.other, np.array(rigid, dtype=np.int64)]
    touched = []
    for part in (solid, other):
        distinct, _ = number_over_ranks(comm, np.concatenate([np.zeros(0, np.int64), *part]))
        touched.append(look_up(comm, distinct, [distinct], points.label)[0])
    rotations, loose = touched[0] & ~touched[1] & ~points.scalar, ~touched[0] & ~touched[1] & ~points.scalar
    points.marks[rotations, 3:] |= HELD
    points.marks[loose] |= HELD
    return True
