"""A result file on a grid of frequencies, alone or against the full model it came from."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from ..analysis.error import error_integral, relative_error
from ..analysis.error_check import accuracy_of, check_reduced, said_at
from ..analysis.frequency_response import frequency_response
from ..formats.locks import locks_given_back
from ..formats.model_file import read_model
from ..formats.outputs import check_outputs
from ..formats.response_file import Responses, check_response_name, kind_of_responses, write_responses
from ..formats.result_file import read_result
from ..formats.room import rescued
from ..linalg.factorisation import Factoring
from ..model.damping import NoDamping
from ..model.dofs import target_of
from ..parallel import startup
from ..parallel.failures import InputError
from ..parallel.petsc import is_complex
from ..parallel.progress import Progress
from ..parallel.ranges import FREQUENCY, within
from ..reduction.interface_coordinates import elastic_part
from ..reduction.pseudo_modal import worst_pair
from ..reduction.record import signature_of, versions
from .pair_figures import check_figures, figures_of_pairs
from .reduce import with_interfaces, with_targets

MOST = (1, 10**7, "")  # frequencies
SAME = 1e-8  # relative difference of signatures of the same matrices, written and read on other ranks


@locks_given_back()
def evaluate_result(
    result, full=None, *, frequencies=(), band=None, points: int = 61, output=None, figure=None,
    groups: int | None = None, factoring: Factoring | None = None, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Responses of result.h5, and eps(f) (55) and Q (57) against the model file `full` if given. Collective.

    `frequencies` (Hz), or else `points` of them over `band` (two numbers, default that of the job). The frame, the
    damping, the inputs and outputs of the full model are those of the reduction, and so is `factoring` unless it is
    given; that it is the model of the reduction is checked. `output`: a .csv or HDF5 file for the responses, see
    formats.response_file. `figure`: a .png, .svg or .pdf of every response and its error, see workflows.pair_figures.
    `groups`: see frequency_response. Returns plain numbers for a table or JSON. Raises InputError.
    """
    comm = comm or startup.start_mpi()
    reduced = elastic_part(read_result(result, comm).reduced)
    record = reduced.record
    grid = frequencies_over(frequencies, band or band_of(reduced), points)
    given = [(record.job or {}).get(key) for key in ("inputs", "outputs")]
    reads = [result, full, *(name for name in given if isinstance(name, str))]
    if output is not None:
        check_response_name(output)
        check_outputs({output: kind_of_responses(output)}, comm, reads, progress=progress)
    if figure is not None:
        check_figures(figure, comm, reads, progress)
    report = {"result": str(result), "frequencies_hz": grid.tolist()}
    arrays = {"frequencies": grid, "reduced": frequency_response(reduced, grid)}
    report["reduced_norm"] = np.linalg.norm(arrays["reduced"], axis=(1, 2)).tolist()
    if full is not None:
        damped = not isinstance(record.damping, NoDamping)
        factoring = factoring or factoring_of(record)
        startup.start(preferred="complex" if damped else "real", low_rank=factoring.low_rank is not None)
        with model_of_record(full, record, result, comm) as model:
            arrays["full"] = frequency_response(
                model, grid, record.frame, record.damping, factoring=factoring, progress=progress, groups=groups
            )
        arrays["eps"] = relative_error(arrays["full"], arrays["reduced"])
        report |= {
            "arithmetic": "full model solved in "
            + ("real arithmetic (undamped)" if not damped
               else "complex arithmetic" if is_complex()
               else "real arithmetic of twice the size (real PETSc)"),
            "full_norm": np.linalg.norm(arrays["full"], axis=(1, 2)).tolist(),
            "eps": arrays["eps"].tolist(),
            "eps_max": float(arrays["eps"].max()),
            "Q": error_integral(grid, arrays["eps"]),
            "worst_pair": _worst_pair(arrays, reduced),
        }  # fmt: skip
    if output is not None:
        made = {"result": str(result), "model": record.model, "versions": versions()}
        names = {"input_names": reduced.input_names, "output_names": reduced.output_names}
        responses = Responses(**arrays, **names, record=made)
        rescued(lambda place: write_responses(place, responses, comm), output, comm)
    if figure is not None:
        labels = {"reduced": "reduced", "full": "full model"}
        curves = [(label, grid, arrays[key]) for key, label in labels.items() if key in arrays]
        report["figures"] = figures_of_pairs(figure, reduced.output_names, reduced.input_names, curves, comm)
    return report


def _worst_pair(arrays, reduced) -> dict:
    i, j, error = worst_pair(arrays["full"], arrays["reduced"])
    return {"output": reduced.output_names[i], "input": reduced.input_names[j], "error": error}


def estimate_of_result(result, *, frequencies=(), parts: int = 61, comm=None) -> dict:
    """eps(f) as result.h5 says it, of an automatic reduction: nothing is computed. Collective.

    `rows`: the error at `frequencies` (Hz), or else where it is largest in each of `parts` equal parts of the band.
    Besides the whole curve, its maximum, Q (57), the proofs and the sentence. Raises InputError where the basis was
    chosen by hand.
    """
    reduced = elastic_part(read_result(result, comm or startup.start_mpi()).reduced)
    accuracy = accuracy_of(reduced, result)
    if len(frequencies):
        chosen = frequencies_over(frequencies, accuracy.band, 2)
        errors = said_at(accuracy, chosen)
    else:
        if parts < 1:
            raise InputError(f"points: found {parts}, expected at least 1")
        S, curve = np.array(accuracy.frequencies), np.array(accuracy.eps)
        part = np.clip(((S - S[0]) / (S[-1] - S[0]) * parts).astype(int), 0, parts - 1)
        worst = [index[curve[index].argmax()] for k in range(parts) if len(index := np.flatnonzero(part == k))]
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
        "proofs": [asdict(proof) for proof in accuracy.proofs],
        "frequencies_hz": list(accuracy.frequencies),
        "eps": list(accuracy.eps),
    }


def check_result(
    result, full, count: int = 5, *, seed: int | None = None, groups: int | None = None,
    factoring: Factoring | None = None, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """The error that result.h5 says, against full solves of the model file `full`, at `count` fresh frequencies of the
    band and some right beside pseudo-frequencies. Collective.

    `seed` draws the same frequencies again; the other keywords are those of evaluate_result. Returns rows of f, said
    and exact, whether it `passed`, and the sentence. Raises InputError where the basis was chosen by hand.
    """
    comm = comm or startup.start_mpi()
    reduced = elastic_part(read_result(result, comm).reduced)
    accuracy, record = accuracy_of(reduced, result), reduced.record
    factoring = factoring or factoring_of(record)
    startup.start(preferred="complex", low_rank=factoring.low_rank is not None)
    with model_of_record(full, record, result, comm) as model:
        check = check_reduced(reduced, model, count, seed=seed, factoring=factoring, groups=groups, progress=progress)
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


def frequencies_over(frequencies, band, points) -> np.ndarray:
    """The frequencies in ascending order, or else `points` over the band (Hz). Raises InputError."""
    if not len(frequencies) and points < 2:
        raise InputError(f"points: found {points}, expected at least 2 frequencies over the band")
    within("points", points, MOST)
    within("band", band, FREQUENCY)
    grid = np.sort(np.asarray(frequencies, dtype=float)) if len(frequencies) else np.linspace(*band, points)
    if not np.isfinite(grid).all() or grid.min() < 0:
        raise InputError(f"frequencies: found {grid[0]:g} to {grid[-1]:g} Hz, expected finite ones, none negative")
    return grid


def band_of(reduced) -> tuple[float, float]:
    """The band of the job, of the accuracy, or up to the highest pseudo-frequency, in Hz."""
    record = reduced.record
    known = record.accuracy.band if record.accuracy is not None else (0.0, float(reduced.frequencies[-1]))
    return (record.job or {}).get("band") or known


def factoring_of(record) -> Factoring:
    job = record.job or {}
    return Factoring(**{key: job.get(key) for key in ("out_of_core", "low_rank", "memory_mb")})


def model_of_record(path, record, result, comm):
    """The model of a model file with the inputs and outputs of a reduction, checked to be the one that was reduced.

    Collective. Raises InputError.
    """
    model = with_interfaces(read_model(path, comm), record.interfaces)
    for key, names in (("input", record.inputs), ("output", record.outputs)):
        model = _as_recorded(model, key, names, record, path)
    try:
        _check_same(signature_of(model), record, path, result)
    except InputError:
        model.close()  # a refusal of all ranks
        raise
    return model


def _as_recorded(model, key, names, record, path):
    """The model with the inputs or outputs of a reduction, from their names or from the file of the job."""
    if key == "output" and names == record.inputs and "C" not in record.signature:
        with model:
            return model.with_output_columns(None, ())
    if getattr(model, f"{key}_names") == names:
        return model
    targets = [target_of(name) for name in names]
    file = (record.job or {}).get(key + "s")
    if None in targets and not isinstance(file, str):
        with model:
            raise InputError(f"{path}: has no {key}s {', '.join(names)}, which the reduction used")
    return with_targets(model, key, file if None in targets else targets)


def _check_same(found, record, path, result):
    for key, expected in record.signature.items():
        if key == "D" and record.damping.kind != "given":
            continue
        values = np.array(found.get(key, ()))
        scale = np.abs(expected).max(initial=0.0)
        if values.shape != np.shape(expected) or np.abs(values - expected).max(initial=0.0) > SAME * scale:
            what = {"B": "inputs", "C": "outputs"}.get(key, f"matrix {key}")
            raise InputError(f"{path}: its {what} differ from what {result} was reduced from; take that model, or "
                             "reduce this one again")  # fmt: skip
