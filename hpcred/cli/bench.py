"""Measure this machine."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..report.tables import in_words, show_table
from . import session
from .options import JsonFile


def bench(
    cells: Annotated[tuple[int, int, int], typer.Option(help="Hexahedra of the block to try on.")] = (40, 16, 16),
    folder: Annotated[str | None, typer.Option(metavar="DIR", help="Where to try writing and reading.")] = None,
    json: JsonFile = None,
):
    """Measure this machine: factorisation, solves, products, orthogonality, files."""
    report = hpcred.bench(cells, folder=folder, progress=session.progress())
    show_table("This machine", [{"": key.replace("_", " "), " ": in_words(item)} for key, item in report.items()
                                if key != "hints"])  # fmt: skip
    session.list_all("hint", report["hints"])
    session.write_json(json, report)
