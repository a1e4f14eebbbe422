"""Read the model of a job or a record, with its interface nodes, inputs and outputs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..body.preload import preloaded
from ..files.model_file import read_model
from ..model.interfaces import motion as interface_motion
from ..model.material_stiffness import material_stiffness
from ..model.outputs.rates import Rates
from ..model.parameters.parametric_model import ParametricModel
from ..model.rotation import rotation_matrix, unit_axis
from ..model.second_order_model import SYMMETRIC_TO, UNSYMMETRIC
from ..model.viscoelastic import Viscoelastic
from ..parallel.failures import InputError, agreed
from ..readers.nodes.table import read_node_numbers
from ..settings.declared_terms import DeclaredTerms, viscoelastic_from
from ..settings.job_file import Job
from ..settings.source import Source


def model_of_job(job: Job, comm):
    """Return the model of a job with its inputs and outputs: a ParametricModel where it has terms, and no values `at`
    which it is. Collective. Raises InputError."""
    model = with_interfaces_of_job(job, comm)
    for key in ("input", "output"):
        model = with_targets(model, key, getattr(job, key + "s"))
    model = with_loads(model, job.load)
    model = with_bases(model, job.base, job.factoring)
    if model.B is None:
        with model:
            raise InputError(
                f"inputs: neither the job nor {model.name} has any; give dof numbers or [node, direction] pairs, "
                "bearings by [[interface]], loads by [[load]], or a motion by [[base]]"
            )
    if not job.term:
        return model
    parametric = with_terms(model, job.parameter, job.term)
    if not job.at:
        return parametric
    with parametric:
        return parametric.at(**job.at)


def at_reference(model):
    """Return the model at the reference values of its parameters, with references of its own. Collective."""
    return model.at() if isinstance(model, ParametricModel) else model.shared()


def with_terms(model, parameters, tables) -> ParametricModel:
    """Return a model with the terms of tables [[term]]; `model` is closed. Collective. Raises InputError."""
    from ..readers.term_files import read_term_matrix  # which loads the readers of all formats

    with model:
        terms, remarks = [], list(model.remarks)
        for table in tables:
            if table.kind == "matrix":
                matrix, notes = read_term_matrix(model, table.of, table.file, table.variable, table.units)
                remarks += notes
            else:
                matrix = rotation_matrix(model, table.kind, unit_axis("term: axis", table.axis))
            terms.append(table.with_matrix(matrix))
        with model.with_fields(remarks=tuple(remarks)) as constant:
            return ParametricModel(constant, parameters, terms)


def with_interfaces_of_job(job: Job, comm):
    """Return the model of a job with its interfaces, which are the inputs and outputs unless the job has others.
    Collective. Raises InputError."""
    model = with_interfaces(with_declared_terms(model_of_files(job.model, comm), job), job.interface)
    return model if job.inputs is not None or not job.interface else _loaded_at_interfaces(model, job)


def model_of_files(source, comm):
    """Return the model of a model.h5 or of a Source. Collective. Raises InputError."""
    if not isinstance(source, Source):
        return read_model(source, comm)
    from ..readers.model_source import load_source  # which loads the readers of all formats

    return load_source(source, comm, Path(source.K).name)


def _loaded_at_interfaces(model, job):
    """Return the model with all directions of its interfaces as inputs, and as outputs unless the job has some, in
    place of those of its file; `model` is closed. Collective."""
    declared, fields = [("inputs", model.B is not None, model.input_names)], {}
    if job.outputs is None:
        declared.append(("outputs", model.has_own_outputs, model.own_output_names))
        fields = {"Ct": None, "rates": Rates(), "own_output_names": ()}
    lost = [f"{key} ({', '.join(names[:4])}{', ...' if len(names) > 4 else ''})"
            for key, there, names in declared if there]  # fmt: skip
    if lost:
        first, *others = model.interfaces
        told = f"the interfaces of the job take the place of the {' and '.join(lost)} of {model.name}; name all that " \
               "shall be there in `inputs` and `outputs`"  # fmt: skip
        fields["interfaces"] = (replace(first, warnings=(*first.warnings, told)), *others)
    with model, model.with_fields(**fields) as bare:
        return bare.with_inputs([interface.name for interface in bare.interfaces])


def with_declared_terms(model, terms: Job | DeclaredTerms):
    """Return the model with viscoelastic parts, whose matrices are in files, and as one whose K may be unsymmetric,
    where these are declared; `model` is closed. Collective. Raises InputError."""
    if terms.circulatory:
        with model:
            model = model.with_fields(**UNSYMMETRIC)
    if not terms.viscoelastic:
        return model
    from ..readers.term_files import read_term_matrix  # which loads the readers of all formats

    with model:
        added, remarks = [], list(model.remarks)
        for part in terms.viscoelastic:
            if part.material is not None:
                matrix = material_stiffness(model, part.material)
                added.append(Viscoelastic(matrix, part.law, part.name or part.material, within=True))
                continue
            matrix, notes = read_term_matrix(model, "K", part.file, part.variable, part.units)
            remarks += notes
            added.append(Viscoelastic(matrix, part.law, part.name or Path(part.file).name))
        with model.with_fields(remarks=tuple(remarks)) as elastic:
            return elastic.with_viscoelastic(added)


def with_matrices_of_record(model, record):
    """Return the model with what the job of a record adds to its matrices; `model` is closed. Collective. Raises
    InputError."""
    job, unsymmetric = record.job or {}, record.symmetry_defects.get("K", 0.0) > SYMMETRIC_TO
    added = job.get("viscoelastic", ()) if record.viscoelastic and not model.added else ()
    terms = DeclaredTerms(viscoelastic=viscoelastic_from(added), circulatory=unsymmetric or job.get("circulatory"))
    return with_declared_terms(model, terms)


def with_interfaces(model, interfaces):
    """Return the model with interface nodes, whose nodes may be in files; `model` is closed. Collective. Raises
    InputError."""
    if not interfaces:
        return model
    with model:
        with agreed(model.comm):
            interfaces = [replace(each, nodes=read_node_numbers(each.nodes)) if isinstance(each.nodes, str) else each
                          for each in interfaces]  # fmt: skip
        return interface_motion.with_interfaces(model, interfaces)


def with_loads(model, loads):
    """Return the model with loads as further inputs; `model` is closed. Collective. Raises InputError."""
    if not loads:
        return model
    with model:
        return model.with_loads(loads)


def with_bases(model, bases, factoring=None):
    """Return the model with the motions of bases as inputs; `model` is closed. Collective. Raises InputError."""
    if not bases:
        return model
    with model:
        return model.with_bases(bases, factoring)


def at_preload(model, preload, frame, factoring):
    """The model under a preload, or as it is for None; `model` is closed. Collective. Raises InputError."""
    if preload is None:
        return model
    with model:
        return preloaded(model, preload, frame, factoring=factoring)


def with_targets(model, key, targets):
    """Return the model with other inputs or outputs (`key`: "input" or "output"), from a matrix file or as dofs;
    `model` is closed. None leaves them as they are. Collective. Raises InputError."""
    if targets is None:
        return model
    with model:
        if not isinstance(targets, str):
            return getattr(model, f"with_{key}s")(targets)
        from ..readers.assembly import column_names, read_columns  # which loads the readers of all formats

        local = read_columns(model.comm, model.row_starts, model.size, targets, key == "output")
        return getattr(model, f"with_{key}_columns")(local, column_names(targets, local))
