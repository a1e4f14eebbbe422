"""Describe files that hpcred wrote, but for models, by plain numbers and texts, and check their checksums.

Those of HDF5 are read by all ranks; exports, tables and reports on one rank.
"""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np

from ..analysis.summary import inspect
from ..files import (
    campbell_file,
    model_file,
    motion_file,
    outputs,
    point_store,
    recovered_file,
    response_file,
    result_file,
    sweep_table,
)
from ..files.hdf5 import kind_of_file, reading, require_whole, texts
from ..model.parameters.definitions import rows_of_parameters
from ..model.second_order_model import declared_in
from ..parallel.failures import InputError, agreed
from ..parallel.plugins import OWN, blamed
from ..parallel.progress import Progress
from ..parallel.shares import row_range
from ..writers.registry import WRITERS
from .workflow import workflow


def result(path, comm) -> dict:
    """Describe a result. Collective. Raises InputError."""
    content = result_file.read_result(path, comm)
    reduced = content.reduced
    report = {
        "format": "hpcred result",
        "coordinates": reduced.size,
        **({"of_these_rigid_body": reduced.rigid_size} if reduced.rigid_size else {}),
        "frequencies_hz": reduced.frequencies.tolist(),
        "inputs": list(reduced.input_names),
        "outputs": list(reduced.output_names),
        "interface_nodes": [shape.node for shape in content.nodes],
    }
    # what the reduced model has beside M, D, K
    report |= reduced.operator.families
    if content.geometric_stiffness is not None:
        report["geometric_stiffness"] = list(content.geometric_stiffness.states)
    if varied := getattr(reduced, "parameters", ()):
        report["parameters"] = rows_of_parameters(varied)
        report["terms"] = [{"of": entry.of, "factor": entry.factor} for entry in reduced.terms]
    if content.stress_nodes:
        report["stress"] = f"{content.stress_nodes} nodes; {content.stress_source}"
    # where it comes from, and how accurate it is
    record = reduced.record
    if record is None:
        return report | {"warnings": []}
    report |= {"model": record.model, "dofs": record.size, "frame": record.frame.kind, "damping": _damping(record)}
    report |= declared_in(record.job or {})
    if record.basis_of:
        report["basis_of"] = record.basis_of
    if record.accuracy is not None:
        report["accuracy"] = record.accuracy.sentence
        report["modes_of_the_band"] = record.accuracy.modes_in_words
    if blas := record.versions.get("blas"):
        report["blas"] = blas
    if record.interface_rows:
        report["interfaces"] = record.interface_rows
    if record.joints:
        report["joints"] = [entry.row for entry in record.joints]
    if record.loads:
        report["loads"] = [entry.row for entry in record.loads]
    return report | {"warnings": list(record.warnings)}


def _damping(record) -> str:
    """Return the damping of a result, and that of its errors where it has none itself."""
    kind = record.damping.kind
    if kind != "none" or record.accuracy is None or not record.accuracy.loss_factor:
        return kind
    return f"none; errors are {record.accuracy.measured}"


def response(path, comm) -> dict:
    """Describe a file of responses. Raises InputError."""
    responses = response_file.read_responses(path)
    f = responses.frequencies
    report = {
        "format": "hpcred frequency responses",
        "frequencies": len(f),
        "band_hz": [float(f.min()), float(f.max())] if len(f) else [],
        "inputs": list(responses.input_names),
        "outputs": list(responses.output_names),
        "arrays": [key for key in response_file.ARRAYS if getattr(responses, key) is not None],
    }
    if responses.eps is not None and len(f):
        report["largest_eps"] = float(responses.eps.max())
    made_from = {key: responses.record[key] for key in ("model", "result") if key in responses.record}
    return report | made_from | {"warnings": list(responses.record.get("warnings", []))}


def simulation(path, comm) -> dict:
    """Describe a file of a simulation. Raises InputError."""
    with reading(path, motion_file.FORMAT, motion_file.VERSION, motion_file.SCHEMA) as file:
        record = file.table("provenance")
        report = {
            "format": "hpcred simulation",
            "times": file["t"].shape[0],
            "end_s": float(file["t"][-1]),
            "elastic_coordinates": file["elastic"].shape[1],
            "nodes": file["nodes/number"][...].tolist(),
            "constraints": texts(file["constraints/name"]),
            "largest_displacement_m": float(np.abs(file["nodes/displacement"][...]).max(initial=0.0)),
        }
    known = ("constraint_drift_m", "energy_defect")
    report |= {key: record[key] for key in known if key in record}
    warnings = [*record.get("warnings", []), *record.get("notes", [])]
    return report | {"body": record["setup"]["body"], "warnings": warnings}


def recovery(path, comm) -> dict:
    """Describe a file of recovered motion. Raises InputError."""
    with reading(path, recovered_file.FORMAT, recovered_file.VERSION, recovered_file.SCHEMA) as file:
        record = file.table("record")
        report = {
            "format": "hpcred recovered motion",
            "times": file["t"].shape[0],
            "end_s": float(file["t"][-1]),
            "nodes": file["nodes/number"].shape[0],
            "arrays": [key for key in recovered_file.FIELDS if key in file],
        }
    return report | {key: record[key] for key in ("result", "motion", "axes")} | {"warnings": record["remarks"]}


def diagram(path, comm) -> dict:
    """Describe a file of a Campbell diagram. Raises InputError."""
    content = campbell_file.read_campbell(path)
    report = {
        "format": "hpcred Campbell diagram",
        "parameter": f"{content.parameter} in {content.unit}" if content.unit else content.parameter,
        "from_to": [float(content.values[0]), float(content.values[-1])],
        "values": len(content.values),
        "modes": content.poles.shape[1],
        "critical_speeds": [critical.value for critical in content.critical_speeds],
    }
    return report | {"stability_limit": content.stability_limit, "warnings": list(content.warnings)}


OUTPUTS = {
    campbell_file.FORMAT: diagram,
    result_file.FORMAT: result,
    response_file.FORMAT: response,
    motion_file.FORMAT: simulation,
    recovered_file.FORMAT: recovery,
}


CHECKED = (model_file, result_file, response_file, motion_file, recovered_file, campbell_file, point_store, sweep_table)
FORMATS = {item.FORMAT: (item.VERSION, getattr(item, "SCHEMA", None)) for item in CHECKED}


@workflow
def verify_file(path, *, comm=None, progress: Progress | None = None) -> dict:
    """Read all of a file of hpcred that has checksums, such as a model or a result, on all ranks. Collective.

    Parameters
    ----------
    path : str or PathLike

    Returns
    -------
    dict
        What was checked, in numbers, and of a model its summary, for which M is factored (see inspect).

    Raises
    ------
    InputError
        At the first dataset that is damaged, and where there are no checksums, or those of earlier versions.
    """
    with agreed(comm):
        require_whole(path)
        kind = kind_of_file(path)
        if kind is None:
            raise InputError(f"{path}: found no HDF5 file of hpcred, expected one such as model.h5")
        with reading(path, kind, *FORMATS.get(kind, ())) as file:  # of all that it writes, formats without table too
            if not file.complete:
                raise InputError(f"{path}: has no checksums, or other ones, made by an older hpcred; make it again")
            count = file.verify(lambda rows: row_range(comm, rows))
    report = {"format": kind, "verified_datasets": count, "warnings": []}
    if kind == model_file.FORMAT:
        with model_file.read_model(path, comm) as model, progress.stage("inspect"):
            report |= inspect(model, verify=True, progress=progress)
    return report


def table(path) -> dict:
    """Return columns and number of lines of a .csv."""
    with open(path, encoding="utf-8", newline="") as file:
        rows = csv.reader(file)
        return {"format": "table (.csv)", "columns": next(rows), "rows": sum(1 for _ in rows)}


def data(path) -> dict:
    """Return the keys of a JSON file."""
    content = json.loads(Path(path).read_text(encoding="utf-8"))
    keys = list(content if isinstance(content, dict) else content[0] if content else [])
    return {"format": "JSON", "keys": keys, **({} if isinstance(content, dict) else {"rows": len(content)})}


def page(path) -> dict:
    """Return the title of a report."""
    with open(path, encoding="utf-8") as file:
        title = re.search("<title>(.*?)</title>", file.read(4096), re.S)
    return {"format": "HTML report", "about": title[1] if title else "not known"}


def by_writers(path, entries) -> dict | None:
    """Return the description of the first writer that knows the format of a file, or None. On one rank."""
    with open(path, "rb") as file:
        start = file.read(4096)
    for entry in WRITERS.fitting(lambda writer: start and writer.begins(start), entries):
        writer = WRITERS.load(entry)
        with blamed(writer):
            content = writer.describe(path)
        if entry.package != OWN:
            return {"format": f"{writer.name} (of the package {writer.package})", **content}
        if content:
            return content
    return None


def described(path, tables=True) -> dict | None:
    """Describe an export of hpcred, a table or a picture; None for others. `tables`: also texts between commas.

    On one rank.
    """
    if content := by_writers(path, WRITERS.own):
        return content
    kind = outputs.kind_of(path)
    if kind in outputs.TABLES or kind.startswith(".csv table"):
        return table(path) if tables else None
    if kind == outputs.JSON:
        return data(path)
    if kind == outputs.HTML:
        return page(path)
    return {"format": kind} if kind.endswith("of a sweep") else None


def read_whole(describe, path, comm) -> dict:
    """Describe a file by one of the functions of this module; refuse a damaged one. Collective."""
    try:
        return describe(path, comm)
    except (KeyError, IndexError, TypeError, AttributeError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise damaged(path, error) from error


def damaged(path, error) -> InputError:
    """Return the refusal of a file that its reader does not understand."""
    return InputError(f"{path}: damaged, or not whole ({type(error).__name__}: {error}); make it again")
