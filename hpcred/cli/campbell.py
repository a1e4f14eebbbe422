"""Compute Campbell diagrams of results."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel.declared import flattened
from ..parallel.failures import InputError
from ..report.tables import show_table
from . import session, values
from .options import Figure, JsonFile, Output, Solving


@flattened
def campbell(
    result: Annotated[str, typer.Argument(metavar="RESULT.h5")],
    over: Annotated[str, typer.Option(metavar="PARAMETER", help="The parameter, such as omega.")] = "omega",
    range: Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Default: that of the parameter.")] = None,
    points: Annotated[int, typer.Option(help="Number of equally spaced values in the range.")] = 41,
    at: Annotated[str | None, typer.Option(metavar="P=V,...", help="Values of other parameters.")] = None,
    nodes: Annotated[
        str | None, typer.Option(metavar="N1,N2,...", help="Nodes whose orbits tell the whirl: numbers, names, sets.")
    ] = None,
    axis: Annotated[
        str | None, typer.Option(help="Of the rotation: x, y, z or three numbers; default: that of the job, or z.")
    ] = None,
    orders: Annotated[str, typer.Option(metavar="K1,K2,...", help="Multiples of the speed.")] = "1",
    highest: Annotated[float | None, typer.Option(metavar="HZ", help="Frequency up to which modes are shown.")] = None,
    full: Annotated[
        str | None, typer.Option(metavar="MODEL.h5", help="Solve this full model at some of the values.")
    ] = None,
    solves: Annotated[int, typer.Option(help="Number of these values.")] = 5,
    *,
    solving: Solving,
    output: Output = None,
    figure: Figure = None,
    json: JsonFile = None,
):
    """Campbell diagram: frequencies, damping and whirl over a parameter, critical speeds and the limit of stability."""
    limits = values.numbers(range, "--range")
    if limits and len(limits) != 2:
        raise InputError(f"--range: found '{range}', expected two values, the lower one first, such as 0,800")
    report = hpcred.campbell_file(
        result, over, range=limits or None, points=points, at=values.parameters(at, "--at"),
        nodes=values.labels(nodes), axis=axis if axis in (None, "x", "y", "z") else values.numbers(axis, "--axis"),
        orders=values.numbers(orders, "--orders"), highest=highest, full=full, solves=solves,
        output=output, figure=figure, **solving.given,
    )  # fmt: skip
    unit = f" ({report['unit']})" * bool(report["unit"])
    show_table(f"{result} over {over}{unit}", report["modes"])
    show_table("Critical speeds: a mode has a multiple of the speed", report["critical_rows"])
    if report["full"]:
        _show_full(report)
    session.verdict(report["sentence"], report["stability_limit"] is None)
    session.written(output, figure)
    session.warn(report["warnings"])
    session.write_json(json, report)


def _show_full(report):
    """Print how near the poles of the full model are, value by value."""
    rows = []
    for value in dict.fromkeys(row["value"] for row in report["full"]):
        there = [row for row in report["full"] if row["value"] == value]
        worst = max(there, key=lambda row: row["distance"])
        rows.append({report["parameter"]: value, "modes": len(there), "largest distance": worst["distance"],
                     "at (Hz)": worst["frequency"]})  # fmt: skip
    show_table("Full model: relative distance of its poles from the nearest of the reduced model", rows)
    print(f"largest relative residual of the full eigenproblems {report['residual']:.1e}")
