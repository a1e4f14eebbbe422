"""Take a reduction at values of parameters from the result of the same job over their ranges, without factoring."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
from scipy.linalg import eigh

from ..files.result_file import read_basis, read_result
from ..linalg.blocks import multiply
from ..model.definiteness import growing
from ..model.loads.columns import loads_of, resultants
from ..parallel.decisions import decided
from ..parallel.failures import InputError
from ..parallel.petsc import is_complex
from ..reduction.result.record import versions
from ..reduction.result.reduced_model import ReducedModel
from ..reduction.run.projection import project
from ..settings.job_file import Job
from ..settings.sweep_file import SweepRun

SAME = 1e-8  # relative difference of V^T M V from the reduced mass, which round-off does not reach


def job_of_ranges(job: Job, output) -> Job:
    """Return the job over the ranges of its parameters, with what its basis is needed for and no more."""
    return replace(
        job, at={}, output=str(output), write_basis=True, stress=False, geometric_stiffness=False, report=False,
        unreached="mark",
    )  # fmt: skip


def reduced_from_ranges(path, job: Job, model, contents) -> ReducedModel:
    """Return the ReducedModel of the `model` of a job at its values `at`, in a basis for all ranges, with its record.

    `path`: the result of the same job over the ranges; `contents` of the files of the job. Collective; the caller
    closes it. Raises InputError for another result, and for one that did not reach the tolerance.
    """
    result = read_result(path, model.comm)
    record = result.reduced.record
    asked = SweepRun("", {}, {}, job_of_ranges(job, job.output))
    if not job.at or record is None or record.accuracy is None or record.accuracy.parameters is None or (
        not asked.same_job(record.job, record.contents, lambda name: contents[str(Path(name).absolute())])
    ):
        raise InputError(f"--basis {path}: expected the result of this job over the ranges of its parameters, made "
                         "without its `at`; reduce that first, or leave --basis out")  # fmt: skip
    if not record.accuracy.reached:
        raise InputError(f"--basis {path}: it did not reach the tolerance; leave --basis out")
    there = decided(model.comm, lambda: result.at(**job.at))
    columns = read_basis(path, model)  # which the job has written, as it is that of the ranges
    multiply(columns, there.turn)
    reduced = replace(there.reduced, columns=columns, resultants=resultants(model))
    defect = float(np.abs(project(model.M, columns) - reduced.M).max() / np.abs(reduced.M).max())
    if not model.comm.bcast(defect <= SAME):
        columns.destroy()
        raise InputError(f"--basis {path}: its basis is not one of {model.name}: V^T M V differs from the reduced mass "
                         f"by {defect:.1e}; leave --basis out")  # fmt: skip
    told = growing(model, eigh((reduced.K + reduced.K.T) / 2, reduced.M, eigvals_only=True))
    record = model.comm.bcast(replace(
        reduced.record, date=datetime.now(timezone.utc).isoformat(timespec="seconds"), versions=versions(),
        scalar="complex" if is_complex() else "real", ranks=model.comm.size, model=model.name,
        digests=model.digests, loads=loads_of(model), factorisations=(), factorisations_saved=0,
        symbolic_analyses=0, orthonormality_defect=defect, basis_of=str(Path(path).absolute()),
        unstable_poles=tuple((pole.real, pole.imag) for pole in reduced.unstable_poles().tolist()),
        warnings=tuple(dict.fromkeys([*record.warnings, *([told] if told else [])])),
    ))  # fmt: skip
    return replace(reduced, record=record)
