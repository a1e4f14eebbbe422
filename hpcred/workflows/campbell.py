"""Compute the Campbell diagram of a result file, beside poles of its full model, into files."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np

from ..analysis.campbell import campbell
from ..analysis.campbell_diagram import FULL_POINTS, Campbell
from ..analysis.whirl import in_words
from ..body.preload import Preload, reduced_at, warning_of_basis
from ..files.campbell_file import write_campbell
from ..files.hdf5 import written_by_one
from ..files.result_file import Result, read_result
from ..files.together import rescued, together
from ..linalg.solvers.settings import Factoring
from ..model.parameters.definitions import Parameter
from ..model.rotation import unit_axis
from ..parallel.declared import declared, flattened
from ..parallel.failures import InputError, agreed
from ..parallel.progress import Progress
from ..parallel.ranges import SAMPLES, within
from ..reduction.result.record import Record, versions
from ..report.campbell_figure import campbell_figure
from ..report.figures import kind_of_figure
from .full_model import factoring_of, full_of_record
from .keywords import At, Files, Speeds, Whirl
from .workflow import workflow


@workflow
@flattened
def campbell_file(
    result, over: str = "omega", *, speeds: Speeds, at: At = None, whirl: Whirl, full=None, solves: int = FULL_POINTS,
    factoring: Factoring | None = None, files: Files, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Return the Campbell diagram of result.h5 over a parameter. Collective.

    A result without parameters that has geometric stiffness goes over the speed omega of a rotation about the `axis`,
    whose centrifugal forces stiffen it.

    Parameters
    ----------
    result : Result or path
    over : str
        The name of the parameter.
    values, range, points : optional
        Of the parameter; or else so many equally spaced points over a range, by default that of the parameter.
    at : dict of float, optional
        Values of the other parameters.
    nodes : sequence of int or str, optional
        Whose orbits tell the direction of whirl; by default those of the inputs and outputs.
    axis : {"x", "y", "z"} or sequence of 3 floats, optional
        By default that of the terms of rotation of the job, or else z.
    orders : sequence of float
        Multiples of the speed whose crossings are critical speeds (see campbell).
    highest : float, optional
        Hz, up to which modes are shown.
    full, solves : optional
        The model file of the reduction, and at how many of the values it is solved.
    factoring : Factoring, optional
        How the full model is factored.
    output, figure : str or PathLike, optional
        A .csv or HDF5 file (see write_campbell); a .png, .svg or .pdf.

    Returns
    -------
    dict
        Plain numbers for a table or JSON.

    Raises
    ------
    InputError
        For a parameter, an axis or a model that does not fit.
    """
    source, output, figure = read_result(result, comm), files.output, files.figure
    files.check(comm, [result, full], progress, over=over)
    for key, number in (("points", speeds.points), ("solves", solves)):
        within(key, declared(key, number, int), SAMPLES)
    if speeds.points < 2:
        raise InputError(f"points: found {speeds.points}, expected at least 2")
    if solves < 1:
        raise InputError(f"solves: found {solves}, expected at least 1")
    # the model over the parameter, at values of it, with the nodes that tell the whirl
    axis = axis_of(source.reduced.record) or "z" if whirl.axis is None else whirl.axis
    model = parametric_of(source, over, axis)
    if at and not model.parameters:
        raise InputError(f"at: found a value of {next(iter(at))}, but {result} has no parameters; leave it out")
    values = speeds.values
    if not len(values):
        range = speeds.range or _range_of(model, over)
        values = np.linspace(*declared("range", range, tuple[float, float]), speeds.points)
    with agreed(comm):
        shapes = source.nodes if whirl.nodes is None else source.body(whirl.nodes).nodes
    # the poles, and those of the full model at some of the values
    with progress.stage("poles"):
        diagram = campbell(
            model, over, values, at=at, nodes=shapes, axis=axis, orders=whirl.orders, highest=whirl.highest
        )
    if full is not None:
        diagram = _with_full(diagram, full, source, at, solves, factoring, comm, progress)
    if not model.parameters:
        told = ["the body is stiffened by its centrifugal forces; Coriolis forces are left out"]
        with agreed(comm):
            fastest = diagram.values[np.abs(diagram.values).argmax()] * unit_axis("axis", axis)
            far = warning_of_basis(source.body(), Preload(omega=tuple(fastest.tolist())))
        diagram = replace(diagram, warnings=(*diagram.warnings, *told, *([far] if far else [])))
    report = _report(diagram) | {"result": str(result), "output": output and str(output)}
    with progress.stage("write"), together(comm):
        if output is not None:
            made = {"result": str(result), "versions": versions()}
            rescued(lambda place: write_campbell(place, diagram, comm, made), output, comm)
        if figure is not None:
            written_by_one(figure, comm, campbell_figure, diagram, str(result), kind_of_figure(figure))
            report["figure"] = str(figure)
    return report | {"timing": asdict(progress.timing())}


def _with_full(diagram, full, result, at, solves, factoring, comm, progress):
    """Return the diagram with poles of a model file. Collective."""
    record = result.reduced.record
    if record is None or not getattr(result.reduced, "parameters", ()):
        raise InputError(f"full: {result.path} was not reduced from a model with parameters")

    @contextmanager
    def full_at(**values):
        with full_of_record(full, record, result.path, factoring=factoring, at=values, comm=comm) as known:
            yield known.model

    return diagram.with_full(
        SimpleNamespace(at=full_at), diagram.spread(solves), record.frame, record.damping, at=at,
        factoring=factoring or factoring_of(record), progress=progress,
    )  # fmt: skip


def axis_of(record: Record | None):
    """Return the axis of the terms of rotation of the job of a record, or None where it has none, or several."""
    terms = ((record and record.job) or {}).get("term", ())
    axes = [term["axis"] for term in terms if term.get("axis") is not None]
    return axes[0] if axes and all(axis == axes[0] for axis in axes) else None


def parametric_of(result: Result, over: str, axis):
    """Return the reduced model of a result over its parameters, or over the speed of a rotation about an axis by its
    geometric stiffness. Raises InputError where it has neither."""
    if getattr(result.reduced, "parameters", ()):
        return result.reduced
    if result.geometric_stiffness is None:
        raise InputError(
            f"{result.path}: it has no parameters; reduce a job with [[parameter]] and [[term]], or with "
            "geometric_stiffness = true for a body that spins"
        )
    if over != "omega":
        raise InputError(f"over: found '{over}', expected omega, the speed of a body with geometric stiffness")
    if result.reduced.rigid_size:
        raise InputError(
            f"{result.path}: found {result.reduced.rigid_size} rigid-body coordinates, expected none: without Coriolis "
            "forces centrifugal ones make rigid-body motions unstable; reduce without interface coordinates, or hold "
            "the body"
        )
    body, e = result.body(), unit_axis("axis", axis)

    def at(omega):
        return reduced_at(body, Preload(omega=tuple((omega * e).tolist())))

    return SimpleNamespace(at=at, parameters=())


def _range_of(model, over):
    known: dict[str, Parameter] = {parameter.name: parameter for parameter in model.parameters}
    if not known:
        raise InputError(f"range: a result with geometric stiffness has no range of {over}; give it (rad/s)")
    if over not in known:
        raise InputError(f"over: found the parameter '{over}', expected one of {', '.join(known)}")
    return known[over].range


def _report(diagram: Campbell) -> dict:
    return {
        "parameter": diagram.parameter,
        "unit": diagram.unit,
        "values": diagram.values.tolist(),
        "frequencies_hz": diagram.frequencies.tolist(),
        "damping_ratios": diagram.damping_ratios.tolist(),
        "orbits": diagram.orbits.tolist(),
        "modes": rows_of_modes(diagram),
        "critical_speeds": [asdict(entry) | {"mode": entry.mode + 1} for entry in diagram.critical_speeds],
        "critical_rows": rows_of_critical(diagram),
        "full": diagram.full_rows,
        "residual": max((entry.residual for entry in diagram.full), default=None),
        "stability_limit": diagram.stability_limit,
        "unstable_frequency_hz": diagram.unstable_frequency,
        "sentence": diagram.sentence,
        "warnings": list(diagram.warnings),
    }


def rows_of_modes(diagram: Campbell) -> list[dict]:
    """Return a row for each mode: frequency and damping at the first and the last value, where it is there, and the
    whirl between."""
    low, high = (f"{value:.6g}" for value in diagram.values[[0, -1]])
    rows = []
    for k, orbits in enumerate(diagram.orbits.T):
        widest = orbits[np.nanargmax(np.abs(orbits))] if np.isfinite(orbits).any() else np.nan
        senses = {in_words(orbit) for orbit in orbits[np.isfinite(orbits)]} - {"none"}
        ends = [{"f": diagram.frequencies[end, k], "damping": 100 * diagram.damping_ratios[end, k]} for end in (0, -1)]
        first, last = ({key: "" if np.isnan(value) else float(value) for key, value in end.items()} for end in ends)
        rows.append({
            "mode": k + 1, f"f (Hz) at {low}": first["f"], f"at {high}": last["f"],
            f"damping (%) at {low}": first["damping"], f"and at {high}": last["damping"],
            "whirl": "changes" if len(senses) > 1 else in_words(widest),
        })  # fmt: skip
    return rows


def rows_of_critical(diagram: Campbell) -> list[dict]:
    """Return a row for each critical speed."""
    to_rpm = {"rad/s": 30 / np.pi}.get(diagram.unit)
    return [
        {"order": speed.order, diagram.parameter: speed.value, **({"rpm": to_rpm * speed.value} if to_rpm else {}),
         "f (Hz)": speed.frequency, "mode": speed.mode + 1, "whirl": speed.whirl,
         "damping (%)": 100 * speed.damping_ratio}
        for speed in diagram.critical_speeds
    ]  # fmt: skip
