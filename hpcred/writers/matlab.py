"""A .mat file of a Body for MATLAB, Octave and Neweul-M2: the arrays of writers.body_npz under the same names.

Lists of names are cell arrays.
"""

from __future__ import annotations

from scipy.io import savemat

from ..body.body import Body, remarks
from ..files.outputs import MATLAB
from .base import Writer
from .body_npz import arrays_of


def write_matlab(path, body: Body) -> list[str]:
    """Write all arrays of a body; call it on one rank. Returns remarks on what is approximated."""
    save_mat(path, arrays_of(body))
    return remarks(body)


def save_mat(path, arrays: dict):
    """Write arrays by name, lists of texts as cell arrays; call it on one rank."""
    cells = {key: value.astype(object) if value.dtype.kind == "U" and value.ndim else value
             for key, value in arrays.items()}  # fmt: skip
    with open(path, "wb") as file:
        savemat(file, cells, oned_as="column")


class MatFile(Writer):
    """Arrays of a body for MATLAB."""

    suffix, needs, kind = ".mat", "body", MATLAB

    def write(self, target, source):
        return write_matlab(target, source.body)
