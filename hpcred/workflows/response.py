"""Compute the frequency response of a model file over a band to a tolerance, with its verification, into files."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from ..analysis.full_response import FullResponse, full_response
from ..files.hdf5 import written_by_one
from ..files.model_file import read_model
from ..files.response_file import Responses, lost_channels, write_responses
from ..files.together import rescued, together
from ..model.damping import NoDamping
from ..model.loads.kinds import motions_of
from ..model.parameters.definitions import checked_values
from ..parallel.declared import flattened
from ..parallel.failures import InputError, agreed
from ..parallel.progress import Progress, counted
from ..reduction.result.record import versions
from ..report.figures import MOST, kind_of_figure, response_figure
from ..settings.job_file import read_job
from .keywords import FineGrid, FreshPoints, ResponseFiles, Solving, State
from .model_of_job import at_preload, model_of_job, with_targets
from .pair_figures import pairs_to_show
from .workflow import workflow


@workflow
@flattened
def response_file(
    model, *, grid: FineGrid, tolerance: float = 1e-6, state: State, fresh: FreshPoints, solving: Solving,
    files: ResponseFiles, polar: bool = False, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Return the frequency response of a model file to a tolerance (see full_response). Collective.

    Parameters
    ----------
    model : str or PathLike
        A model.h5, or a job file, whose inputs and outputs, frame and damping are then the default.
    frequencies, band, points : optional
        Hz; or else so many equally spaced points over a band (Hz), by default that of the job.
    tolerance : float
        Relative error over the band.
    frame, damping : optional
        See full_response.
    inputs, outputs : optional
        Dofs or a matrix file, as in a job; by default those of the model.
    check, seed : int, optional
        Number of further full solves, and what draws their frequencies again.
    groups, factoring : optional
        Groups of ranks that share the frequencies (see frequency_response), and how full models are factored.
    output, figure : str or PathLike, optional
        A .csv or an HDF5 file (see write_responses); a .png, .svg or .pdf.
    polar : bool
        Magnitude and phase in a .csv.
    preload : Preload, optional
        A constant load, as for modes_of_file.
    at : dict of float, optional
        Values of the parameters by name; by default those of reference.

    Returns
    -------
    dict
        Plain numbers for a table or JSON: sentences, whether the tolerance is `reached`, proofs, and of the response
        its norm and estimated error.

    Raises
    ------
    InputError, ComputationError
        For input that does not fit, and a computation that fails.
    """
    if grid.band is None and not len(grid.frequencies):
        raise InputError("response: no frequencies; give the band in Hz, such as 0,6000, or of a result.h5 "
                         "one of psd, harmonic and srs")
    chosen, output, figure = grid.over(), files.output, files.figure
    # a job file has defaults of what is not given
    with agreed(comm):
        job = read_job(model) if str(model).endswith(".toml") else None
        if state.at and (job is None or not job.parameter):
            raise InputError(f"--at: {model} has no parameters; give the job file that has [[parameter]] and [[term]]")
        if job is not None:
            job = replace(job, at=job.at | checked_values(job.parameter, job.at | (state.at or {})))
            state = replace(state, frame=state.frame or job.frame, damping=state.damping or job.damping)
    # what cannot be written is refused before anything is computed
    named = [targets for targets in (state.inputs, state.outputs) if isinstance(targets, str)]
    files.check(comm, [model, *(job.files if job else ()), *named], progress, needed=len(chosen) * 16)
    if polar and output is not None and not str(output).endswith(".csv"):
        raise InputError(f"--polar: is of a .csv, and {output} has complex numbers; leave it out")
    # the model with the inputs, outputs and load that are asked for
    solving.start()
    with progress.stage("read", str(model)):
        loaded = read_model(model, comm) if job is None else model_of_job(job, comm)
    for key, targets in (("input", state.inputs), ("output", state.outputs)):
        loaded = with_targets(loaded, key, targets)
    loaded = at_preload(loaded, state.preload, state.frame, solving.factoring)
    # the response, and files of it
    with loaded:
        result = full_response(
            loaded, chosen, state.frame, state.damping, tolerance=tolerance, band=grid.band, **fresh.given,
            **solving.given, progress=progress,
        )  # fmt: skip
        warnings = list(result.warnings)
        if loaded.D is not None and isinstance(state.damping, NoDamping):
            warnings.append(f"the damping matrix of {loaded.name} is not used; --damping given takes it")
        size, loads = loaded.size, getattr(loaded, "loads", ())
    report = _report(result, size) | {
        "model": str(model), "warnings": warnings, "output": output and str(output),
    } | ({"moves": moves} if (moves := motions_of(loads)) else {})  # fmt: skip
    with progress.stage("write"), together(comm):
        if output is not None:
            _write(output, result, report, comm, polar)
        if figure is not None:
            drawn, response, eps = result.to_draw()
            names = result.output_names, result.input_names
            curves = [(names[0][i], names[1][j], response[:, i, j]) for i, j in pairs_to_show(response, *names)]
            effort = counted(report["factorisations"], "factorisation")
            title = f"{report['model']}: {counted(len(chosen), 'frequency', 'frequencies')}, {effort}"
            written_by_one(figure, comm, response_figure, drawn, curves, eps, result.accuracy.tolerance, title, loads,
                           kind_of_figure(figure))  # fmt: skip
            report["figure"] = str(figure)
            if len(curves) > MOST:
                report["warnings"].append(f"the figure shows the {MOST} largest of {len(curves)} pairs")
    if job is not None and job.at:
        report["at"] = job.at
    return report | {"timing": asdict(progress.timing())}


def _write(output, response, report, comm, polar):
    left_out = ("frequencies_hz", "norm", "eps", "output")
    record = {key: value for key, value in report.items() if key not in left_out} | {"versions": versions()}
    arrays = {key: getattr(response, key) for key in ("frequencies", "input_names", "output_names", "response", "eps")}
    responses = Responses(**arrays, record=record)
    report["warnings"] += lost_channels(output, responses)
    rescued(lambda place: write_responses(place, responses, comm, polar), output, comm)


def _report(response: FullResponse, size: int) -> dict:
    accuracy = response.accuracy
    report = {
        "size": size,
        "inputs": list(response.input_names),
        "outputs": list(response.output_names),
        "reached": response.reached,
        "sentences": list(response.sentences),
        "columns": accuracy.uncompressed_size,
        "factorisations": len(response.factorisations),
        "points": [asdict(point) for point in accuracy.points],
        "proofs": [asdict(proof) for proof in accuracy.proofs],
        "tolerance": accuracy.tolerance,
        "estimated": accuracy.largest,
        "noise": accuracy.noise,
        "measured": accuracy.measured,
        "missing_modes": accuracy.missing_modes,
        "counted": None if accuracy.counted is None else asdict(accuracy.counted),
        "frequencies_hz": response.frequencies.tolist(),
        "norm": np.linalg.norm(response.response, axis=(1, 2)).tolist(),
        "eps": response.eps.tolist(),
    }
    if response.check is not None:
        report["check"] = {"seed": response.check.seed, "passed": response.check.passed, "rows": response.check.rows}
    return report
