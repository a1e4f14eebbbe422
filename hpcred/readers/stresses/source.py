"""Read the displacements and stresses of all steps that a finite-element program computed, at nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...files.text import first_bytes
from ...parallel.failures import InputError, agreed
from ..calculix import frd
from . import calculix_frd


@dataclass(frozen=True)
class Answers:
    """Stresses of steps at nodes of this rank.

    Attributes
    ----------
    node : ndarray of int, shape (s,)
    displacement : ndarray, shape (steps, s, 3)
    stress : ndarray, shape (steps, s, 6)
        xx, yy, zz, xy, yz, zx, in the units of the file.
    source : str
        What made them.
    """

    node: np.ndarray
    displacement: np.ndarray
    stress: np.ndarray
    source: str


def read_answers(path, comm) -> Answers:
    """Read the results of a program by its format. Collective. Raises InputError."""
    with agreed(comm):
        if not frd.begins(first_bytes(path)):
            raise InputError(f"{path}: found no results of a known program, expected a .frd file of CalculiX")
    return Answers(*calculix_frd.read(path, comm), "CalculiX, means at nodes in .frd")
