"""Read the full model of a record as it was reduced, checked to be that one, and compute its responses."""

from __future__ import annotations

import os
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from ..analysis.frequency_response import response_and_drive
from ..fe.dofs import ABSOLUTE, target_of
from ..files.checksums import content_of
from ..files.model_file import read_model
from ..linalg.solvers.settings import PACKAGES, Factoring, LinearSolver
from ..model.damping import Damping, NoDamping
from ..model.interfaces.nodes import Interface
from ..model.loads.base import Base
from ..model.loads.kinds import AnyLoad, motions_of
from ..model.operator import ADDED
from ..model.outputs.cuts import cut_output_of
from ..model.outputs.motions import motion_output_of
from ..model.outputs.rates import KEY as RATES
from ..model.outputs.stresses import stress_output_of
from ..model.parameters.definitions import Parameter
from ..model.parameters.parametric_model import ParametricModel
from ..model.second_order_model import SecondOrderModel
from ..parallel import startup
from ..parallel.declared import adapter_of
from ..parallel.failures import InputError
from ..reduction.components.modes import Modes
from ..reduction.reduce import reduce
from ..reduction.result.parameter_accuracy import in_words
from ..reduction.result.record import Record, difference_of
from ..settings.term_table import TermTable
from .model_of_job import (
    with_bases,
    with_interfaces,
    with_loads,
    with_matrices_of_record,
    with_targets,
    with_terms,
)

WORDS = {
    "B": "inputs differ", "Ct": "outputs differ", RATES: "outputs differ", "dofs": "nodes differ",
    "interfaces": "interfaces, or their nodes, differ", ADDED: f"{ADDED} laws or matrices differ",
}  # fmt: skip


@dataclass(frozen=True)
class FullModel:
    """The model that a record is of, with its inputs and outputs, and the damping and factoring of its responses."""

    model: SecondOrderModel
    record: Record
    damping: Damping
    factoring: Factoring

    def response(self, frequencies, groups=None, progress=None) -> tuple[np.ndarray, np.ndarray]:
        """Return H (F, r, p) and drive-point responses (F, p) at frequencies (F,) in Hz, in the frame of the record;
        see response_and_drive. Collective."""
        return response_and_drive(
            self.model, frequencies, self.record.frame, self.damping, factoring=self.factoring, groups=groups,
            progress=progress,
        )  # fmt: skip

    def lowest_modes(self, count, progress=None):
        """Return the ReducedModel of the `count` lowest undamped modes in the frame of the record. Collective; close
        it."""
        return reduce(self.model, [Modes(count=count)], self.record.frame, factoring=self.factoring, progress=progress)


@contextmanager
def full_of_record(path, record: Record, result, *, damping=None, factoring=None, at=None, comm):
    """Yield the FullModel of a model file `path` while the context is open; `result` names the file of the record.

    `damping`: that of the responses, by default that of the record, which decides on the PETSc build where none is
    loaded; `factoring` likewise. `at`: values of its parameters, by default those of reference. Collective. Raises
    InputError where it is another model.
    """
    damping = record.damping if damping is None else damping
    factoring = factoring or factoring_of(record)
    start_for([damping], factoring)
    with _model_of_record(path, record, result, at, comm) as model:
        yield FullModel(model, record, damping, factoring)


def start_for(dampings, factoring):
    """Load the PETSc build that suits responses with these damping models, where none is loaded yet."""
    damped = not all(isinstance(item, NoDamping) for item in dampings)
    startup.start(preferred="complex" if damped else "real", low_rank=factoring.low_rank is not None)


def factoring_of(record) -> Factoring:
    """Return how the reduction factored."""
    job = record.job or {}
    package = job.get("solver", {}).get("package", LinearSolver.package)
    solver = LinearSolver(package=package if package in PACKAGES else LinearSolver.package)
    return Factoring(solver=solver, **{key: job.get(key) for key in ("out_of_core", "low_rank", "memory_mb")})


def _model_of_record(path, record, result, at, comm):
    """Return the model of a model file with the inputs and outputs of a reduction, checked to be the one that was
    reduced."""
    record.require_model(result)
    model = read_model(path, comm)
    # what the job adds to a model file that does not have it
    job = record.job or {}
    bases = adapter_of(tuple[Base, ...]).validate_python(job.get("base", ()))
    moved = [name for entry in bases for name in entry.input_names]
    if set(moved) <= {*motions_of(model.loads)}:
        bases = ()  # they are in the file
    loads = adapter_of(tuple[AnyLoad, ...]).validate_python(job.get("load", ()))
    loads = [entry for entry in loads if entry.name not in model.input_names]
    if not bases and model.size != record.size:  # before interfaces are looked for, which another model does not have
        with model:
            raise InputError(f"{path}: has {model.size} dofs, and the model that {result} was reduced from has "
                             f"{record.size}; take that model, or reduce this one again")  # fmt: skip
    # in the order of a job
    model = with_matrices_of_record(model, record)
    interfaces = record.interfaces
    if bases:  # of which one may move an interface
        interfaces = adapter_of(tuple[Interface, ...]).validate_python(job.get("interface", ()))
    model = with_interfaces(model, interfaces)
    inputs, outputs = record.inputs, record.outputs
    if bases:
        inputs, outputs = (
            tuple(name for name in names if name not in moved and not name.startswith(ABSOLUTE))
            for names in (inputs, outputs)
        )
    added = [entry.name for entry in loads]
    forces = tuple(name for name in inputs if name not in added)
    if forces or not (bases or loads):
        model = _as_recorded(model, "input", forces, record, path)
    model = with_loads(model, loads)
    if outputs or not bases:
        model = _as_recorded(model, "output", outputs, record, path)
    model = with_bases(model, bases, factoring_of(record))
    parametric = with_terms_of_record(model, record)
    if parametric is not None:
        model = parametric.at(**(record.job.get("at") or parametric.reference))
    key = difference_of(model.digests, record)
    if key is not None:
        with model:
            difference = WORDS.get(key, f"matrix {key} differs")
            raise InputError(f"{path}: its {difference} from what {result} was reduced from; take that model, or "
                             "reduce this one again")  # fmt: skip
    if parametric is None and at:
        with model:
            raise InputError(
                f"{result}: found values of parameters ({in_words(at)}), but no [[term]] in its job, without which "
                f"{path} is known at the reference values alone; leave the values out, or reduce by a job"
            )
    if parametric is None:
        return model
    with model, parametric:
        return parametric.at(**at) if at else model.shared()


def with_terms_of_record(model, record) -> ParametricModel | None:
    """Return a model with the terms of the job of a record, and close it; None, and `model` stays, where the job has
    none. Collective. Raises InputError."""
    job = record.job or {}
    if not job.get("term"):
        return None
    parameters, tables = (
        adapter_of(tuple[kind, ...]).validate_python(job[key])
        for kind, key in ((Parameter, "parameter"), (TermTable, "term"))
    )
    for name in [table.file for table in tables if table.file is not None]:
        known = (record.contents or {}).get(name)
        if known is not None and os.path.isfile(name) and content_of(name, model.comm) != known:
            with model:
                raise InputError(f"{name}: has another content than when its term was reduced; take the file of then, "
                                 "or reduce again")  # fmt: skip
    return with_terms(model, parameters, tables)


def _as_recorded(model, key, names, record, path):
    """Return the model with the inputs or outputs of a reduction, from their names or from the file of the job."""
    if key == "output" and names == record.inputs and not {"Ct", RATES} & record.digests.keys():
        with model:
            return model.with_output_columns(None, ())
    if getattr(model, f"{key}_names") == names:
        return model
    kinds = (stress_output_of, motion_output_of, cut_output_of, target_of)
    targets = [next(filter(None, (kind(name) for kind in kinds)), None) for name in names]
    file = (record.job or {}).get(key + "s")
    if None in targets and not isinstance(file, str):
        with model:
            raise InputError(f"{path}: has no {key}s {', '.join(names)}, which the reduction used")
    return with_targets(model, key, file if None in targets else targets)
