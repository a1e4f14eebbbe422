"""Read the displacements and stresses of all steps that a finite-element program computed, at nodes."""

from dataclasses import dataclass

import numpy as np

from ...files.system_errors import damaged_file
from ...files.text import first_bytes
from ...parallel.failures import InputError, agreed
from ..ansys import rst
from ..calculix import frd
from ..nastran import op2
from . import ansys_rst, calculix_dat, calculix_frd, nastran_op2, nastran_punch

FORMATS = (
    (frd.begins, calculix_frd.read, "CalculiX, means at nodes in .frd"),
    (calculix_dat.begins, calculix_dat.read, "CalculiX, points of elements in .dat, means at nodes"),
    (rst.begins, ansys_rst.read, "ANSYS, means at corner nodes in .rst"),
    (nastran_punch.begins, nastran_punch.read, "Nastran, means at corner nodes in the punch file"),
    (op2.begins, nastran_op2.read, "Nastran, means at corner nodes in OUTPUT2"),
)
# what damaged places and numbers of a binary file end in
DAMAGES = (ArithmeticError, LookupError, TypeError, ValueError)
LARGEST = 1e100  # of displacements and stresses in any units


@dataclass(frozen=True)
class Answers:
    """Displacements (steps, s, 3) and stresses (steps, s, 6), xx, yy, zz, xy, yz, zx, at nodes (s,) of this rank, in
    the units of the file; `source`: what made them."""

    node: np.ndarray
    displacement: np.ndarray
    stress: np.ndarray
    source: str


def read_answers(path, comm) -> Answers:
    """Read the results of a program by its format. Collective. Raises InputError."""
    with agreed(comm):
        start = first_bytes(path)
        known = [entry for entry in FORMATS if entry[0](start)]
        if not known:
            raise InputError(f"{path}: found no results of a known program, expected a .frd or .dat file of CalculiX, "
                             "a .rst file of ANSYS, a punch file of Nastran, or its OUTPUT2")  # fmt: skip
    _, read, source = known[0]
    try:
        with np.errstate(all="ignore"):  # numbers that are none are refused below
            answers = Answers(*read(path, comm), source)
    except DAMAGES as error:
        if isinstance(error, InputError):
            raise
        raise damaged_file(path, f"records that do not fit each other ({error})") from error
    with agreed(comm):
        for quantity in ("displacement", "stress"):
            if not (np.abs(getattr(answers, quantity)) <= LARGEST).all():
                raise damaged_file(path, f"a {quantity} that is no number, or none of a body")
    return answers
