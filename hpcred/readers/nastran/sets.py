"""Mark the dofs that have no row, from the cards of a Nastran input file.

The cards are supports, rigid elements, multi-point constraints, ASET and OMIT, or the EXTRN of an external
superelement.
"""

from typing import NamedTuple

import numpy as np

from ...parallel.failures import agreed
from ...parallel.lookup import look_up, number_over_ranks
from .bulk import Deck
from .cards import Card, whole_of
from .points import DEPENDENT, HELD, OMITTED, SUPPORTED, Points

UNTOLD = ("RROD", "RTRPLT", "RTRPLT1", "RSPLINE", "RSSCON", "RJOINT", "EPOINT", "SEQGP", "CSUPER", "SESET", "SEBULK")
SOLID = ("tetra", "tetra10", "hexahedron", "hexahedron20", "wedge", "wedge15", "pyramid")
ANALYSIS = 16  # in the analysis set: what is not named is omitted
MARKS = {"ASET": ANALYSIS, "BSET": ANALYSIS, "CSET": ANALYSIS, "QSET": ANALYSIS, "OMIT": OMITTED, "SUPORT": SUPPORTED}


class Marked(NamedTuple):
    """The dofs that a card marks: points from `low` to `high` (lists of numbers), their `directions` (6,), a mark."""

    low: list[int]
    high: list[int]
    directions: np.ndarray
    mark: int


def mark_sets(deck: Deck, comm, points: Points) -> str | None:
    """Mark the dofs that cards remove; return why this cannot be told, or None. Collective."""
    with agreed(comm):
        reason, marked = _marked(deck)
    if reason:
        return reason
    analysis = np.zeros(points.marks.shape, bool)
    chosen = False
    for low, high, directions, mark in marked:
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


def _marked(deck) -> tuple[str | None, list[Marked]]:
    """Return the marks of all cards, or the reason why they are not known."""
    rows = [_named(card, k, ANALYSIS) for card in deck.cards if card.name == "EXTRN"
            for k in range(0, len(card.fields), 2) if card.text(k)]  # fmt: skip
    if rows:  # what an external superelement says of its rows
        return None, rows
    untold = next((card for card in deck.cards if card.name in UNTOLD), None)
    if untold is not None:
        return f"{untold.name} in {untold.file}, whose dofs are not known from the input file alone", []
    chosen = {key: _chosen(deck, key) for key in ("SPC", "MPC")}
    for key, sets in chosen.items():
        if sets is None:
            return f"more than one set of {key} in {deck.path}, and no word on which one was used", []
    return None, [marked for card in deck.cards for marked in _marked_by(card, chosen)]


def _chosen(deck, key):
    """Return numbers of the sets of SPC or MPC that are in force, or None where that is not known."""
    numbers = {_set_of(card) for card in deck.cards if card.name in (key, f"{key}1")}
    added = {_set_of(card): {whole_of(word, card.error, "a set") for word in card.fields[1:] if word}
             for card in deck.cards if card.name == f"{key}ADD"}  # fmt: skip
    wanted = deck.case[key] if deck.case is not None else set(added) or numbers
    if len(wanted) > 1:
        return None
    return set().union(*(added.get(number, {number}) for number in wanted))


def _set_of(card):
    return card.whole(0, "the number of the set")


def _marked_by(card: Card, chosen) -> list[Marked]:
    """Return the marks of a card; `chosen`: the sets of SPC and of MPC that are in force."""
    name = card.name
    if name in ("SPC", "SPC1", "MPC") and _set_of(card) not in chosen[name[:3]]:
        return []
    if name == "SPC":
        return [_named(card, k, HELD) for k in (1, 4) if card.text(k)]
    if name == "SPC1":
        return [Marked(*card.points(2), card.directions(1), HELD)]
    if name == "MPC":
        return [_named(card, 1)]
    if name.startswith("RB"):
        return _dependent(card)
    mark = MARKS.get(name.removesuffix("1"))
    if mark is None:
        return []
    if name.endswith("1") and mark != SUPPORTED:
        return [Marked(*card.points(1), card.directions(0), mark)]
    return [_named(card, k, mark) for k in range(name == "SUPORT1", len(card.fields), 2) if card.text(k)]


def _named(card, k, mark=DEPENDENT, what="a point"):
    """Return the point in the field k, in the directions of the field behind it."""
    return _one(card.whole(k, what), card.directions(k + 1), mark)


def _one(point, directions, mark=DEPENDENT):
    return Marked([point], [point], directions, mark)


def _dependent(card) -> list[Marked]:
    """Return the dependent dofs of a rigid element."""
    words, name = card.fields, card.name
    if name == "RBE2":
        # behind the points may stand the thermal expansion and its temperature
        low = [whole_of(word, card.error, "a point") for word in words[3:] if word and "." not in word]
        return [Marked(low, low, card.directions(2), DEPENDENT)]
    if name == "RBE3" and "UM" not in words:
        return [_named(card, 2, what="the reference point")]
    if name in ("RBE1", "RBE3"):
        if "UM" not in words:
            raise card.error("found no UM, expected the dependent dofs behind it")
        labels, k = [], words.index("UM") + 1
        while k + 1 < len(words) and (not words[k] or words[k].isdecimal()):
            if words[k]:
                labels.append(_named(card, k))
                k += 1
            k += 1  # three pairs a line, the first field of a line further down is empty
        return labels
    a, b = card.whole(1, "a point"), card.whole(2, "a point")
    if name == "RBAR1":
        return [_one(b, card.directions(3) if card.text(3) else np.ones(6, bool))]
    if card.text(5) or card.text(6):
        return [_one(a, card.directions(5)), _one(b, card.directions(6))]
    return [_one(a, ~card.directions(3)), _one(b, ~card.directions(4))]


def hold_rotations_of_solids(deck: Deck, comm, points: Points) -> bool:
    """Mark rotations of points of solids only, and lone points, as AUTOSPC; return if known. Collective."""
    if deck.unknown:
        return False
    solid, other = ([corners.ravel() for kind, corners in deck.elements.items() if (kind in SOLID) == which]
                    for which in (True, False))  # fmt: skip
    rigid = [whole_of(word, card.error, "a point") for card in deck.cards if card.name.startswith("RB")
             for word in card.fields[1:] if word.isdecimal()] if comm.rank == 0 else []  # fmt: skip
    other += [deck.other, np.array(rigid, dtype=np.int64)]
    touched = []
    for corners in (solid, other):
        distinct, _ = number_over_ranks(comm, np.concatenate([np.zeros(0, np.int64), *corners]))
        touched.append(look_up(comm, distinct, [distinct], points.label)[0])
    rotations, loose = touched[0] & ~touched[1] & ~points.scalar, ~touched[0] & ~touched[1] & ~points.scalar
    points.marks[rotations, 3:] |= HELD
    points.marks[loose] |= HELD
    return True
