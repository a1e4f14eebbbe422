"""Read sets of points of an input file of Nastran or OptiStruct, which have numbers in place of names.

SET of the case control is "SET 5", the cards SET1, SET3 and SET (of OptiStruct) are "SET1 5", "SET3 5" and "SET 5".
SET3 and OptiStruct's SET say what their numbers are; other sets are of points if each that is listed by itself is a
point of the file, and if the case control does not ask for results of elements in them.
"""

import re
from collections import Counter
from typing import NamedTuple

import numpy as np

from ...parallel.lookup import look_up, sort_over_ranks
from ..nodes.table import in_ranges

CARDS = {"SET1": 1, "SET3": 2, "SET": 2}  # where their numbers begin
SET = re.compile(rb"(?mi)^[ \t]*SET[ \t]+(?P<number>\d{1,9})[ \t]*=(?P<list>(?:[^\n]*,[ \t\r]*\n)*[^\n]*)")
OF_ELEMENTS = re.compile(
    rb"(?mi)^[ \t]*(?:STRE|STRESS|STRA|STRAIN|ELST|ELSTRESS|ELFO|ELFORCE|FORC|FORCE|GPFORCE|GPSTRESS|GPSTRAIN|ESE|EKE|"
    rb"EDE|FLUX)[ \t]*(?:\([^)\n]*\)[ \t]*)?=[ \t]*(?P<number>\d{1,9})[ \t\r]*$"
)
NUMBER = re.compile("[0-9]{1,10}")


class PointSet(NamedTuple):
    """A set as it is written: the numbers that are listed by themselves, and all ranges."""

    name: str
    single: list[int]
    ranges: list[tuple[int, int]]


def read_point_sets(path, comm, label, cards, of_case) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return numbers of points by name of the set, each once over all ranks, and remarks. Collective.

    `label`: points of this rank; `cards` and sets `of_case` control are the same on all ranks.
    """
    given = [*of_case, *_of_cards(cards)]
    names, sets, left = Counter(item.name for item in given), {}, []
    label = np.unique(sort_over_ranks(comm, label)[0])
    for item in given:
        there, _ = look_up(comm, label, [], np.array(item.single, np.int64))
        if names[item.name] > 1 or not item.ranges or not there.all():
            left.append(item.name)
            continue
        inside = label[in_ranges(label, item.ranges)]
        if comm.allreduce(len(inside)):
            sets[item.name] = inside
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
    return [PointSet(f"SET {number}", *_numbers(re.split(r"[,\s]+", words.strip(", \t\r\n"))))
            for number, words in sets if number not in asked and words.strip().upper() != "ALL"]  # fmt: skip


def _of_cards(cards):
    for card in cards:
        if card.name in CARDS and (card.name == "SET1" or card.text(1) == "GRID"):
            first = CARDS[card.name] + (card.name == "SET" and card.text(2) == "LIST")
            words = [word for word in card.fields[first:] if word]
            yield PointSet(f"{card.name} {card.text(0)}", *_numbers(words))


def _numbers(words) -> tuple[list[int], list[tuple[int, int]]]:
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
    return single, [item for item in ranges if item[0] <= item[1]]
