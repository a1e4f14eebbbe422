"""Read coordinates over time from a .csv with names in its first line.

Ours: t, q1 .. qm, and qdot1 .. qdotm, qddot1 .. qddotm perhaps, as `hpcred simulate` writes the first of them. Those of
an FMU that hpcred wrote, as FMPy records them: time, q[1] .. q[m], v[1] .. v[m], der(v[1]) .. der(v[m]). Other columns
are left out, but for those with names as of outputs of an FMU, which tell whether the body is the same.
"""

import csv
import re
from collections import Counter

import numpy as np

from ...body.coordinates import Coordinates
from ...files.system_errors import open_input
from ...files.text import BYTE_ORDER_MARK, LONGEST_LINE, is_cut_line, pieces, refuse_packed, shown
from ...files.text_numbers import ragged
from ...parallel.failures import InputError
from ...parallel.petsc import MPI

TIMES = ("t", "time")
OUTPUTS = ("displacement_", "rotation_", "output_")
FAMILIES = {  # names of columns, of which the first family counts that is there
    "q": ("q{}", "q[{}]"),
    "velocity": ("qdot{}", "v[{}]", "der(q[{}])"),
    "acceleration": ("qddot{}", "der(v[{}])"),
}
NUMBER = "[1-9][0-9]*"  # of any length, and never taken as a number


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is a table with a time in its first column."""
    first = start.removeprefix(BYTE_ORDER_MARK).split(b"\n")[0]
    return first.split(b",")[0].strip().strip(b'"').decode("latin-1").lower() in TIMES


def read(path) -> Coordinates:
    """Read a table. On one rank. Raises InputError."""
    names, start = head_of(path)
    chosen = {key: _family(path, names, patterns) for key, patterns in FAMILIES.items()}
    if not chosen["q"]:
        raise InputError(
            f"{path}: found columns {', '.join(map(_shown, names[:6]))}{', ...' * (len(names) > 6)}, and none of the "
            "reduced coordinates, q1, q2, ... or q[1], q[2], ...; outputs alone do not give them: record the states"
        )
    for key in ("velocity", "acceleration"):
        if chosen[key] and len(chosen[key]) != len(chosen["q"]):
            raise InputError(
                f"{path}: found {len(chosen['q'])} coordinates and {len(chosen[key])} columns of their {key}, such as "
                f"{names[chosen[key][0]]}; expected as many"
            )
    table = read_columns(path, start, len(names))
    inertial = "position_x" in names  # of hpcred simulate, whose displacements are no outputs of the body
    outputs = {name: table[:, k].copy() for k, name in enumerate(names) if name.startswith(OUTPUTS) and not inertial}
    return Coordinates(
        t=table[:, 0].copy(), outputs=outputs,
        **{key: np.ascontiguousarray(table[:, at]) for key, at in chosen.items() if at},
    )  # fmt: skip


def head_of(path) -> tuple[list[str], int]:
    """Return the names of the columns, and where the line below them begins."""
    with open_input(path) as file:
        line = file.readline(LONGEST_LINE)
    try:
        (names,) = csv.reader([line.removeprefix(BYTE_ORDER_MARK).decode()], skipinitialspace=True)
    except (UnicodeDecodeError, csv.Error, ValueError) as error:
        raise InputError(f"{path}: its first line is no list of names ({error})") from error
    names = [name.strip() for name in names]
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise InputError(f"{path}: found the column '{_shown(twice)}' more than once, expected names that differ")
    return names, len(line)


def read_columns(path, start: int, columns: int) -> np.ndarray:
    """Return the numbers (lines, columns) from the byte `start` on; comments are left out. On one rank.

    Raises InputError that names the line, too where the last one has no end.
    """
    refuse_packed(path, "coordinates over time")
    tables = [np.zeros((0, columns))]
    for piece in pieces(path, MPI.COMM_SELF, start):
        values, counts, lines = ragged(piece, expected=f"{columns} numbers", blanks=False)
        if (wrong := counts != columns).any():
            raise piece.refusal(lines[wrong.argmax()], f"{columns} numbers, as many as the head has names")
        tables.append(values.reshape(-1, columns))
    if is_cut_line(path):
        raise InputError(f"{path}: found no line break at its end; the file is cut off: write it again")
    return np.concatenate(tables)


def _shown(name):
    return shown(name.encode("latin-1", "replace"))


def _family(path, names, patterns) -> list[int]:
    """Return the places of the columns 1, 2, ... of the first pattern that is there, or none. Raises InputError."""
    for pattern in patterns:
        form = re.compile(re.escape(pattern).replace(re.escape("{}"), f"({NUMBER})"))
        places = {match[1]: k for k, match in enumerate(map(form.fullmatch, names)) if match}
        if not places:
            continue
        wanted = [str(number) for number in range(1, len(places) + 1)]
        missing = next((number for number in wanted if number not in places), None)
        if missing is not None:
            raise InputError(
                f"{path}: found {len(places)} columns such as {_shown(names[min(places.values())])}, and no "
                f"{pattern.format(missing)}; expected all from 1 on"
            )
        return [places[number] for number in wanted]
    return []
