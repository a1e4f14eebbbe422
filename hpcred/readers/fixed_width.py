"""Separate numbers in fields of fixed width, as Fortran writes them, by blanks.

Fields may touch each other ("0.1D+00-0.2D+00"), exponents may have no letter ("0.1-101") or a blank ("1.0E 00").
"""

import re
from typing import NamedTuple

import numpy as np

from ..files.text import Piece, shown
from ..files.text_numbers import BARE_EXPONENT
from ..parallel.failures import InputError

FORMAT = re.compile(
    rb"\s*(?:(?P<scale>[+-]?\d+)\s*P\s*,?\s*)?(?P<repeat>\d*)\s*(?P<kind>[IEDFG])\s*(?P<width>\d+)"
    rb"(?:\.(?P<decimals>\d+)(?:E\d+)?)?\s*(?:,|$)",
    re.IGNORECASE,
)
NESTED = re.compile(rb"^(?P<before>[^()]*?)(?P<repeat>\d+)\s*\((?P<inner>[^()]*)\)\s*$")
DIGITS = np.zeros(256, bool)
DIGITS[list(b"0123456789+-.eEdD \r")] = True
WHOLE = np.zeros(256, bool)
WHOLE[list(b"0123456789+- ")] = True
LONGEST = 1000  # characters a line
SPLIT_EXPONENT = re.compile(rb"([eEdD]) (?=[0-9])")


class Field(NamedTuple):
    """A field: `whole` (of an integer), its `width`, `decimals` where no point is written, `scale` (of P)."""

    whole: bool
    width: int
    decimals: int
    scale: int


def fields_of_format(text: bytes, where: str) -> list[Field]:
    """Return the fields of a line from a Fortran format, such as those of the message. Raises InputError."""
    refusal = InputError(f"{where}: found the format '{shown(text)}', expected one such as (16I5), "
                         "(1P,5D16.9) or (3i9,6e21.13e3)")  # fmt: skip
    inner = text.strip()
    if not (inner.startswith(b"(") and inner.endswith(b")")) or len(inner) > LONGEST:
        raise refusal
    inner = inner[1:-1]
    # an outer repetition such as 5(1PE16.8)
    nested = NESTED.match(inner)
    times = 1
    if nested:  # such as (5(1PE16.8))
        if nested["before"].strip(b" ,"):
            raise refusal
        times, inner = int(nested["repeat"]), nested["inner"]
        if times > LONGEST:
            raise refusal
    # descriptors one after the other, of which P holds for those that follow
    fields, at, scale = [], 0, 0
    while at < len(inner):
        match = FORMAT.match(inner, at)
        if match is None:
            raise refusal
        scale = int(match["scale"] or scale)
        whole = match["kind"] in b"Ii"
        repeat, width = int(match["repeat"] or 1), int(match["width"])
        if not 0 < width <= 60 or not 0 < repeat <= LONGEST or (not whole and match["decimals"] is None):
            raise refusal
        fields += [Field(whole, width, int(match["decimals"] or 0), scale)] * repeat
        at = match.end()
    fields *= times
    if not fields or sum(field.width for field in fields) > LONGEST:
        raise refusal
    return fields


def separated(piece: Piece, fields: list[Field], fill=False) -> Piece:
    """Return the same lines with a blank between the fields; `fill`: empty fields count as 0. Raises InputError."""
    text = piece.text if piece.text.endswith(b"\n") else piece.text + b"\n"
    # the lines as a table of letters, one line a row, so that no line is looked at by itself
    letters = np.frombuffer(text, np.uint8)
    ends = np.flatnonzero(letters == ord("\n"))
    starts = np.append(0, ends[:-1] + 1)
    lengths = ends - starts
    wide = sum(field.width for field in fields)
    if lengths.max(initial=0) > LONGEST:
        raise piece.refusal(int(lengths.argmax()), f"lines of at most {LONGEST} characters")
    across = np.arange(max(lengths.max(initial=0), wide))
    inside = across < lengths[:, None]
    table = np.full(inside.shape, ord(" "), np.uint8)
    table[inside] = letters[(starts[:, None] + across)[inside]]
    table[table == ord("\r")] = ord(" ")
    # nothing but numbers in the fields, and blanks behind them
    fits = DIGITS[table].all(axis=1) & (table[:, wide:] == ord(" ")).all(axis=1)
    piece.require(fits, None, f"at most {len(fields)} numbers in fields of {fields[0].width} characters")
    result = np.full((len(starts), wide + len(fields)), ord(" "), np.uint8)
    # each field goes one column further than the one before it, behind a blank
    source = target = 0
    for field in fields:
        digits = table[:, source : source + field.width]
        result[:, target : target + field.width] = digits
        if not field.whole:
            _require_point(piece, field, digits)
        else:
            piece.require(WHOLE[digits].all(axis=1), None, "whole numbers in the fields of such")
        if fill:
            result[(digits == ord(" ")).all(axis=1), target + field.width - 1] = ord("0")
        source, target = source + field.width, target + field.width + 1
    result[:, -1] = ord("\n")
    # exponents that Fortran writes without a letter, or with blanks
    text = SPLIT_EXPONENT.sub(rb"\1+", result.tobytes())
    if not all(field.whole for field in fields):
        text = BARE_EXPONENT.sub(b"e", text)
    return Piece(piece.path, text, piece.start)


def _require_point(piece, field, digits):
    """Raise InputError where a number but 0 leaves its point to the format, or its scale to a missing exponent."""
    written = np.isin(digits, list(b"123456789")).any(axis=1)
    point = (digits == ord(".")).any(axis=1)
    if field.scale:
        point &= np.isin(digits, list(b"eEdD")).any(axis=1) | (np.isin(digits[:, 1:], list(b"+-")) & np.isin(
            digits[:, :-1], list(b"0123456789."))).any(axis=1)  # fmt: skip
    expected = f"numbers with a decimal point{' and an exponent' * bool(field.scale)}"
    piece.require(point | ~written, None, expected)
