"""Read the coordinates of a body over time from a file of any program that is known, told by how it begins."""

from ...body.coordinates import Coordinates
from ...files import motion_file
from ...files.hdf5 import HDF5, kind_of_file
from ...files.opened_hdf5 import guarded, opened_hdf5, real_numbers
from ...files.text import first_bytes
from ...parallel.failures import InputError, agreed
from . import exudyn, table

# of HDF5: t (nt), q (nt, m), and qdot, qddot (nt, m) perhaps
ARRAYS = {"t": "t", "q": "q", "velocity": "qdot", "acceleration": "qddot"}


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
        return motion_file.read_coordinates(path) if kind_of_file(path) == motion_file.FORMAT else _read_arrays(path)
    if exudyn.begins(start):
        return exudyn.read(path, count, first)
    if table.begins(start):
        return table.read(path)
    raise InputError(
        f"{path}: found no motion; expected simulation.h5, a solution of Exudyn, HDF5 with t and q, or a .csv whose "
        "first line begins with t or time"
    )


def _read_arrays(path) -> Coordinates:
    """Read an HDF5 file with the arrays of ARRAYS, the last two perhaps. On one rank. Raises InputError."""
    with opened_hdf5(path) as file, guarded(path, "its contents"):
        arrays = {key: real_numbers(file, name, path) for key, name in ARRAYS.items()}
        missing = [name for name in ("t", "q") if arrays[name] is None]
        if missing:
            raise InputError(f"{path}: found the arrays {', '.join(sorted(file)) or 'none'}, and no "
                             f"{' and no '.join(missing)}; expected t (nt) and q (nt, m)")  # fmt: skip
    arrays = {key: array for key, array in arrays.items() if array is not None}
    if arrays["t"].ndim != 1:
        raise InputError(f"{path}: t has the shape {arrays['t'].shape}, expected (nt)")
    for key, array in arrays.items():
        expected = (len(arrays["t"]), arrays["q"].shape[-1] if arrays["q"].ndim else 0)
        if key != "t" and array.shape != expected:
            raise InputError(f"{path}: {ARRAYS[key]} has the shape {array.shape}, expected (nt, m) = {expected}")
    return Coordinates(**arrays)
