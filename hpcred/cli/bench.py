"""Measure this machine; reproduce the results of the paper."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..report.tables import in_words, say, show_table, show_timing
from ..settings import texts
from . import session
from .options import JsonFile


def bench(
    cells: Annotated[tuple[int, int, int], typer.Option(help="Hexahedra of the block to try on.")] = (40, 16, 16),
    folder: Annotated[str | None, typer.Option(metavar="DIR", help="Where to try writing and reading.")] = None,
    json: JsonFile = None,
):
    """Measure this machine: factorisation, solves, products, orthogonality, files."""
    report = hpcred.bench(cells, folder=folder, progress=session.progress())
    show_table("This machine", [{"": key.replace("_", " "), " ": in_words(value)} for key, value in report.items()
                                if key != "hints"])  # fmt: skip
    session.list_all("hint", report["hints"])
    session.write_json(json, report)


def paper(
    output: Annotated[
        str, typer.Option("-o", "--output", metavar="DIR", help="Folder for figures and data.")
    ] = "paper",
    figures: Annotated[
        str, typer.Option(metavar="N1,N2,...", help="Figures to draw after the tables, or none; 5 takes minutes.")
    ] = "3,4,5",
    json: JsonFile = None,
):
    """Reproduce Section 5 of the paper on the built-in linkage: Tables 1 and 2, Figures 3 to 5."""
    progress = session.progress()
    chosen = [] if figures == "none" else [int(number) if number % 1 == 0 else number
                                           for number in texts.numbers(figures, "--figures")]  # fmt: skip
    data = hpcred.paper(output, figures=chosen, show=_show_tables, progress=progress)
    show_table("Figure 5. u_y of node 20 in time, against all elastic modes", data.get("figure_5", ())[1:])
    drawn = f"figure{'s' * (len(chosen) > 1)} {', '.join(map(str, chosen))} (png, svg), " if chosen else ""
    say(f"{drawn}section5.h5 and section5.json written to {output}")
    show_timing(progress.timing())
    session.write_json(json, data)


def _show_tables(data):
    """Print the tables, before the figures."""
    show_table("Table 1. SISO: chord frame, force at node 20", data["table_1"])
    show_table("Table 2. MIMO: Buckens frame, seven inputs and outputs", data["table_2"])
