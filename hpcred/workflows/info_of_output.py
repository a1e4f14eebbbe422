"""Files that hpcred wrote, but for models, enter; what they contain leaves as plain numbers and texts."""

from __future__ import annotations

import json

import numpy as np

from ..files import motion_file, response_file, result_file
from ..files.hdf5 import reading, texts
from ..parallel.failures import InputError
from ..writers.sid import read_sid


def result(path, comm) -> dict:
    """What result.h5 says. Collective. Raises InputError."""
    found = result_file.read_result(path, comm)
    reduced = found.reduced
    report = {
        "format": "hpcred result",
        "coordinates": reduced.size,
        **({"of_these_rigid_body": reduced.rigid_size} if reduced.rigid_size else {}),
        "frequencies_hz": reduced.frequencies.tolist(),
        "inputs": list(reduced.input_names),
        "outputs": list(reduced.output_names),
        "interface_nodes": [shape.node for shape in found.nodes],
    }
    record = reduced.record
    if record is None:
        return report | {"warnings": []}
    report |= {"model": record.model, "dofs": record.size, "frame": record.frame.kind, "damping": record.damping.kind}
    if record.accuracy is not None:
        report["accuracy"] = record.accuracy.sentence
    if record.interface_rows:
        report["interfaces"] = record.interface_rows
    return report | {"warnings": list(record.warnings)}


def response(path, comm) -> dict:
    """What a file of responses says. Raises InputError."""
    found = response_file.read_responses(path)
    f = found.frequencies
    report = {
        "format": "hpcred frequency responses",
        "frequencies": len(f),
        "band_hz": [float(f.min()), float(f.max())] if len(f) else [],
        "inputs": list(found.input_names),
        "outputs": list(found.output_names),
        "arrays": [key for key in response_file.ARRAYS if getattr(found, key) is not None],
    }
    if found.eps is not None and len(f):
        report["largest_eps"] = float(found.eps.max())
    made_from = {key: found.record[key] for key in ("model", "result") if key in found.record}
    return report | made_from | {"warnings": list(found.record.get("warnings", []))}


def simulation(path, comm) -> dict:
    """What a file of a simulation says. Raises InputError."""
    with reading(path, motion_file.FORMAT, motion_file.VERSION, motion_file.SCHEMA) as file:
        record = json.loads(file["provenance"][()])
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
    return report | {"body": record["setup"]["body"], "warnings": list(record.get("notes", []))}


def sid(path, comm) -> dict:
    """What a SID file says. Raises InputError."""
    found = read_sid(path)
    J = found.objects["J"].m0.ravel().tolist()
    return {
        "format": "SID file of a flexible body",
        "mass": found.mass,  # in units that the file does not say
        "coordinates": found.coordinates,
        "interface_nodes": [node.node for node in found.nodes],
        "inertia_xx_yy_zz_xy_xz_yz": J,
        "damping": "none" if found.objects["De"].structure == 0 else "given",
        "comment": found.comment,
        "warnings": [],
    }


OUTPUTS = {
    result_file.FORMAT: result,
    response_file.FORMAT: response,
    motion_file.FORMAT: simulation,
}


def read_whole(describe, path, comm) -> dict:
    """What a file says by one of the functions of this module; a damaged one is refused. Collective."""
    try:
        return describe(path, comm)
    except (KeyError, IndexError, TypeError, AttributeError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise damaged(path, error) from error


def damaged(path, error) -> InputError:
    """The refusal of a file that its reader does not understand."""
    return InputError(f"{path}: damaged, or not whole ({type(error).__name__}: {error}); make it again")
