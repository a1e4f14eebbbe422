"""Collect the results of a sweep file in one table, and draw figures that compare them."""

from __future__ import annotations

import re
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ..analysis.error import as_compared, error_integral, errors_of
from ..analysis.frequency_response import frequency_response
from ..files.folders import folder_for
from ..files.locks import locks_given_back
from ..files.outputs import PICTURES, check_outputs
from ..files.response_file import read_responses
from ..files.result_file import result_at
from ..files.sweep_table import check_table_name, write_sweep_table
from ..files.together import together
from ..parallel.declared import spelled
from ..parallel.failures import InputError
from ..reduction.interface_coordinates import elastic_part
from ..reduction.result.directions import worst_of_directions
from ..report.figures import new_figure
from ..report.sweep_figures import curves_figure, key_figure, size_figure, stem_of
from ..settings.sweep_file import read_sweep
from .sweep import refuse_ranks, responses_of, states_of

SELF = MPI.COMM_SELF


@spelled
@locks_given_back()
def collect_sweep(path, *, output=None, figures=None, store=None, comm=None) -> dict:
    """Return one row a run of a sweep. Collective.

    Parameters
    ----------
    path : str or PathLike
        The sweep file.
    output : str or PathLike, optional
        A .csv, .json or HDF5 file for the table.
    figures : str or PathLike, optional
        A folder, created where needed, for error over size, error over each key with numbers, and eps(f), as PNG and
        SVG.
    store : str or PathLike, optional
        As for run_sweep.

    Returns
    -------
    dict
        `rows`: name, status, the keys that vary, size, Q (57), the largest eps against the full model, the estimate of
        an automatic reduction, the direction that is known worst, seconds, factorisations made and saved, and memory of
        all ranks in MB; `missing` (runs without a result of their job), `curves` {run: (frequencies, eps)}, the names
        of the figures and remarks.

    Raises
    ------
    InputError
        For a file that is no sweep, and outputs that cannot be written.
    """
    refuse_ranks(comm, "collect")
    sweep = read_sweep(path, store, runs_come=False)
    if output is not None:
        check_table_name(output, SELF)
    if figures is not None:
        new_figure()  # refused early where there is none
        stems = ["error_over_size", "errors", *(f"error_over_{stem_of(key)}" for key in sweep.keys)]
        if Path(figures).is_dir():
            check_outputs({Path(figures, stem + suffix): PICTURES[suffix] for stem in stems
                           for suffix in (".png", ".svg")}, SELF)  # fmt: skip
    states, full = states_of(sweep), responses_of(sweep)
    rows, curves, remarks = [], {}, []
    for run in sweep.runs:
        row, curve = _row(run, states[run.name], full.get(run.name), sweep.keys)
        rows.append(row)
        if curve is not None:
            curves[run.name] = curve
    if lacking := sorted({str(file) for file in full.values() if not file.is_file()}):
        remarks.append(f"the full response {', '.join(lacking)} is not there; `hpcred sweep {path}` computes it")
    folder = nullcontext() if figures is None else folder_for(figures, SELF, "--figures ")
    with folder, together(SELF):
        if output is not None:
            write_sweep_table(output, rows, curves, SELF)
        drawn = _draw(Path(figures), rows, curves, sweep, remarks) if figures is not None else []
    return {
        "rows": rows,
        "missing": [row["run"] for row in rows if row["size"] is None],
        "curves": {name: [list(map(float, numbers)) for numbers in curve] for name, curve in curves.items()},
        "figures": drawn,
        "remarks": remarks,
    }


def _row(run, state, full, keys):
    """Return a row of the table, and the frequencies and errors of its curve or None."""
    row = {"run": run.name, "status": state.word}
    row |= {key: _plain(run.values.get(key), run.labels.get(key)) for key in keys}
    row |= dict.fromkeys(
        ("size", "Q", "eps", "estimate", "worst_direction", "seconds", "factorisations", "factorisations_saved",
         "memory_mb")
    )
    if not state.done:
        return row, None
    reduced = result_at(state.file, None, SELF).reduced
    record, curve = reduced.record, None
    row |= {
        "size": reduced.size, "seconds": record.timing.elapsed, "factorisations": len(record.factorisations),
        "factorisations_saved": record.factorisations_saved, "memory_mb": sum(record.timing.memory_mb_per_rank),
    }  # fmt: skip
    if record.accuracy is not None:
        row["estimate"] = record.accuracy.largest
        row["worst_direction"] = worst_of_directions(record.accuracy.directions)
        row["Q"] = record.accuracy.mean * (record.accuracy.band[1] - record.accuracy.band[0])
        curve = record.accuracy.frequencies, record.accuracy.eps
    if full is not None and full.is_file():
        frequencies, errors = errors_against(elastic_part(reduced), full)
        curve = frequencies, errors.eps
        row["Q"], row["eps"] = error_integral(*curve), float(errors.eps.max())
        row["worst_direction"] = worst_of_directions(errors.directions)
    return row, curve


def errors_against(reduced, path):
    """Return frequencies (F,) in Hz and the Errors of a ReducedModel against the full response of a file. Raises
    InputError."""
    responses = read_responses(path)
    if responses.full is None or responses.drive is None:
        raise InputError(
            f"{path}: has no response of a full model, or not that at its inputs; remove it, and it is made again"
        )
    for key in ("input_names", "output_names"):
        if getattr(responses, key) != getattr(reduced, key):
            raise InputError(f"{path}: its {key.replace('_', ' ')} are not those of the reduced model")
    f = responses.frequencies
    reduced = as_compared(reduced, (f[0], f[-1]))[0]
    return f, errors_of(reduced, f, responses.full, frequency_response(reduced, f), responses.drive)


def _plain(value, label):
    """Return a number or text as it is, and the label of a table or list."""
    return value if value is None or isinstance(value, (int, float, str)) else label


def _draw(folder, rows, curves, sweep, remarks) -> list[str]:
    drawn, error = [], next((key for key in ("eps", "estimate") if any(row[key] is not None for row in rows)), None)
    known = [row for row in rows if error and row[error] is not None and np.isfinite(row[error])]
    if not known:
        asked = "evaluate = true in the sweep computes it" if sweep.evaluate is None else "the sweep has not come to it"
        remarks.append(f"no figures: no error is known; {asked}")
        return []
    # keys of numbers become an axis, other keys name the curves
    keys = {key: [row[key] for row in known] for key in sweep.keys}
    numeric = [key for key, values in keys.items() if all(_is_number(value) for value in values)]
    words = [key for key in keys if key not in numeric]
    kinds = {run.name: " + ".join(component.kind for component in run.job.basis) or "automatic" for run in sweep.runs}

    def method(row):
        return ", ".join(_said(key, row[key]) for key in words) or kinds[row["run"]]

    # error over size, over each key of numbers, and over frequency
    size_figure(folder / "error_over_size", known, method, error)
    drawn.append("error_over_size")
    for key in numeric:
        if len(set(keys[key])) > 1:
            others = [other for other in keys if other != key and keys[other] != keys[key]]
            stem = f"error_over_{stem_of(key)}"
            key_figure(folder / stem, known, key, lambda row, others=others: ", ".join(
                _said(other, row[other]) for other in others), error)  # fmt: skip
            drawn.append(stem)
    if curves:
        curves_figure(folder / "errors", curves)
        drawn.append("errors")
    return [str(folder / f"{stem}.png") for stem in drawn]


def _is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _said(key, value):
    """Return a key and its value in a legend, with the last words of the key."""
    short = key if re.search(r"\.\d+\.", key) else key.rpartition(".")[2]
    return f"{short} {value:.6g}" if isinstance(value, float) else f"{short} {value}"
