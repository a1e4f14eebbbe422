"""Find the bearings of a model."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..report.tables import show_table
from . import session, values
from .options import JsonFile


def bores(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5")],
    turn: Annotated[float, typer.Option(help="Degrees around its axis that a cylinder has at least.")] = 120.0,
    figure: Annotated[str | None, typer.Option(metavar="FILE", help="Draw them: .png, .svg, .pdf.")] = None,
    json: JsonFile = None,
):
    """Find the holes and pins of a model, and print them as interfaces for a job."""
    report = hpcred.bores_of_file(model, turn=turn, figure=figure, progress=session.progress())
    rows = [
        {"name": row["name"], **dict(zip(("centre x", "y", "z"), row["centre"], strict=True)),
         "axis": values.direction(row["axis"]), "radius": row["radius"], "length": row["length"],
         "turn": f"{row['turn']:g}", "nodes": row["nodes"]} for row in report["bores"]
    ]  # fmt: skip
    if rows:
        show_table(f"{model}: holes (bore) and pins; m, turn in degrees", rows)
        print(f"Lines for the job; give them names of your own, and leave out what is no bearing\n\n{report['job']}")
    else:
        print(f"{model}: no cylinder of {turn:g} degrees or more on its surface; --turn takes less")
    if figure:
        print(f"written to {figure}")
    session.warn(report["warnings"])
    session.write_json(json, report)
