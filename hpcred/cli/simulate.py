"""Simulate a reduced body in time."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..report.tables import say, show_table
from . import session
from .options import JsonFile


def simulate(
    file: Annotated[str, typer.Argument(metavar="SIM.toml")],
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Replace a key of the file: end=2.0, force.0.node=20"),
    ] = None,
    json: JsonFile = None,
):
    """Simulate a reduced body in time, with large rigid motion, loads, joints, drives and springs."""
    report = hpcred.simulate_file(file, overrides=set_ or [], progress=session.progress())
    rows = [{"node": node, "largest displacement (m)": value}
            for node, value in report["largest_displacement_m"].items()]  # fmt: skip
    show_table(", ".join(report["output"]), rows)
    say(f"constraint drift {report['constraint_drift_m']:.1e} m and {report['constraint_drift_rad']:.1e} rad, "
          f"energy defect {report['energy_defect']:.1e}")  # fmt: skip
    session.list_all("note", report["notes"])
    session.warn(report["warnings"])
    session.write_json(json, report)
