"""A job file enters, result.h5 leaves."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from ..formats.hdf5 import check_writable
from ..formats.job_file import Job, read_job
from ..formats.model_file import read_model
from ..formats.model_source import column_names, load_source, read_columns
from ..formats.node_table import read_node_numbers
from ..formats.restart_file import RestartFile
from ..formats.result_file import write_result
from ..parallel import startup
from ..parallel.failures import ComputationError, InputError, agreed
from ..parallel.progress import Progress
from ..reduction.record import Record
from ..reduction.reduce import reduce


@dataclass(frozen=True)
class Reduced:
    """What a job gave: the file, its record, the number of coordinates, and the pseudo-frequencies in Hz."""

    output: str
    record: Record
    size: int
    frequencies: tuple[float, ...]


def reduce_job(
    job: str | Path | Job, *, overrides=(), restart=None, comm=None, progress: Progress | None = None
) -> Reduced:
    """Read, reduce and write as a job says: the name of a job file, with `overrides` "key.path=value", or a Job.

    `restart`: a file in which an automatic reduction keeps its state after each point, and goes on from what is there.
    Where a tolerance was not reached, the model is written under a name that says so, unless the job wants otherwise.
    Takes the PETSc build that fits the job, where PETSc is not loaded yet. Collective. Raises InputError or
    ComputationError.
    """
    comm = comm or startup.start_mpi()
    with agreed(comm):
        if not isinstance(job, Job):
            job = read_job(job, overrides)
        job.factoring  # noqa: B018  (refused early)
    startup.start(preferred=job.preferred_scalar, low_rank=job.low_rank is not None)
    check_writable(job.output, comm)
    progress = progress or Progress(comm, show=False)
    with progress.stage("read", str(job.model)):
        model = model_of_job(job, comm)
    checkpoint = RestartFile(restart, comm, job) if restart is not None and job.search is not None else None
    with model, reduce(
        model, job.basis, job.frame, job.damping, adaptive=job.search, checkpoint=checkpoint, settings=job.settings,
        factoring=job.factoring, progress=progress,
    ) as reduced:  # fmt: skip
        output = _name_of(job, reduced.record.accuracy)
        record = replace(reduced.record, job=_plain(job), timing=progress.timing())
        reduced.record = record
        with progress.stage("write", output):
            write_result(
                output, reduced, model, basis=job.write_basis, origin=job.body_origin, lumped=job.lumped_integrals
            )
        record = replace(record, timing=progress.timing())
        return Reduced(output, record, reduced.size, tuple(reduced.frequencies.tolist()))


def _name_of(job, accuracy) -> str:
    """Where the result goes: a model that is not what was asked for has a name that says so."""
    if accuracy is None or accuracy.reached or job.unreached == "write":
        return job.output
    if job.unreached == "refuse":
        raise ComputationError(f"tolerance: {accuracy.sentence}")
    path = Path(job.output)
    return str(path.with_name(f"{path.stem}.not-reached{path.suffix}"))


def _plain(job) -> dict:
    """The job as plain types, with absolute names of files, which stay right wherever the result is used."""
    table = asdict(job)
    for key in ("model", "output", "inputs", "outputs", "out_of_core"):
        if isinstance(table[key], str):
            table[key] = str(Path(table[key]).absolute())
    if isinstance(table["model"], dict):
        table["model"] = {key: str(Path(name).absolute()) if isinstance(name, str) else name
                          for key, name in table["model"].items()}  # fmt: skip
    return table


def model_of_job(job: Job, comm):
    """The model of a job with its inputs and outputs. Collective. Raises InputError."""
    model = read_model(job.model, comm) if isinstance(job.model, str) else load_source(
        job.model, comm, Path(job.model.K).name)  # fmt: skip
    model = with_interfaces(model, job.interface)
    for key in ("input", "output"):
        model = with_targets(model, key, getattr(job, key + "s"))
    if model.B is None and model.interfaces:
        model = with_targets(model, "input", [(item.name, "all") for item in model.interfaces])
    if model.B is None:
        with model:
            raise InputError(
                f"inputs: neither the job nor {model.name} has any; give dof numbers or [node, direction] pairs"
            )
    return model


def with_interfaces(model, interfaces):
    """The model with interface nodes, whose nodes may be in files; `model` is closed. Collective. Raises InputError."""
    if not interfaces:
        return model
    with model:
        with agreed(model.comm):
            interfaces = [replace(item, nodes=read_node_numbers(item.nodes)) if isinstance(item.nodes, str) else item
                          for item in interfaces]  # fmt: skip
        return model.with_interfaces(interfaces)


def with_targets(model, key, targets):
    """The model with other inputs or outputs (`key`: "input" or "output"), from a matrix file or as dofs; `model` is
    closed. None leaves them as they are. Collective. Raises InputError."""
    if targets is None:
        return model
    with model:
        if not isinstance(targets, str):
            return getattr(model, f"with_{key}s")(targets)
        local = read_columns(model.comm, model.row_starts, model.size, targets, key == "output")
        return getattr(model, f"with_{key}_columns")(local, column_names(targets, local))
