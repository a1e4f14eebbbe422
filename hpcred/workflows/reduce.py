"""Reduce a model by a job file, and write result.h5."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from ..body.geometric_stiffness import VELOCITIES
from ..body.spin_stress import REMEDY, lacks_spin
from ..body.stress import stress_modes
from ..fe.solids import Solids
from ..files.checksums import content_of
from ..files.folders import folder_for
from ..files.outputs import HTML, check_outputs, check_room, hdf5_kind
from ..files.point_store import PointStore
from ..files.result_file import FORMAT, write_result
from ..files.together import rescued
from ..parallel import startup
from ..parallel.failures import ComputationError, agreed
from ..parallel.progress import Progress
from ..parallel.stopping import listening
from ..reduction.reduce import reduce
from ..reduction.result.record import Record
from ..settings.job_file import Job, plain, read_job
from .geometric_stiffness import check_geometric_stiffness, geometric_stiffness_of_job
from .model_of_job import at_reference, model_of_job
from .shared_basis import reduced_from_ranges
from .workflow import workflow

SIZE = 40  # coordinates that a reduction to a tolerance is expected to have


@dataclass(frozen=True)
class Reduced:
    """What a job gave: the file, its record, the number of coordinates, also in words, the pseudo-frequencies in Hz,
    the report, None without one, and whether the file has a body in a floating frame, as multibody programs need."""

    output: str
    record: Record
    size: int
    size_in_words: str
    frequencies: tuple[float, ...]
    report: str | None = None
    has_body: bool = False


@workflow
def reduce_job(
    job: str | Path | Job, *, overrides=(), basis: str | Path | None = None, comm=None,
    progress: Progress | None = None,
) -> Reduced:  # fmt: skip
    """Read, reduce and write as a job says. Collective.

    With a `store` in the job SIGTERM or SIGUSR1 to any rank end the run after the current point, by
    parallel.stopping.Stopped, and the same job goes on from there. Where a tolerance was not reached, the model is
    written under a name that says so, unless the job wants otherwise. Takes the PETSc build that fits the job, where
    PETSc is not loaded yet.

    Parameters
    ----------
    job : str, PathLike or Job
        A job, or the name of its file.
    overrides : sequence of str
        "key.path=value", which replace or add keys of the file.
    basis : str or PathLike, optional
        The result of the same job over the ranges of its parameters, whose basis is taken at the values `at` of the
        job; nothing is factored then.

    Returns
    -------
    Reduced
        The file, its size and frequencies, and the record.

    Raises
    ------
    InputError, ComputationError
        For a job that does not fit its files, and a reduction that fails.
    """
    reads = [name for name in (job, basis) if name is not None and not isinstance(name, Job)]
    with agreed(comm):
        if not isinstance(job, Job):
            job = read_job(job, overrides)
        job.factoring  # noqa: B018  (refused early)
    startup.start(preferred=job.preferred_scalar, low_rank=job.low_rank is not None)
    if job.solver.kind != "multigrid":
        job.factoring.package.check_build(comm)
    with folder_for(job.store, comm, "store ") if job.store is not None else nullcontext():
        return _reduced(job, basis, reads, comm, progress)


def _reduced(job, basis, reads, comm, progress) -> Reduced:
    """Reduce a job, and write its result and report. Collective."""
    store = PointStore(job.store, comm) if job.store is not None else None
    check_outputs({job.output: hdf5_kind(FORMAT)}, comm, [*reads, *job.files], progress=progress)
    if job.search is not None and job.unreached == "mark":
        check_outputs({_not_reached(job.output): hdf5_kind(FORMAT)}, comm, [*reads, *job.files])
    if job.report:
        check_outputs({_report_of(job.output): HTML}, comm, [*reads, *job.files])
    with progress.stage("read", str(job.model)):
        model = model_of_job(job, comm)
    with model, at_reference(model) as reference:
        nodes = job.stress if isinstance(job.stress, tuple) else None
        if job.stress:
            Solids(reference, nodes)  # refused early
        with agreed(comm):
            check_room(job.output, _bytes(job, reference) if job.write_basis else 0)
        with progress.stage("read"):
            contents = {str(Path(name).absolute()): content_of(name, comm) for name in job.files}
        told = check_geometric_stiffness(job, reference)  # before what takes long
        with listening(store is not None):
            reduced = reduced_from_ranges(basis, job, model, contents) if basis is not None else reduce(
                model, job.basis, job.frame, job.damping, adaptive=job.search, settings=job.settings,
                factoring=job.factoring, store=store, progress=progress,
                parameter_search=job.parameter_search if job.term and not job.at and job.search is not None else None,
            )  # fmt: skip
        with reduced:
            output = _name_of(job, reduced.record.accuracy)
            record = replace(reduced.record, job=plain(job), contents=contents, timing=progress.timing())
            reduced = replace(reduced, record=record)
            with progress.stage("geometric stiffness"):
                stiffness = geometric_stiffness_of_job(job, reference, reduced)
            stress = None
            if job.stress:
                with progress.stage("stress"):
                    stress = stress_modes(reference, reduced.columns, nodes)
                spins = stiffness is not None and any(state in VELOCITIES for state in stiffness.states)
                told += stress.remarks
                told += [f"stress: {REMEDY}, if it spins"] if spins and lacks_spin(reduced.record) else []
            warnings = tuple(dict.fromkeys((*reduced.record.warnings, *told)))
            reduced = replace(reduced, record=replace(reduced.record, warnings=warnings))
            with progress.stage("write", output):
                rescued(
                    lambda place: write_result(
                        place, reduced, reference, basis=job.write_basis, origin=job.body_origin,
                        lumped=job.lumped_integrals, geometric_stiffness=stiffness, stress=stress,
                    ), output, comm,
                )  # fmt: skip
            record = replace(reduced.record, timing=progress.timing())
            report = str(_report_of(output)) if job.report else None
            outcome = Reduced(
                output, record, reduced.size, reduced.size_in_words, tuple(reduced.frequencies.tolist()), report,
                has_body=reference.dofs is not None and reduced.left_columns is None,
            )  # fmt: skip
    if job.report:
        from .report import report_file  # which most jobs do without

        with progress.stage("report"):
            report_file([output], output=_report_of(output), comm=comm)
    return outcome


def _name_of(job, accuracy) -> str:
    """Return the name of the result, .not-reached.h5 if the tolerance was not reached."""
    if accuracy is None or accuracy.reached or job.unreached == "write":
        return job.output
    if job.unreached == "refuse":
        raise ComputationError(f"tolerance: {accuracy.sentence}")
    return _not_reached(job.output)


def _not_reached(output) -> str:
    path = Path(output)
    return str(path.with_name(f"{path.stem}.not-reached{path.suffix}"))


def _report_of(output) -> Path:
    return Path(output).with_suffix(".html")


def _bytes(job, model) -> int:
    """Estimate the bytes of the basis in the file, as far as its columns are known beforehand."""
    columns = sum(component.columns(len(model.input_names), 0) for component in job.basis)
    if job.search is not None:
        columns += job.adaptive.size or SIZE
    return 8 * model.size * min(columns, model.size) * (3 if job.stress is True else 1)  # six stresses a node
