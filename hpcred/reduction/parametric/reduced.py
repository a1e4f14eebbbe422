"""Define the reduced model whose matrices depend on parameters as those of the full model do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...linalg.eigensolver import congruent, graded_eigenpairs
from ...linalg.pencil import massless_last
from ...model.damping import Caughey, GivenDamping, ModalDamping, Rayleigh, caughey_terms
from ...model.operator import Operator, in_coordinates
from ...model.parameters.definitions import Parameter, checked_values
from ...model.parameters.expressions import Expression
from ..result.reduced_model import ReducedModel
from ..run.projection import project, project_columns
from ..small.damping import reduced_damping
from .singular import factor_of_mass


@dataclass(frozen=True, eq=False)
class ReducedTerm:
    """A term of a reduced model with parameters.

    Attributes
    ----------
    of : str
        "M", "D", "K", "B" or "C".
    factor : str
        An expression of the parameters.
    matrix : ndarray
        (m, m) of M, D or K, (m, p) of B, (r, m) of C.
    """

    of: str
    factor: str
    matrix: np.ndarray = field(repr=False)

    def __post_init__(self):
        object.__setattr__(self, "expression", Expression(self.factor))


def with_terms(constant: Mapping[str, np.ndarray], terms, values: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Return matrices by name with the terms that join them at values of the parameters."""
    matrices = dict(constant)
    for term in terms:
        matrices[term.of] = matrices[term.of] + term.expression.at(values) * term.matrix
    return matrices


@dataclass(frozen=True, eq=False, repr=False)
class ParametricReducedModel(ReducedModel):
    """A reduced model for all values of some parameters in their ranges; by itself it is that at the reference values.

    A(p) = A + sum theta_k(p) A_k as in the full model, in the coordinates of the model at the reference. Viscoelastic
    parts do not depend on parameters.

    Attributes
    ----------
    parameters : tuple of Parameter
        Names and ranges.
    constant : dict of ndarray
        M, D, K (m, m), B (m, p) and C (r, m) without the terms, by name, and Cv, Ca where outputs are velocities or
        accelerations.
    terms : tuple of ReducedTerm
        What joins them.

    Notes
    -----
    The other attributes are those of ReducedModel.
    """

    parameters: tuple[Parameter, ...] = ()
    constant: dict[str, np.ndarray] = field(default_factory=dict)
    terms: tuple[ReducedTerm, ...] = ()

    @classmethod
    def of(cls, reduced: ReducedModel, **more: Any) -> ParametricReducedModel:
        """Return the model that is a `reduced` one at the reference values; `more`: parameters, constant and terms."""
        return cls(**{attribute.name: getattr(reduced, attribute.name) for attribute in fields(ReducedModel)}, **more)

    @property
    def base(self) -> ReducedModel:
        """The model at the reference values, V^T M V = I and V^T K V diagonal, which shares the basis."""
        return ReducedModel(**{attribute.name: getattr(self, attribute.name) for attribute in fields(ReducedModel)})

    @property
    def reference(self) -> dict[str, float]:
        """Reference values of the parameters by name."""
        return checked_values(self.parameters, {})

    @property
    def damping_follows(self) -> bool:
        """Whether D is made from the eigenfrequencies at each value, so that it is no sum of terms."""
        changes = any(term.of in "MK" for term in self.terms)
        return changes and _follows_frequencies(None if self.record is None else self.record.damping)

    def matrices(self, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Return M, D, K, B, C (Cv, Ca) at values of the parameters, in the coordinates of the model at the reference.

        Raises InputError for other names, and values outside of the ranges.
        """
        values = checked_values(self.parameters, values)
        matrices = with_terms(self.constant, self.terms, values)
        damping = None if self.record is None else self.record.damping
        if _follows_frequencies(damping):
            modes = _modes(matrices, values, self.base)
            elastic = slice(self.rigid_size, None)  # the others damping models leave alone
            stiffness, mass = (np.diag(projected[elastic]) for projected in (modes.stiffnesses, modes.masses))
            back = np.linalg.inv(modes.X).T[:, elastic]
            matrices["D"] = back @ reduced_damping(damping, stiffness, modes.frequencies[elastic], mass) @ back.T
        return matrices

    def turn(self, values: Mapping[str, float]) -> np.ndarray:
        """Return X (m, m) of the coordinates x = X z of the model at values of the parameters: X^T M X = I, but for
        coordinates without mass, and X^T K X diagonal; the identity in interface coordinates."""
        matrices = self.matrices(values)
        if self.interfaces:
            return np.eye(self.size)
        return _modes(matrices, checked_values(self.parameters, values), self.base).X

    def at(self, **values: float) -> ReducedModel:
        """Return the model at values of the parameters, in pseudo-modal coordinates of its own (see turn).

        Parameters
        ----------
        **values : float
            By name, in their ranges; parameters that are not named have their reference values.

        Returns
        -------
        ReducedModel
            Without a basis: its columns are those of this model times turn().

        Raises
        ------
        InputError
            For other names, and values outside of the ranges.
        """
        matrices: dict[str, Any] = self.matrices(values)
        modes, base = _modes(matrices, checked_values(self.parameters, values), self.base), self.base
        X = modes.X
        if not self.interfaces:
            outputs = {key: matrices[key] @ X for key in ("C", "Cv", "Ca") if key in matrices}
            skew = (matrices["K"] - matrices["K"].T) / 2  # none of symmetric parts, which are so exactly
            operator = Operator.of(np.diag(modes.masses), X.T @ matrices["D"] @ X,
                                   np.diag(modes.stiffnesses) + X.T @ skew @ X, self.added.projected(X))  # fmt: skip
            matrices = {"operator": operator, "B": X.T @ matrices["B"], **outputs}
        if any(term.of == "B" for term in self.terms) and checked_values(self.parameters, values) != self.reference:
            matrices["resultants"] = None  # those of the columns at the reference
        record = base.record
        if record is not None and checked_values(self.parameters, values) != self.reference:
            record = record.away_from_reference()
        return replace(base, **matrices, frequencies=modes.frequencies, columns=None, left_columns=None, model=None,
                       record=record)  # fmt: skip

    def in_coordinates(self, T: np.ndarray, **changed) -> ReducedModel:
        """Return the model in coordinates z (k,) with x = T z, at all values, and further fields."""
        constant = {of: in_coordinates(of, matrix, T) for of, matrix in self.constant.items()}
        terms = tuple(replace(term, matrix=in_coordinates(term.of, term.matrix, T)) for term in self.terms)
        return super().in_coordinates(T, **{"constant": constant, "terms": terms} | changed)

    def to_pymor(self) -> Any:
        """Return the model for all values of the parameters: see ReducedModel.to_pymor."""
        from ..result.to_pymor import parametric_pymor_model

        return parametric_pymor_model(self)

    def transfer_function(self, s: complex | np.ndarray, **values: float) -> np.ndarray:
        """Return H(s) (r, p) at `values` of the parameters by name; (..., r, p) for an array (...) of s in 1/s."""
        if not values:  # what was replaced in this one counts
            return self.base.transfer_function(s)
        return replace(self.base, **self.matrices(values)).transfer_function(s)

    def frequency_response(self, frequencies: ArrayLike, **values: float) -> np.ndarray:
        """Return H(i omega) at `frequencies` in Hz and at values of the parameters, (F, r, p)."""
        return (self.at(**values) if values else self.base).frequency_response(frequencies)


def projected_parts(parametric, reduced: ReducedModel, damping) -> dict:
    """Return the `constant` parts and the `terms` of a reduced model from its basis. Collective."""
    model, columns = parametric.model, reduced.columns
    comm, small = model.comm, {}
    square = {"M": model.M, "K": model.K}
    if isinstance(damping, GivenDamping):
        square["D"] = model.D
    for key, mat in square.items():
        small[key] = _projected(mat, columns, model.is_symmetric(key))
    small["B"] = project_columns(columns, model.B)
    small["C"] = (small["B"] if model.Ct is None else project_columns(columns, model.Ct)).T.copy()
    small |= model.rates.of(small["C"])
    terms = []
    for term, symmetric in zip(parametric.terms, parametric.symmetric_terms, strict=True):
        if term.of in "MDK":
            terms.append((term.of, term.factor, _projected(term.matrix, columns, symmetric)))
        else:
            small_term = project_columns(columns, term.matrix)
            terms.append((term.of, term.factor, small_term if term.of == "B" else small_term.T.copy()))
            if term.of == "B" and model.Ct is None:
                terms.append(("C", term.factor, small_term.T.copy()))
    small.setdefault("D", _proportional(small["M"], small["K"], damping, reduced))
    if coefficients := _of_matrices(damping):
        of = dict(zip("MK", coefficients, strict=True))
        terms += [("D", factor, of[key] * matrix) for key, factor, matrix in terms if of.get(key)]
    small, terms = comm.bcast((small, terms))
    return {"constant": small, "terms": tuple(ReducedTerm(*term) for term in terms)}


def _projected(mat, columns, symmetric):
    """Return V^T A V (m, m), exactly symmetric where A is `symmetric` but for round-off."""
    small = project(mat, columns)
    return (small + small.T) / 2 if symmetric else small


def _of_matrices(damping):
    """Return the coefficients of M and K in D, None where D is no combination of them."""
    if not isinstance(damping, Rayleigh | Caughey) or caughey_terms(damping) is not None:
        return None
    return (*damping.coefficients, 0.0)[:2]


def _proportional(M, K, damping, reduced):
    if coefficients := _of_matrices(damping):
        # rigid-body motion in interface coordinates is without damping
        return reduced.D + coefficients[0] * (M - reduced.M) + coefficients[1] * (K - reduced.K)
    return reduced.D if _follows_frequencies(damping) else np.zeros_like(K)


def _follows_frequencies(damping):
    """Test whether D is made from the eigenfrequencies of the reduced model."""
    return isinstance(damping, ModalDamping) or (isinstance(damping, Caughey) and caughey_terms(damping) is not None)


class _Modes(NamedTuple):
    """X (m, m) that makes M and K diagonal, both diagonals (m,), and frequencies (m,) in Hz; masses are 1, or 0."""

    X: np.ndarray
    masses: np.ndarray
    stiffnesses: np.ndarray
    frequencies: np.ndarray


def _modes(matrices, values, base) -> _Modes:
    """Return the modes of the matrices at values of the parameters; `base`: the model at the reference, of whose
    coordinates some may have no mass. Raises InputError where M is singular for others."""
    M, K = ((matrices[key] + matrices[key].T) / 2 for key in "MK")
    without = ~base.M.any(axis=0)
    if without.any():
        tau = np.diag(base.K)[without].max() ** -0.5
        squares, X, static = massless_last(K, M, tau)
        masses = np.where(np.arange(len(K)) < len(K) - static, 1.0, 0.0)
        stiffnesses = np.where(masses > 0, squares, tau**-2)
    else:
        inverse = np.linalg.inv(factor_of_mass(M, values, np.diag(base.M)))
        squares, vectors = graded_eigenpairs(congruent(K, inverse.T))
        X, masses, stiffnesses = inverse.T @ vectors, np.ones(len(K)), squares
    X = np.where(X[np.abs(X).argmax(axis=0), np.arange(len(X))] < 0.0, -X, X)
    return _Modes(X, masses, stiffnesses, np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi))
