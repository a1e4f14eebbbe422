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

A format whose files hold several matrices by name has `named`: its read takes (path, comm, key, variables), where key
is the matrix that is wanted (K, M, D, B or C) and `variables` the names that the user gave, by key.

A file, or set of files, of a whole finite-element model (several matrices, row labels, nodes, elements) belongs into
the table of model_source.
"""

from dataclasses import dataclass
from types import ModuleType

from ..files.text import first_bytes, first_line, refuse_packed, shown
from ..parallel.failures import InputError, agreed
from .abaqus import matrices as abaqus_matrices
from .calculix import matrices as calculix_matrices
from .entries import Entries, LabelledEntries
from .matlab import matrices as mat_matrices
from .matrices import harwell_boeing, matrix_market, npz, petsc_binary
from .nastran import dmig as nastran_dmig
from .nastran import op2_matrices as nastran_op2_matrices
from .nastran import op4 as nastran_op4
from .unread import refuse_unread


@dataclass(frozen=True)
class MatrixFormat:
    """`name` for messages, the `module` that reads it, and whether it can be read from a gzip file.

    `told_by`: what of its first bytes tells it, for the table of formats; `named`: see above.
    """

    name: str
    module: ModuleType
    packed: bool
    told_by: str = ""
    named: bool = False


FORMATS = (
    MatrixFormat("Matrix Market", matrix_market, True, "%%MatrixMarket"),
    MatrixFormat("PETSc binary", petsc_binary, False, "the number 1211216"),
    MatrixFormat("SciPy .npz", npz, False, "a zip archive"),
    MatrixFormat("MATLAB .mat (version 4 to 7.3)", mat_matrices, False, "its header, or HDF5 with one", True),
    MatrixFormat("Nastran OP4", nastran_op4, False, "the header of its first matrix", True),
    MatrixFormat("Nastran OP2", nastran_op2_matrices, False, "its records of one number", True),
    MatrixFormat("Nastran DMIG", nastran_dmig, False, "a DMIG card", True),
    MatrixFormat("Harwell-Boeing or Rutherford-Boeing", harwell_boeing, True, "the four or five lines of its header"),
    MatrixFormat("CalculiX .sti or .mas", calculix_matrices, True, "lines of an upper triangle, 14 digits each"),
    MatrixFormat("text lines of row, column, value or node, dof, node, dof, value", abaqus_matrices, True,
                 "a first line of numbers"),
)  # fmt: skip


def format_of(path) -> MatrixFormat | None:
    """The first format that fits the first bytes of a file. Raises InputError where it cannot be read."""
    start = first_bytes(path)
    return next((item for item in FORMATS if item.module.begins(start)), None)


def read_entries(path, comm, key="K", variables=None) -> Entries | LabelledEntries:
    """Read a matrix in any of the formats. Collective. Raises InputError.

    `key`: which of K, M, D, B, C is wanted, and `variables`: names by key, where the file holds several matrices.
    """
    with agreed(comm):
        found = format_of(path)
        if found is None or found.module in (abaqus_matrices, npz):  # which take what begins with a number, or PK
            refuse_unread(path)
        if found is None:
            start = first_bytes(path)
            if first_line(start)[:1] == b"*":
                raise InputError(
                    f"{path}: found keywords such as '{shown(first_line(start), 40)}' (an input file, or "
                    "matrices of single elements or of a substructure), expected an assembled matrix; let Abaqus "
                    "write it by *Matrix Generate, Stiffness, Mass and *Matrix Output, Stiffness, Mass"
                )
            raise InputError(
                f"{path}: found a file that begins with {start[:12]!r}, expected "
                f"{', '.join(item.name for item in FORMATS[:-1])}, or {FORMATS[-1].name}"
            )
        if not found.packed:
            refuse_packed(path, found.name)
    if found.named:
        return found.module.read(path, comm, key, variables or {})
    return found.module.read(path, comm)
