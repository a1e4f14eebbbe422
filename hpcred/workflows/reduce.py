"""A job file enters, result.h5 leaves."""

from dataclasses import asdict
from pathlib import Path

from ..formats.hdf5 import check_writable
from ..formats.job_file import Job, read_job
from ..formats.model_file import read_model
from ..formats.result_file import write_result
from ..linalg.factorisation import SolverOptions
from ..multibody.floating_frame import floating_frame
from ..multibody.node_shapes import interface_nodes, node_shapes
from ..parallel.failures import InputError, agreed
from ..reduction.reduce import reduce
from .convert import column_names, convert, read_columns


def run_job(path, overrides, comm, progress):
    """Read, reduce and write as a job file says; returns the ReducedModel and the name of the result. Collective."""
    with agreed(comm):
        job = read_job(path, overrides)
    check_writable(job.output, comm)
    with agreed(comm):
        options = SolverOptions(job.out_of_core, job.low_rank)
    with progress.stage("read", str(job.model)):
        model = job_model(job, comm)
    with model:
        rom = reduce(
            model,
            job.basis,
            job.frame,
            job.damping,
            job.deflation_tolerance,
            job.drop_above,
            progress,
            job.projection,
            job.allow_unstable,
            job.groups,
            options,
        )
        rom.provenance["job"] = asdict(job)
        body = None
        if model.dofs is not None and rom.left_columns is None:
            with progress.stage("floating frame"):
                frame = floating_frame(model, rom.columns, job.body_origin, job.lumped_integrals, rom.M)
                body = frame, node_shapes(model, rom.columns, interface_nodes(model))
        with progress.stage("write", job.output):
            write_result(job.output, rom, model.dofs, job.write_basis, comm, body, model.elements)
    rom.provenance["run"] = progress.summary()
    return rom, job.output


def job_model(job: Job, comm):
    """The model of a job with its inputs and outputs. Collective."""
    if isinstance(job.model, str):
        model = read_model(job.model, comm)
    else:
        model = convert(job.model, comm, Path(job.model.K).name)
    for key, transposed in (("input", False), ("output", True)):
        given = getattr(job, key + "s")
        if isinstance(given, str):
            local = read_columns(comm, model.row_starts, model.size, given, transposed)
            getattr(model, f"set_{key}_columns")(local, column_names(given, local))
        elif given is not None:
            getattr(model, f"set_{key}s")(given)
    if model.B is None:
        raise InputError(
            f"inputs: neither the job nor {model.name} has any; give dof numbers or [node, direction] pairs"
        )
    return model
