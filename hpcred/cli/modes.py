"""Compute the natural frequencies of a model."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..report.tables import show_table
from . import session, values
from .options import JsonFile, LowRank, OutOfCore, Package


def modes(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5")],
    count: Annotated[int, typer.Option(help="How many of the lowest modes, rigid-body modes included.")] = 20,
    frame: Annotated[str, typer.Option(help="auto, or as for response.")] = "auto",
    figure: Annotated[str | None, typer.Option(metavar="FILE", help="A .png of the first six elastic modes.")] = None,
    out_of_core: OutOfCore = None,
    low_rank: LowRank = None,
    package: Package = None,
    json: JsonFile = None,
):
    """Lowest natural frequencies, effective masses and participation factors of a model.

    A free body shows its rigid-body modes at 0 Hz, unless a frame other than auto holds it.
    """
    report = hpcred.modes_of_file(
        model, count, frame=None if frame == "auto" else values.frame(frame), figure=figure,
        factoring=values.factoring(out_of_core, low_rank, package), progress=session.progress(),
    )  # fmt: skip
    f = report["frequencies_hz"]
    if "masses" in report:
        share, factors = hpcred.tables_of_modes(report)
        show_table(f"{model}: effective masses in % of the mass along x, y, z and of the inertia about them", share)
        show_table("Participation factors (kg^(1/2); kg^(1/2) m)", factors)
        print(hpcred.mass_in_words(report))
    else:
        show_table(model, [{"mode": i, "f (Hz)": value} for i, value in enumerate(f, 1)])
    print(f"{report['rigid_body_modes']} rigid-body modes; largest residual {report['residual']:.1e}")
    if figure:
        print(f"written to {figure}")
    session.warn(report["warnings"])
    session.write_json(json, report)
