"""A .mat file of a Body for MATLAB, Octave and Neweul-M2: the arrays of formats.body_npz under the same names.

Lists of names are cell arrays.
"""

from __future__ import annotations

from scipy.io import savemat

from ..multibody.body import Body, remarks
from .body_npz import arrays_of


def write_matlab(path, body: Body) -> list[str]:
    """Write all arrays of a body; call it on one rank. Returns remarks on what is approximated."""
    arrays = {key: value.astype(object) if value.dtype.kind == "U" and value.ndim else value
              for key, value in arrays_of(body).items()}  # fmt: skip
    with open(path, "wb") as file:
        savemat(file, arrays, oned_as="column")
    return remarks(body)
