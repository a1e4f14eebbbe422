"""Recover the motion of the nodes of a reduced body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

import hpcred

from ..parallel.declared import Keywords
from ..parallel.failures import InputError
from ..parallel.messages import printable
from ..report.tables import say, show_table
from ..workflows.keywords import Motion, Recovered
from ..writers.decks import DECKS
from . import session
from .options import JsonFile, command

LARGEST = {"largest_displacement_m": "displacement (m)", "largest_velocity_m_s": "velocity (m/s)",
           "largest_acceleration_m_s2": "acceleration (m/s^2)",
           "largest_von_mises_pa": "von Mises stress (Pa)"}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Deck(Keywords):
    """Options of stresses that another program computes."""

    deck: Annotated[
        str | None, typer.Option(metavar=" or ".join(DECKS), help="Write input files for stresses of the basis.")
    ] = None
    original: Annotated[
        str | None, typer.Option("--input", metavar="FILE", help="Of --deck: the input file of the matrices.")
    ] = None
    answers: Annotated[
        str | None, typer.Option(metavar="FILE", help="Take the stresses of the basis from the results of --deck.")
    ] = None
    units: Annotated[str, typer.Option(help="Of --deck and --answers: SI; mm,t,s; ...")] = "SI"


@command
def recover(
    result: Annotated[str, typer.Argument(metavar="RESULT.h5")],
    output: Annotated[
        str, typer.Option("-o", "--output", metavar="FILE", help="A .pvd, .vtu, .csv or .h5 file; of --deck a folder.")
    ],
    motion: Annotated[
        str | None, typer.Argument(metavar="[MOTION]", help="simulation.h5, a solution of Exudyn, .csv or HDF5.")
    ] = None,
    *,
    recovered: Recovered,
    taken: Motion,
    stresses: Deck,
    json: JsonFile = None,
):
    """Displacements, velocities and accelerations of nodes from reduced coordinates over time, and stresses."""
    # three commands in one, of which each has options of its own
    deck, original, answers = stresses.deck, stresses.original, stresses.answers
    how = {"units": stresses.units, "progress": session.progress()}
    if sum(source is not None for source in (motion, deck, answers)) != 1:
        raise InputError("recover: expected one of MOTION, --deck with --input, and --answers")
    if (deck is None) != (original is None):
        raise InputError("--deck, --input: found one without the other; give the program and the input file that the "
                         "matrices came from")  # fmt: skip
    if motion is None and (surplus := [*recovered.changed(), *taken.changed()]):
        raise InputError(f"{surplus[0]}: belongs to MOTION; leave it out with --deck and --answers")
    if motion is not None and stresses.units != "SI":
        raise InputError("--units: belongs to --deck and --answers; what is recovered is in SI")
    # a deck for stresses of the basis, the answers to it, or the motion
    if deck is not None:
        report = hpcred.workflows.write_deck(result, deck, original, output, **how)
        say(f"{printable(report['folder'])}: {report['columns']} steps; run there {report['run']}")
        session.write_json(json, report)
        return
    if answers is not None:
        report = hpcred.workflows.add_stresses(result, answers, output, **how)
        say(f"{printable(report['output'])}: stresses of {report['columns']} columns at {report['nodes']} nodes "
              f"({report['source']})")  # fmt: skip
        session.write_json(json, report)
        return
    report = hpcred.recover(result, motion, output, progress=session.progress(), **recovered.given, **taken.given)
    largest = [(name, report[key]) for key, name in LARGEST.items() if key in report]
    rows = [{"largest": name, "value": peak["value"], "node": peak["node"] or "", "t (s)": peak["t_s"]}
            for name, peak in largest]  # fmt: skip
    show_table(f"{report['output']}: {report['instants']} instants of {report['nodes']} nodes", rows)
    session.list_all("remark", report["remarks"])
    session.write_json(json, report)
