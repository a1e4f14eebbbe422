"""Read models of other programs: from a Source of single matrices, or from the main file of a whole export."""

from ..files.model_file import FORMAT as OF_MODELS
from ..files.outputs import HDF5, OTHER, hdf5_kind, kind_of
from ..files.text import first_bytes
from ..model.second_order_model import SecondOrderModel
from ..parallel.failures import InputError
from ..parallel.petsc import MPI
from ..settings.source import Source
from .assembly import assemble
from .parts import Parts
from .registry import READERS, read_by, reader_of, readers_of, with_broken
from .source_parts import read_source
from .unread import refuse_unread


def load_source(source: Source, comm=MPI.COMM_WORLD, name="model") -> SecondOrderModel:
    """Read a model from single matrix files. Collective.

    Parameters
    ----------
    source : Source
        The files of K and M, and optionally of D, B, C, Cv, Ca, nodes and dofs.
    comm : MPI.Comm, default all ranks
    name : str, default "model"
        Name in messages.

    Raises
    ------
    InputError
        For files that cannot be read or do not fit each other.
    """
    rates = {key: path for key, path in (("Cv", source.Cv), ("Ca", source.Ca)) if path}
    return assemble(read_source(source, comm), comm, name, source.B, source.C, source.variables, rates)


def load_export(path, comm=MPI.COMM_WORLD, name="model", variables=None) -> SecondOrderModel:
    """Read a model from the export of a finite-element program. Collective.

    Parameters
    ----------
    path : str or Path
        The main file; the other files of the export are found beside it.
    comm : MPI.Comm, default all ranks
    name : str, default "model"
        Name in messages.
    variables : dict of str to str, optional
        Names of the matrices by "K", "M", "D", for files that have several.

    Raises
    ------
    InputError
        For files that cannot be read or do not fit each other.

    Notes
    -----
    The first bytes of the file determine the format, not its suffix.
    """
    return assemble(read_export(path, comm, variables), comm, name)


def read_export(path, comm, variables=None) -> Parts:
    """Return the parts of a whole finite-element export. Collective. Raises InputError."""

    def check(reader):
        if reader is None:
            raise _no_export(path)
        if variables and not reader.named:
            raise InputError(f"--variables: found names of matrices, but {path} is {reader.name}, which has no names")

    return read_by(reader_of(path, comm, "model", check), "model", path, comm, variables or {})


def _no_export(path) -> InputError:
    """Return the error for a file that is not an export."""
    start, content = first_bytes(path), None
    if not start:
        return InputError(f"{path}: found an empty file")
    refuse_unread(path)
    if start.startswith(HDF5):
        content = kind_of(path)
        if content == hdf5_kind(OF_MODELS):
            return InputError(f"{path}: found a model of hpcred, which needs no conversion; a job names its inputs")
    elif single := READERS.first(lambda reader: "matrix" in reader.holds and reader.begins(start)):
        content = f"{READERS.load(single).name}: give single matrices by -K and -M"
    elif (kind := kind_of(path)) != OTHER:
        content = kind
    expected = ", ".join(reader.name for reader in readers_of("model"))
    return InputError(with_broken(
        f"{path}: found a file that begins with {start[:12]!r}{f' ({content})' if content else ''}, expected {expected}"
    ))  # fmt: skip
