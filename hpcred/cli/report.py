"""Write a report on results."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel.declared import flattened
from ..parallel.messages import printable
from . import session, values
from .options import AtValues, Band, FullFile, JsonFile, Pairs, SharedSolving


@flattened
def report(
    results: Annotated[list[str], typer.Argument(metavar="RESULT.h5 ...")],
    full: FullFile = None,
    output: Annotated[str, typer.Option("-o", "--output", metavar="FILE", help="The HTML file.")] = "report.html",
    band: Band = None,
    solves: Annotated[int, typer.Option(help="Frequencies at which the full model is solved.")] = 21,
    pairs: Pairs = None,
    modes: Annotated[int, typer.Option(help="Number of shapes to look at.")] = 10,
    motion: Annotated[
        str | None, typer.Option(metavar="FILE", help="simulation.h5, ...: a picture of its largest stress.")
    ] = None,
    png: Annotated[str | None, typer.Option(metavar="DIR", help="Figures for papers, too.")] = None,
    svg: Annotated[str | None, typer.Option(metavar="DIR", help="Figures for papers, too.")] = None,
    csv: Annotated[str | None, typer.Option(metavar="DIR", help="The numbers as tables, too.")] = None,
    at: AtValues = None,
    *,
    solving: SharedSolving,
    json: JsonFile = None,
):
    """Write a report on results beside each other, one HTML file to look at in a browser, without a network."""
    told = hpcred.report_file(
        results, full, output=output, band=values.band(band), solves=solves, pairs=pairs.split(",") if pairs else (),
        modes=modes, motion=motion, png=png, svg=svg, csv=csv, at=values.parameters(at, "--at"), **solving.given,
    )  # fmt: skip
    session.list_all("note", told["notes"])
    for name in told["files"]:
        print(printable(str(name)))
    print(f"{printable(told['output'])}: {told['megabytes']:.1f} MB")
    session.write_json(json, told)
