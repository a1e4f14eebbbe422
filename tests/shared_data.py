"""Real files that may not be part of the checkout: a folder beside it, or that of HPCRED_SHARED_DATA."""

import gzip
from pathlib import Path

import pytest
from conftest import DATA

from benchmarks.models.published import find


def shared(name):
    """The path of a file of the shared folder; the test is skipped where there is none."""
    found = find(name)
    return found or pytest.skip(f"{name} of the shared data is not here")


def unpacked(comm, folder, *names):
    """Copies of packed files of tests/data in a folder; the path of the first."""
    if comm.rank == 0:
        for name in names:
            (folder / Path(name).name).write_bytes(gzip.decompress((DATA / f"{name}.gz").read_bytes()))
    comm.Barrier()
    return folder / Path(names[0]).name
