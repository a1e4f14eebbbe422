"""Read matrices in the text format of CalculiX (.sti, .mas, also .gz); the entries have both triangles.

Each line has row, column, value with numbers from 1, of the upper triangle with its whole diagonal, ascending by column
and then by row. The text has no counts: damage is detected by these rules, by the last line break, and by the other
matrix, which has the same pattern.
"""

import re
from dataclasses import dataclass

import numpy as np

from ...files.system_errors import damaged_file
from ...files.text import first_bytes, is_cut_line, pieces
from ...files.text_numbers import triples
from ...parallel.failures import InputError, agreed
from ..base import Reader
from ..entries import Collected, Entries, both_triangles

LINE = re.compile(rb"[1-9]\d* [1-9]\d* [ -]\d\.\d{13}e[+-]\d\d\d?")
MIXED = 0x9E3779B97F4A7C15  # an odd number that spreads places over 64 bits


@dataclass
class Triangle:
    """Entries (row <= column, from 0) of this rank, the `size` of the whole matrix, and the `places` of all entries:
    their number and a sum over their rows and columns, equal for matrices with entries at the same places."""

    size: int
    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    places: tuple[int, int]

    def mirrored(self) -> Entries:
        """Return the entries of both triangles."""
        return Entries((self.size, self.size), *both_triangles(self.rows, self.columns, self.values))


def begins(start: bytes) -> bool:
    """Test whether a file that starts so has lines of an upper triangle as CalculiX writes them."""
    lines = start.split(b"\n")
    lines = [line.rstrip(b"\r") for line in (lines[:-1] if len(lines) > 1 else lines)]
    if not all(map(LINE.fullmatch, lines)):
        return False
    places = [tuple(map(int, line.split()[:2])) for line in lines]
    return places[0] == (1, 1) and all(row <= column for row, column in places)


def read_triangle(path, comm) -> Triangle:
    """Read the upper triangle of a matrix. Collective. Raises InputError."""
    with agreed(comm):
        require_last_line(path)
        entries, bounds, diagonal, places = Collected((np.int64, np.int64, float)), [], 0, 0
        # each piece ascends, and is of the upper triangle
        for piece in pieces(path, comm):
            i, j, v, lines = triples(piece)
            order = j * np.int64(2**31) + i  # rows stay below 2^31
            ascends = np.append(True, order[1:] > order[:-1])[: len(order)]
            piece.require((i <= j) & ascends, lines,
                          "an entry of the upper triangle, ascending by column and then by row, as CalculiX writes "
                          "them")  # fmt: skip
            if len(order):
                bounds.append((piece.start, int(order[0]), int(order[-1])))
            diagonal += np.count_nonzero(i == j)
            places += int((order.astype(np.uint64) * np.uint64(MIXED) >> np.uint64(20)).sum(dtype=np.uint64))
            entries.add((i, j, v), piece.share)
        i, j, v = entries.arrays
    # so do the pieces one after the other, and each column has its diagonal
    size = 1 + max(comm.allgather(int(j.max(initial=-1))))
    diagonal, places, count = (comm.allreduce(number) for number in (diagonal, places, len(v)))
    ends = sorted(bound for bounds_of_rank in comm.allgather(bounds) for bound in bounds_of_rank)
    for (_, _, last), (start, first, _) in zip(ends[:-1], ends[1:], strict=True):
        if first <= last:
            raise damaged_file(path, f"columns that do not ascend at byte {start}")
    if diagonal != size or not size:
        raise InputError(
            f"{path}: found {diagonal} entries of the diagonal for {size} columns, expected one in each column; the "
            "file is damaged, or not one of CalculiX' upper triangles"
        )
    return Triangle(size, i, j, v, (count, places))


def require_last_line(path):
    """Raise InputError where the (unpacked) text does not end with a line break: its last line may be cut."""
    if not first_bytes(path):
        raise InputError(f"{path}: found an empty file")
    if is_cut_line(path):
        raise InputError(f"{path}: found no line break at its end; the file is cut")


class CalculixMatrix(Reader):
    """One matrix of CalculiX."""

    name, told_by, packed = "CalculiX .sti or .mas", "lines of an upper triangle, 14 digits each", True
    begins = staticmethod(begins)

    def read_matrix(self, path, comm):
        return read_triangle(path, comm).mirrored()
