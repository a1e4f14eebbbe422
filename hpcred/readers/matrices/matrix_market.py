"""Read Matrix Market files (also .gz), coordinate or array; each rank returns a share of the entries."""

import numpy as np

from ...files.system_errors import damaged_file
from ...files.text import BYTE_ORDER_MARK, open_unpacked, pieces, read_lines, shown
from ...files.text_numbers import numbers, triples
from ...parallel.failures import InputError, agreed
from ..base import Reader
from ..entries import Collected, Entries, both_triangles

SYMMETRIES = ("general", "symmetric", "skew-symmetric")


def read(path, comm) -> Entries:
    """Read a real matrix; of symmetric files both triangles are given. Collective. Raises InputError."""
    with agreed(comm):
        kind, symmetry, shape, count, start = _header(path)
    if kind == "array":
        return _read_array(path, comm, symmetry, shape, start)
    with agreed(comm):
        # each rank reads its share of the lines
        entries, above, below = Collected((np.int64, np.int64, float)), None, False
        for piece in pieces(path, comm, start):
            i, j, v, lines = triples(piece)
            piece.require((i < shape[0]) & (j < shape[1]), lines,
                          f"an entry of the {shape[0]} x {shape[1]} matrix that the header announces")  # fmt: skip
            if symmetry != "general":
                if above is None and (upper := np.flatnonzero(j > i)).size:
                    above = piece, upper[0] if lines is None else lines[upper[0]]
                below = below or bool((j < i).any())
                if symmetry == "skew-symmetric":
                    piece.require((i != j) | (v == 0), lines, "no diagonal in a skew-symmetric matrix")
            entries.add((i, j, v), piece.share)
        i, j, v = entries.arrays
    # what the header says: the number of entries, and one triangle of a symmetric matrix
    total = comm.allreduce(len(v))
    if total != count:
        raise damaged_file(path, f"{total} entries, the header says {count}")
    if symmetry == "general":
        return Entries(shape, i, j, v)
    below = any(comm.allgather(below))
    with agreed(comm):
        if below and above is not None:
            raise above[0].refusal(above[1], f"one triangle only, as the header says {symmetry} and entries below "
                                             "the diagonal were found too")  # fmt: skip
    return Entries(shape, *both_triangles(i, j, v, -1.0 if symmetry == "skew-symmetric" else 1.0))


def _read_array(path, comm, symmetry, shape, start):
    """Return a dense matrix, one number a line by columns, of symmetric ones from the diagonal, or below it, down."""
    values, place = read_lines(path, comm, lambda piece: (numbers(piece, 1, commas=False)[0][:, 0],), start)
    total = comm.allreduce(len(values))
    rows, columns = shape
    skew = symmetry == "skew-symmetric"
    expected = rows * columns if symmetry == "general" else rows * (rows - 1 if skew else rows + 1) // 2
    if total != expected:
        raise damaged_file(path, f"{total} entries, the header says {rows} x {columns}, {symmetry}: {expected}")
    if symmetry == "general":
        return Entries(shape, place % rows, place // rows, values)
    top = np.arange(columns) + skew  # the first row of each column
    begin = np.cumsum(rows - top) - (rows - top)
    j = np.searchsorted(begin, place, side="right") - 1
    return Entries(shape, *both_triangles(top[j] + place - begin[j], j, values, -1.0 if skew else 1.0))


def _header(path):
    """Return format, symmetry, shape, number of entries in the file and the byte where they begin."""
    with open_unpacked(path) as file:
        line = file.readline().removeprefix(BYTE_ORDER_MARK)
        # the kind of matrix
        words = [word.decode("latin-1") for word in line.lower().split()]
        if (
            len(words) != 5 or words[:2] != ["%%matrixmarket", "matrix"] or words[2] not in ("coordinate", "array")
            or words[3] not in ("real", "integer") or words[4] not in SYMMETRIES
        ):  # fmt: skip
            raise InputError(
                f"{path}, line 1: found '{shown(line)}', expected a real Matrix Market header: '%%MatrixMarket "
                f"matrix', coordinate or array, real or integer, {SYMMETRIES[0]}, {SYMMETRIES[1]} or {SYMMETRIES[2]}"
            )
        # behind comments its size
        number, text = 2, file.readline()
        while text.lstrip()[:1] == b"%" or (text and not text.strip()):
            number, text = number + 1, file.readline()
        sizes = [int(word) for word in text.split() if word.isdigit() and len(word) < 1000]
        expected = 3 if words[2] == "coordinate" else 2
        if len(sizes) != expected or len(text.split()) != expected:
            raise InputError(
                f"{path}, line {number}: found the size line '{shown(text)}', expected "
                f"{'rows, columns and entries' if expected == 3 else 'rows and columns'}"
            )
        if words[4] != "general" and sizes[0] != sizes[1]:
            raise InputError(
                f"{path}, line {number}: found a {words[4]} matrix of {sizes[0]} x {sizes[1]}, expected a square one"
            )
        return words[2], words[4], (sizes[0], sizes[1]), sizes[-1], file.tell()


class MatrixMarket(Reader):
    """Matrix Market files."""

    name, told_by, packed, line_ended = "Matrix Market", "%%MatrixMarket", True, True
    read_matrix = staticmethod(read)

    def begins(self, start):
        return start[:14].lower() == b"%%matrixmarket"
