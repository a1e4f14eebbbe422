"""Check all numbers of a file of hpcred against their checksums."""

from __future__ import annotations

from ..files import model_file, motion_file, recovered_file, response_file, result_file
from ..files.hdf5 import kind_of_file, reading, require_whole
from ..parallel.failures import InputError, agreed
from ..parallel.shares import row_range
from .workflow import workflow

FORMATS = {item.FORMAT: item for item in (model_file, result_file, response_file, motion_file, recovered_file)}


@workflow
def verify_file(path, *, comm=None) -> dict:
    """Read all of a model, result, file of responses or of a simulation, on all ranks; what was checked, in numbers.

    Collective. Raises InputError at the first dataset that is damaged, and where there are no
    checksums, or those of earlier versions.
    """
    with agreed(comm):
        require_whole(path)
        kind = kind_of_file(path)
        if kind not in FORMATS:
            raise InputError(f"{path}: found no HDF5 file of hpcred that has checksums, expected such as model.h5")
        room = FORMATS[kind]
        with reading(path, kind, room.VERSION, room.SCHEMA) as file:
            if not file.complete:
                raise InputError(f"{path}: has no checksums, or other ones, made by an older hpcred; make it again")
            count = file.verify(lambda rows: row_range(comm, rows))
    return {"format": kind, "verified_datasets": count, "warnings": []}
