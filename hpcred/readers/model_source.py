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
    """Read the files on all ranks and assemble the model. Collective. Raises InputError."""
    return assemble(read_source(source, comm), comm, name, source.B, source.C, source.variables)


def load_export(path, comm=MPI.COMM_WORLD, name="model", variables=None) -> SecondOrderModel:
    """The model of a whole finite-element export, told by its first bytes. Collective. Raises InputError.

    `variables`: names of matrices by K, M, D, for files that hold several.
    """
    return assemble(read_export(path, comm, variables), comm, name)


def read_export(path, comm, variables=None) -> Parts:
    """The parts that a whole finite-element export holds. Collective. Raises InputError."""

    def check(found):
        if found is None:
            raise _no_export(path)
        if variables and not found.named:
            raise InputError(f"--variables: found names of matrices, but {path} is {found.name}, which has no names")

    return read_by(reader_of(path, comm, "model", check), "model", path, comm, variables or {})


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
    elif single := READERS.first(lambda reader: "matrix" in reader.holds and reader.begins(start)):
        what = f"{READERS.load(single).name}: give single matrices by -K and -M"
    elif (kind := kind_of(path)) != OTHER:
        what = kind
    expected = ", ".join(item.name for item in readers_of("model"))
    return InputError(with_broken(
        f"{path}: found a file that begins with {start[:12]!r}{f' ({what})' if what else ''}, expected {expected}"
    ))  # fmt: skip
