"""Hold a model whose matrices depend on parameters in affine form: A(p) = A + sum theta_k(p) A_k, A of M, D, K, B, C.

The constant part is a SecondOrderModel; each term is one matrix with its factor, an expression of the parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from ...linalg.csr import diagonal_of
from ...linalg.matrix_estimates import symmetry_defect
from ...parallel.as_html import as_html
from ...parallel.declared import declared
from ...parallel.failures import InputError, agreed, settle
from ...parallel.petsc import PETSc
from ..outputs.cuts import cut_output_of
from ..petsc_matrices import on_one_pattern
from ..second_order_model import SYMMETRIC_TO, UNSYMMETRIC, SecondOrderModel, listed, require_model
from .definitions import Parameter, Term, check_terms, checked_values, factors_of, in_words
from .term_matrices import FIELD, term_matrix

OF_MASS = ("gravity", "centrifugal")  # loads that are M times accelerations


@dataclass(frozen=True, eq=False, repr=False, init=False)
class ParametricModel:
    """A model M(p) q'' + D(p) q' + K(p) q = B(p) u, y = C(p) q, with A(p) = A + sum theta_k(p) A_k for each matrix.

    Parameters
    ----------
    model : SecondOrderModel
        The constant parts. The parametric model keeps references of its own.
    parameters : sequence of Parameter
    terms : sequence of Term
        Terms of C need outputs of the model; where C = B^T, it follows the terms of B.

    Raises
    ------
    InputError
        For terms whose matrices do not fit the model, factors with names that are no parameters, and parameters that
        no factor has.

    Notes
    -----
    Collective. A(p) is the model's matrix where no term is added to it. A model without damping matrix has D = 0 as the
    constant part of its terms of D. A skew-symmetric term of K declares K unsymmetric. Viscoelastic parts are
    those of the constant part: K(s, p) = K(p) + sum (g(s) - g(0)) K_v.

    Attributes
    ----------
    model : SecondOrderModel
        The constant parts, M, D and K on the common pattern of all.
    parameters : tuple of Parameter
    terms : tuple of Term
        With PETSc matrices: AIJ for M, D and K, dense for B (n, p) and C^T (n, r).

    Examples
    --------
    >>> rotor = hpcred.ParametricModel(
    ...     model, [hpcred.Parameter("omega", (0.0, 800.0), unit="rad/s")],
    ...     [hpcred.Term("D", G, "omega"), hpcred.Term("K", N, "-omega^2")])
    >>> rotor.at(omega=300.0).frequency_response([10.0])
    """

    model: SecondOrderModel
    parameters: tuple[Parameter, ...]
    terms: tuple[Term, ...]

    def __init__(self, model: SecondOrderModel, parameters: Iterable[Parameter], terms: Iterable[Term]) -> None:
        require_model(model)
        parameters = declared("parameters", parameters, tuple[Parameter, ...])
        terms = declared("terms", terms, tuple[Term, ...])
        check_terms(parameters, terms)
        if model.rates and any(term.of == "C" for term in terms):
            raise InputError(f"{model.name}: found terms of C, and outputs that are velocities or accelerations, "
                             "expected displacements")  # fmt: skip
        if model.rates.direct is not None:
            raise InputError(f"{model.name}: found absolute accelerations of a base beside parameters, expected "
                             "motions relative to the base")  # fmt: skip
        terms = tuple(replace(term, matrix=term_matrix(model, term)) for term in terms)
        square = [term.matrix for term in terms if term.of in "MDK"]
        mats = model.matrices
        if model.D is None and any(term.of == "D" for term in terms):
            mats["D"] = model.K.duplicate(copy=False)
            mats["D"].zeroEntries()
        mats, known = on_one_pattern(mats, square), model.matrices
        changed: dict[str, Any] = {key: mat for key, mat in mats.items() if mat is not known.get(key)}
        if any(term.of == "K" and _is_skew(term.matrix) for term in terms):
            changed |= UNSYMMETRIC
        if any(term.of == "M" for term in terms):
            changed["loads"] = tuple(_of_constant_mass(load) for load in model.loads)
        self._take(model.with_fields(**changed), parameters, terms)

    def _take(self, model, parameters, terms):
        if any(term.of == "K" for term in terms) and any(map(cut_output_of, model.own_output_names)):
            raise InputError(
                f"{model.name}: found terms of K, and outputs that are section forces, which would be those of the "
                "constant part of K alone; leave the outputs of cuts out, or give rows and terms of C of their own"
            )
        vars(self).update(model=model, parameters=parameters, terms=terms)

    def __enter__(self) -> ParametricModel:
        return self

    def __exit__(self, _, error, __):
        if error is not None:
            settle(self.comm, error)
        self.close()

    def close(self) -> None:
        """Free the PETSc objects. Collective."""
        self.model.close()
        for term in self.terms:
            term.matrix.destroy()

    def __repr__(self):
        """Return one line. Not collective."""
        ranges = ", ".join("{} {:g} to {:g}".format(known.name, *known.range) for known in self.parameters)
        return f"<ParametricModel of {len(self.terms)} terms over {ranges}: {self.model!r}>"

    def _repr_html_(self):
        """Return a table for notebooks. Not collective."""
        rows = [{"parameter": known.name, "from": known.range[0], "to": known.range[1]} for known in self.parameters]
        return self.model._repr_html_() + as_html(f"{len(self.terms)} terms of parameters", {}, rows)

    def __str__(self):
        """Return lines that describe the model. Collective."""
        terms = listed([f"{term.of} ({term.factor})" for term in self.terms])
        return f"{self.model}\n  parameters {in_words(self.parameters)}; terms of {terms}"

    @property
    def name(self) -> str:
        return self.model.name

    @property
    def comm(self):
        return self.model.comm

    @property
    def size(self) -> int:
        return self.model.size

    @property
    def dofs(self):
        return self.model.dofs

    @property
    def input_names(self) -> tuple[str, ...]:
        return self.model.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        return self.model.output_names

    @cached_property
    def symmetry_defects(self) -> tuple[float, ...]:
        """Symmetry defects of the terms of M, D and K in their order (see SecondOrderModel), 0 for others. Collective.
        """
        return tuple(symmetry_defect(term.matrix) if term.of in "MDK" else 0.0 for term in self.terms)

    @property
    def symmetric_terms(self) -> tuple[bool, ...]:
        """Whether the terms, in their order, are symmetric but for round-off. Collective."""
        return tuple(self.model.counts_as_symmetric(term.of, defect)
                     for term, defect in zip(self.terms, self.symmetry_defects, strict=True))  # fmt: skip

    @property
    def reference(self) -> dict[str, float]:
        """Reference values of the parameters by name."""
        return checked_values(self.parameters, {})

    def checked(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return values of all parameters by name; references for those that are not among `values`. Raises InputError
        for names that are no parameters, and values outside of their ranges."""
        return checked_values(self.parameters, values)

    def factors(self, values: Mapping[str, float]) -> list[float]:
        """Return the factors of the terms, in their order, at `values` of the parameters by name. Raises InputError."""
        return factors_of(self.terms, self.checked(values))

    def at(self, **values: float) -> SecondOrderModel:
        """Return the model at values of the parameters. Collective.

        Parameters
        ----------
        **values : float
            By name, in their ranges; parameters that are not named have their reference values.

        Returns
        -------
        SecondOrderModel
            The caller closes it.

        Raises
        ------
        InputError
            For other names, values outside of the ranges, factors that are no finite numbers, and a mass matrix with a
            negative diagonal.
        """
        values = self.checked(values)
        factors = self.factors(values)
        changed: dict[str, Any] = {"name": f"{self.name} at {', '.join(f'{k} = {v:g}' for k, v in values.items())}"}
        for term, theta in zip(self.terms, factors, strict=True):
            key = FIELD[term.of]
            if key not in changed:
                changed[key] = getattr(self.model, key).copy()
            if theta:
                changed[key].axpy(theta, term.matrix, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        if "M" in changed:
            with agreed(self.comm):
                if (lowest := diagonal_of(changed["M"]).min(initial=0.0)) < 0:
                    raise InputError(f"{changed['name']}: the mass matrix has a negative diagonal entry, {lowest:g}; "
                                     "expected none; look at the factors and ranges of the terms of M")  # fmt: skip
        if "B" in changed:
            changed["loads"] = ()  # their sums are those of the constant part
        there = self.model.with_fields(**changed)
        known = self.model.symmetry_defects
        for key in changed.keys() & {"M", "D", "K"}:  # a sum is as symmetric as its parts, however small they are in it
            there.take_symmetry(key, max(known[key], *(
                defect for term, theta, defect in zip(self.terms, factors, self.symmetry_defects, strict=True)
                if term.of == key and theta
            ), 0.0))  # fmt: skip
        return there

    def with_inputs(self, targets) -> ParametricModel:
        """Return the model with unit loads at dofs as inputs: `targets` as for with_inputs of a SecondOrderModel.
        Collective."""
        self._require_no_terms("B", "inputs")
        return self._with(self.model.with_inputs(targets))

    def with_outputs(self, targets) -> ParametricModel:
        """Return the model with other outputs: `targets` as for with_outputs of a SecondOrderModel. Collective."""
        self._require_no_terms("C", "outputs")
        return self._with(self.model.with_outputs(targets))

    def _require_no_terms(self, key, what):
        if any(term.of == key for term in self.terms):
            raise InputError(f"{self.name}: it has terms of {key}, which belong to the {what} that it has; give the "
                             "model others before its terms")  # fmt: skip

    def _with(self, model):
        """Return the same terms with another constant part, with references of its own."""
        other = object.__new__(type(self))
        other._take(model, self.parameters, tuple(replace(term, matrix=copy(term.matrix)) for term in self.terms))
        return other


def _is_skew(mat) -> bool:
    """Test whether a matrix is skew-symmetric and not zero. Collective."""
    return symmetry_defect(mat, skew=True) <= SYMMETRIC_TO < symmetry_defect(mat)


def _of_constant_mass(load):
    """Return the LoadColumn of a load, with a remark where it is made from M."""
    if load.kind not in OF_MASS:
        return load
    told = "it is that of the constant part of M, to which terms of M add nothing; give them as terms of B"
    return replace(load, remark="; ".join(filter(None, (load.remark, told))))
