"""Split a reduced model into the parts that an FMU adds up by its parameters, and write their factors in C."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..model.parameters.definitions import Parameter
from ..model.parameters.expressions import in_c
from ..reduction.parametric.reduced import ParametricReducedModel
from ..reduction.result.massless import static_coordinates
from ..reduction.result.parameter_accuracy import in_words
from ..reduction.result.reduced_model import ReducedModel


@dataclass(frozen=True)
class Family:
    """`constant` and `terms`: models with K, D, B and C of the parts, and M of the reduced model; `factors` of the
    terms; `feedthrough` (r, p): of inputs to outputs that no state has part in."""

    constant: ReducedModel
    parameters: tuple[Parameter, ...] = ()
    terms: tuple[ReducedModel, ...] = ()
    factors: tuple = ()
    remarks: tuple[str, ...] = ()
    feedthrough: np.ndarray | None = None

    @classmethod
    def of(cls, parametric: ParametricReducedModel | None, reduced: ReducedModel) -> Family:
        """Return the parts of a model that is `reduced` at the reference values, perhaps with further outputs, whose
        rows do not depend on parameters; `reduced` alone for None, and where its mass does, its damping is no sum of
        terms, or coordinates without mass were eliminated."""
        if parametric is None:
            return cls(reduced)
        what = "mass" if any(item.of == "M" for item in parametric.terms) else "damping"
        without = bool(static_coordinates(parametric))
        if without:
            what, how = "motion of coordinates without mass", "follows forces by the stiffness at each value"
        elif what == "mass" or parametric.damping_follows:
            how = "depends on parameters" if what == "mass" else "follows the eigenfrequencies at each value"
        if without or what == "mass" or parametric.damping_follows:
            remark = f"the {what} {how}: at {in_words(parametric.reference)}; --at takes others"
            return cls(reduced, remarks=(remark,))
        known = {key: parametric.constant[key] for key in "KDB"}
        outputs = np.vstack([parametric.constant["C"], reduced.C[len(parametric.C) :]])
        terms = []
        for item in parametric.terms:
            part = {key: np.zeros_like(array) for key, array in (known | {"C": outputs}).items()}
            part[item.of][: len(item.matrix)] = item.matrix
            terms.append(replace(reduced, **part, Cv=None if reduced.Cv is None else np.zeros_like(reduced.Cv)))
        factors = tuple(item.expression for item in parametric.terms)
        return cls(replace(reduced, **known, C=outputs), parametric.parameters, tuple(terms), factors)

    def in_c(self) -> list[str]:
        """Return the limits of the parameters, and the function `factors`."""
        if not self.parameters:
            return []
        limits = {
            "reference_values": [item.reference for item in self.parameters],
            "lowest_values": [item.range[0] for item in self.parameters],
            "highest_values": [item.range[1] for item in self.parameters],
        }  # fmt: skip
        lines = [f"static const double {key}[PARAMETERS] = {{{', '.join(f'{value:.17g}' for value in values)}}};"
                 for key, values in limits.items()]  # fmt: skip
        places = {item.name: f"p[{k}]" for k, item in enumerate(self.parameters)}
        return [
            *lines, "", "static void factors(const double *p, double *theta)", "{",
            *(f"    theta[{k}] = {in_c(item, places)};" for k, item in enumerate(self.factors, 1)), "}",
        ]  # fmt: skip
