"""Reduce a model by a job file; look after the store of its expansion points."""

from __future__ import annotations

import os
import shlex
from dataclasses import asdict
from shutil import get_terminal_size
from typing import Annotated

import typer

import hpcred

from ..parallel.failures import InputError
from ..parallel.progress import counted, in_time
from ..reduction.result.accuracy import WORST
from ..reduction.result.directions import rows_of_directions
from ..report.tables import say, show_table
from ..settings import texts
from ..settings.toml_file import check_file_names
from . import session
from .details import show_details
from .options import Details, JsonFile, LowRank, OutOfCore, Overrides


def reduce(
    job: Annotated[str, typer.Argument(metavar="JOB.toml")],
    set_: Overrides = None,
    groups: Annotated[str | None, typer.Option(help="Groups of ranks for different points: a number or auto.")] = None,
    out_of_core: OutOfCore = None,
    low_rank: LowRank = None,
    store: Annotated[
        str | None,
        typer.Option("--store", "--restart", metavar="DIR", help="Keep expansion points there, and go on from those."),
    ] = None,
    basis: Annotated[
        str | None,
        typer.Option(metavar="RESULT.h5", help="Of this job without `at`: take its basis, factor nothing."),
    ] = None,
    details: Details = False,
    json: JsonFile = None,
):
    """Reduce a model as a job file says."""
    folders = {"out_of_core": out_of_core, "store": store}  # of the command line, not of the job file
    settings = {"groups": groups, "low_rank": low_rank}
    check_file_names(**{"--store": store, "--out-of-core": out_of_core, "--basis": basis})
    settings |= {key: os.path.abspath(name) for key, name in folders.items() if name is not None}
    overrides = [*(set_ or []), *(f"{key}={value}" for key, value in settings.items() if value is not None)]
    outcome = hpcred.reduce_job(job, overrides=overrides, basis=basis, progress=session.progress())
    record, accuracy = outcome.record, outcome.record.accuracy
    size, output = f"{outcome.size_in_words} for {record.size} dofs", os.path.normpath(outcome.output)
    verdict = size if accuracy is None else accuracy.sentence
    session.verdict(verdict, accuracy is None or accuracy.reached)
    say(f"{'' if accuracy is None else f'{size}, '}{record.effort}, {in_time(record.timing.elapsed)}")
    if accuracy is not None:
        say(accuracy.measured)
    if accuracy is not None and accuracy.directions:
        show_table(f"Least accurate of {counted(len(accuracy.directions), 'direction')} (|H| in SI units)",
                   rows_of_directions(accuracy.directions[:WORST], accuracy.band))  # fmt: skip
    if details:
        show_details(record)
        session.list_all("hint", record.hints)
    session.warn([warning for warning in record.warnings if warning != verdict])
    session.written(output, outcome.report)
    _show_next(outcome, output)
    session.write_json(json, {**asdict(record), "output": outcome.output, "reduced_size": outcome.size,
                              "frequencies_hz": outcome.frequencies})  # fmt: skip
    return int(accuracy is not None and not accuracy.reached)


def _show_next(outcome, output):
    """Print what is usually done with a result."""
    named = (outcome.record.job or {}).get("model")
    model = shlex.quote(os.path.relpath(named)) if isinstance(named, str) else "MODEL.h5"
    output = shlex.quote(output)
    rows = [
        (f"evaluate {output} --full {model} --check 5", "more full solves"),
        (f"report {output}", "responses, error and shapes"),
        (f"export {output} --format sid", "for a multibody program") if outcome.has_body
        else (f"export {output} --format statespace-mat", "matrices of first order"),
        (f"info {output} --details", "basis, points, time, memory"),
    ]  # fmt: skip
    accuracy = outcome.record.accuracy
    if accuracy is None:
        rows[0] = (f"evaluate {output} --full {model}", "the error, by full solves")
    elif not accuracy.reached:  # a model to look at, not to go on with
        del rows[2]
    if outcome.report:
        del rows[1]
    # what a command is for stands beside it where that fits, below each other as far as it does
    before, between = "next: hpcred ", "  # "
    room = get_terminal_size().columns - len(before + between)
    width = min(max(len(command) for command, _ in rows), room - max(len(purpose) for _, purpose in rows))
    for k, (command, purpose) in enumerate(rows):
        if len(command) + len(purpose) > room:
            between = "\n      # "
        print(f"{before if k == 0 else '      hpcred '}{command:{width}}{between}{purpose}")


def store(
    folder: Annotated[str, typer.Argument(metavar="DIR")],
    check: Annotated[bool, typer.Option("--check", help="Verify all checksums.")] = False,
    prune: Annotated[bool, typer.Option("--prune", help="Remove entries that fit all of the options below.")] = False,
    older: Annotated[str | None, typer.Option(metavar="30d", help="Not used for so long (m, h, d, w).")] = None,
    below: Annotated[
        str | None, typer.Option(metavar="10G", help="The longest unused, until no more than this is left.")
    ] = None,
    model: Annotated[str | None, typer.Option(metavar="NAME", help="Of the model of this name.")] = None,
    broken: Annotated[bool, typer.Option("--broken", help="Damaged, or left by a run that was killed.")] = False,
    json: JsonFile = None,
):
    """List, check and prune a folder of expansion points (reduce --store DIR)."""
    filters = {"--older": older, "--below": below, "--model": model, "--broken": broken or None}
    if not prune and any(value is not None for value in filters.values()):
        raise InputError(f"{next(key for key in filters if filters[key] is not None)}: belongs to --prune")
    if prune:
        rows = hpcred.workflows.prune_store(
            folder, older=texts.amount(older, "--older", {"m": 60, "h": 3600, "d": 86400, "w": 604800}),
            below=texts.amount(below, "--below", {"k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}), model=model,
            broken=broken,
        )  # fmt: skip
    else:
        rows = hpcred.store(folder, check=check)
    show_table(folder, [
        {"entry": row["kind"] if row["valid"] and row["kind"] else row["entry"],
         **{key: "" if row[key] is None else row[key] for key in ("model", "point", "blocks", "columns")},
         "MB": round(row["bytes"] / 1e6, 3), "date": (row["date"] or "")[:10],
         **({} if prune else {"valid": "yes" if row["valid"] else f"no: {row['reason']}"})} for row in rows
    ])  # fmt: skip
    total = sum(row["bytes"] for row in rows)
    say(f"{len(rows)} entries{' removed' if prune else ''}, {total / 1e6:.6g} MB")
    session.write_json(json, rows)
    return int(not prune and not all(row["valid"] for row in rows if ".tmp-" not in row["entry"]))
