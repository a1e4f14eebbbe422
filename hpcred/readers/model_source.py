"""Models of other programs: files enter, a SecondOrderModel leaves.

The parts of a model travel as `Parts`: matrices, row labels, nodes and elements, each rank with the slices that it
read. A new format of whole finite-element exports is one module beside this one with

    begins(start: bytes) -> bool
        whether a file that starts so (its first 4096 bytes, unpacked) is of the format. Never by the suffix.
    read_parts(path, comm) -> Parts
        what the file, or the set of files that belongs to it, says. Collective. Each rank reads slices; never a
        file on one rank. Raises InputError on all ranks. Rows that the program removed (supports, dependent dofs)
        have no label and no entry.

and one line in EXPORTS. A format whose files hold several matrices by name has `named`, and read_parts(path, comm,
variables) with the names that the user gave by K, M, D. Single matrices have a table of their own in matrix_formats.
"""

from collections.abc import Callable
from dataclasses import dataclass

from ..files.model_file import FORMAT as OF_MODELS
from ..files.outputs import HDF5, OTHER, hdf5_kind, kind_of
from ..files.text import first_bytes
from ..model.second_order_model import SecondOrderModel
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI
from ..settings.source import Source
from .abaqus import input_file as abaqus_input
from .abaqus import matrices as abaqus_matrices
from .ansys import full as ansys_full
from .ansys import texts as ansys_text
from .assembly import assemble
from .calculix import matrix_storage as calculix
from .matlab import matrices as mat_matrices
from .matrix_formats import format_of
from .nastran import exports as nastran
from .nastran import op2 as nastran_op2
from .nastran import op4 as nastran_op4
from .parts import Parts
from .source_parts import abaqus_source, read_source
from .unread import refuse_unread


def load_source(source: Source, comm=MPI.COMM_WORLD, name="model") -> SecondOrderModel:
    """Read the files on all ranks and assemble the model. Collective. Raises InputError."""
    return assemble(read_source(source, comm), comm, name, source.B, source.C, source.variables)


def load_export(path, comm=MPI.COMM_WORLD, name="model", variables=None) -> SecondOrderModel:
    """The model of a whole finite-element export, told by its first bytes. Collective. Raises InputError.

    `variables`: names of matrices by K, M, D, for files that hold several.
    """
    return assemble(read_export(path, comm, variables), comm, name)


def export_of(path):
    """The Export whose files begin as this one, or None. Raises InputError where the file cannot be read."""
    start = first_bytes(path)
    return next((item for item in EXPORTS if item.begins(start)), None)


def _no_export(path) -> InputError:
    """What to raise for a file that is no export."""
    start, what = first_bytes(path), None
    if not start:
        return InputError(f"{path}: found an empty file")
    refuse_unread(path)
    if start.startswith(HDF5):
        what = kind_of(path)
        if what == hdf5_kind(OF_MODELS):
            return InputError(f"{path}: found a model of hpcred, which needs no conversion; a job names its inputs")
    elif (single := format_of(path)) is not None:
        what = f"{single.name}: give single matrices by -K and -M"
    elif (kind := kind_of(path)) != OTHER:
        what = kind
    expected = ", ".join(item.name for item in EXPORTS)
    return InputError(
        f"{path}: found a file that begins with {start[:12]!r}{f' ({what})' if what else ''}, expected {expected}"
    )


def read_export(path, comm, variables=None) -> Parts:
    """The parts that a whole finite-element export holds. Collective. Raises InputError."""
    with agreed(comm):
        export = export_of(path)
        if export is None:
            raise _no_export(path)
        if variables and not export.named:
            raise InputError(f"--variables: found names of matrices, but {path} is {export.name}, which has no names")
    return export.read_parts(path, comm, variables or {}) if export.named else export.read_parts(path, comm)


def read_abaqus(path, comm) -> Parts:
    """An Abaqus input file and the matrices beside it. Collective. Raises InputError."""
    with agreed(comm):
        source = abaqus_source(path)
    return read_source(source, comm)


def read_input_file(path, comm) -> Parts:
    """An input file of Abaqus or CalculiX, told by the matrices beside it. Collective. Raises InputError."""
    with agreed(comm):
        of_calculix = "K" in calculix.files_of(path)
        if of_calculix and abaqus_matrices.is_beside(path):
            raise InputError(
                f"{path}: found matrices of both Abaqus and CalculiX beside it; give the .sti file in place of it, or "
                "-K and -M of Abaqus with --nodes"
            )
    return calculix.read_parts(path, comm) if of_calculix else read_abaqus(path, comm)


@dataclass(frozen=True)
class Export:
    """A format of whole finite-element exports; see the top of this module.

    `told_by` and `companions`: what tells it, and the files beside it that are read too, for the table of formats.
    `contents`: (path) -> names and sizes of the matrices in a file that holds several, without reading them.
    """

    name: str
    begins: Callable[[bytes], bool]
    read_parts: Callable[..., Parts]
    told_by: str = ""
    companions: str = ""
    named: bool = False
    contents: Callable[[str], dict[str, str]] | None = None


EXPORTS = (
    Export("an Abaqus or CalculiX input file with its matrices beside it", abaqus_input.begins, read_input_file,
           "a keyword such as *Node", "x_STIF1.mtx, x_MASS1.mtx, x_DMPV1.mtx; x.sti, x.mas, x.dof (.gz)"),
    Export("CalculiX .sti, .mas or .dof", calculix.begins, calculix.read_parts,
           "lines of an upper triangle, or of node.direction", "x.sti, x.mas, x.dof (.gz), x.inp"),
    Export("MATLAB .mat (version 4 to 7.3)", mat_matrices.begins, mat_matrices.read_parts,
           "its header, or HDF5 with one", "none: K, M, D, nodes, dofs in one file", True, mat_matrices.contents),
    Export("ANSYS' .full file", ansys_full.begins, ansys_full.read_parts, "the header of its first record",
           ".cdb, .rst or a list with nodes"),
    Export("matrices of ANSYS' HBMAT or *EXPORT,...,MMF", ansys_text.begins, ansys_text.read_parts,
           "its title, or a Matrix Market header with a mapping beside it", "the other matrices, mapping, nodes"),
    Export("Nastran OP4", nastran_op4.begins, nastran.read_op4, "the header of its first matrix",
           "other .op4 files, .op2, .bdf or .dat with nodes", True),
    Export("Nastran OP2 with matrices", nastran_op2.begins, nastran.read_op4, "its records of one number",
           ".bdf or .dat with nodes", True),
    Export("Nastran DMIG, or an input file with the matrices beside it", nastran.begins_bulk, nastran.read_bulk,
           "DMIG or other cards", ".pch or .op4 with the matrices, .bdf or .dat with nodes", True),
)  # fmt: skip
