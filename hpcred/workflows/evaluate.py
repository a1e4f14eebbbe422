"""A result file on a grid of frequencies, alone or against the full model it came from."""

from __future__ import annotations

import numpy as np

from ..analysis.error import error_integral, relative_error
from ..analysis.frequency_response import frequency_response
from ..formats.hdf5 import check_writable, writing
from ..formats.model_file import read_model
from ..formats.result_file import read_result
from ..linalg.factorisation import Factoring
from ..model.damping import NoDamping
from ..model.dofs import target_of
from ..parallel import startup
from ..parallel.failures import InputError
from ..parallel.petsc import is_complex
from ..parallel.progress import Progress
from ..reduction.record import signature_of
from .reduce import with_targets

SAME = 1e-8  # relative difference of signatures of the same matrices, written and read on other ranks


def evaluate_result(
    result, full=None, *, frequencies=(), band=None, points: int = 61, output=None, groups: int | None = None,
    factoring: Factoring | None = None, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Responses of result.h5, and eps(f) (55) and Q (57) against the model file `full` if given. Collective.

    `frequencies` (Hz), or else `points` of them over `band` (two numbers, default that of the job). The frame, the
    damping, the inputs and outputs of the full model are those of the reduction, and so is `factoring` unless it is
    given; that it is the model of the reduction is checked. `output`: HDF5 file for the responses. `groups`: see
    frequency_response. Returns plain numbers for a table or JSON. Raises InputError.
    """
    comm = comm or startup.start_mpi()
    reduced = read_result(result, comm).reduced
    record = reduced.record
    grid = _grid(frequencies, band or (record.job or {}).get("band") or (0.0, float(reduced.frequencies[-1])), points)
    if output is not None:
        check_writable(output, comm)
    report = {"result": str(result), "frequencies_hz": grid.tolist()}
    arrays = {"frequencies": grid, "reduced": frequency_response(reduced, grid)}
    report["reduced_norm"] = np.linalg.norm(arrays["reduced"], axis=(1, 2)).tolist()
    if full is not None:
        damped = not isinstance(record.damping, NoDamping)
        factoring = factoring or _factoring_of(record)
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
        }  # fmt: skip
    if output is not None:
        with writing(output, comm) as file:
            file.attribute("format", "hpcred-response")
            for key, value in arrays.items():
                file.small(key, value)
    return report


def _grid(frequencies, band, points):
    if not len(frequencies) and points < 2:
        raise InputError(f"points: found {points}, expected at least 2 frequencies over the band")
    grid = np.sort(np.asarray(frequencies, dtype=float)) if len(frequencies) else np.linspace(*band, points)
    if not np.isfinite(grid).all() or grid.min() < 0:
        raise InputError(f"frequencies: found {grid[0]:g} to {grid[-1]:g} Hz, expected finite ones, none negative")
    return grid


def _factoring_of(record) -> Factoring:
    job = record.job or {}
    return Factoring(**{key: job.get(key) for key in ("out_of_core", "low_rank", "memory_mb")})


def model_of_record(path, record, result, comm):
    """The model of a model file with the inputs and outputs of a reduction, checked to be the one that was reduced.

    Collective. Raises InputError.
    """
    model = read_model(path, comm)
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
