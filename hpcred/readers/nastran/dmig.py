"""Read matrices on DMIG cards of Nastran and OptiStruct (.pch); each rank returns a share of labelled entries.

A matrix has a card NAME, 0, form, type, then one card per column: NAME, node, direction, and for each entry node,
direction, real part, imaginary part. Of a symmetric matrix one half is given. The numbers have few digits.
"""

import os
import re
from dataclasses import dataclass

import numpy as np

from ...fe.dofs import SCALAR
from ...files.system_errors import damaged_file, open_input
from ...files.text import first_bytes, first_line, line_number, records, refuse_packed, shown
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up, number_over_ranks, repeated_key
from ..abaqus.matrices import is_one_triangle
from ..base import Reader
from ..entries import LabelledEntries, both_triangles, joined, label_name, label_of
from .cards import CARD, lines_of, reals, wholes
from .names import single

NAME = re.compile(rb"DMIG")
START = re.compile(rb"(?mi)^DMIG[ ,*\t]")
END = re.compile(rb"(?mi)^[ \t]*ENDDATA")
END_LINE = re.compile(rb"(?i)ENDDATA[\s,]*(?:\s[0-9a-f]{8})?\s*(?:\$.*)?")  # Patran puts eight digits behind it
REMARK = re.compile(rb"(?:\$.*)?")
SQUARE, SYMMETRIC = 1, 6
FORMS = {SQUARE: "square", SYMMETRIC: "symmetric", 2: "rectangular", 9: "rectangular"}
COMPLEX = (3, 4)


@dataclass(frozen=True)
class DmigMatrix:
    """The header card of a matrix; `columns` it says, 0 where it does not."""

    name: str
    form: int
    kind: int
    columns: int


@dataclass(frozen=True)
class Lacking:
    """A stiffness with fewer columns, `there`, than its header card says; none of its rows lacks one.

    The number counts for rectangular matrices; for others programs write the number of all dofs, or anything.
    """

    path: object
    matrix: DmigMatrix
    there: int

    def error(self, sentence: str) -> InputError:
        """Return an InputError on the number of columns."""
        return InputError(
            f"{self.path}: found {self.there} columns of the matrix {self.matrix.name}, expected {self.matrix.columns}"
            + sentence
        )


def begins(start: bytes) -> bool:
    """Test whether a text that starts so has DMIG cards."""
    return first_line(start)[:1] != b"*" and b"\0" not in start and START.search(start) is not None


def contents(path, comm, section=None) -> list[DmigMatrix]:
    """Return the matrices of a file, or of a section of it (see bulk.sections_of), in order. Collective. Raises
    InputError."""
    with agreed(comm):
        first_bytes(path)
        refuse_packed(path, "DMIG cards")
    # a file that was cut between two cards looks whole but for its end
    _require_end(path, comm)
    with agreed(comm):
        mine, used, ends = [], set(), []
        for piece in _pieces(path, comm, section):
            lines = lines_of(piece, NAME, strict=True)
            # cards with 0 in their second field say form and type of a matrix
            table, number = lines.table(8)
            which = lines.card[lines.starts]
            edges = (int(which[0]), table[0, 0], lines.total - 1 - int(which[-1]), table[-1, 0]) if len(which) else ()
            ends.append((piece.start, lines.total, *edges))
            at = np.flatnonzero(table[:, 1] == b"0")
            form, kind, columns = (wholes(piece, table[at, k], number[at], meaning, 0, empty=0)
                                   for k, meaning in ((2, "the form"), (3, "the type"), (7, "the number of columns")))
            mine += [DmigMatrix(name.decode("latin-1"), *(int(number) for number in rest))
                     for name, *rest in zip(table[at, 0], form, kind, columns, strict=True)]  # fmt: skip
            used |= set(table[:, 0].tolist())
    # each matrix has one such card, before its columns
    matrices = sum(comm.allgather(mine), [])
    _check_order(path, sorted(sum(comm.allgather(ends), [])))
    used = set().union(*comm.allgather(used))
    without = sorted(name.decode("latin-1") for name in used - {matrix.name.encode("latin-1") for matrix in matrices})
    if without:
        raise damaged_file(path, f"DMIG cards of {without[0]!r}, which has no card with its form and type")
    return matrices


def _check_order(path, pieces):
    """Refuse other cards between two of one matrix, where a piece ends and the next one begins."""
    # of each piece: start, number of cards, and, where there are DMIG cards, the number of others before the first, its
    # matrix, the number behind the last, and its matrix
    others, name = 0, None
    for _, total, *dmig in pieces:
        if not dmig:
            others += total
            continue
        before, first, behind, last = dmig
        if first == name and others + before:
            raise damaged_file(path, f"other cards between those of the matrix {shown(name)}, expected none")
        others, name = behind, last


def read(path, comm, key="K", variables=None) -> LabelledEntries:
    """Read one matrix of a file, for -K and the like. Collective. Raises InputError."""
    return read_matrices(path, comm, {key: single(path, contents(path, comm), key, variables)})[0][key]


def read_matrices(path, comm, wanted: dict[str, DmigMatrix], section=None) -> tuple[dict, list[str], Lacking | None]:
    """Return entries by key from one pass through a file or a section of it, warnings, and what K lacks of its columns.
    Collective."""
    with agreed(comm):
        # terms as they stand in the lines, of all wanted matrices in one pass
        for matrix in wanted.values():
            if matrix.form not in (SQUARE, SYMMETRIC) or matrix.kind not in (1, 2, 3, 4):
                raise InputError(
                    f"{path}: found the matrix {matrix.name} of form {matrix.form} "
                    f"({FORMS.get(matrix.form, 'unknown')}) and type {matrix.kind}, expected a square or symmetric one"
                )
        entries, digits = {key: [] for key in wanted}, 0
        for piece in _pieces(path, comm, section):
            lines = lines_of(piece, NAME, strict=True)
            for key, matrix in wanted.items():
                triplets, most = _entries(piece, lines, matrix)
                entries[key].append(triplets)
                digits = max(digits, most)
    digits = max(comm.allgather(digits))
    warnings = [
        f"{path}: the numbers have {digits} digits, of which few are left where stiff parts cancel: rigid-body modes "
        "of a free body come out at up to about +-1 Hz (real or imaginary), and its first elastic modes may be off in "
        "the third digit; binary OP4 has all digits",
    ]
    result, lacking = {}, None
    for key, matrix in wanted.items():
        i, j, v = joined(entries.pop(key), (np.int64, np.int64, float))
        _require_once(path, comm, matrix, i, j)
        # a matrix of all rows has entries in every column, unless the file was cut off or masses are 0
        columns = number_over_ranks(comm, j)[0]
        there = comm.allreduce(len(columns))
        if key == "K" and there < matrix.columns:
            lacking = Lacking(path, matrix, there)
            if not all(comm.allgather(bool(look_up(comm, columns, [], np.unique(i))[0].all()))):
                raise lacking.error("; the file is cut off or damaged")
        elif there < matrix.columns:
            warnings.append(
                f"{path}: the matrix {matrix.name} has {there} of {matrix.columns} columns, the others are 0"
            )
        # one half of a symmetric matrix is written
        if matrix.form == SYMMETRIC:
            if not is_one_triangle(comm, i, j):
                raise InputError(f"{path}: found both halves of the symmetric matrix {matrix.name}, expected one")
            i, j, v = both_triangles(i, j, v)
        result[key] = LabelledEntries(i, j, v)
    return result, warnings, lacking


def _require_once(path, comm, matrix, i, j):
    """Raise InputError where a place of a matrix is given more than once, as no program writes it."""
    names, place = number_over_ranks(comm, np.concatenate([i, j]))
    key = place[: len(i)] * comm.allreduce(len(names)) + place[len(i) :]
    twice = repeated_key(comm, key)
    if twice is not None:
        places = np.flatnonzero(key == twice)[:1]
        (row, column), *_ = sum(comm.allgather([(i[k], j[k]) for k in places]), [])
        raise InputError(
            f"{path}: found the entry {label_name(row)}, {label_name(column)} of the matrix {matrix.name} more than "
            "once; the file is damaged"
        )


def _pieces(path, comm, section=None):
    yield from records(path, comm, *(section[1:] if section else (0, os.path.getsize(path))), CARD)


def _require_end(path, comm):
    """Raise InputError where cards stand behind ENDDATA, or the last line may be cut. Collective."""
    with agreed(comm):
        ends = [piece.start + match.start() for piece in _pieces(path, comm) for match in END.finditer(piece.text)]
    decided(comm, _check_end, path, min(sum(comm.allgather(ends), []), default=None))


def _check_end(path, end):
    """As `_require_end`, where ENDDATA is at the byte `end`, or None."""
    with open_input(path) as file:
        if end is None:
            file.seek(max(os.path.getsize(path) - 200, 0))
            last = file.read().splitlines(keepends=True)[-1]
            if not last.endswith(b"\n"):
                rest = f"'{shown(last)}'" if last.strip() else f"of {len(last)} blanks"
                raise damaged_file(path, f"the last line {rest} without an end", "cut off")
            return
        file.seek(end)
        expected, at = END_LINE, end
        while line := file.readline():
            if not expected.fullmatch(line.strip()):
                raise InputError(
                    f"{path}, line {line_number(path, at)}: found '{shown(line)}', expected nothing behind ENDDATA"
                )
            expected, at = REMARK, file.tell()


def _entries(piece, lines, matrix):
    """Return labels of rows and columns, and values, of one matrix in a piece, and the digits of the longest."""
    # each line is two fours of fields, or one in large form; the first four of a card name the column
    fours = lines.fields.reshape(-1, 2, 4)
    have = np.arange(2) < (lines.count // 4)[:, None]
    head = np.zeros(have.shape, bool)
    head[:, 0] = lines.starts
    fours, head = fours[have], head[have]
    number = np.broadcast_to(lines.number[:, None], have.shape)[have]
    owner = np.cumsum(head) - 1
    heads = fours[head]
    column = (heads[:, 0] == matrix.name.encode("latin-1")) & (heads[:, 1] != b"0")
    at = np.flatnonzero(~head & column[owner] & (fours != b"").any(axis=1))
    stray = ~head & ~column[owner] & (heads[owner, 0] == matrix.name.encode("latin-1")) & (fours[:, 0] != b"")
    # but the second half of that card: what is written, whether polar, nothing, and the number of columns
    stray &= (np.arange(len(fours)) - np.flatnonzero(head)[owner] > 1) | (fours[:, 2] != b"")
    if stray.any():
        raise piece.refusal(int(number[stray][-1]), "no entries below the card with form and type")
    piece.require(~column | (heads[:, 3] == b""), number[head], "name, node and direction of a column")
    j = np.zeros(len(heads), np.int64)
    j[column] = _labels(piece, heads[column, 1], heads[column, 2], number[head][column], "of a column")
    entry, line = fours[at], number[at]
    i = _labels(piece, entry[:, 0], entry[:, 1], line, "of a row")
    piece.require(entry[:, 2] != b"", line, "node, direction and value of an entry")
    v = reals(piece, entry[:, 2], line, "the value of an entry")
    if matrix.kind in COMPLEX and reals(piece, entry[:, 3], line, "the imaginary part of an entry").any():
        raise InputError(f"{piece.path}: found the complex matrix {matrix.name}, expected a real one")
    if matrix.kind not in COMPLEX:
        piece.require(entry[:, 3] == b"", line, f"no imaginary part in the real matrix {matrix.name}")
    return (i, j[owner[at]], v), _digits(entry[:, 2])


def _labels(piece, nodes, directions, lines, what):
    node = wholes(piece, nodes, lines, f"the node {what}", 1)
    direction = wholes(piece, directions, lines, f"the direction {what}", 0, 6, empty=0)
    return label_of(node, np.where(direction == 0, SCALAR, direction - 1))


def _digits(fields):
    """Return the most digits that a number has in front of its exponent."""
    if not len(fields):
        return 0
    codes = np.ascontiguousarray(fields).view(np.uint8).reshape(len(fields), fields.dtype.itemsize)
    digit = (codes >= ord("0")) & (codes <= ord("9"))
    begun = np.maximum.accumulate(digit, axis=1)
    sign = (codes == ord("+")) | (codes == ord("-")) | (codes == ord("E")) | (codes == ord("D"))
    ended = np.maximum.accumulate(sign & begun, axis=1)
    return int((digit & ~ended).sum(axis=1).max())


class Dmig(Reader):
    """Single matrices on DMIG cards, perhaps of the G-set."""

    name, told_by = "Nastran DMIG", "a DMIG card"
    named = open_ended = loose = True
    begins, read_matrix = staticmethod(begins), staticmethod(read)
