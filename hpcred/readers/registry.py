"""List the readers in the order in which they are tried, and find the one of a file.

To add a format, write a Reader (see base) in the folder of its program, and add its address to OURS.
"""

from collections.abc import Callable

from ..files.text import first_bytes
from ..parallel.failures import InputError, agreed
from ..parallel.plugins import OWN, Registry, blamed
from .base import Reader

OURS = (
    "abaqus.user_element:UserElement",
    "input_file:AbaqusInput",
    "calculix.matrix_storage:MatrixStorage",
    "matrices.matrix_market:MatrixMarket",
    "matrices.petsc_binary:PetscBinary",
    "matrices.npz:Npz",
    "matlab.matrices:MatFile",
    "ansys.full:Full",
    "ansys.texts:Texts",
    "nastran.exports:Op4",
    "nastran.exports:Op2",
    "nastran.exports:Bulk",
    "nastran.dmig:Dmig",
    "matrices.harwell_boeing:HarwellBoeing",
    "calculix.matrices:CalculixMatrix",
    "abaqus.matrices:Triplets",
)
READERS = Registry("readers.base:Reader", "hpcred.readers", {address: f"readers.{address}" for address in OURS})


def readers_of(holds: str) -> list[Reader]:
    """Return all readers of models or of single matrices. `holds`: "model" or "matrix"."""
    return [reader for reader in READERS.all() if holds in reader.holds]


def reader_of(path, comm, holds: str, check: Callable[[Reader | None], None] | None = None) -> Reader | None:
    """Return the first reader of a file, as rank 0 finds it, or None; `check` it on rank 0. Collective."""
    entry = None
    with agreed(comm):
        start = first_bytes(path)
        if comm.rank == 0:
            entry = _first(start, holds, vague=False) or _first(start, holds, vague=True)
            if check is not None:
                check(entry and READERS.load(entry))
    entry = comm.bcast(entry)
    with agreed(comm):
        return entry and READERS.load(entry)


def _first(start, holds, vague):
    return READERS.first(lambda reader: holds in reader.holds and reader.vague == vague and reader.begins(start))


def read_by(reader: Reader, holds: str, path, comm, *named):
    """Read by a reader, and check the type that a reader of another package returns. Collective."""
    with blamed(reader):
        content = getattr(reader, f"read_{holds}")(path, comm, *(named if reader.named else ()))
    if reader.package != OWN:
        with agreed(comm):
            if not hasattr(content, "matrices" if holds == "model" else "values"):
                raise InputError(
                    f"{path}: '{reader.name}' of the package {reader.package} gave {type(content).__name__}, expected "
                    f"{'hpcred.readers.Parts' if holds == 'model' else 'Entries'}; tell its authors"
                )
    return content


def with_broken(sentence: str) -> str:
    """Return the message for a file that no reader accepts, with unusable readers of other packages. On rank 0."""
    return "; ".join([sentence, *READERS.broken])
