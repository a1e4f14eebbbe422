"""Put reduced bodies together to a machine."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..report.tables import say, show_table
from . import session
from .details import show_joints
from .options import JsonFile

LOWEST = 10  # frequencies that are printed


def assemble(
    file: Annotated[str, typer.Argument(metavar="MACHINE.toml")],
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Replace a key of the file: tolerance=1e-3"),
    ] = None,
    json: JsonFile = None,
):
    """Put reduced bodies together with rigid joints, bushings and masses, and estimate the error of the whole."""
    report = hpcred.assemble_file(file, overrides=set_ or [], progress=session.progress())
    session.verdict(report["sentence"], report["reached"])
    show_table("Errors of the bodies", [{key: "not known" if value is None else value for key, value in row.items()}
                                        for row in report["budget"]])  # fmt: skip
    show_joints(report["joints"])
    if "size" in report:
        frequencies = report["pseudo_frequencies_hz"]
        lowest = ", ".join(f"{f:.6g}" for f in frequencies[:LOWEST])
        say(f"{report['size']} coordinates; frequencies (Hz): {lowest}{', ...' * (len(frequencies) > LOWEST)}")
    session.written(report["output"])
    session.warn(report["warnings"])
    session.write_json(json, report)
    return 0 if report["reached"] else 1
