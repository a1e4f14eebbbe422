"""Define the parameters of a model and the terms of its affine form, and check values of parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from ...parallel.declared import as_declared, declared, nearest
from ...parallel.failures import InputError
from ...parallel.ranges import ANYTHING, within
from .expressions import Expression, check_name
from .factor_ranges import possible_pole, without_value

NARROW = 1e-9  # of the values: ranges that are not wider are those of one value


@dataclass(frozen=True)
class Parameter:
    """A quantity that matrices of a model depend on.

    Parameters
    ----------
    name : str
        As in the factors of the terms: letters, digits and _.
    range : (float, float)
        The lowest and the highest value.
    reference : float, optional
        A value in the range, by default its middle: results are written at it, and it is taken where no value is given.
    unit : str, default ""
        For tables and figures.

    Raises
    ------
    InputError
        For a name that no expression can have, a range that does not ascend or is that of one value, and a reference
        outside of it.
    """

    name: str
    range: tuple[float, float]
    reference: float | None = None
    unit: str = ""

    def __post_init__(self):
        as_declared(self, "parameter.")
        check_name("parameter.name", self.name)
        where, (low, high) = f"parameter '{self.name}'", self.range
        within(f"{where}: range", self.range, ANYTHING)
        if not high - low > NARROW * max(abs(low), abs(high)):
            raise InputError(
                f"{where}: range: found {[low, high]}, expected a lower and a higher value; a parameter of one value "
                "is none: leave it out, and add its terms to the matrices"
            )
        if self.reference is None:
            object.__setattr__(self, "reference", (low + high) / 2)
        if not low <= self.reference <= high:
            raise InputError(f"{where}: reference: found {self.reference:g}, expected a value in {low:g} to {high:g}")


@dataclass(frozen=True, eq=False)
class Term:
    """One matrix of the affine form, with its factor.

    Parameters
    ----------
    of : str
        The matrix of the model that it is added to: "M", "D", "K", "B" or "C".
    matrix : SciPy sparse matrix, ndarray or PETSc.Mat
        Shape (n, n), (n, p) for B and (r, n) for C. Every rank passes the whole of a SciPy matrix or array; PETSc
        matrices have the layout of the model, and that of C is C^T (n, r).
    factor : str
        An expression of parameters, such as "omega" or "-omega^2".

    Raises
    ------
    InputError
        For other matrices of a model, and for factors that are no expressions.
    """

    of: Literal["M", "D", "K", "B", "C"]
    matrix: Any = field(repr=False)
    factor: str

    def __post_init__(self):
        as_declared(self, "term.", keys=("of", "factor"))
        object.__setattr__(self, "expression", Expression(self.factor))


def checked_values(parameters: tuple[Parameter, ...], values: Mapping[str, float]) -> dict[str, float]:
    """Return the values of all parameters by name, references where none is given.

    Raises InputError for other names, and for values outside of the ranges.
    """
    known = {parameter.name: parameter for parameter in parameters}
    for name, value in values.items():
        if name not in known:
            raise InputError(f"parameter '{name}': there is none of this name{nearest(name, known)}; there are "
                             f"{', '.join(known)}")  # fmt: skip
        parameter, value = known[name], declared(f"parameter '{name}'", value, float)
        low, high = parameter.range
        if not low <= value <= high:
            unit = f" {parameter.unit}" if parameter.unit else ""
            raise InputError(f"parameter '{name}': found {value:g}, expected {low:g} to {high:g}{unit}, its range")
    return {parameter.name: float(values.get(parameter.name, parameter.reference)) for parameter in parameters}


def factors_of(terms, values: Mapping[str, float]) -> list[float]:
    """Return the factors of terms at values of all parameters. Raises InputError."""
    factors = []
    for term in terms:
        try:
            factors.append(term.expression.at(values))
        except InputError as error:
            raise InputError(f"term of {term.of}: {error}") from None
    return factors


def check_terms(parameters: tuple[Parameter, ...], terms):
    """Refuse parameters twice, factors and parameters that do not fit each other, and factors that have no finite value
    somewhere in the ranges."""
    names = [parameter.name for parameter in parameters]
    if not names or not terms:
        raise InputError("parameters: found no parameter, or no term; expected one of each at least")
    if len(set(names)) < len(names):
        raise InputError(f"parameters: found the names {', '.join(names)}, expected each once")
    for term in terms:
        for name in sorted(term.expression.names.difference(names)):
            raise InputError(f"term of {term.of}: factor '{term.factor}': found '{name}'{nearest(name, names)}, "
                             f"expected the parameters {', '.join(names)}")  # fmt: skip
    ranges = {parameter.name: parameter.range for parameter in parameters}
    for term in terms:
        values, fault = without_value(term.expression, ranges), f"no number of {ANYTHING[0]:g} to {ANYTHING[1]:g} at"
        if values is None:
            values, fault = possible_pole(term.expression, ranges), "a pole, or what cannot be told from one, near"
        if values is not None:
            where = ", ".join(f"{name} = {value:g}" for name, value in values.items()) or "any values"
            raise InputError(
                f"term of {term.of}: factor '{term.factor}': found {fault} {where}, expected a number in all of the "
                f"ranges ({in_words(parameters)}); change the range or the factor"
            )
    for name in names:
        if not any(name in term.expression.names for term in terms):
            raise InputError(f"parameter '{name}': found it in the factor of no term; give its terms, or leave it out")


def in_words(parameters) -> str:
    """ "omega 0 to 800 rad/s, e 1 to 2" """
    ranges = ((known.name, *known.range, known.unit) for known in parameters)
    return ", ".join(f"{name} {low:g} to {high:g} {unit}".strip() for name, low, high, unit in ranges)


def rows_of_parameters(parameters) -> list[dict]:
    """Return a row of a table for each parameter."""
    return [{"parameter": parameter.name, "lowest": parameter.range[0], "highest": parameter.range[1],
             "reference": parameter.reference, "unit": parameter.unit} for parameter in parameters]  # fmt: skip
