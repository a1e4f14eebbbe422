"""Read coordinates over time from the solution file of Exudyn, such as solution/coordinatesSolution.txt.

An ObjectFFRFreducedOrder has the coordinates of its rigid-body node, seven with Euler parameters, and behind them those
of its generic node, the reduced coordinates. The file has displacements, velocities and accelerations of all
second-order coordinates of the system one after the other. Where there are other objects, the user says where the
reduced coordinates begin. Reference values of the rigid-body node are not in the file.
"""

import re

from ...body.coordinates import Coordinates
from ...files.system_errors import open_input
from ...files.text import first_line, shown
from ...parallel.failures import InputError
from .table import read_columns

BEGINNING, BINARY = b"#Exudyn", b"EXUBIN"
SIZES = re.compile(rb"#number of written coordinates \[[^\]]*\] *= *\[([\d, ]+)\]")
RIGID = 7  # coordinates of a rigid-body node with Euler parameters
LONGEST_HEAD = 100  # lines


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is a solution of Exudyn."""
    return start.startswith((BEGINNING, BINARY))


def read(path, count: int, first: int | None = None) -> Coordinates:
    """Read `count` coordinates, the first of them the coordinate number `first` (from 0) of the system. On one rank.

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
    table = read_columns(path, start, 1 + sum(sizes))
    places = {key: 1 + sum(sizes[:k]) + first for k, key in enumerate(("q", "velocity", "acceleration")) if sizes[k]}
    stopped = f"{path}: no line says that the simulation is finished; it may have stopped"
    return Coordinates(t=table[:, 0].copy(), remarks=() if _is_finished(path) else (stopped,),
                       **{key: table[:, at : at + count].copy() for key, at in places.items()})  # fmt: skip


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
