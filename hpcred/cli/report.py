"""Write a report on results."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel.messages import printable
from ..report.tables import say
from ..workflows.keywords import At, Band, Folders, FullFile, Shown
from . import session
from .options import JsonFile, SharedSolving, command


@command
def report(
    results: Annotated[list[str], typer.Argument(metavar="RESULT.h5 ...")],
    full: FullFile = None,
    output: Annotated[str, typer.Option("-o", "--output", metavar="FILE", help="The HTML file.")] = "report.html",
    band: Band = None,
    solves: Annotated[int, typer.Option(help="Frequencies at which the full model is solved.")] = 21,
    *,
    shown: Shown,
    folders: Folders,
    at: At = None,
    solving: SharedSolving,
    json: JsonFile = None,
):
    """Write a report on results beside each other, one HTML file to look at in a browser, without a network."""
    told = hpcred.report_file(
        results, full, output=output, band=band, solves=solves, at=at, **shown.given, **folders.given, **solving.given
    )
    session.list_all("note", told["notes"])
    for name in told["files"]:
        print(printable(str(name)))
    say(f"{printable(told['output'])}: {told['megabytes']:.1f} MB")
    session.write_json(json, told)
