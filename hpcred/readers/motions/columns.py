"""Read the lines of numbers below the head of a text, to their last character."""

import numpy as np

from ...files.text import is_cut_line, pieces, refuse_packed
from ...files.text_numbers import ragged
from ...parallel.failures import InputError
from ...parallel.petsc import MPI


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
