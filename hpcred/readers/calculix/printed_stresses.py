"""Read the stresses at integration points that CalculiX prints into a .dat file by *EL PRINT with S."""

import re

import numpy as np

from ...fe.point_stresses import MOST_POINTS
from ...files.text import Piece, pieces
from ...files.text_numbers import labels, numbers, whole
from ...parallel.failures import InputError, agreed
from ..entries import joined

TITLE = re.compile(rb"(?m)^[ \t]*(\S.*?)[ \t]+for set .*? and time[ \t]+(\S+)[ \t]*\r?$")
STRESSES = b"stresses (elem, integ.pnt.,sxx,syy,szz,sxy,sxz,syz)"
IN_ORDER = [2, 3, 4, 5, 7, 6]  # columns of xx, yy, zz, xy, yz, zx


def read(path, comm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return numbers of elements (r,) and of points (r,) from 1, and stresses (r, 6) xx, yy, zz, xy, yz, zx of this
    rank, in the unit of the file. Collective. Raises InputError for other contents than stresses of one time."""
    with agreed(comm):
        parts, times = [], set()
        for piece in pieces(path, comm):
            for title, time in TITLE.findall(piece.text):
                if title.strip() != STRESSES:
                    raise InputError(
                        f"{path}: found '{title.decode(errors='replace')[:60]}', expected stresses in global "
                        "directions only; print nothing but S by *EL PRINT"
                    )
                times.add(time)
            parts.append(stresses_of(Piece(path, TITLE.sub(b"", piece.text), piece.start)))
        element, point, stress = joined(parts, (np.int64, np.int64, float))
    stress = stress.reshape(-1, 6)
    instants = sorted(set().union(*comm.allgather(times)))
    if len(instants) != 1:
        listed = ", ".join(time.decode(errors="replace") for time in instants) or "none"
        raise InputError(f"{path}: found stresses of the times {listed}, expected those of one")
    return element, point, stress


def stresses_of(piece: Piece) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return numbers of elements (r,) and of points (r,), and stresses (r, 6), of the lines of a piece."""
    table, lines = numbers(piece, 8, commas=False)
    piece.require(np.isfinite(table).all(axis=1), lines, "an element, a point and six finite stresses")
    element = labels(piece, table[:, 0], lines, "the number of an element")
    point = whole(piece, table[:, 1], lines, "the number of an integration point", 1, MOST_POINTS - 1)
    return element, point, table[:, IN_ORDER]
