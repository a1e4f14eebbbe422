"""Read the coordinates of a body over time from a file of any program that is known, told by how it begins."""

import re

from ...body.coordinates import Coordinates
from ...files import motion_file
from ...files.hdf5 import HDF5, kind_of_file
from ...files.opened_hdf5 import guarded, opened_hdf5, real_numbers
from ...files.system_errors import open_input
from ...files.text import first_bytes, first_line, shown
from ...parallel.failures import InputError, agreed
from . import table

# of HDF5: t (nt), q (nt, m), and qdot, qddot (nt, m) perhaps
ARRAYS = {"t": "t", "q": "q", "velocity": "qdot", "acceleration": "qddot"}
BEGINNING, BINARY = b"#Exudyn", b"EXUBIN"  # of Exudyn
SIZES = re.compile(rb"#number of written coordinates \[[^\]]*\] *= *\[([\d, ]+)\]")
RIGID = 7  # coordinates of a rigid-body node with Euler parameters
LONGEST_HEAD = 100  # lines


def read_coordinates(path, count: int, basis: str, outputs: dict, comm, first: int | None = None) -> Coordinates:
    """Read `count` coordinates, and check that they belong to a basis of this digest, and to a body with these outputs.

    Collective. `outputs`: rows (count,) of C by the names of an FMU. `first`: see _read_exudyn. Raises InputError.
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
    if first is not None and not start.startswith((BEGINNING, BINARY)):
        raise InputError(f"--first: belongs to a solution of Exudyn; {path} is none")
    if start.startswith(HDF5):
        return motion_file.read_coordinates(path) if kind_of_file(path) == motion_file.FORMAT else _read_arrays(path)
    if start.startswith((BEGINNING, BINARY)):
        return _read_exudyn(path, count, first)
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


def _read_exudyn(path, count: int, first: int | None) -> Coordinates:
    """Read `count` coordinates, the first of them the coordinate number `first` (from 0) of the system, from a solution
    file of Exudyn, such as solution/coordinatesSolution.txt. On one rank.

    An ObjectFFRFreducedOrder has the coordinates of its rigid-body node, seven with Euler parameters, and behind them
    those of its generic node, the reduced coordinates. The file has displacements, velocities and accelerations of all
    second-order coordinates of the system one after the other. Where there are other objects, the user says where the
    reduced coordinates begin. Reference values of the rigid-body node are not in the file.

    `first`: by default 7, where the body is all of the system. Raises InputError.
    """
    sizes, start = _head(path)
    size = sizes[0]
    if first is None:
        if size != RIGID + count:
            raise InputError(
                f"{path}: found {size} coordinates of second order, expected {RIGID} of the frame and {count} of the "
                "body; where the system has more objects, or another node, say where those of the body begin: "
                "--first N, with N = mbs.GetNodeODE2Index(body['nGenericODE2'])"
            )
        first = RIGID
    elif not 0 <= first <= size - count:
        raise InputError(f"--first: found {first}, expected 0 to {size - count}, since {path} has {size} coordinates "
                         f"of second order, and the body {count}")  # fmt: skip
    lines = table.read_columns(path, start, 1 + sum(sizes))
    places = {key: 1 + sum(sizes[:k]) + first for k, key in enumerate(("q", "velocity", "acceleration")) if sizes[k]}
    stopped = f"{path}: no line says that the simulation is finished; it may have stopped"
    return Coordinates(t=lines[:, 0].copy(), remarks=() if _is_finished(path) else (stopped,),
                       **{key: lines[:, at : at + count].copy() for key, at in places.items()})  # fmt: skip


def _head(path) -> tuple[list[int], int]:
    """Return the numbers of columns of each kind, displacements, velocities and accelerations first, and where the
    first line of numbers begins."""
    sizes, start = None, 0
    with open_input(path) as file:
        for _ in range(LONGEST_HEAD):
            line = file.readline()
            if line.startswith(BINARY):
                raise InputError(f"{path}: found a binary solution of Exudyn, expected a text; set "
                                 "solution.file.binary = False")  # fmt: skip
            if not line.startswith(b"#"):
                break
            start += len(line)
            if match := SIZES.match(line):
                sizes = [int(word) for word in match[1].split(b",") if word.strip()]
    if sizes is None or len(sizes) < 3:
        raise InputError(
            f"{path}: found '{shown(first_line(line) or line)}' and no line '#number of written coordinates [nODE2, "
            "...] = [...]' above it; expected the head of a solution of Exudyn"
        )
    if any(size not in (0, sizes[0]) for size in sizes[1:3]):
        raise InputError(f"{path}: found {sizes[1]} velocities and {sizes[2]} accelerations of {sizes[0]} coordinates "
                         "of second order; expected all or none")  # fmt: skip
    return sizes, start


def _is_finished(path) -> bool:
    with open_input(path) as file:
        file.seek(max(file.seek(0, 2) - 2000, 0))
        return b"#simulation finished" in file.read()
