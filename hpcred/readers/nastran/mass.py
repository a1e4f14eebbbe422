"""Read the mass that a Nastran run reports, to check a mass matrix from a file without end mark."""

from __future__ import annotations

import re

import numpy as np

from ...files.text import open_unpacked
from ...parallel.decisions import decided
from ...parallel.failures import InputError
from ..entries import STRIDE, LabelledEntries
from .bulk import beside

WEIGHT = re.compile(rb"MASS AXIS SYSTEM \(S\)[^\n]*\n[ \t]*X[ \t]+(?P<mass>[-+\d.]+E[-+]\d+)")  # of GRDPNT in an .f06
LONGEST = 2**30  # bytes of a listing that is looked at
SAME = 0.01


def compare_mass(comm, path, deck, M: LabelledEntries) -> list[str]:
    """Compare the mass of M, without supports, with a listing or point masses; InputError if less. Collective."""
    same = (M.rows % STRIDE == M.columns % STRIDE) & (M.rows % STRIDE < 3)
    found = float(max(comm.allreduce(np.bincount(M.rows[same] % STRIDE, M.values[same], 3))))  # in x, y, z
    told, source = decided(comm, _told, path)
    exact = told is not None
    if not exact:
        told, source = deck.point_mass, f"the CONM2 of {deck.path} sum up to"
    told *= deck.mass_unit
    if found < (1 - SAME) * told:
        raise InputError(
            f"{path}: found a mass of {found:.6g} in M, while {source} {told:.6g}; the file is cut off, or of another "
            "run: export it again"
        )
    if exact and found > (1 + SAME) * told:
        return [f"{path}: M has a mass of {found:.6g}, while {source} {told:.6g}; the two are of different runs"]
    return [f"{path}: the mass of M, {found:.6g}, is what {source}"] if exact else []


def _told(path):
    """Return the mass of the grid point weight generator in a listing of the same name, and words for it, or None."""
    for file in beside(path):
        if file.suffix.lower() == ".f06":
            with open_unpacked(file) as text:
                masses = {float(match["mass"]) for match in WEIGHT.finditer(text.read(LONGEST))}
            if len(masses) == 1:
                return masses.pop(), f"the grid point weight in {file} says"
    return None, None
