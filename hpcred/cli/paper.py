"""Reproduce the results of the paper."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..report.tables import show_table, show_timing
from . import session
from .options import JsonFile


def paper(
    output: Annotated[
        str, typer.Option("-o", "--output", metavar="DIR", help="Folder for figures and data.")
    ] = "paper",
    json: JsonFile = None,
):
    """Reproduce Section 5 of the paper on the built-in linkage: Tables 1 and 2, Figures 3 to 5."""
    progress = session.progress()
    data = hpcred.reproduce(output, progress=progress)
    show_table("Table 1. SISO: chord frame, force at node 20", data["table_1"])
    show_table("Table 2. MIMO: Buckens frame, seven inputs and outputs", data["table_2"])
    show_table("Figure 5. u_y of node 20 in time, against all elastic modes", data["figure_5"][1:])
    print(f"figures 3 to 5 (png, svg), section5.h5 and section5.json written to {output}")
    show_timing(progress.timing())
    session.write_json(json, data)
