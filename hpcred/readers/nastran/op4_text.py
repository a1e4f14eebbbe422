"""Read text files of OUTPUT4: all matrices, or the entries of one. Each rank reads its share of the lines."""

import os
import re
from typing import NamedTuple

import numpy as np

from ...files.system_errors import damaged_file
from ...files.text import pieces, records, shown
from ...files.text_numbers import parse, parse_fortran, with_e
from ...parallel.failures import InputError, agreed
from .cards import whole_numbers
from .op4_matrix import COMPLEX, DOUBLE, SMALL, Op4Matrix, matrix_of, real_values

# the format of the numbers at the end tells the header line from all others: 1P,5E16.9; without it, four whole numbers
HEADER = re.compile(
    rb"(?m)^(?=[ \d-]{31}) *\d(?:[^\n]*?[EeDd](?P<width>\d+)\.\d+ *(?P<wide>\|I16)?|"
    rb"\d* *-?\d+ {6,7}\d\d? {7}[1-4][ \w]{0,8}) *\r?$"
)
WHOLE = 8  # characters of a whole number, but in headers that say I16
COLUMN = re.compile(rb"(?m)^[ 0-9]{17,24}\r?$")


def contents(path, comm) -> list[Op4Matrix]:
    """Return the matrices of a text: each rank looks for header lines in its share. Collective. Raises InputError."""
    with agreed(comm):
        mine = [(piece.start + match.start(), piece.start + match.end() + 1, match.group())
                for piece in pieces(path, comm) for match in HEADER.finditer(piece.text)]  # fmt: skip
    lines = sum(comm.allgather(mine), [])
    with agreed(comm):
        ends = [line[0] for line in lines[1:]] + [os.path.getsize(path)]
        return [_header(path, *line, end) for line, end in zip(lines, ends, strict=True)]


def _header(path, start, stop, line, end):
    match = HEADER.match(line)
    wide = 16 if match["wide"] else 8
    cuts = (0, wide, 2 * wide, 2 * wide + 8, 2 * wide + 16, 2 * wide + 24)
    fields = [line[low:high] for low, high in zip(cuts, cuts[1:], strict=False)]
    text = shown(line)
    try:
        if any(set(field.strip()) - set(b"-0123456789") for field in fields[:4]):
            raise ValueError
        numbers = [int(field) for field in fields[:4]]
    except ValueError as error:
        raise InputError(
            f"{path}: found the header '{text}' of a matrix, expected columns, rows, form, type, name and format"
        ) from error
    layout = (int(match["width"] or 16),)
    if not 8 <= layout[0] <= 40:
        raise InputError(f"{path}: found the header '{text}' of a matrix, expected a format such as 1P,5E16.9")
    return matrix_of(path, f"byte {start}", numbers, fields[4], starts=(stop, end), layout=layout, is_text=True)


def read(path, comm, matrix: Op4Matrix) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return rows and columns (from 0) and values of the pieces of this rank. Collective. Raises InputError."""
    with agreed(comm):
        triplets, last = [], []
        for piece in records(path, comm, *matrix.starts, COLUMN):
            i, j, v, columns = _decode(piece, matrix)
            triplets.append((i, j, v))
            last += [int(columns[0]), int(columns[-1])] if len(columns) else []
    last = sum(comm.allgather(last), [])
    if not last or last[-1] != matrix.shape[1] + 1:
        raise InputError(
            f"{path}: found column {last[-1] if last else 0} as the last of the matrix {matrix}, expected "
            f"{matrix.shape[1] + 1} to close it; the file is cut off or damaged"
        )
    if any(later < earlier for earlier, later in zip(last, last[1:], strict=False)):
        raise damaged_file(path, f"columns that do not ascend in the matrix {matrix}")
    return triplets


def _decode(piece, matrix):
    """Return rows and columns (from 0) and values of whole columns of a text, and the numbers of the columns."""
    lines = _Lines(piece, matrix)
    (width,) = matrix.layout
    lines.refuse(lines.numbers[lines.size[lines.numbers] % width > 0], f"numbers of {width} characters")
    per_line = lines.size[lines.numbers] // width
    values = _fixed_numbers(piece, lines.text, lines.start[lines.numbers], per_line, width)
    heads, numbers = _heads(lines)
    owner = np.searchsorted(lines.heads, lines.numbers, side="right") - 1
    count = np.bincount(owner, weights=per_line, minlength=len(lines.heads)).astype(np.int64)
    closing = heads.column == matrix.shape[1] + 1
    _check_counts(lines, heads, count, closing)
    values = real_values(piece.path, matrix, values[: len(values) - int(count[closing].sum())])
    width = 2 if matrix.kind in COMPLEX else 1
    count, row, column = count[~closing] // width, heads.row[~closing], heads.column[~closing]
    i = np.repeat(row - 1 - (np.cumsum(count) - count), count) + np.arange(len(values))
    j = np.repeat(column - 1, count)
    kept = values != 0
    return i[kept], j[kept], values[kept], numbers


class _Lines:
    """The lines of a piece of a text: where they `start`, their `size` in characters without the end, and which are
    `numbers` and which `heads`, those of columns and strings."""

    def __init__(self, piece, matrix):
        self.piece, self.matrix = piece, matrix
        text = np.frombuffer(piece.text + (b"" if piece.text.endswith(b"\n") else b"\n"), np.uint8)
        newline = np.flatnonzero(text == ord("\n"))
        start = np.concatenate([[0], newline[:-1] + 1])
        self.text, self.start = text, start
        self.size = newline - start - ((newline > start) & (text[newline - 1] == ord("\r")))
        points = np.concatenate([[0], np.cumsum(text == ord("."))])
        is_number = points[newline] > points[start]
        self.filled = np.flatnonzero(self.size > 0)  # blank lines may stand at the end
        self.numbers, self.heads = self.filled[is_number[self.filled]], self.filled[~is_number[self.filled]]

    def refuse(self, bad, expected):
        """Refuse the first of some lines."""
        if bad.size:
            raise self.piece.refusal(int(bad[0]), f"{expected} in the matrix {self.matrix}")

    def whole(self, lines, place, width):
        """Return the whole numbers in a field of some lines."""
        stop = (self.start + self.size)[lines][:, None]
        at = (self.start[lines] + place * width)[:, None] + np.arange(width)
        fields = np.where(at < stop, self.text[np.minimum(at, stop)], ord(" "))  # at most the end of the line
        digit = (fields >= ord("0")) & (fields <= ord("9"))
        after = np.maximum.accumulate(digit, axis=1)
        wrong = ~(digit | (fields == ord(" "))).all(axis=1) | ~digit.any(axis=1) | (digit.sum(axis=1) > 18)
        wrong |= (after & ~digit & np.maximum.accumulate(digit[:, ::-1], axis=1)[:, ::-1]).any(axis=1)
        self.piece.require(~wrong, lines, "whole numbers")
        return whole_numbers(fields, digit)


class _Heads(NamedTuple):
    """Of each head (H,), in the order of the lines: the first `row` of its numbers, 0 of a column of strings, how many
    `words` it says that it has itself and, where it begins a column, `in_all`, the `column`, and the head `at` which
    that begins."""

    row: np.ndarray
    words: np.ndarray
    in_all: np.ndarray
    column: np.ndarray
    at: np.ndarray

    @property
    def begins(self) -> np.ndarray:
        """Whether it is the head of a column, and not of a string."""
        return self.at == np.arange(len(self.at))


def _heads(lines):
    """Return the heads of columns and strings, and the numbers of the columns."""
    heads, size = lines.heads, lines.size
    # heads of columns have three numbers, those of strings two, or one in which both are packed
    is_column = (size[heads] > 2 * WHOLE) & (size[heads] <= 3 * WHOLE)
    columns, strings = heads[is_column], heads[~is_column]
    if lines.filled.size and (not columns.size or lines.filled[0] != columns[0]):
        lines.refuse(lines.filled[:1], "a column: its number, first row and number of words")
    # columns ascend, and their head is followed by strings where the first row is 0
    number, first, words = (lines.whole(columns, k, WHOLE) for k in range(3))
    lines.refuse(columns[(number < 1) | (number > lines.matrix.shape[1] + 1) | (first < 0) | (words < 1)],
                 "the number of a column, its first row and number of words")  # fmt: skip
    lines.refuse(columns[1:][np.diff(number) <= 0], "a column behind the one before")
    lines.refuse(strings[size[strings] > 2 * WHOLE], "the header of a string of numbers")
    # length and first row of each string; the length counts the head
    if lines.matrix.big:
        length, row = (lines.whole(strings, k, WHOLE) for k in range(2))
    else:
        length, row = np.divmod(lines.whole(strings, 0, 2 * WHOLE), SMALL)
    length = length - 1
    lines.refuse(strings[(length < 1) | (row < 1)], "the header of a string of numbers")
    # heads in the order of the file: a string belongs to the last column before it
    order = np.argsort(np.concatenate([columns, strings]), kind="stable")
    column = np.concatenate([number, np.zeros(len(row), np.int64)])[order]
    at = np.maximum.accumulate(np.where(column > 0, np.arange(len(column)), 0))
    all_heads = _Heads(
        row=np.concatenate([first, row])[order],
        words=np.concatenate([np.where(first > 0, words, 0), length])[order],
        in_all=np.concatenate([words, np.zeros(len(row), np.int64)])[order],
        column=column[at],
        at=at,
    )
    return all_heads, number


def _check_counts(lines, heads, count, closing):
    """Refuse heads that contradict the `count` (H,) of numbers below them, or each other.

    `closing` (H,): those of the last column, which does not exist; it may have a first row of 0, and then counts
    otherwise.
    """
    matrix, begins, row = lines.matrix, heads.begins, heads.row
    width = 2 if matrix.kind in COMPLEX else 1
    string_words = 2 if matrix.big else 1  # of the header of a string

    def refuse(which, expected):
        lines.refuse(lines.heads[which], expected)

    refuse(~begins & (row[heads.at] > 0), "numbers of a dense column")
    # a dense column counts its numbers, a string words
    announced = np.where(begins, 1, 2 if matrix.kind in DOUBLE else 1) * count
    refuse((announced != heads.words) & ~(closing & (row == 0)), "as many numbers below as it says")
    inside = np.zeros(len(count), np.int64)
    np.add.at(inside, heads.at, np.where(begins, 0, heads.words + string_words))
    refuse(begins & (row == 0) & (inside != heads.in_all), "as many words below as it says")
    columns = begins & ~closing
    whole = row[columns] > 0
    lines.refuse(lines.heads[columns][whole != whole[:1]], "a column as the ones above")
    follows = np.append(False, ~begins[1:] & (row[1:] < (row + count // width)[:-1]))
    refuse(follows[: len(row)], "rows that ascend in a column")
    refuse(~closing & (count % width > 0), "pairs of numbers below")
    lines.refuse(lines.heads[closing][1:], "no lines behind the last column")
    rows = matrix.shape[0]
    refuse(~closing & (count > 0) & (row - 1 + count // width > rows), f"rows up to {rows}")


def _fixed_numbers(piece, text, start, counts, width):
    """Return the numbers of fields of one width in lines that begin at `start`, each with some of them."""
    line = np.repeat(np.arange(len(start)), counts)
    place = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts)
    fields = np.full((len(line), width + 1), ord(" "), np.uint8)
    fields[:, :-1] = text[(start[line] + width * place)[:, None] + np.arange(width)]
    plain = fields.tobytes()
    values = parse(with_e(plain))
    if values is None:
        values = parse_fortran(plain)
    if values is None or len(values) != len(line):
        for k, field in enumerate(fields):
            numbers = parse_fortran(field.tobytes())
            if numbers is None or len(numbers) != 1:
                raise piece.refusal(int(np.count_nonzero(text[: start[line[k]]] == ord("\n"))), "numbers")
    return values
