"""Compute Campbell diagrams of results."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel.declared import Option
from ..report.tables import say, show_table
from ..settings import texts
from ..workflows.keywords import At, Files, Speeds, Whirl
from . import session
from .options import JsonFile, Solving, command


@command
def campbell(
    result: Annotated[str, typer.Argument(metavar="RESULT.h5")],
    over: Annotated[str, typer.Option(metavar="PARAMETER", help="The parameter, such as omega.")] = "omega",
    *,
    speeds: Speeds,
    at: Annotated[At, Option("Values of other parameters.", "P=V,...", texts.parameters)] = None,
    whirl: Whirl,
    full: Annotated[
        str | None, typer.Option(metavar="MODEL.h5", help="Solve this full model at some of the values.")
    ] = None,
    solves: Annotated[int, typer.Option(help="Number of these values.")] = 5,
    solving: Solving,
    files: Files,
    json: JsonFile = None,
):
    """Campbell diagram: frequencies, damping and whirl over a parameter, critical speeds and the limit of stability."""
    report = hpcred.campbell_file(
        result, over, at=at, full=full, solves=solves, **speeds.given, **whirl.given, **files.given, **solving.given
    )
    unit = f" ({report['unit']})" * bool(report["unit"])
    show_table(f"{result} over {over}{unit}", report["modes"])
    show_table("Critical speeds: a mode has a multiple of the speed", report["critical_rows"])
    if report["full"]:
        _show_full(report)
    session.verdict(report["sentence"], report["stability_limit"] is None)
    session.written(files.output, files.figure)
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
    say(f"largest relative residual of the full eigenproblems {report['residual']:.1e}")
