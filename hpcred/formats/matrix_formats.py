"""The table of matrix formats: a file enters, entries leave, some on each rank; its first bytes tell the format.

A new format of single matrices is one module beside this one and one line in FORMATS, of which the first that fits is
taken. The module has two functions:

    begins(start: bytes) -> bool
        whether a file that starts so (its first 4096 bytes, unpacked) is of the format. Never by the suffix.
    read(path, comm) -> Entries | LabelledEntries
        the matrix. Collective. Each rank reads a slice of the file and gives the entries it found, in any order,
        wherever they belong; never the file on one rank. Entries where the file numbers the rows from 1 to n,
        LabelledEntries where it names them by node and direction. Both triangles of a symmetric matrix are given.
        What is not understood to the last character raises InputError on all ranks: use `agreed` around the reading,
        and `Piece.refusal` to name the line.

A file, or set of files, of a whole finite-element model (several matrices, row labels, nodes, elements) belongs into
the table of model_source.
"""

from dataclasses import dataclass
from types import ModuleType

from ..parallel.failures import InputError, agreed
from . import abaqus_matrices, harwell_boeing, matrix_market, npz, petsc_binary
from .entries import Entries, LabelledEntries
from .text import first_bytes, is_packed


@dataclass(frozen=True)
class MatrixFormat:
    """`name` for messages, the `module` that reads it, and whether it can be read from a gzip file."""

    name: str
    module: ModuleType
    packed: bool


FORMATS = (
    MatrixFormat("Matrix Market", matrix_market, True),
    MatrixFormat("PETSc binary", petsc_binary, False),
    MatrixFormat("SciPy .npz", npz, False),
    MatrixFormat("Harwell-Boeing or Rutherford-Boeing", harwell_boeing, True),
    MatrixFormat("text lines of row, column, value or node, dof, node, dof, value", abaqus_matrices, True),
)


def read_entries(path, comm) -> Entries | LabelledEntries:
    """Read a matrix in any of the formats. Collective. Raises InputError."""
    with agreed(comm):
        start = first_bytes(path)
        found = next((item for item in FORMATS if item.module.begins(start)), None)
        if found is None:
            raise InputError(
                f"{path}: found a file that begins with {start[:12]!r}, expected "
                f"{', '.join(item.name for item in FORMATS[:-1])}, or {FORMATS[-1].name}"
            )
        if is_packed(path) and not found.packed:
            raise InputError(f"{path}: found a gzip file of {found.name}; unpack it first")
    return found.module.read(path, comm)
