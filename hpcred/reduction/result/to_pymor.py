"""Make a reduced model a model of pyMOR, which is imported here alone; parameters stay parameters."""

from __future__ import annotations

import re

import numpy as np

from ...model.from_pymor import refuse_event_loop
from ...parallel.failures import InputError
from .maxwell_states import with_maxwell_states

NAMES = re.compile(r"(?<![\w.])[A-Za-z]\w*")  # not the exponent of a number
RESERVED = {"s", "t", "input"}  # names of pyMOR's own parameters


def _pymor():
    """Return the classes of pyMOR that are used. Raises InputError."""
    refuse_event_loop("to_pymor")
    try:
        from pymor.models.iosys import SecondOrderModel
        from pymor.operators.constructions import LincombOperator
        from pymor.operators.numpy import NumpyMatrixOperator
        from pymor.parameters.functionals import ExpressionParameterFunctional
    except ImportError as error:
        raise InputError(f"to_pymor: pyMOR is missing ({error}); install it by `pip install pymor`") from error
    return SecondOrderModel, LincombOperator, NumpyMatrixOperator, ExpressionParameterFunctional


def pymor_model(reduced, state_space):
    """Return pyMOR's SecondOrderModel of a ReducedModel, by the function `state_space`. Raises InputError."""
    model, *_ = _pymor()
    arrays = state_space(reduced)  # which refuses structural damping
    keys = ("mass", "damping", "stiffness", "input_matrix", "output_matrix")
    *matrices, Cp = (arrays[key] for key in keys)
    if reduced.displaces.all():
        return model.from_matrices(*matrices, Cp)
    # no acceleration of a coordinate without mass comes so far
    Cv, by_mass = arrays.get("velocity_matrix", 0.0), reduced.output_parts[2] @ np.linalg.pinv(reduced.M)
    D, K = (mat[: reduced.size] for mat in matrices[1:3])  # states of added terms come after the coordinates
    return model.from_matrices(*matrices, Cp - by_mass @ K, Cv - by_mass @ D, arrays["D"])


def parametric_pymor_model(reduced):
    """Return pyMOR's SecondOrderModel of a ParametricReducedModel, a linear combination for each matrix that depends
    on parameters. Raises InputError."""
    model, lincomb, matrix, functional = _pymor()
    names = [parameter.name for parameter in reduced.parameters]
    at = "; take rom.at(...).to_pymor(), of one set of values"
    if reduced.damping_follows:
        raise InputError(f"to_pymor: found damping that follows the eigenfrequencies, which is no sum of terms{at}")
    if reduced.loss_factor:
        raise InputError(f"to_pymor: found structural damping, expected viscous or none{at}")
    if reduced.constant.get("Ca") is not None:
        raise InputError(f"to_pymor: found outputs that are accelerations, which are no sum of terms in pyMOR{at}")
    if taken := RESERVED.intersection(names):
        raise InputError(f"to_pymor: found the parameter '{sorted(taken)[0]}', a name that pyMOR uses itself{at}")
    if reduced.added:
        reduced, _ = with_maxwell_states(reduced)
    operators = {}
    for key, constant in reduced.constant.items():
        terms = [term for term in reduced.terms if term.of == key]
        factors = []
        for term in terms:
            text = NAMES.sub(lambda word: word[0] + "[0]" * (word[0] in names), term.factor)
            used = dict.fromkeys(term.expression.names, 1)
            factors.append(functional(text.strip().replace("^", "**"), used, name=term.factor) if used
                           else term.expression.at({}))  # fmt: skip
        summands = [matrix(array) for array in (constant, *(term.matrix for term in terms))]
        operators[key] = lincomb(summands, [1.0, *factors]) if terms else summands[0]
    return model(*(operators[key] for key in "MDKBC"), operators.get("Cv"))
