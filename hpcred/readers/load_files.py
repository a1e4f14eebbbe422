"""Read load vectors from files: columns of matrices."""

from __future__ import annotations

import numpy as np

from ..model.loads import GivenLoad
from ..parallel.declared import declared
from ..parallel.failures import InputError
from .assembly import read_columns


def read_load_column(model, load: GivenLoad) -> np.ndarray:
    """Return the rows of this rank (rows,) of a column of a matrix file.

    Collective.

    Parameters
    ----------
    model : SecondOrderModel
        The model whose rows the file has.
    load : GivenLoad
        The file and the number of the column.

    Returns
    -------
    ndarray, shape (rows of this rank,)

    Raises
    ------
    InputError
        For files that cannot be read or do not fit the model, and columns that do not exist.
    """
    declared("load", load, GivenLoad)
    local = read_columns(model.comm, model.row_starts, model.size, load.file)
    if load.column > local.shape[1]:
        raise InputError(
            f"load '{load.name}': column: found {load.column}, but {load.file} has {local.shape[1]}"
        )
    return local[:, load.column - 1]
