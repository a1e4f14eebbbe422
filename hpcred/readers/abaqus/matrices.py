"""Read matrices in the formats of Abaqus' *MATRIX OUTPUT; each rank returns a share of the entries.

FORMAT=COORDINATE has lines of row, column, value with numbers from 1 and both triangles. FORMAT=MATRIX INPUT has lines
of node, dof, node, dof, value; one triangle of a symmetric matrix, both of others.
"""

import re
from pathlib import Path

import numpy as np

from ...files.text import end_to_end, first_bytes, first_line, pieces, shown
from ...files.text_numbers import labels, numbers, triples, whole
from ...parallel.exchange import exchange
from ...parallel.failures import InputError, agreed
from ..base import Reader
from ..entries import Collected, Entries, LabelledEntries, both_triangles, label_of, sides

ENDINGS = {"K": "STIF", "M": "MASS", "D": "DMPV"}
STRUCTURAL_DAMPING = "DMPS"
MATRIX_MARKET = (  # compiled when a file has a %
    rb"(?im)^[ \t]*%[^\n]*(?:matrixmarket|matrix +(?:coordinate|array)|(?:real|integer) +(?:general|symmetric|skew))"
)


def read(path, comm) -> Entries | LabelledEntries:
    """Read a real square matrix. Collective. Raises InputError."""
    with agreed(comm):
        line = first_line(first_bytes(path))
        words = line.replace(b",", b" ").split()
        columns = len(words)
        if columns == 6 and b"." not in b"".join(words[:5]):
            raise InputError(
                f"{path}: found a first line '{shown(line)}' of 6 numbers, as of matrices element by "
                "element, expected the assembled matrix; leave Element by Element out of *Matrix Generate"
            )
        if columns not in (3, 5):
            raise InputError(
                f"{path}: found a first line '{shown(line)}' of {columns} numbers, expected "
                "row, column, value or node, dof, node, dof, value"
            )
    if columns == 3:
        return _read_coordinates(path, comm)
    with agreed(comm):
        i, j, v = end_to_end(_pieces(path, comm), _labelled)
    if is_one_triangle(comm, i, j):
        i, j, v = both_triangles(i, j, v)
    return LabelledEntries(i, j, v)


def _pieces(path, comm):
    """As text.pieces; refused is Matrix Market with a damaged header, whose sizes would be taken for an entry."""
    for piece in pieces(path, comm):
        if b"%" in piece.text and (header := re.search(MATRIX_MARKET, piece.text)):
            raise piece.refusal(piece.text[: header.start()].count(b"\n"), "the header of a Matrix Market file as the "
                                "first line, or no such line")  # fmt: skip
        yield piece


def _read_coordinates(path, comm):
    with agreed(comm):
        entries = Collected((np.int64, np.int64, float))
        for piece in _pieces(path, comm):
            entries.add(triples(piece, commas=True)[:3], piece.share)
        i, j, v = entries.arrays
    below, above = sides(comm, i, j)
    if below != above:
        raise InputError(
            f"{path}: found entries {'below' if below else 'above'} the diagonal only, expected lines of row, column, "
            "value of both triangles; write one triangle as a symmetric Matrix Market file"
        )
    size = 1 + max(comm.allgather(int(max(i.max(initial=-1), j.max(initial=-1)))))
    if comm.bcast((i[0], j[0], v[0]) if len(i) else None) == (size - 1, size - 1, comm.allreduce(len(i)) - 1):
        raise InputError(
            f"{path}: found a first line of the numbers of rows, columns and lines below it, as of a Matrix Market "
            "file without its header; put %%MatrixMarket matrix coordinate real general (or symmetric) above it"
        )
    return Entries((size, size), i, j, v)


def _labelled(piece):
    """Return labels of rows and columns, and values, of lines of node, dof, node, dof, value."""
    table, lines = numbers(piece, 5)
    ends = []
    for k in (0, 2):
        piece.require(~(table[:, k] <= 0), lines,
                      "the number of a node of the mesh; nodes that are not positive are Abaqus' own (Lagrange "
                      "multipliers, hybrid elements, contact), which a mechanical model cannot have")  # fmt: skip
        node = labels(piece, table[:, k], lines)
        dof = whole(piece, table[:, k + 1], lines, "the dof (1 to 3 displacements, 4 to 6 rotations)", 1, 6)
        ends.append(label_of(node, dof - 1))
    return *ends, table[:, 4].copy()


def is_one_triangle(comm, i, j):
    """Test whether no entry has its mirror image; the order of Abaqus' rows need not be that of the node numbers."""
    if not all(sides(comm, i, j)):
        return True
    off = i != j
    low, high, is_above = np.minimum(i, j)[off], np.maximum(i, j)[off], (i < j)[off]
    low, high, is_above = exchange(comm, low % comm.size, [low, high, is_above])
    order = np.lexsort((is_above, high, low))
    low, high, is_above = low[order], high[order], is_above[order]
    mirrored = (low[1:] == low[:-1]) & (high[1:] == high[:-1]) & (is_above[1:] != is_above[:-1])
    return not any(comm.allgather(bool(mirrored.any())))


def matrices_beside(path) -> dict[str, dict[str, str]]:
    """Return the matrix files beside an input file by step and by kind (STIF, MASS, ...)."""
    path, files = Path(path), {}
    pattern = re.compile(re.escape(path.stem) + r"_?(STIF|MASS|DMPV|DMPS)(\d+)\.mtx(\.gz)?")
    folder = path.parent
    for file in sorted(folder.iterdir()) if folder.is_dir() else ():
        match = pattern.fullmatch(file.name)
        if match:
            files.setdefault(match[2], {}).setdefault(match[1], str(file))
    return files


def files_beside(path) -> dict[str, str]:
    """Return K, M and perhaps D of Abaqus beside block.inp: block_STIF1.mtx or blockSTIF1.mtx, also .gz."""
    path = Path(path)
    steps = matrices_beside(path)
    if len(steps) > 1:
        raise InputError(
            f"{path}: found matrices of the steps {', '.join(sorted(steps, key=int))} beside it, expected those of one "
            "step; give the files by -K and -M, and the input file by --nodes"
        )
    files = next(iter(steps.values()), {})
    for key in ("K", "M"):
        if ENDINGS[key] not in files:
            expected = path.with_name(f"{path.stem}_{ENDINGS[key]}1.mtx")
            other = "" if files else f", or {path.stem}.sti of CalculiX (*Frequency, SOLVER=MATRIXSTORAGE)"
            raise InputError(f"{path}: found no matrix {key} beside it, expected {expected}{other}")
    if STRUCTURAL_DAMPING in files:
        raise InputError(
            f"{files[STRUCTURAL_DAMPING]}: found a matrix of structural damping, which a model cannot hold; give the "
            "other files by -K, -M and -D, and a loss factor in the job"
        )
    return {key: files[ending] for key, ending in ENDINGS.items() if ending in files}


class Triplets(Reader):
    """Lines of numbers, as of Abaqus."""

    name = "text lines of row, column, value or node, dof, node, dof, value"
    told_by = "a first line of numbers"
    packed = vague = open_ended = line_ended = True
    read_matrix = staticmethod(read)

    def begins(self, start):
        return first_line(start)[:1].isdigit() or first_line(start)[:1] == b"-"
