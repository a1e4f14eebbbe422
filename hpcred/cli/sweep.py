"""Run many reductions, and collect their results."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel.failures import ComputationError, InputError
from ..report.tables import say, show_table, told_apart
from . import session
from .options import JsonFile


def sweep(
    file: Annotated[str, typer.Argument(metavar="SWEEP.toml")],
    parallel: Annotated[int | None, typer.Option(help="Runs at the same time.")] = None,
    index: Annotated[int | None, typer.Option(help="Only this share of the runs, from 1; with --of.")] = None,
    of: Annotated[int | None, typer.Option(help="Number of shares.")] = None,
    store: Annotated[str | None, typer.Option(metavar="DIR", help="Expansion points are kept and found there.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, list the runs, and stop.")] = False,
    slurm: Annotated[bool, typer.Option("--slurm", help="Write the array script for SLURM.")] = False,
    pbs: Annotated[bool, typer.Option("--pbs", help="Write the array script for PBS.")] = False,
    submit: Annotated[bool, typer.Option("--submit", help="Submit that script.")] = False,
    json: JsonFile = None,
):
    """Run many reductions that differ in some keys of the job; what is finished is skipped.

    On this machine, one after the other or --parallel; or as an array of a batch system. See docs/sweeps.md.
    """
    if slurm or pbs or submit:
        if slurm == pbs:
            raise InputError("--submit: belongs to --slurm or --pbs" if submit and not slurm else
                             "--slurm: write one script after the other, --slurm or --pbs")  # fmt: skip
        if dry_run or parallel is not None or index is not None or of is not None:
            raise InputError("--slurm, --pbs: a script is written and nothing runs; leave the other options out")
        report = hpcred.workflows.write_script(file, "slurm" if slurm else "pbs", store=store, submit=submit)
        say(f"{report['script']} written; " + (report["said"] or f"submit it by: {report['command']}"))
        session.write_json(json, report)
        return 0
    report = hpcred.sweep(
        file, parallel=parallel, index=index, of=of, store=store, dry_run=dry_run, progress=session.progress()
    )
    columns = [key for key in report["runs"][0] if key not in ("sentence", "output")] if report["runs"] else []
    show_table(report["folder"], _named_shortly([{key: row.get(key, "") for key in columns} for row in report["runs"]]))
    for row in report["failed"]:
        session.verdict(f"FAILED {row['run']}: {row['sentence']}", False)
    if not dry_run:
        say(f"{report['finished']} finished, {report['skipped']} skipped, {len(report['failed'])} failed; "
              f"{report['factorisations']} factorisations made, {report['factorisations_saved']} saved")  # fmt: skip
    session.write_json(json, report)
    if report["failed"] and not dry_run:  # the log of a batch system may have no more than errors
        first = report["failed"][0]
        raise ComputationError(f"{len(report['failed'])} of {len(report['runs'])} runs failed, the first of them "
                               f"{first['run']}: {first['sentence'].removeprefix('error: ')}")  # fmt: skip
    return 0


def _named_shortly(rows):
    """Rows of runs with as much of their names as tells them apart, and then the names of their files."""
    names = [row["run"] for row in rows]
    short = told_apart(names)
    files = [{"result": f"{name}.h5"} if short != names else {} for name in names]
    return [row | {"run": name} | file for row, name, file in zip(rows, short, files, strict=True)]


def collect(
    file: Annotated[str, typer.Argument(metavar="SWEEP.toml")],
    output: Annotated[str | None, typer.Option("-o", "--output", metavar="FILE", help=".csv, .json or .h5")] = None,
    figures: Annotated[str | None, typer.Option(metavar="DIR", help="Draw errors over size, keys, frequency.")] = None,
    store: Annotated[str | None, typer.Option(metavar="DIR", help="As for sweep.")] = None,
    json: JsonFile = None,
):
    """One table of the results of a sweep, and figures that compare them."""
    report = hpcred.collect(file, output=output, figures=figures, store=store)
    rows = report["rows"]
    short = {"factorisations": "factored", "factorisations_saved": "saved", "memory_mb": "MB"}
    known = [key for key in rows[0] if any(row[key] is not None for row in rows)]
    rows = [{short.get(key, key): "" if row[key] is None else row[key] for key in known} for row in rows]
    show_table(file, _named_shortly(rows))
    session.list_all("note", report["remarks"])
    session.written(output, *report["figures"])
    if missing := report["missing"]:
        few = ", ".join(missing[:8]) + ", ..." * (len(missing) > 8)
        session.verdict(f"{len(missing)} of {len(report['rows'])} runs have no result of their job: {few}", False)
    session.write_json(json, report)
    return int(bool(report["missing"]))
