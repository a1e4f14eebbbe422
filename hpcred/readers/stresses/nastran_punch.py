"""Read displacements and stresses of solids at nodes from a punch file of Nastran; each rank reads a share.

A block has heading lines ($) and lines of 72 characters, and perhaps a number: a label in 18 characters and three
numbers of 18, where -CONT- goes on with the line before. A solid has a line of its number, its coordinate system and
GRID, and seven lines for its centre and each corner: grid, sxx, sxy, then of the axis x five numbers and the von Mises
stress, syy, syz, four numbers, szz, szx, four numbers.
"""

import re
from typing import NamedTuple

import numpy as np

from ...files.system_errors import mapped
from ...files.text import end_to_end, records
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from .means import means_at_nodes

HEADING = re.compile(rb"(?m)(?:^\$[^\n]*\n)+")
FIRST = re.compile(rb"(?m)^(?!-CONT-)")
SOLID = re.compile(rb"(?m)^ *\d+ +0 *GRID")  # in the basic coordinate system
SUBCASE = re.compile(rb"(?m)^\$SUBCASE ID = *(\d+)")
TYPE = re.compile(rb"(?m)^\$ELEMENT TYPE = *(\d+)")
CORNERS = {39: 4, 67: 8, 68: 6}  # by element type: CTETRA, CHEXA, CPENTA
LINES, WIDTH, FIELD, LABEL = 7, 72, 18, 10  # of a corner; characters of a line, of a number, of a label
GOES_ON, MOST_LINES = b"-CONT-", 10**8  # numbers at the ends of lines have eight digits
PLACES = [(0, 1), (3, 0), (5, 0), (0, 2), (3, 1), (5, 1)]  # line and field of xx, yy, zz, xy, yz, zx


class Block(NamedTuple):
    """Displacements (`kind` 0) or stresses of an element type of a subcase, in the bytes start..stop."""

    subcase: int
    kind: int
    start: int
    stop: int


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is a punch file."""
    return start.startswith((b"$TITLE", b"$DISPLACEMENTS", b"$ELEMENT STRESSES"))


def read(path, comm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes (s,), displacements (steps, s, 3) and mean stresses (steps, s, 6) of this rank.

    Collective. Raises InputError.
    """
    blocks = decided(comm, _blocks, path)
    moved, stressed = {}, {}
    with agreed(comm):
        for block in blocks:
            columns = end_to_end(records(path, comm, block.start, block.stop, FIRST), _reader_of(block))
            (stressed if block.kind else moved).setdefault(block.subcase, []).append(columns)
    arrays = ((np.concatenate(chunks) for table in (moved, stressed) for chunks in zip(*table[subcase], strict=True))
             for subcase in sorted(moved))  # fmt: skip
    return means_at_nodes(path, comm, arrays)


def _blocks(path) -> list[Block]:
    """Return the blocks of displacements and of stresses of solids. Raises InputError."""
    blocks = []
    with mapped(path) as data:
        headings = list(HEADING.finditer(data))
        ends = [*(heading.start() for heading in headings), len(data)][1:]
        for heading, end in zip(headings, ends, strict=True):
            text, subcase, type_ = heading[0], SUBCASE.search(heading[0]), TYPE.search(heading[0])
            displaced, stressed = b"$DISPLACEMENTS" in text, b"$ELEMENT STRESSES" in text
            if not (displaced or stressed):
                continue
            if b"$REAL OUTPUT" not in text or subcase is None or (stressed and type_ is None):
                raise InputError(f"{path}: found a block of results without $REAL OUTPUT, $SUBCASE ID or $ELEMENT "
                                 "TYPE, expected those of a static analysis")  # fmt: skip
            kind = int(type_[1]) if stressed else 0
            if kind and kind not in CORNERS:
                raise InputError(f"{path}: found stresses of the element type {kind}, expected solids (CTETRA 39, "
                                 "CHEXA 67, CPENTA 68)")  # fmt: skip
            blocks.append(Block(int(subcase[1]), kind, heading.end(), end))
    have = [{block.subcase for block in blocks if bool(block.kind) == stress} for stress in (False, True)]
    if not have[0] or have[0] != have[1]:
        raise InputError(f"{path}: found displacements of {len(have[0])} subcases and stresses of {len(have[1])}, "
                         "expected both of each, as the deck of `hpcred recover --deck` asks for")  # fmt: skip
    return blocks


def _reader_of(block):
    """Return the function that reads a piece of a block: nodes and displacements, or corners and stresses."""
    lines = 1 + LINES * (1 + CORNERS[block.kind]) if block.kind else 2

    def decode(piece):
        table = _table(piece, lines)
        if not block.kind:
            return _whole(piece, table[:, 0, :LABEL]), _numbers(piece, table[:, 0, FIELD:WIDTH]).reshape(-1, 3)
        if len(SOLID.findall(np.insert(table[:, 0], WIDTH, ord("\n"), axis=1).tobytes())) < len(table):
            raise piece.refusal(0, "solids with stresses in the basic coordinate system (CORDM of PSOLID blank or 0)")
        corners = table[:, 1 + LINES :].reshape(len(table), CORNERS[block.kind], LINES, WIDTH)[..., FIELD:]
        fields = corners.reshape(*corners.shape[:3], 3, FIELD)
        stress = np.stack([_numbers(piece, fields[:, :, line, field]) for line, field in PLACES], axis=-1)
        return _whole(piece, fields[:, :, 0, 0]).ravel(), stress.reshape(-1, len(PLACES))

    return decode


def _table(piece, lines) -> np.ndarray:
    """Return the characters (records, lines, WIDTH) of records of so many lines. Raises InputError."""
    rows = piece.text.decode("latin-1").removesuffix("\n").split("\n") if piece.text else []
    if len(rows) % lines or any(len(row) < WIDTH for row in rows):
        raise piece.refusal(len(rows) - 1 if rows else 0, f"records of {lines} lines of at least {WIDTH} characters")
    text = "".join(row[:WIDTH] for row in rows).encode("latin-1")
    table = np.frombuffer(text, "S1").view(np.uint8).reshape(-1, lines, WIDTH)
    goes_on = (table[..., : len(GOES_ON)] == np.frombuffer(GOES_ON, np.uint8)).all(axis=2)
    piece.require((goes_on == (np.arange(lines) > 0)).ravel(), None, f"records of {lines} lines, -CONT- in all but "
                                                                     "the first")  # fmt: skip
    _check_counted(piece, np.char.strip(np.array([row[WIDTH:] for row in rows], str)))
    return table


def _check_counted(piece, ends):
    """Raise InputError where the numbers at the ends of lines (k,), if there are any, are not one after the other."""
    digits = np.char.isdecimal(ends) & (np.char.str_len(ends) < 10)
    if digits.any():
        piece.require(digits, None, "the number of the line at its end")
        number = ends.astype(np.int64)
        after = np.append(True, number[1:] == (number[:-1] + 1) % MOST_LINES)
        piece.require(after, None, "the line that follows by the numbers at the ends; lines are missing or exchanged")



def _numbers(piece, fields) -> np.ndarray:
    """Return the numbers (...) of fields of characters (..., FIELD), or of lines of such. Raises InputError."""
    words = np.ascontiguousarray(fields.reshape(-1, FIELD)).view(f"S{FIELD}").ravel()
    try:
        values = np.char.strip(words).astype(float)
    except ValueError as error:
        raise piece.refusal(0, "numbers in fields of 18 characters") from error
    if not np.isfinite(values).all():
        raise piece.refusal(0, "finite numbers in fields of 18 characters")
    return values.reshape(fields.shape[:-1]) if fields.shape[-1] == FIELD else values


def _whole(piece, fields) -> np.ndarray:
    """Return the whole numbers (...) of fields of characters (..., width). Raises InputError."""
    words = np.ascontiguousarray(fields.reshape(-1, fields.shape[-1])).view(f"S{fields.shape[-1]}").ravel()
    words = np.char.strip(words)
    if not np.char.isdigit(words).all():
        raise piece.refusal(0, "the number of a grid point")
    return words.astype(np.int64).reshape(fields.shape[:-1])
