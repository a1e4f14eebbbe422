"""Compute digests of the contents of a model: the same on any number of ranks and in both builds of PETSc."""

import numpy as np

from ..parallel.digest import digest, digest_of_block
from ..parallel.petsc import MPI


def digest_of(model, key: str) -> str:
    """Return the digest that SecondOrderModel.digest_of keeps. Collective."""
    first = model.first_row
    if key in ("dofs", "labels"):
        labels = [model.dofs.node, model.dofs.direction, *([model.dofs.position] if key == "dofs" else [])]
        return digest_of_block(model.comm, first, np.column_stack(labels).astype("<f8"))
    item = model.matrices[key] if key in model.matrices else getattr(model, key)
    if key in ("B", "Ct"):
        columns = np.ascontiguousarray(item.getDenseArray().real, "<f8") + 0.0
        return digest_of_block(model.comm, first, _rounded(model, columns) if model.interfaces else columns)
    indptr, indices, values = item.getValuesCSR()
    number = "<u4" if model.size < 2**32 else "<u8"
    # adding zero makes -0.0 the same as 0.0
    return digest(model.comm, first, [(indptr, indices.astype(number)), (indptr, values.real.astype("<f8") + 0.0)])


def _rounded(model, columns):
    """Return columns without the last digits, which depend on the number of ranks where interface nodes made them."""
    most = np.zeros(columns.shape[1])
    model.comm.Allreduce(np.abs(columns).max(axis=0, initial=0.0), most, MPI.MAX)
    # by pi, since what comes of a division by 2, 4, 8, ... lies between two decimals
    return np.round(columns * (np.pi * 1e7 / np.where(most > 0, most, 1.0))).astype("<i8")
