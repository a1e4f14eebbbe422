"""Read the stresses at integration points that CalculiX prints into a .dat file by *EL PRINT with S."""

from __future__ import annotations

import re

import numpy as np

from ...files.text import Piece, pieces
from ...files.text_numbers import numbers
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
            text = TITLE.sub(b"", piece.text)
            table, _ = numbers(Piece(path, text, piece.start), 8)
            parts.append((table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, IN_ORDER]))
        element, point, stress = joined(parts, (np.int64, np.int64, float))
    stress = stress.reshape(-1, 6)
    found = sorted(set().union(*comm.allgather(times)))
    if len(found) != 1:
        listed = ", ".join(time.decode(errors="replace") for time in found) or "none"
        raise InputError(f"{path}: found stresses of the times {listed}, expected those of one")
    return element, point, stress
