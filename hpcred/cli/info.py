"""Describe a file; find the bearings of a model, and its natural frequencies."""

from __future__ import annotations

from typing import Annotated, Any

import typer

import hpcred

from ..parallel.declared import Option
from ..parallel.failures import InputError
from ..parallel.messages import printable
from ..report.tables import say, show_table
from ..settings import texts
from ..workflows.keywords import Load
from . import session
from .details import show_details, show_report
from .options import Details, JsonFile, Solving, command


@command
def info(
    file: Annotated[str | None, typer.Argument(metavar="FILE", help="Without it, this installation.")] = None,
    below: Annotated[Any, Option("Count modes below (Hz).", "F1,F2", texts.numbers)] = (),
    band_top: Annotated[float | None, typer.Option(help="Upper end of the band (Hz): size hint.")] = None,
    modes: Annotated[int | None, typer.Option(help="Find so many of the lowest frequencies.")] = None,
    verify: Annotated[bool, typer.Option("--verify", help="Read all of it, check all checksums, factor M.")] = False,
    figure: Annotated[
        str | None, typer.Option(metavar="FILE", help="Draw node sets, or the interfaces of a job: .png, .svg, .pdf.")
    ] = None,
    names: Annotated[str | None, typer.Option("--sets", metavar="A,B", help="Draw these node sets only.")] = None,
    details: Details = False,
    json: JsonFile = None,
):
    """Say what a file is: what a model contains and needs, and the format and matrices of any other file."""
    if file is None:
        if below or band_top or modes or verify or figure or names or details:
            raise InputError("FILE: is missing, which the options ask about")
        report = hpcred.workflows.installation()
        show_table(None, [{"": key.replace("_", " "), "this installation": value} for key, value in report.items()])
        session.write_json(json, report)
        return
    if names and not figure:
        raise InputError("--sets: belongs to --figure")
    if verify and (below or band_top or modes or figure):
        raise InputError("--verify: cannot be combined with other questions; call info twice")
    report = hpcred.workflows.verify_file(file, progress=session.progress()) if verify else hpcred.info(
        file, frequencies=below, band_top=band_top, modes=modes, figure=figure,
        sets=names.split(",") if names else None, progress=session.progress(),
    )  # fmt: skip
    record = hpcred.read_result(file).reduced.record if details else None  # refuses other files before it prints
    session.warn(report["warnings"])  # first, as units that look wrong are those of the table
    show_report(file, report, details)
    if record is not None:
        show_details(record)
    session.written(figure)
    session.write_json(json, report)


def bores(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5")],
    turn: Annotated[float, typer.Option(help="Degrees around its axis that a cylinder has at least.")] = 120.0,
    figure: Annotated[str | None, typer.Option(metavar="FILE", help="Draw them: .png, .svg, .pdf.")] = None,
    json: JsonFile = None,
):
    """Find the holes and pins of a model, and print them as interfaces for a job."""
    report = hpcred.bores(model, turn=turn, figure=figure, progress=session.progress())
    rows = [
        {"name": row["name"], **dict(zip(("centre x", "y", "z"), row["centre"], strict=True)),
         "axis": _direction(row["axis"]), "radius": row["radius"], "length": row["length"],
         "turn": f"{row['turn']:g}", "nodes": row["nodes"]} for row in report["bores"]
    ]  # fmt: skip
    if rows:
        show_table(f"{model}: holes (bore) and pins; m, turn in degrees", rows)
        say("Lines for the job; give them names of your own, and leave out what is no bearing")
        print(f"\n{report['job']}")
    else:
        say(f"{printable(model)}: no cylinder of {turn:g} degrees or more on its surface; --turn takes less")
    session.written(figure)
    session.warn(report["warnings"])
    session.write_json(json, report)


def _direction(vector) -> str:
    """Return a unit vector as x, y or z where it is one of these, else as three numbers."""
    axis = next((name for name, component in zip("xyz", vector, strict=True) if abs(component) > 1 - 1e-9), None)
    return axis or " ".join(f"{component:.4g}" for component in vector)


@command
def modes(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5")],
    count: Annotated[int, typer.Option(help="How many of the lowest modes, rigid-body modes included.")] = 20,
    frame: Annotated[str, typer.Option(help="auto, or as for response.")] = "auto",
    figure: Annotated[str | None, typer.Option(metavar="FILE", help="A .png of the first six elastic modes.")] = None,
    preload: Load = None,
    *,
    solving: Solving,
    json: JsonFile = None,
):
    """Lowest natural frequencies, effective masses and participation factors of a model.

    The rigid-body modes of a free body are counted, not listed.
    """
    report = hpcred.modes(
        model, count, frame=None if frame == "auto" else texts.frame(frame, "--frame"), figure=figure,
        preload=preload, **solving.given,
    )  # fmt: skip
    f, rigid = report["frequencies_hz"], report["rigid_body_modes"]
    if "masses" in report and rigid < 6:  # all of which take all of the mass
        share, factors = hpcred.workflows.tables_of_modes(report)
        show_table(f"{model}: effective masses in % of the mass along x, y, z and of the inertia about them", share)
        show_table("Participation factors (kg^(1/2); kg^(1/2) m)", factors)
        say(hpcred.workflows.mass_in_words(report))
    else:
        show_table(model, [{"mode": i, "f (Hz)": value} for i, value in enumerate(f[rigid:], rigid + 1)])
        if "masses" in report:
            say(hpcred.workflows.mass_in_words(report))
    moved = " at 0 Hz, which move all of the mass" if rigid == 6 else ""
    say(f"{rigid} rigid-body modes{moved}; largest residual {report['residual']:.1e}")
    session.written(figure)
    session.warn(report["warnings"])
    session.write_json(json, report)
