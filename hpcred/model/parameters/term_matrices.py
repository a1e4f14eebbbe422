"""Take over the matrices of terms in the row layout of their model. Errors are InputErrors."""

from __future__ import annotations

import numpy as np

from ...linalg.blocks import dense_matrix
from ...linalg.csr import assembled
from ...parallel.failures import InputError, agreed
from ...parallel.petsc import PETSc
from ..checked_arrays import coordinates, real_columns, real_values
from ..petsc_matrices import as_aij

FIELD = {"M": "M", "D": "D", "K": "K", "B": "B", "C": "Ct"}  # of SecondOrderModel


def term_matrix(model, term) -> PETSc.Mat:
    """Return the matrix of a term: AIJ, or dense for B and C^T. Collective. Raises InputError."""
    where = f"term of {term.of}, factor '{term.factor}'"
    columns = term.of in ("B", "C")
    like = getattr(model, FIELD[term.of]) if columns else model.K
    if like is None:
        lacking = "no inputs" if term.of == "B" else "the inputs as outputs, C = B^T"
        raise InputError(f"{where}: {model.name} has {lacking}; give it {'inputs' if term.of == 'B' else 'outputs'} "
                         "before its terms")  # fmt: skip
    shape = like.getSize()
    if isinstance(term.matrix, PETSc.Mat):
        return _of_petsc(model.K, term.matrix, shape, where, columns)
    first, last = model.K.getOwnershipRange()
    if columns:
        matrix = term.matrix if hasattr(term.matrix, "tocsr") else np.asarray(term.matrix)
        matrix = matrix.T if term.of == "C" and matrix.ndim == 2 else matrix
        _check_shape(where, matrix.shape, shape)
        return dense_matrix(model.K, real_columns(matrix, model.size, where)[first:last])
    i, j, v, size = coordinates(where, term.matrix)
    _check_shape(where, (size, size), shape)
    _check_finite(where, v)
    mine = (i >= first) & (i < last)
    return assembled(model.K, i[mine], j[mine], v[mine])


def _of_petsc(like, mat, shape, where, columns):
    """Return a reference to a PETSc matrix, or a copy of the type that is needed."""
    with agreed(like.comm.tompi4py()):
        if not mat.assembled:
            raise InputError(f"{where}: the matrix is not assembled; call assemble() before")
        _check_shape(where, mat.getSize(), shape)
        if mat.getOwnershipRange() != like.getOwnershipRange():
            raise InputError(
                f"{where}: this rank has the rows {mat.getOwnershipRange()} of it, but the rows "
                f"{like.getOwnershipRange()} of the model; expected one layout"
            )
    mat = mat.convert("dense", PETSc.Mat()) if columns else as_aij(mat, where)
    with agreed(like.comm.tompi4py()):
        values = mat.getDenseArray(readonly=True) if columns else mat.getValuesCSR()[2]
        _check_finite(where, real_values(values, where))
    return mat


def _check_finite(where, values):
    if not np.isfinite(values).all():
        raise InputError(f"{where}: found NaN or Inf, expected finite numbers")


def _check_shape(where, found, expected):
    """The shapes of C^T are those of a matrix with rows of the model."""
    if tuple(found) != tuple(expected):
        found = " x ".join(map(str, found))
        raise InputError(f"{where}: found a matrix of {found}, expected {expected[0]} x {expected[1]}, as that of the "
                         "model")  # fmt: skip
