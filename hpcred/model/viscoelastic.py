"""Give a model stiffness that depends on frequency, K(s) = K_e + sum g(s) K_v, as terms of its operator.

A model holds the static stiffness K = K_e + sum g(0) K_v, and what its parts add to it, (g(s) - g(0)) K_v.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..linalg.csr import assembled
from ..linalg.matrix_estimates import extreme_quotients, symmetry_defect
from ..parallel.declared import declared
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import PETSc
from .checked_arrays import check_finite, coordinates
from .laws.registry import AnyLaw
from .operator import KEY, Operator, Term
from .outputs.cuts import cut_output_of, cuts_refused
from .petsc_matrices import taken

if TYPE_CHECKING:
    from scipy.sparse import sparray, spmatrix

SYMMETRIC_TO, NEGATIVE = 1e-10, 1e-7  # symmetry defect of K_v; x^T K_v x of its diagonal, by round-off of files


@dataclass(frozen=True, eq=False)
class Viscoelastic(Term):
    """A part of a body with a stiffness that depends on frequency, g(s) K_v.

    Parameters
    ----------
    matrix : SciPy sparse matrix, ndarray or PETSc.Mat, shape (n, n)
        K_v, symmetric and positive semidefinite.
    law : Maxwell, Fractional or FractionalKelvinVoigt
        g(s).
    name : str, default ""
        Name in messages and records, by default "Kv1", "Kv2" and so on.
    within : bool, default False
        Whether K of the model has K_v already, as that of elements with the modulus of their material, for which g is
        1; K_e is K - K_v then.

    Raises
    ------
    InputError
        For what is no law.
    """

    matrix: spmatrix | sparray | np.ndarray | PETSc.Mat
    within: bool = False

    def __post_init__(self):
        object.__setattr__(self, "law", declared("law", self.law, AnyLaw))
        object.__setattr__(self, "name", declared("name", self.name, str))


def with_viscoelastic(model, parts):
    """Return the model, whose K is K_e, with viscoelastic parts; see SecondOrderModel.with_viscoelastic. Collective.
    Raises InputError."""
    parts = tuple(declared("parts", parts, tuple[Viscoelastic | Term, ...]))  # terms: of a file
    if model.added:
        raise InputError(f"{model.name}: it has viscoelastic parts already; give all of them at once")
    if not parts:
        return model.shared()
    if any(cut_output_of(name) for name in model.own_output_names):
        raise cuts_refused(model, Operator.of(added=parts))
    named = tuple(replace(term, name=term.name or f"{KEY}{number}") for number, term in enumerate(parts, 1))
    names = [term.name for term in named]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"{model.name}: found two viscoelastic parts with the name '{twice}', expected one of each "
                         "name; give another one a name of its own")  # fmt: skip
    matrices = {f"{KEY}{number}": _of_rows(model, term.matrix, term.name) for number, term in enumerate(named, 1)}
    mats, _ = taken(model.operator.matrices | matrices, None, model.name)
    operator = Operator.of(added=named).with_matrices(mats)
    K = mats["K"].copy()
    for term in operator.added:
        _check(model, term)
        if missing := term.law.static - getattr(term, "within", False):
            K.axpy(missing, term.matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    K.stateIncrease()
    return model.with_fields(operator=operator.with_matrices(mats | {"K": K}))


def _of_rows(model, matrix, name) -> PETSc.Mat:
    """Return a matrix that every rank has as one with the rows of the model; PETSc's stays as it is. Collective."""
    if isinstance(matrix, PETSc.Mat):
        return matrix
    with agreed(model.comm):
        i, j, v, size = coordinates(name, matrix)
        if size != model.size:
            raise InputError(f"{name}: found {size} rows of K_v, expected {model.size} as K of {model.name} has")
    first, last = model.K.getOwnershipRange()
    mine = (i >= first) & (i < last) & (v != 0)
    return assembled(model.K, i[mine], j[mine], v[mine])


def _check(model, term):
    """Refuse a K_v that is not symmetric and positive semidefinite, or has no numbers. Collective."""
    with agreed(model.comm):
        indptr, _, values = term.matrix.getValuesCSR()
        check_finite(indptr, {term.name: values}, model.first_row, model.name, model.dofs)
    if not term.matrix.norm(PETSc.NormType.FROBENIUS) > 0:
        raise InputError(f"{term.name}: K_v is zero, expected the stiffness of the viscoelastic parts of {model.name}")
    if (defect := symmetry_defect(term.matrix)) > SYMMETRIC_TO:
        raise InputError(
            f"{term.name}: found an unsymmetric K_v (a_ij and a_ji differ by {defect:.1e} of them), expected a "
            "symmetric one, as stiffness of a material is"
        )
    low, high = extreme_quotients(term.matrix)
    if low < -NEGATIVE * max(high, 1.0):
        raise InputError(
            f"{term.name}: x^T K_v x comes down to {low:.1e} of its diagonal, expected none below zero: K_v would put "
            "energy in"
        )
