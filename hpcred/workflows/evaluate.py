"""Evaluate a result file on a grid of frequencies, alone or against its full model."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..analysis.error import as_compared, error_integral, errors_of
from ..analysis.error_check import accuracy_of, check_reduced, estimate_at, measuring_damping
from ..analysis.frequency_response import above_rest, frequencies_to_draw, frequency_response, resonances_of
from ..body.preload import warning_of_basis
from ..files.names import in_text
from ..files.response_file import FOREIGN, Responses, lost_channels, write_responses
from ..files.result_file import result_at
from ..files.together import rescued, together
from ..model.damping import NoDamping
from ..model.frames import NoFrame
from ..model.loads.kinds import motions_of
from ..model.units import unit_of_response
from ..parallel.declared import flattened
from ..parallel.failures import InputError
from ..parallel.petsc import is_complex
from ..parallel.progress import Progress
from ..reduction.interface_coordinates import elastic_part
from ..reduction.result.directions import rows_of_directions
from ..reduction.result.record import versions
from ..report.figures import UNKNOWN
from .full_model import full_of_record
from .keywords import At, FullFile, Grid, Load, Measured, Pairs, ResponseFiles, Solving
from .pair_figures import figures_of_pairs, pairs_by_name, pairs_to_show
from .workflow import workflow

MOST_FIGURES = 16  # of the largest responses


@workflow
@flattened
def evaluate_result(
    result, full: FullFile = None, *, grid: Grid, files: ResponseFiles, pairs: Pairs = (), measure: Measured = None,
    solving: Solving, preload: Load = None, at: At = None, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Return the responses of result.h5, and eps(f) and Q (57) against a full model if given. Collective.

    The frame, the damping, the inputs and outputs of the full model are those of the reduction; that it is the model of
    the reduction is checked. Modal ratios are measured as the loss factor of the smallest.

    Parameters
    ----------
    result : str or PathLike
    full : str or PathLike, optional
        The model file.
    frequencies, band, points : optional
        Hz; or else so many equally spaced points over a band (Hz), by default that of the job.
    output : str or PathLike, optional
        A .csv or HDF5 file for the responses (see write_responses).
    figure : str or PathLike, optional
        A .png, .svg or .pdf of a response and its error, for each of the `pairs`.
    pairs : sequence of str
        "output/input", whose responses are shown with their units; by default figures are those of the largest.
    measure : {"directions", "paper"}, optional
        What eps is; by default as the model was reduced.
    groups, factoring : optional
        Groups of ranks that share the frequencies (see frequency_response), and how full models are factored; by
        default as in the reduction.
    preload : Preload, optional
        A constant load, by the geometric stiffness of the result.
    at : dict of float, optional
        Values of the parameters by name; by default those of reference, of the full model too, whose terms are those of
        the job.

    Returns
    -------
    dict
        Plain numbers for a table or JSON.

    Raises
    ------
    InputError
        For another model, and where a response is infinite, but for 0 Hz beside other frequencies, which is left out.
    """
    if preload is not None and full is not None:
        raise InputError("--preload: cannot be combined with --full, which is without load; leave one of them out")
    # the reduced model at the values and the load
    source = result_at(result, at, comm)
    reduced = elastic_part((source if preload is None else source.at_preload(preload)).reduced)
    record = reduced.record
    # what cannot be written is refused before anything is computed
    grid, output, figure = grid.over(band_of(reduced)), files.output, files.figure
    named = [(record.job or {}).get(key) for key in ("inputs", "outputs")]
    reads = [result, full, *(name for name in named if isinstance(name, str))]
    files.check(comm, reads, progress)
    grid, told = above_rest(grid, reduced.transfer_function)
    shown = pairs_by_name(pairs, reduced.output_names, reduced.input_names, result)
    report = {"result": str(result), "frequencies_hz": grid.tolist()}
    if at:
        report |= {"at": source.values, "pseudo_frequencies_hz": reduced.frequencies.tolist()}
    if preload is not None:
        report |= {"preload": asdict(preload), "pseudo_frequencies_hz": reduced.frequencies.tolist()}
        told += [text for text in [warning_of_basis(source.body(), preload)] if text]
    # both responses, with a damping that both have
    damping, words = record.damping, ""
    if full is not None:
        reduced, damping, words = as_compared(reduced, (grid[0], grid[-1]))
    arrays = {"frequencies": grid, "reduced": frequency_response(reduced, grid)}
    report["reduced_norm"] = np.linalg.norm(arrays["reduced"], axis=(1, 2)).tolist()
    # eps(f) (55) and Q (57) against full solves
    if full is not None:
        with full_of_record(
            full, record, result, damping=damping, factoring=solving.factoring, at=source.values, comm=comm
        ) as known:
            arrays["full"], arrays["drive"] = known.response(grid, solving.groups, progress)
        errors = errors_of(reduced, grid, arrays["full"], arrays["reduced"], arrays["drive"], measure)
        arrays["eps"] = errors.eps
        report |= {
            "arithmetic": "full model solved in "
            + ("real arithmetic (undamped)" if isinstance(damping, NoDamping)
               else "complex arithmetic" if is_complex()
               else "real arithmetic of twice the size (real PETSc)") + f"; {words}" * bool(words),
            "full_norm": np.linalg.norm(arrays["full"], axis=(1, 2)).tolist(),
            "eps": arrays["eps"].tolist(),
            "eps_max": float(arrays["eps"].max()),
            "Q": error_integral(grid, arrays["eps"]),
            "measure": errors.measure.kind,
            "directions": [asdict(direction) for direction in errors.directions],
            "direction_rows": rows_of_directions(errors.directions, grid),
        }  # fmt: skip
    if shown:
        report["pairs"] = [
            {"pair": name, "unit": unit_of_response(*name.split("/", 1), record.loads) or UNKNOWN,
             **{key: np.abs(arrays[key][:, i, j]).tolist() for key in ("reduced", "full") if key in arrays}}
            for name, (i, j) in zip(pairs, shown, strict=True)
        ]  # fmt: skip
    with together(comm):
        if output is not None:
            made = {"result": str(result), "model": record.model, "versions": versions(),
                    "moves": motions_of(record.loads)}  # fmt: skip
            names = {"input_names": reduced.input_names, "output_names": reduced.output_names}
            places = {node.label: (node.node, node.position) for node in source.nodes}
            responses = Responses(**arrays, **names, record=made, places=places)
            rescued(lambda place: write_responses(place, responses, comm), output, comm)
            told += lost_channels(output, responses)
            left_out = 0 if isinstance(record.frame, NoFrame) else record.rigid_body_modes
            if left_out and str(output).endswith(tuple(FOREIGN)):
                told.append(
                    f"{output} is without the {left_out} rigid-body motions of the free body, so that nothing can be "
                    "coupled by it; a machine takes the result itself, and that of this body alone has them"
                )
        if figure is not None:
            names = reduced.output_names, reduced.input_names
            every = shown or pairs_to_show(arrays["reduced"], *names)
            shown = shown or pairs_to_show(arrays["reduced"], *names, MOST_FIGURES)
            fine = frequencies_to_draw((grid[0], grid[-1]), resonances_of(reduced), grid)
            curves = [("reduced", fine, frequency_response(reduced, fine))]
            curves += [("full model", grid, arrays["full"])] if full is not None else []
            report["figures"] = figures_of_pairs(figure, *names, curves, comm, shown, record.loads)
            report["responses"] = len(every)
    return report | {"warnings": told}


@workflow
def estimate_of_result(result, *, frequencies=(), parts: int = 61, comm=None) -> dict:
    """Return eps(f) of result.h5, a reduction to a tolerance: nothing is computed. Collective.

    Parameters
    ----------
    result : str or PathLike
    frequencies : sequence of float
        Hz, where `rows` have the error; or else where it is largest in each of `parts` equal parts of the band.
    parts : int
        Number of them.

    Returns
    -------
    dict
        `rows`, the whole curve, its maximum, Q (57), the proofs and the sentence.

    Raises
    ------
    InputError
        Where the basis was chosen by hand.
    """
    reduced = elastic_part(result_at(result, None, comm).reduced)
    accuracy = accuracy_of(reduced, result)
    if len(frequencies):
        chosen = Grid(frequencies=frequencies, points=2).over(accuracy.band)
        errors = estimate_at(accuracy, chosen)
    else:
        if parts < 1:
            raise InputError(f"points: found {parts}, expected at least 1")
        # the largest error of each part of the band
        S, curve = np.array(accuracy.frequencies), np.array(accuracy.eps)
        piece = np.clip(((S - S[0]) / (S[-1] - S[0]) * parts).astype(int), 0, parts - 1)
        worst = [index[curve[index].argmax()] for k in range(parts) if len(index := np.flatnonzero(piece == k))]
        chosen, errors = S[worst], curve[worst]
    return {
        "result": str(result),
        "sentence": accuracy.sentence,
        "reached": accuracy.reached,
        "measured": accuracy.measured,
        "rows": [{"f (Hz)": f, "eps": eps} for f, eps in zip(chosen.tolist(), errors.tolist(), strict=True)],
        "eps_max": accuracy.largest,
        "noise": accuracy.noise,
        "Q": accuracy.mean * (accuracy.band[1] - accuracy.band[0]),
        "measure": accuracy.measure.kind,
        "directions": [asdict(item) for item in accuracy.directions],
        "direction_rows": rows_of_directions(accuracy.directions, accuracy.band),
        "warnings": list(accuracy.warnings),
        "proofs": [asdict(proof) for proof in accuracy.proofs],
        "frequencies_hz": list(accuracy.frequencies),
        "eps": list(accuracy.eps),
    }


@workflow
@flattened
def check_result(
    result, full, count: int = 5, *, seed: int | None = None, solving: Solving,
    at: At = None, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Return the estimated error of result.h5 against full solves at fresh frequencies, some right beside
    resonances. Collective.

    Parameters
    ----------
    result : str or PathLike
        A reduction to a tolerance.
    full : str or PathLike
        The model file of the reduction.
    count : int
        Number of random frequencies.
    seed : int, optional
        Draws the same frequencies again.
    groups, factoring : optional
        Groups of ranks that share the frequencies (see frequency_response), and how full models are factored; by
        default as in the reduction.
    at : dict of float, optional
        Values of the parameters by name; by default those of reference.

    Returns
    -------
    dict
        Rows of f, estimated and measured errors, whether it `passed`, and the sentence.

    Raises
    ------
    InputError
        Where the basis was chosen by hand, and for another model.
    """
    source = result_at(result, at, comm)
    reduced = elastic_part(source.reduced)
    accuracy, record = accuracy_of(reduced, result), reduced.record
    damping = measuring_damping(accuracy, record.damping)
    with full_of_record(
        full, record, result, damping=damping, factoring=solving.factoring, at=source.values, comm=comm
    ) as known:
        check = check_reduced(
            reduced, known.model, count, seed=seed, factoring=known.factoring, groups=solving.groups, progress=progress
        )
    return {
        "result": str(result),
        "sentence": check.sentence,
        "claim": accuracy.sentence,
        "measured": accuracy.measured,
        "passed": check.passed,
        "seed": check.seed,
        "eps": check.bound,
        "rows": check.rows,
    }


def band_of(reduced, others=()) -> tuple[float, float]:
    """Return the band (Hz) that the job or the accuracy of a reduced model states, or else the first that one of the
    others does, or up to between the two highest pseudo-frequencies."""
    for model in (reduced, *others):
        record = model.record
        stated = (record.job or {}).get("band") or (record.accuracy and record.accuracy.band)
        if stated:
            return tuple(stated)
    return 0.0, float(reduced.frequencies[-2:].mean())  # not at a resonance


def short_names(paths) -> list[str]:
    """Return the names of files without folder and suffix, or as they are given where two would be the same."""
    stems = [Path(path).stem for path in paths]
    return list(map(in_text, stems if len(set(stems)) == len(stems) else paths))
