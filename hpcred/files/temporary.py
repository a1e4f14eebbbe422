"""Make a temporary folder that all ranks see."""

import tempfile
from contextlib import contextmanager, nullcontext
from pathlib import Path

from ..parallel.failures import agreed
from ..parallel.petsc import MPI


@contextmanager
def folder_of_all(comm, place=None):
    """A temporary folder in `place`, by default that of the system, or the working folder for ranks on several nodes.

    Collective.
    """
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    place = place or (None if node.size == comm.size else ".")
    node.Free()
    with agreed(comm):
        made = tempfile.TemporaryDirectory(dir=place, prefix=".hpcred-") if comm.rank == 0 else nullcontext()
    with made as folder:
        yield Path(comm.bcast(folder))
        comm.Barrier()
