"""Matrices of Nastran's OUTPUT4, text or binary: a file enters, its table of contents or the entries of one leave.

A matrix is a header of columns, rows, form, type and name, then one record a column (number of the column, first row or
0, number of words, words), and a last record of a column that does not exist. Where the first row is 0 the words are
strings, each with the length and the first row of its numbers: two words, or (nonbigmat) both packed in one. A binary
file is a chain of Fortran records without table: rank 0 follows it once, and each rank decodes its share of the bytes.
Of text each rank reads its share of the lines.
"""

import mmap
import os
import re
import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..parallel.failures import InputError, agreed
from .entries import Entries, joined
from .nastran_names import single
from .text import first_bytes, parse, pieces, records, refuse_packed, shown

SHARE = 2**22  # bytes of a binary file decoded at a time
SMALL = 65536  # rows from which a string header needs two words
SQUARE, DIAGONAL, SYMMETRIC, IDENTITY = 1, 3, 6, 8
TRIANGLES = (4, 5)
COMPLEX = (3, 4)
DOUBLE = (2, 4)
# the format of the numbers at the end tells the header line from all others: 1P,5E16.9; without it, four whole numbers
HEADER = re.compile(
    rb"(?m)^(?=[ \d-]{31}) *\d(?:[^\n]*?[EeDd](?P<width>\d+)\.\d+ *(?P<wide>\|I16)?|"
    rb"\d* *-?\d+ {6,7}\d\d? {7}[1-4][ \w]{0,8}) *\r?$"
)
WHOLE = 8  # characters of a whole number, but in headers that say I16
COLUMN = re.compile(rb"(?m)^[ 0-9]{17,24}\r?$")
NUMBER = re.compile(rb"(?<=[0-9.])([+-])")


@dataclass(frozen=True)
class Matrix:
    """What the header of a matrix says, and where its columns lie in the file.

    `form` and `kind` (1 and 2 real, 3 and 4 complex; even ones of two words a number) as OUTPUT4 numbers them. `starts`
    (shares + 1,): bytes where shares of whole columns begin and, last, where the closing record does; of a text, where
    the lines begin and end. `layout` of a text: width of a number; of a binary file: byte order and bytes of a
    whole number.
    """

    name: str
    shape: tuple[int, int]
    form: int
    kind: int
    big: bool
    starts: tuple[int, ...]
    layout: tuple
    is_text: bool

    def __str__(self):
        return f"{self.name} ({self.shape[0]} x {self.shape[1]})"


def begins(start: bytes) -> bool:
    """Whether a file that starts so is one of OUTPUT4."""
    return _binary_layout(start) is not None or HEADER.match(start.split(b"\n", 1)[0]) is not None


def _binary_layout(start):
    """Byte order and bytes of a whole number, or None."""
    for order in "<>":
        for size in (4, 8):
            length = 6 * size
            if len(start) >= length + 8 and struct.unpack_from(order + "i", start)[0] == length:
                header = struct.unpack_from(order + ("4i" if size == 4 else "4q"), start, 4)
                closing = struct.unpack_from(order + "i", start, 4 + length)[0]
                if closing == length and header[0] >= 0 and 0 < header[2] < 100 and header[3] in (1, 2, 3, 4):
                    return order, size
    return None


def contents(path, comm) -> list[Matrix]:
    """The matrices of a file, in order. Collective. Raises InputError."""
    with agreed(comm):
        start = first_bytes(path)
        refuse_packed(path, "Nastran OP4")
        layout = _binary_layout(start)
        if layout is None and not begins(start):
            raise InputError(f"{path}: found a file that begins with {start[:12]!r}, expected one of OUTPUT4")
    if layout is None:
        return _text_contents(path, comm)
    with agreed(comm):
        found = _binary_contents(path, *layout) if comm.rank == 0 else None
    return comm.bcast(found)


def read_matrix(path, comm, matrix: Matrix) -> Entries:
    """The entries of a matrix that `contents` found. Collective. Raises InputError."""
    if matrix.form in TRIANGLES:
        raise InputError(
            f"{path}: found the matrix {matrix} as a triangular factor (form {matrix.form}), expected a whole matrix"
        )
    parts = (_read_text if matrix.is_text else _read_binary)(path, comm, matrix)
    i, j, v = joined(parts, (np.int64, np.int64, float))
    del parts
    rows, columns = matrix.shape
    if matrix.form == DIAGONAL and columns == 1 < rows:  # the diagonal as one column
        return Entries((rows, rows), i, i.copy(), v)
    if matrix.form == IDENTITY and not comm.allreduce(len(v)) and rows == columns:
        mine = np.arange(rows * comm.rank // comm.size, rows * (comm.rank + 1) // comm.size)
        return Entries(matrix.shape, mine, mine.copy(), np.ones(len(mine)))
    if matrix.form == SYMMETRIC:
        below, above = (any(comm.allgather(bool(part.any()))) for part in (i > j, i < j))
        if below != above:
            off = i != j
            i, j, v = (np.concatenate(pair) for pair in ((i, j[off]), (j, i[off]), (v, v[off])))
    return Entries(matrix.shape, i, j, v)


def read(path, comm, key="K", variables=None) -> Entries:
    """One matrix of a file, for -K and the like; `variables`: names by key. Collective. Raises InputError."""
    found = contents(path, comm)
    return read_matrix(path, comm, found[single(path, [item.name for item in found], key, variables)])


def _header(path, where, numbers, name, **place):
    columns, rows, form, kind = numbers
    text = name.replace(b"\0", b" ").decode("latin-1").strip()
    if columns < 0 or not 0 < form < 100 or kind not in (1, 2, 3, 4) or not text.isprintable():
        raise InputError(
            f"{path}: found the numbers {columns}, {rows}, {form}, {kind} and the name {text[:8]!r} at {where}, "
            "expected columns, rows, form, type (1 to 4) and name of a matrix; the file is damaged"
        )
    return Matrix(text.upper(), (abs(rows), columns), form, kind, rows < 0 or rows >= SMALL, **place)


def _real(path, matrix, numbers):
    """The values of numbers that may be complex."""
    if matrix.kind not in COMPLEX:
        return numbers
    if numbers[1::2].any():
        raise InputError(f"{path}: found the complex matrix {matrix}, expected a real one")
    return numbers[::2]


# binary files


def _binary_contents(path, order, size):
    """The matrices of a file, from one walk along its records on one rank."""
    found, end = [], os.path.getsize(path)
    head = struct.Struct(order + ("ii" if size == 4 else "iq")).unpack_from
    whole = 4 + 6 * size + 4
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = 0
        while at < end:
            if end - at < whole or head(data, at)[0] != 6 * size:
                raise InputError(
                    f"{path}: found no header of a matrix at byte {at} of {end}, behind "
                    f"{found[-1].name if found else 'the start'}; the file is damaged or cut off"
                )
            numbers = struct.unpack_from(order + ("4i" if size == 4 else "4q"), data, at + 4)
            name = data[at + 4 + 4 * size : at + 4 + 6 * size]
            if size == 8 and not (name[4:8] + name[12:]).strip():
                name = name[:4] + name[8:12]  # four letters a word
            columns = numbers[0]
            at += whole
            starts, column, mark = [at], 0, at + SHARE
            while column <= columns:
                if at + 12 > end:
                    raise InputError(
                        f"{path}: found the end of the file in a matrix after column {column} of {columns}; the file "
                        "is cut off"
                    )
                length, number = head(data, at)
                if length < 3 * size or number <= column or number > columns + 1:
                    raise InputError(
                        f"{path}: found a record of {length} bytes for column {number} behind column {column} of "
                        f"{columns} at byte {at}; the file is damaged"
                    )
                column = number
                if at >= mark or column > columns:
                    starts.append(at)
                    mark = at + SHARE
                at += length + 8
            if at > end:
                raise InputError(f"{path}: found {end} bytes, expected {at}; the file is cut off")
            if struct.unpack_from(order + "i", data, at - 4)[0] != length:
                raise InputError(f"{path}: found no end of the record at byte {at - 4}; the file is damaged")
            place = {"starts": tuple(starts), "layout": (order, size), "is_text": False}
            found.append(_header(path, f"byte {starts[0] - whole}", numbers, name, **place))
    return found


def _read_binary(path, comm, matrix):
    starts = matrix.starts
    shares = len(starts) - 1
    low, high = shares * comm.rank // comm.size, shares * (comm.rank + 1) // comm.size
    with agreed(comm):
        return [_decode(path, matrix, starts[k], starts[k + 1]) for k in range(low, high)]


class _Words:
    """The 4-byte words of a share of a file, and whole numbers at some of them."""

    def __init__(self, path, order, size, low, high):
        self.raw = np.fromfile(path, order + "u4", (high - low) // 4, offset=low)
        self.order, self.size = order, size

    def markers(self, at):
        return self.raw[at].view(self.order + "i4").astype(np.int64)

    def integers(self, at):
        if self.size == 4:
            return self.markers(at)
        return self.raw[at[:, None] + np.arange(2)].reshape(-1).view(self.order + "i8").astype(np.int64)


def _decode(path, matrix, low, high):
    """Rows and columns (from 0) and values of the columns in the bytes low..high."""
    order, size = matrix.layout
    rows, columns = matrix.shape

    def damaged(what):
        return InputError(f"{path}: found {what} in the matrix {matrix} between the bytes {low} and {high}; "
                          "the file is damaged")  # fmt: skip

    begin = _records(path, order, low, high)
    words = _Words(path, order, size, low, high)
    length = words.markers(begin)
    step = size // 4
    head = begin + 1
    finish = head + length // 4
    if (length % 4).any() or (words.markers(finish) != length).any():
        raise damaged("a record without its end")
    column, first, count = (words.integers(head + k * step) for k in range(3))
    if (count * size != length - 3 * size).any():
        raise damaged("a column whose number of words is not that of its record")
    dense = first > 0
    if (first < 0).any() or (column < 1).any() or (column > columns).any():
        raise damaged("a column or row that does not exist")
    number = size if size == 8 else 8 if matrix.kind in DOUBLE else 4  # bytes
    width = number // 4 * (2 if matrix.kind in COMPLEX else 1)  # words of 4 bytes of an entry
    at = head[dense] + 3 * step
    strings = [(column[dense], first[dense], at, finish[dense])]
    strings += _strings(words, matrix.big, column[~dense], head[~dense] + 3 * step, finish[~dense], damaged)
    column, row, at, stop = (np.concatenate(part) for part in zip(*strings, strict=True))
    place = np.argsort(at)
    column, row, at, stop = column[place], row[place], at[place], stop[place]
    entries = (stop - at) // width
    if ((stop - at) % width).any() or (row < 1).any() or (row + entries - 1 > rows).any():
        raise damaged("a string of numbers that does not fit its column")
    if dense.any() and not dense.all():
        raise damaged("whole columns beside columns of strings")
    if ((column[1:] == column[:-1]) & (row[1:] < (row + entries)[:-1])).any():
        raise damaged("strings of numbers that do not ascend in their column")
    change = np.zeros(len(words.raw) + 1, np.int8)
    np.add.at(change, at, 1)
    np.add.at(change, stop, -1)
    values = words.raw[np.cumsum(change, dtype=np.int8)[:-1].view(bool)].view(f"{order}f{number}").astype(float)
    values = _real(path, matrix, values)
    i = np.repeat(row - 1 - (np.cumsum(entries) - entries), entries) + np.arange(len(values))
    j = np.repeat(column - 1, entries)
    if dense.any():
        kept = values != 0
        i, j, values = i[kept], j[kept], values[kept]
    return i, j, values


def _records(path, order, low, high):
    """The words, counted from low, at which the records of the bytes low..high begin."""
    unpack = struct.Struct(order + "i").unpack_from
    with open(path, "rb") as file:
        file.seek(low)
        data = file.read(high - low)
    found, at, end = [], 0, high - low
    while at < end:
        found.append(at)
        at += unpack(data, at)[0] + 8
    if at != end or len(data) < end:
        raise InputError(f"{path}: found records that overlap between the bytes {low} and {high}; the file is damaged")
    return np.array(found, dtype=np.int64) // 4


def _strings(words, big, column, at, end, damaged):
    """(column, row, first word, last word) of the strings of sparse columns: the k-th of all columns in one step."""
    step = words.size // 4
    found = []
    while len(at):
        if big:
            length, row = words.integers(at) - 1, words.integers(np.minimum(at + step, len(words.raw) - step))
            at = at + 2 * step
        else:
            length, row = np.divmod(words.integers(at), SMALL)
            length, at = length - 1, at + step
        stop = at + length * step
        if (length < 1).any() or (stop > end).any():
            raise damaged("a string of numbers that goes beyond its column")
        found.append((column, row, at, stop))
        more = stop < end
        column, at, end = column[more], stop[more], end[more]
    return found


# texts


def _text_contents(path, comm):
    """The matrices of a text: each rank looks for header lines in its share."""
    with agreed(comm):
        mine = [(piece.start + match.start(), piece.start + match.end() + 1, match.group())
                for piece in pieces(path, comm) for match in HEADER.finditer(piece.text)]  # fmt: skip
    lines = sum(comm.allgather(mine), [])
    with agreed(comm):
        ends = [line[0] for line in lines[1:]] + [os.path.getsize(path)]
        return [_text_header(path, *line, end) for line, end in zip(lines, ends, strict=True)]


def _text_header(path, start, stop, line, end):
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
    return _header(path, f"byte {start}", numbers, fields[4], starts=(stop, end), layout=layout, is_text=True)


def _read_text(path, comm, matrix):
    with agreed(comm):
        parts, last = [], []
        for piece in records(path, comm, *matrix.starts, COLUMN):
            i, j, v, columns = _decode_text(piece, matrix)
            parts.append((i, j, v))
            last += [int(columns[0]), int(columns[-1])] if len(columns) else []
    last = sum(comm.allgather(last), [])
    if not last or last[-1] != matrix.shape[1] + 1:
        raise InputError(
            f"{path}: found column {last[-1] if last else 0} as the last of the matrix {matrix}, expected "
            f"{matrix.shape[1] + 1} to close it; the file is cut off or damaged"
        )
    if any(later < earlier for earlier, later in zip(last, last[1:], strict=False)):
        raise InputError(f"{path}: found columns that do not ascend in the matrix {matrix}; the file is damaged")
    return parts


def _decode_text(piece, matrix):
    """Rows and columns (from 0) and values of whole columns of a text, and the numbers of the columns."""
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
    values = _real(piece.path, matrix, values[: len(values) - int(count[closing].sum())])
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
        """The whole numbers in a field of some lines."""
        stop = (self.start + self.size)[lines][:, None]
        at = (self.start[lines] + place * width)[:, None] + np.arange(width)
        fields = np.where(at < stop, self.text[np.minimum(at, stop)], ord(" "))  # at most the end of the line
        digit = (fields >= ord("0")) & (fields <= ord("9"))
        after = np.maximum.accumulate(digit, axis=1)
        wrong = ~(digit | (fields == ord(" "))).all(axis=1) | ~digit.any(axis=1) | (digit.sum(axis=1) > 18)
        wrong |= (after & ~digit & np.maximum.accumulate(digit[:, ::-1], axis=1)[:, ::-1]).any(axis=1)
        if wrong.any():
            raise self.piece.refusal(int(lines[wrong][0]), "whole numbers")
        value = np.zeros(len(fields), np.int64)
        for k in range(width):
            value = np.where(digit[:, k], 10 * value + fields[:, k] - ord("0"), value)
        return value


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
    """The heads of columns and strings, and the numbers of the columns."""
    heads, size = lines.heads, lines.size
    is_column = (size[heads] > 2 * WHOLE) & (size[heads] <= 3 * WHOLE)
    columns, strings = heads[is_column], heads[~is_column]
    if lines.filled.size and (not columns.size or lines.filled[0] != columns[0]):
        lines.refuse(lines.filled[:1], "a column: its number, first row and number of words")
    number, first, words = (lines.whole(columns, k, WHOLE) for k in range(3))
    lines.refuse(columns[(number < 1) | (number > lines.matrix.shape[1] + 1) | (first < 0) | (words < 1)],
                 "the number of a column, its first row and number of words")  # fmt: skip
    lines.refuse(columns[1:][np.diff(number) <= 0], "a column behind the one before")
    lines.refuse(strings[size[strings] > 2 * WHOLE], "the header of a string of numbers")
    if lines.matrix.big:
        length, row = (lines.whole(strings, k, WHOLE) for k in range(2))
    else:
        length, row = np.divmod(lines.whole(strings, 0, 2 * WHOLE), SMALL)
    length = length - 1
    lines.refuse(strings[(length < 1) | (row < 1)], "the header of a string of numbers")
    order = np.argsort(np.concatenate([columns, strings]), kind="stable")
    column = np.concatenate([number, np.zeros(len(row), np.int64)])[order]
    at = np.maximum.accumulate(np.where(column > 0, np.arange(len(column)), 0))
    found = _Heads(
        row=np.concatenate([first, row])[order],
        words=np.concatenate([np.where(first > 0, words, 0), length])[order],
        in_all=np.concatenate([words, np.zeros(len(row), np.int64)])[order],
        column=column[at],
        at=at,
    )
    return found, number


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
    said = np.where(begins, 1, 2 if matrix.kind in DOUBLE else 1) * count
    refuse((said != heads.words) & ~(closing & (row == 0)), "as many numbers below as it says")
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
    """The numbers of fields of one width in lines that begin at `start`, each with some of them."""
    line = np.repeat(np.arange(len(start)), counts)
    place = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts)
    fields = np.full((len(line), width + 1), ord(" "), np.uint8)
    fields[:, :-1] = text[(start[line] + width * place)[:, None] + np.arange(width)]
    plain = fields.tobytes()
    values = parse(plain.replace(b"D", b"E").replace(b"d", b"e"))
    if values is None:
        values = _without_letter(plain)
    if values is None or len(values) != len(line):
        for k, field in enumerate(fields):
            found = _without_letter(field.tobytes())
            if found is None or len(found) != 1:
                raise piece.refusal(int(np.count_nonzero(text[: start[line[k]]] == ord("\n"))), "numbers")
    return values


def _without_letter(text):
    """The numbers of a text, or None; three digits of an exponent leave no room for its letter: 1.5-100."""
    return parse(NUMBER.sub(rb"e\1", text.upper().replace(b"D", b"E")))
