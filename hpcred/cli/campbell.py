"""Compute Campbell diagrams of results."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel.failures import InputError
from ..report.tables import show_table
from . import session, values
from .options import JsonFile


def campbell(
    result: Annotated[str, typer.Argument(metavar="RESULT.h5")],
    over: Annotated[str, typer.Option(metavar="PARAMETER", help="The parameter, such as omega.")] = "omega",
    range: Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Default: that of the parameter.")] = None,
    points: Annotated[int, typer.Option(help="Number of equally spaced values in the range.")] = 41,
    at: Annotated[str | None, typer.Option(metavar="P=V,...", help="Values of other parameters.")] = None,
    nodes: Annotated[
        str | None, typer.Option(metavar="N1,N2,...", help="Nodes whose orbits tell the whirl: numbers, names, sets.")
    ] = None,
    axis: Annotated[str, typer.Option(help="Of the rotation: x, y, z or three numbers.")] = "z",
    orders: Annotated[str, typer.Option(metavar="K1,K2,...", help="Multiples of the speed.")] = "1",
    highest: Annotated[float | None, typer.Option(metavar="HZ", help="Frequency up to which modes are shown.")] = None,
    output: Annotated[str | None, typer.Option("-o", "--output", metavar="FILE", help="A .csv or HDF5 file.")] = None,
    figure: Annotated[str | None, typer.Option(metavar="FILE", help="A .png, .svg or .pdf.")] = None,
    json: JsonFile = None,
):
    """Campbell diagram: frequencies, damping and whirl over a parameter, critical speeds and the limit of stability."""
    limits = values.numbers(range, "--range")
    if limits and len(limits) != 2:
        raise InputError(f"--range: found '{range}', expected two values, the lower one first, such as 0,800")
    report = hpcred.campbell_file(
        result, over, range=limits or None, points=points, at=values.parameters(at, "--at"),
        nodes=values.labels(nodes), axis=axis if axis in "xyz" else values.numbers(axis, "--axis"),
        orders=values.numbers(orders, "--orders"), highest=highest, output=output, figure=figure,
        progress=session.progress(),
    )  # fmt: skip
    unit = f" ({report['unit']})" * bool(report["unit"])
    show_table(f"{result} over {over}{unit}", report["modes"])
    rows = [_critical(item, report) for item in report["critical_speeds"]]
    show_table("Critical speeds: a mode has a multiple of the speed", rows)
    session.verdict(report["sentence"], report["stability_limit"] is None)
    session.written(output, figure)
    session.warn(report["warnings"])
    session.write_json(json, report)


def _critical(item, report):
    rpm = {"rpm": item["value"] * 30 / 3.141592653589793} if report["unit"] == "rad/s" else {}
    return {"order": item["order"], report["parameter"]: item["value"], **rpm, "f (Hz)": item["frequency"],
            "mode": item["mode"], "whirl": item["whirl"], "damping (%)": 100 * item["damping_ratio"]}  # fmt: skip
