"""A result file on a grid of frequencies, alone or against the full model it came from."""

import numpy as np

from ..analysis.error import error_integral, relative_error
from ..analysis.frequency_response import frequency_response
from ..formats.hdf5 import check_writable, writing
from ..formats.job_file import CHOICES
from ..formats.model_file import read_model
from ..formats.result_file import read_result
from ..formats.toml_file import as_kind
from ..model.dofs import target_of
from ..parallel.failures import InputError
from ..parallel.petsc import is_complex
from .convert import column_names, read_columns


def evaluate_result(result, full, frequencies, band, points, comm, progress=None, output=None, groups=None) -> dict:
    """Responses of result.h5, and eps(f) and Q against the model file `full` if given. Collective.

    `frequencies` (Hz), or else `points` of them over `band` (two numbers, default that of the job). The frame,
    the damping, the inputs and outputs of the full model are those of the reduction. `output`: HDF5 file for
    the responses. `groups`: see frequency_response. Returns plain numbers for a table or JSON.
    """
    rom = read_result(result, comm)
    record = rom.provenance
    band = list(band or record.get("job", {}).get("band") or [0.0, float(rom.frequencies[-1])])
    grid = np.sort(frequencies) if len(frequencies) else np.linspace(*band, points)
    if grid.min() < 0 or not np.isfinite(grid).all():
        raise InputError(f"frequencies: found {grid.min():g} Hz, expected none negative")
    if output is not None:
        check_writable(output, comm)
    report = {"result": str(result), "frequencies_hz": grid.tolist()}
    arrays = {"frequencies": grid, "reduced": frequency_response(rom, grid)}
    if full is not None:
        frame = as_kind(CHOICES["frame"], record["frame"], "frame")
        damping = as_kind(CHOICES["damping"], record["damping"], "damping")
        with read_model(full, comm) as model:
            if model.size != record["size"]:
                raise InputError(
                    f"{full}: found {model.size} dofs, but {result} was reduced from a model of {record['size']}"
                )
            _load_as(model, record, comm)
            arrays["full"] = frequency_response(model, grid, frame, damping, progress, groups)
        arrays["eps"] = relative_error(arrays["full"], arrays["reduced"])
        report["arithmetic"] = "full model solved in " + (
            "real arithmetic (undamped)" if record["damping"]["kind"] == "none"
            else "complex arithmetic" if is_complex()
            else "real arithmetic of twice the size (real PETSc)"
        )  # fmt: skip
    report["reduced_norm"] = np.linalg.norm(arrays["reduced"], axis=(1, 2)).tolist()
    if full is not None:
        report |= {
            "full_norm": np.linalg.norm(arrays["full"], axis=(1, 2)).tolist(),
            "eps": arrays["eps"].tolist(),
            "eps_max": float(arrays["eps"].max()),
            "Q": error_integral(grid, arrays["eps"]),
        }
    if output is not None:
        with writing(output, comm) as file:
            file.attribute("format", "hpcred-response")
            for key, value in arrays.items():
                file.small(key, value)
    return report


def _load_as(model, record, comm):
    """Give the model the inputs and outputs of the reduction, from their names or from the job's file."""
    if record["outputs"] == record["inputs"]:
        model.clear_outputs()
    for key, names in (("input", record["inputs"]), ("output", record["outputs"])):
        if getattr(model, f"{key}_names") == names or (key == "output" and names == record["inputs"]):
            continue
        targets = [target_of(name) for name in names]
        file = record.get("job", {}).get(key + "s")
        if None not in targets:
            getattr(model, f"set_{key}s")(targets)
        elif isinstance(file, str):
            local = read_columns(comm, model.row_starts, model.size, file, key == "output")
            getattr(model, f"set_{key}_columns")(local, column_names(file, local))
        else:
            raise InputError(f"{model.name}: has no {key}s {', '.join(names)}, which the reduction used")
