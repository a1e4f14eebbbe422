"""Make a temporary folder that all ranks see."""

import os
import re
import shutil
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from ..parallel.failures import agreed, unfinished
from ..parallel.petsc import MPI
from .locks import HOST


@contextmanager
def folder_of_all(comm, place=None):
    """A temporary folder in `place`, by default that of the system, or the working folder for ranks on several nodes.

    What dead processes of this machine left there is removed. Collective.
    """
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    on_one_node, folder = node.size == comm.size, None
    node.Free()
    with agreed(comm):
        if comm.rank == 0:
            place = place or (tempfile.gettempdir() if on_one_node else ".")
            _remove_left(place)
            folder = Path(tempfile.mkdtemp(dir=place, prefix=f".hpcred-{HOST}-{os.getpid()}-"))
    folder = comm.bcast(folder)
    unfinished.add(folder)
    try:
        yield folder
        comm.Barrier()
    finally:
        if comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)
        unfinished.discard(folder)


def _remove_left(place):
    """Remove temporary folders of dead processes of this machine and this user."""
    pattern = re.compile(re.escape(f".hpcred-{HOST}-") + r"(\d{1,9})-[a-z0-9_]{8}")
    with suppress(OSError), os.scandir(place) as entries:
        for entry in entries:
            match = pattern.fullmatch(entry.name)
            if match and not psutil.pid_exists(int(match[1])):
                with suppress(OSError):
                    if entry.is_dir(follow_symlinks=False) and entry.stat(follow_symlinks=False).st_uid == os.geteuid():
                        shutil.rmtree(entry, ignore_errors=True)
