"""Write and read what a result has beside the model at the reference values of its parameters: see result_file."""

import numpy as np

from ..model.parameters.definitions import Parameter
from ..parallel.failures import InputError
from ..reduction.parametric.reduced import ParametricReducedModel, ReducedTerm
from ..reduction.result.reduced_model import ReducedModel
from .checked import Array
from .hdf5 import texts

SHAPES = {"M": ("m", "m"), "D": ("m", "m"), "K": ("m", "m"), "B": ("m", "p"), "C": ("r", "m")}
OF_OUTPUTS = {"Cv": ("r", "m"), "Ca": ("r", "m")}
SCHEMA = {
    "parameters/name": Array("text", ("w",)), "parameters/unit": Array("text", ("w",)),
    "parameters/range": Array("real", ("w", 2)), "parameters/reference": Array("real", ("w",)),
    **{f"parameters/constant/{key}": Array("real", shape) for key, shape in (SHAPES | OF_OUTPUTS).items()},
    "parameters/terms/of": Array("text", ("o",)), "parameters/terms/factor": Array("text", ("o",)),
    **{f"parameters/terms/{key}": Array("real", ("?", *shape)) for key, shape in SHAPES.items()},
}  # fmt: skip


def write_parameters(file, reduced: ParametricReducedModel):
    """Write the parameters and the terms into a result that is being written. Collective."""
    for key in ("name", "unit", "range", "reference"):
        file.small(f"parameters/{key}", [getattr(entry, key) for entry in reduced.parameters])
    for key, value in reduced.constant.items():
        file.small(f"parameters/constant/{key}", value)
    for key in ("of", "factor"):
        file.small(f"parameters/terms/{key}", [getattr(entry, key) for entry in reduced.terms])
    for key in SHAPES:
        if matrices := [entry.matrix for entry in reduced.terms if entry.of == key]:
            file.small(f"parameters/terms/{key}", np.array(matrices))


def with_parameters(file, reduced: ReducedModel, path) -> ReducedModel:
    """Return the model of an open result, with its parameters if it has some. Raises InputError."""
    if "parameters" not in file:
        return reduced
    try:
        names, units, of, factors = (texts(file[f"parameters/{key}"]) for key in ("name", "unit", "terms/of",
                                                                                  "terms/factor"))  # fmt: skip
        numbers = (file[f"parameters/{key}"][...].tolist() for key in ("range", "reference"))
        parameters = tuple(
            Parameter(name, tuple(limits), reference, unit)
            for name, unit, limits, reference in zip(names, units, *numbers, strict=True)
        )
        stacks = {key: iter(file[f"parameters/terms/{key}"][...]) for key in dict.fromkeys(of)}
        terms = tuple([ReducedTerm(key, factor, next(stacks[key])) for key, factor in zip(of, factors, strict=True)])
        constant = {key: file[f"parameters/constant/{key}"][...] for key in (*SHAPES, *OF_OUTPUTS)
                    if key in SHAPES or f"parameters/constant/{key}" in file}  # fmt: skip
    except (KeyError, StopIteration, ValueError) as error:  # an InputError is a ValueError
        raise InputError(f"{path}: its parameters are damaged: {error}; reduce again") from error
    return ParametricReducedModel.of(reduced, parameters=parameters, constant=constant, terms=terms)
