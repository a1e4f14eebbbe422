"""Read matrices of Nastran's OUTPUT4, text or binary, and OUTPUT2: the table of contents, or the entries of one.

In OUTPUT4 a matrix has a header of columns, rows, form, type and name, then one record per column (number of the
column, first row or 0, number of words, words), and a last record of a column that does not exist. If the first row is
0, the words are strings, each with the length and the first row of its numbers: two words, or (nonbigmat) both in one.
"""

from ...files.text import first_bytes, refuse_packed
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ..entries import Entries
from . import op2, op4_binary, op4_text
from .names import single
from .op4_matrix import Op4Matrix, completed


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is one of OUTPUT4."""
    return bool(op4_binary.layout_of(start) or op4_text.HEADER.match(start.split(b"\n", 1)[0]))


def contents(path, comm) -> list[Op4Matrix]:
    """Return the matrices of a file, in order. Collective. Raises InputError."""
    with agreed(comm):
        start = first_bytes(path)
        is_op2 = op2.begins(start)
        refuse_packed(path, "Nastran OP2" if is_op2 else "Nastran OP4")
        layout = op4_binary.layout_of(start)
        if not is_op2 and not begins(start):
            raise InputError(f"{path}: found a file that begins with {start[:12]!r}, expected one of OUTPUT4")
    if is_op2:
        return decided(comm, op2.contents, path)
    return op4_text.contents(path, comm) if layout is None else decided(comm, op4_binary.contents, path, *layout)


def read_matrix(path, comm, matrix: Op4Matrix) -> Entries:
    """Return the entries of a matrix that `contents` found. Collective. Raises InputError."""
    of_op4 = op4_text if matrix.is_text else op4_binary
    program = op2 if isinstance(matrix, op2.Op2Matrix) else of_op4
    return completed(path, comm, matrix, program.read(path, comm, matrix))


def read(path, comm, key="K", variables=None) -> Entries:
    """Read one matrix of a file, for -K and the like; `variables`: names by key. Collective. Raises InputError."""
    return read_matrix(path, comm, single(path, contents(path, comm), key, variables))
