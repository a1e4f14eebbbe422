"""Compare result files of one model: their errors and pseudo-modes beside each other, and the model's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.linalg

from ..analysis.error import as_compared, error_integral, errors_of
from ..analysis.frequency_response import above_rest, frequency_response
from ..files.hdf5 import written_by_one
from ..files.outputs import CSV_OF_RESPONSES, PICTURES, check_outputs
from ..files.result_file import read_basis, result_at
from ..files.together import together
from ..linalg.blocks import inner, times
from ..parallel.declared import flattened
from ..parallel.failures import InputError, agreed
from ..parallel.progress import Progress
from ..reduction.interface_coordinates import elastic_part
from ..reduction.result.record import difference_between
from ..report.figures import error_figure
from .evaluate import band_of, short_names
from .full_model import full_of_record
from .keywords import At, Grid, Measured, ResponseFiles, Solving
from .workflow import workflow

SAME_MODE = 1e-6  # relative difference of the frequencies of repeated modes


@workflow
@flattened
def compare_results(
    results, full, *, grid: Grid, modes: int = 10, files: ResponseFiles, measure: Measured = None,
    solving: Solving, at: At = None, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Compare results of one model against the full model, which is solved once. Collective.

    They must have the same inputs, outputs, frame and damping. All are measured alike: by "directions", whatever they
    were reduced to, unless `measure` is "paper".

    Parameters
    ----------
    results : sequence of str or PathLike
    full : str or PathLike
        The model file.
    frequencies, band, points : optional
        Hz; or else so many equally spaced points over a band (Hz), by default that of the job.
    modes : int
        So many lowest modes of the model are compared.
    output : str or PathLike, optional
        A .csv of eps over the frequencies.
    figure : str or PathLike, optional
        Its picture.
    measure : {"directions", "paper"}, optional
        What eps is; by default as the model was reduced.
    groups, factoring : optional
        Groups of ranks that share the frequencies (see frequency_response), and how full models are factored; by
        default as in the reduction.
    at : dict of float, optional
        Values of the parameters by name; by default those of reference.

    Returns
    -------
    dict
        `rows`: for each result its coordinates, their number, where some are rigid-body ones also that of the elastic
        ones, the largest eps, Q (57), and the direction that is known worst by itself with its error. `modes`: the
        lowest modes and, for each result, the relative error of the frequency of its pseudo-mode with the largest modal
        assurance criterion, MAC = (phi^T M psi)^2 / (phi^T M phi psi^T M psi), which is given too where the file has
        its basis; for repeated modes it is the sum over them; none where K is not symmetric, as `notes` say.

    Raises
    ------
    InputError
        For results that do not belong together.
    """
    # results that can be compared, and the frequencies
    results = [str(path) for path in results]
    labels = short_names(results)
    read = [result_at(path, at, comm) for path in results]
    whole = [result.reduced for result in read]
    reduced = [elastic_part(model) for model in whole]
    _check_alike(results, reduced)
    first = reduced[0].record
    grid, output, figure = grid.over(band_of(reduced[0], reduced[1:])), files.output, files.figure
    # what cannot be written is refused before anything is computed
    if output is not None and not str(output).endswith(".csv"):
        raise InputError(f"output {output}: expected a name that ends in .csv, for the errors of several results")
    written = {output: CSV_OF_RESPONSES}
    if figure is not None:
        written |= {Path(figure).with_suffix(suffix): PICTURES[suffix] for suffix in (".png", ".svg")}
    check_outputs(written, comm, [*results, full], progress=progress)
    reduced, dampings, _ = zip(*(as_compared(model, (grid[0], grid[-1])) for model in reduced), strict=True)
    if dampings.count(dampings[0]) < len(dampings):
        raise InputError("compare: found results with different modal damping; compare those of one damping")
    grid, notes = above_rest(grid, reduced[0].transfer_function)
    # the full model once, for all
    with full_of_record(
        full, first, results[0], damping=dampings[0], factoring=solving.factoring, at=read[0].values, comm=comm
    ) as full_model:
        known, drive = full_model.response(grid, solving.groups, progress)
        shapes = []
        if full_model.model.is_symmetric("K"):
            shapes = _modes(full_model, modes, results, labels, read, reduced, progress)
        else:
            notes.append(f"{full}: K is not symmetric, so that the model has no real modes to compare with")
    # errors of each result
    rows, curves = [], []
    for label, uncut, model in zip(labels, whole, reduced, strict=True):
        response = frequency_response(model, grid)
        errors = errors_of(model, grid, known, response, drive, measure, anew=True)
        eps, worst = errors.eps, errors.directions[0]
        curves.append((label, eps))
        rows.append({
            "result": label, "coordinates": model.record.coordinates, "size": uncut.size,
            **({"elastic": model.size} if any(each.rigid_size for each in whole) else {}),
            "largest eps": float(eps.max()), "Q": error_integral(grid, eps),
            "worst direction": worst.output, "its error": worst.largest,
        })  # fmt: skip
    report = {"full": str(full), **({"at": read[0].values} if at else {}),
              "frequencies_hz": grid.tolist(), "rows": rows, "modes": shapes, "notes": notes,
              "eps": {label: eps.tolist() for label, eps in curves}}  # fmt: skip
    with together(comm):
        if output is not None:
            table = np.array([grid, *(eps for _, eps in curves)]).T
            head = ",".join(["f_hz", *(f"eps_{label}" for label in labels)])
            written_by_one(output, comm, lambda path: np.savetxt(path, table, "%.10e", ",", header=head, comments=""))
        if figure is not None:
            with agreed(comm):
                if comm.rank == 0:
                    error_figure(Path(figure).with_suffix(""), grid, curves, first.model)
    return report


def _check_alike(results, reduced):
    """Refuse results with other inputs, outputs, frames or damping."""
    if len(set(results)) < len(results) or len(results) < 2:
        raise InputError(f"results: found {', '.join(results)}, expected two or more, each once")
    for path, model in zip(results, reduced, strict=True):
        if model.record is None:
            raise InputError(f"{path}: has no record of its reduction that tells its model from others, which a "
                             "comparison needs; reduce it again")  # fmt: skip
        model.record.require_model(path)
    first = reduced[0].record
    for path, model in zip(results[1:], reduced[1:], strict=True):
        record = model.record
        for key in ("inputs", "outputs", "frame", "damping", "size"):
            mine, other = getattr(first, key), getattr(record, key)
            if mine != other:
                raise InputError(
                    f"{path}: found the {key} {other}, but {mine} in {results[0]}; compare results of one "
                    "model with the same loads and frame"
                )
        if (key := difference_between(record, first)) is not None:
            raise InputError(f"{path}: was reduced from another model than {results[0]} (its {key} differs)")


def _modes(full_model, count, results, labels, read, reduced, progress):
    """Return rows of the lowest modes of the FullModel and what each result has for them. Collective."""
    model = full_model.model
    count = min(count, model.size - full_model.record.rigid_body_modes)
    with full_model.lowest_modes(count, progress) as reference:
        rows = [{"mode": i + 1, "f (Hz)": float(f)} for i, f in enumerate(reference.frequencies)]
        momentum = times(model.M, reference.columns)
        for path, label, result, compared in zip(results, labels, read, reduced, strict=True):
            basis = None if compared.record.projection == "two_sided" else read_basis(path, model)
            share = None
            if basis is not None:
                uncut = result.reduced
                X = scipy.linalg.eigh(uncut.K, uncut.M)[1][:, uncut.rigid_size :]
                X = X if result.turn is None else result.turn @ X
                share = (inner(momentum, basis) @ X) ** 2
            for cluster in _clusters(reference.frequencies):
                best, value = _nearest(reference.frequencies[cluster], compared.frequencies,
                                       None if share is None else share[cluster])  # fmt: skip
                for i, j in zip(cluster, best, strict=True):
                    rows[i][f"{label} error"] = float(compared.frequencies[j] / reference.frequencies[i] - 1)
                    if share is not None:
                        rows[i][f"{label} MAC"] = float(value[j])
    return rows


def _clusters(frequencies):
    """Return the places of equal frequencies, whose modes may be mixed in any way."""
    new = np.flatnonzero(np.diff(frequencies) > SAME_MODE * frequencies[1:]) + 1
    return np.split(np.arange(len(frequencies)), new)


def _nearest(frequencies, own, share):
    """Return the pseudo-mode (of frequencies `own`) for each of the equal modes, and the MAC of all with these modes.

    `share` (modes, pseudo-modes): MAC with each; without it the nearest frequencies count.
    """
    if share is None:
        return np.sort(np.argsort(np.abs(own - frequencies[0]), kind="stable")[: len(frequencies)]), None
    value = share.sum(axis=0)
    return np.sort(np.argsort(-value, kind="stable")[: len(frequencies)]), value
