"""Read the loads of a load set (SID) of a Nastran input file: FORCE, MOMENT, PLOAD4, GRAV, and LOAD, which adds them.

Components are in the basic system or a rectangular one. Any other card of loads with this number is refused by its
line. TEMP and DEFORM have numbers of their own, which the case control selects apart.
"""

import re
from pathlib import Path

import numpy as np

from ...fe.elements import CORNERS, FACES, NODES, SHELLS
from ...fe.materials import NUMBER
from ...files.text import records, warnings_of_end
from ...parallel.failures import InputError, agreed
from ..deck_loads import DeckLoads, faces_at, find_elements
from . import bulk
from .cards import CARD, lines_of, reals, wholes
from .points import RECTANGULAR

READ = ("FORCE", "MOMENT", "PLOAD4", "GRAV", "LOAD")
UNREAD = (
    "FORCE1", "FORCE2", "MOMENT1", "MOMENT2", "PLOAD", "PLOAD1", "PLOAD2", "PLOADX1", "PLOADB3", "RFORCE", "RFORCE1",
    "SLOAD", "ACCEL", "ACCEL1", "GMLOAD", "SPCD", "LSEQ", "LOADT", "DAREA", "QBDY1", "QVOL",
)  # fmt: skip
CARDS = re.compile("|".join((*READ, *UNREAD)).encode())
WIDTH = 16  # fields of the longest card but LOAD
SAME = 1e-12  # relative, of the pressures at the corners of a face


def read_loads(path, sid: int, comm) -> DeckLoads:
    """Return the loads of a number. Collective. Raises InputError."""
    path = Path(path)
    cards, combined, elements, numbers, remarks = _cards(path, comm)
    loads = DeckLoads(remarks=remarks)
    with agreed(comm):
        # the wanted set may be a LOAD, a sum of others with factors
        scales = _scales(sid, combined)
    wanted = sorted(scales)
    texts = [str(number).encode() for number in wanted]
    with agreed(comm):
        # loads of other kinds in these sets would be left out silently
        for name in UNREAD:
            for piece, table, lines in cards[name]:
                piece.require(~np.isin(table[:, 0], texts), lines, "only FORCE, MOMENT, PLOAD4, GRAV, LOAD of this set")
    systems = _coordinate_systems(path, comm, cards)
    counts = dict.fromkeys(wanted, 0)
    # PLOAD4 names elements, whose faces are known when all elements are read
    pressed = []
    with agreed(comm):
        for name in READ[:4]:
            for piece, table, lines in cards[name]:
                own = wholes(piece, table[:, 0], lines, "the number of the load set", 1)
                mine = np.isin(own, wanted)
                table, lines, own = table[mine], lines[mine], own[mine]
                scale = np.array([scales[number] for number in own.tolist()])
                for number in own.tolist():
                    counts[number] += 1
                if name in ("FORCE", "MOMENT"):
                    _forces(loads, name, piece, table, lines, scale, systems)
                elif name == "GRAV":
                    size = reals(piece, table[:, 2], lines, "an acceleration") * scale
                    loads.acceleration += size @ _vectors(piece, table, lines, systems, 1, 3, "a component")
                else:
                    pressed.append(_pressures(piece, table, lines, scale))
    # a set without cards would be a load of zero
    every = np.sum(comm.allgather([counts[number] for number in wanted]), axis=0)
    with agreed(comm):
        for number, count in zip(wanted, every, strict=True):
            if not count:
                of = "" if number == sid else f", which LOAD {sid} names"
                raise InputError(f"{path}: found no FORCE, MOMENT, PLOAD4 or GRAV of the load set {number}{of}")
    loads.acceleration = np.sum(comm.allgather(loads.acceleration), axis=0)
    _press(path, comm, loads, pressed, elements, numbers)
    return loads


def _cards(path, comm):
    """Return cards of loads by name, and the LOAD cards of all ranks; nodes and numbers of elements by kind; remarks on
    files that may be cut off."""
    segments, _ = bulk.segments_of(path, comm)
    cards, combined, elements, numbers = {name: [] for name in (*READ, *UNREAD)}, [], {}, {}
    with agreed(comm):
        to_their_end = sorted({file for file, _, stop in segments if stop == Path(file).stat().st_size})
        remarks = [remark for file in to_their_end for remark in warnings_of_end(file)]
        for file, start, stop in segments:
            for piece in records(file, comm, start, stop, CARD):
                lines = lines_of(piece, CARDS)
                for name in np.unique(lines.name):
                    if name == b"LOAD":
                        combined += lines.of("LOAD").listed()
                    else:
                        cards[name.decode()].append((piece, *lines.of(name.decode()).table(WIDTH)))
                lines = lines_of(piece, bulk.ANY_ELEMENT)
                for name in map(bytes.decode, np.unique(lines.name)):
                    if name in bulk.ELEMENTS and bulk.ELEMENTS[name][1][0] in FACES:
                        bulk.elements_by_number(lines.of(name), name, elements, numbers)
    kinds = sorted(set().union(*comm.allgather(set(elements))))
    return (
        cards, sum(comm.allgather(combined), []),
        {kind: np.concatenate([np.zeros((0, NODES[kind]), np.int64), *elements.get(kind, [])]) for kind in kinds},
        {kind: np.concatenate([np.zeros((0, 3), np.int64), *numbers.get(kind, [])])[:, NUMBER] for kind in kinds},
        remarks,
    )  # fmt: skip


def _scales(sid, combined) -> dict[int, float]:
    """Return the factors of the load sets that a number stands for."""
    mine = [card for card in combined if card.whole(0, "the number of the load set") == sid]
    if not mine:
        return {sid: 1.0}
    card, *repeated = mine
    if repeated:
        raise repeated[0].error(f"found a second LOAD of the number {sid}, expected one")
    overall, scales = card.real(1, "the factor", 1.0), {}
    for k in range(2, len(card.fields), 2):
        if not card.text(k) and not card.text(k + 1):
            continue
        number = card.whole(k + 1, "the number of a load set")
        if number in scales or number == sid:
            raise card.error(f"found the load set {number} twice, expected each once and not the LOAD itself")
        scales[number] = overall * card.real(k, "the factor of a load set", 1.0)
    if not scales:
        raise card.error("found no load sets, expected factors and numbers of them")
    return scales


def _coordinate_systems(path, comm, cards):
    """Return the coordinate systems, if any card may name one: only the basic one is known without."""
    column = {"FORCE": 2, "MOMENT": 2, "GRAV": 1, "PLOAD4": 8}
    named = any(bool(np.isin(table[:, place], [b"", b"0"], invert=True).any())
                for name, place in column.items() for _, table, _ in cards[name])  # fmt: skip
    if not any(comm.allgather(named)):
        return {}
    deck = bulk.read_deck(path, comm)
    return bulk.systems_of(comm, deck, deck.label, deck.system, deck.coordinates)


def _vectors(piece, table, lines, systems, place, first, what):
    """Return vectors (k, 3) in the basic system, of the fields from `first` on, in the system of the field `place`."""
    vectors = np.stack([reals(piece, table[:, first + k], lines, what) for k in range(3)], axis=1)
    number = wholes(piece, table[:, place], lines, "the number of a coordinate system", empty=0)
    for system in np.unique(number[number > 0]).tolist():
        mine = number == system
        if system not in systems or systems[system].kind != RECTANGULAR:
            raise piece.refusal(int(lines[mine][0]), "the basic system or a rectangular one, which the file defines")
        vectors[mine] = vectors[mine] @ systems[system].axes.T
    return vectors


def _forces(loads, name, piece, table, lines, scale, systems):
    node = wholes(piece, table[:, 1], lines, "the number of a grid point", 1)
    size = reals(piece, table[:, 3], lines, "a scale factor") * scale
    vectors = size[:, None] * _vectors(piece, table, lines, systems, 2, 4, "a component")
    if (table[:, 7:] != b"").any():
        raise piece.refusal(int(lines[(table[:, 7:] != b"").any(axis=1)][0]), f"a {name} of at most seven fields")
    both = np.zeros((len(node), 6))
    both[:, 3 * (name == "MOMENT") :][:, :3] = vectors
    loads.nodal.append((node, both))


def _pressures(piece, table, lines, scale):
    """Return numbers of elements (k,), pressures (k,), and grid points of the corners (k, 2) of the faces, 0 for
    none."""
    first = wholes(piece, table[:, 1], lines, "the number of an element", 1)
    pressure = reals(piece, table[:, 2], lines, "a pressure")
    for k in (3, 4, 5):
        other = reals(piece, np.where(table[:, k] == b"", table[:, 2], table[:, k]), lines, "a pressure")
        if (wrong := np.abs(other - pressure) > SAME * np.abs(pressure)).any():
            raise piece.refusal(int(lines[wrong][0]), "one pressure on the whole face")
    if (turned := (table[:, 8:14] != b"").any(axis=1)).any():
        raise piece.refusal(int(lines[turned][0]), "a pressure at right angles to the face (no second line)")
    through = table[:, 6] == b"THRU"
    last = np.where(through, wholes(piece, np.where(through, table[:, 7], table[:, 1]), lines, "the last element", 1),
                    first)  # fmt: skip
    piece.require(last >= first, lines, "ascending numbers of elements")
    corners = np.stack([wholes(piece, np.where(through, b"", table[:, k]), lines, "a grid point", empty=0)
                        for k in (6, 7)], axis=1)  # fmt: skip
    count = last - first + 1
    numbers = np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())
    card = np.repeat(np.arange(len(first)), count)
    return numbers, (pressure * scale)[card], corners[card], through[card]


def _press(path, comm, loads, pressed, elements, numbers):
    """Put pressures on the faces that cards name. Collective. Raises InputError."""
    empty = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 2), np.int64), np.zeros(0, bool)
    wanted, pressure, corners, through = (np.concatenate(columns) for columns in zip(empty, *pressed, strict=True))
    there = through.copy()  # a range may name numbers that no element has
    places = find_elements(comm, elements, numbers, wanted)
    with agreed(comm):
        for kind, (place, nodes) in places.items():
            there[place] = True
            if not len(place):
                continue
            face = np.zeros(len(place), int) if kind in SHELLS else _faces_named(kind, nodes, corners[place])
            if (face < 0).any():
                raise InputError(
                    f"{path}: PLOAD4: the grid points {corners[place][face < 0][0].tolist()} tell no face of the "
                    f"element {wanted[place][face < 0][0]}; expected G1 and G3, opposite corners of it, of a triangle "
                    "G1 only, or G1 and for tetrahedra G4, the corner that is not on it"
                )
            loads.pressed.append((faces_at(kind, nodes, face), pressure[place]))
        if not there.all():
            raise InputError(
                f"{path}: PLOAD4: found a pressure on the element {wanted[~there][0]}, which is none of solids or "
                "shells of the file"
            )


def _faces_named(kind, nodes, corners):
    """Return which faces (k,) of FACES the grid points (k, 2) tell of elements with nodes (k, n); -1 for none."""
    faces = np.full(len(nodes), -1)
    first, second = corners.T
    for k, face in enumerate(FACES[kind]):
        count = CORNERS[len(face)]
        on = nodes[:, list(face[:count])]
        has = (on == first[:, None]).any(axis=1)
        also = (on == second[:, None]).any(axis=1)
        if kind.startswith("tetra"):
            fits = has & (nodes[:, :4] == second[:, None]).any(axis=1) & ~also
        elif count == 3:
            fits = has & (second == 0)
        else:
            at = (on == first[:, None]).argmax(axis=1)
            fits = has & (on[np.arange(len(on)), (at + 2) % 4] == second)
        faces[fits] = k
    return faces
