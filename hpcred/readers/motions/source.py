"""Read the coordinates of a body over time from a file of any program that is known, told by how it begins."""

from ...body.coordinates import Coordinates
from ...files import motion_file
from ...files.hdf5 import HDF5, kind_of_file
from ...files.text import first_bytes
from ...parallel.failures import InputError, agreed
from . import arrays, exudyn, table


def read_coordinates(path, count: int, basis: str, outputs: dict, comm, first: int | None = None) -> Coordinates:
    """Read `count` coordinates, and check that they belong to a basis of this digest, and to a body with these outputs.

    Collective. `outputs`: rows (count,) of C by the names of an FMU. `first`: see exudyn.read. Raises InputError.
    """
    coordinates = None
    with agreed(comm):
        if comm.rank == 0:
            coordinates = _read(path, count, first)
            if coordinates.q.shape[1] != count:
                raise InputError(
                    f"{path}: found {coordinates.q.shape[1]} coordinates, expected {count} of the result; the motion "
                    "is that of another body"
                )
            if coordinates.basis and basis and coordinates.basis != basis:
                raise InputError(f"{path}: the motion is that of another result, with another basis; give the result "
                                 "that was simulated, or simulate this one")  # fmt: skip
            coordinates.require_sound(path)
            coordinates.require_outputs(path, outputs)
    return comm.bcast(coordinates)


def _read(path, count, first) -> Coordinates:
    start = first_bytes(path)
    if first is not None and not exudyn.begins(start):
        raise InputError(f"--first: belongs to a solution of Exudyn; {path} is none")
    if start.startswith(HDF5):
        return motion_file.read_coordinates(path) if kind_of_file(path) == motion_file.FORMAT else arrays.read(path)
    if exudyn.begins(start):
        return exudyn.read(path, count, first)
    if table.begins(start):
        return table.read(path)
    raise InputError(
        f"{path}: found no motion; expected simulation.h5, a solution of Exudyn, HDF5 with t and q, or a .csv whose "
        "first line begins with t or time"
    )

