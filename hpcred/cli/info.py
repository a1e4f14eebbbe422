"""Describe a file."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel.failures import InputError
from ..report.tables import in_words, show_table
from . import session, values
from .options import INTERFACES, JsonFile

MOST_SETS = 20  # node sets that are listed


def info(
    file: Annotated[str, typer.Argument(metavar="FILE")],
    below: Annotated[str | None, typer.Option(metavar="F1,F2", help="Count modes below (Hz).")] = None,
    band_top: Annotated[float | None, typer.Option(help="Upper end of the band (Hz): size hint.")] = None,
    modes: Annotated[int | None, typer.Option(help="Find so many of the lowest frequencies.")] = None,
    verify: Annotated[bool, typer.Option("--verify", help="Read all of it, and check all checksums.")] = False,
    figure: Annotated[
        str | None, typer.Option(metavar="FILE", help="Draw node sets, or the interfaces of a job: .png, .svg, .pdf.")
    ] = None,
    names: Annotated[str | None, typer.Option("--sets", metavar="A,B", help="Draw these node sets only.")] = None,
    json: JsonFile = None,
):
    """Say what a file is: what a model contains and needs, and the format and matrices of any other file."""
    if names and not figure:
        raise InputError("--sets: belongs to --figure")
    if verify and (below or band_top or modes or figure):
        raise InputError("--verify: cannot be combined with other questions; call info twice")
    report = hpcred.verify_file(file) if verify else hpcred.describe_file(
        file, frequencies=values.numbers(below, "--below"), band_top=band_top, modes=modes, figure=figure,
        sets=names.split(",") if names else None, progress=session.progress(),
    )  # fmt: skip
    below_it = ("sets", "interfaces", "warnings")
    rows = [{"": key.replace("_", " "), file: in_words(value)} for key, value in report.items() if key not in below_it]
    show_table(None, rows)
    show_table(INTERFACES, report.get("interfaces", []))
    sets = [{"node set": name, "nodes": count} for name, count in report.get("sets", {}).items()]
    show_table(None, sets[:MOST_SETS])
    if len(sets) > MOST_SETS:
        print(f"and {len(sets) - MOST_SETS} more node sets; --json - lists all")
    if figure:
        print(f"written to {figure}")
    session.warn(report["warnings"])
    session.write_json(json, report)
