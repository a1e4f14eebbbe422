"""Real files that may not be part of the checkout: a folder beside it, or that of HPCRED_SHARED_DATA."""

import gzip
import os
from pathlib import Path

import pytest
from conftest import DATA


def shared(name):
    """The path of a file of the shared folder; the test is skipped where there is none."""
    here = Path(__file__).resolve().parent
    folders = [os.environ.get("HPCRED_SHARED_DATA"), here.parents[1] / "shared/data", here.parents[2] / "shared/data"]
    for folder in folders:
        if folder and (Path(folder) / name).is_file():
            return Path(folder) / name
    pytest.skip(f"{name} of the shared data is not here")


def unpacked(comm, folder, *names):
    """Copies of packed files of tests/data in a folder; the path of the first."""
    if comm.rank == 0:
        for name in names:
            (folder / Path(name).name).write_bytes(gzip.decompress((DATA / f"{name}.gz").read_bytes()))
    comm.Barrier()
    return folder / Path(names[0]).name
