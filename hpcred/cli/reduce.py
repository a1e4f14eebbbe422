"""Reduce a model by a job file; look after the store of its expansion points."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import Annotated

import typer

import hpcred

from ..parallel.failures import InputError
from ..parallel.progress import counted
from ..reduction.tolerance.directions import rows_of_directions
from ..report.tables import in_words, show_table, show_timing
from ..settings.toml_file import check_file_names
from . import session, values
from .options import DIRECTIONS, INTERFACES, JsonFile, LowRank, OutOfCore, Overrides


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
    json: JsonFile = None,
):
    """Reduce a model as a job file says."""
    folders = {"out_of_core": out_of_core, "store": store}  # of the command line, not of the job file
    given = {"groups": groups, "low_rank": low_rank}
    check_file_names(**{"--store": store, "--out-of-core": out_of_core, "--basis": basis})
    given |= {key: os.path.abspath(name) for key, name in folders.items() if name is not None}
    overrides = [*(set_ or []), *(f"{key}={value}" for key, value in given.items() if value is not None)]
    found = hpcred.reduce_job(job, overrides=overrides, basis=basis, progress=session.progress())
    record, accuracy = found.record, found.record.accuracy
    stored = any(item.from_store for item in record.components)
    if accuracy is not None:
        made = counted(0 if record.basis_of else accuracy.factorisations, "factorisation")
        session.verdict(f"{accuracy.sentence}, {made}, {found.size_in_words}", accuracy.reached)
        show_table(DIRECTIONS, rows_of_directions(accuracy.directions, accuracy.band))
    show_table(
        f"{found.output}: {found.size_in_words} for {record.size} dofs",
        [{"basis": item.where, "columns": item.columns, "new": item.kept, "dropped": item.columns - item.kept,
          **({"from": "store" if item.from_store else ""} if stored else {})} for item in record.components],
    )  # fmt: skip
    show_table(INTERFACES, record.interface_rows)
    session.show_loads([item.row for item in record.loads])
    if accuracy is not None:
        show_table("Expansion points", [
            {"f (Hz)": item.frequency, "columns": item.columns, "modes below": in_words(item.modes_below),
             "estimate after it": in_words(item.estimate), "factor": item.factor_in_words} for item in accuracy.points
        ])  # fmt: skip
        show_table("Each new point checks the model before it", [asdict(item) for item in accuracy.proofs])
        print(f"{accuracy.measured}; {accuracy.modes_in_words}; round-off {accuracy.noise:.0e}; "
              f"{accuracy.uncompressed_size} columns before the compression")  # fmt: skip
    residual = max((item.residual for item in record.factorisations), default=0.0)
    print(
        f"pseudo-frequencies {found.frequencies[0]:.6g} to {found.frequencies[-1]:.6g} Hz; "
        f"max |V^T M V - I| = {record.orthonormality_defect:.1e}; "
        + (f"largest residual {residual:.1e}; " if residual else "")
        + record.effort
    )
    told = accuracy.sentence if accuracy is not None else None  # which the verdict has said
    session.warn([item for item in record.warnings if item != told])
    print(f"{record.scalar} PETSc {record.versions['petsc']}, {record.ranks} rank(s)")
    show_timing(record.timing, record.factorisations)
    session.list_all("hint", record.hints)
    session.write_json(json, {**asdict(record), "output": found.output, "reduced_size": found.size,
                              "frequencies_hz": found.frequencies})  # fmt: skip
    return int(accuracy is not None and not accuracy.reached)


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
    given = {"--older": older, "--below": below, "--model": model, "--broken": broken or None}
    if not prune and any(value is not None for value in given.values()):
        raise InputError(f"{next(key for key in given if given[key] is not None)}: belongs to --prune")
    if prune:
        rows = hpcred.prune_store(
            folder, older=values.amount(older, "--older", {"m": 60, "h": 3600, "d": 86400, "w": 604800}),
            below=values.amount(below, "--below", {"k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}), model=model,
            broken=broken,
        )  # fmt: skip
    else:
        rows = hpcred.list_store(folder, check=check)
    show_table(folder, [
        {"entry": row["kind"] if row["valid"] and row["kind"] else row["entry"],
         **{key: "" if row[key] is None else row[key] for key in ("model", "point", "blocks", "columns")},
         "MB": round(row["bytes"] / 1e6, 3), "date": (row["date"] or "")[:10],
         **({} if prune else {"valid": "yes" if row["valid"] else f"no: {row['reason']}"})} for row in rows
    ])  # fmt: skip
    total = sum(row["bytes"] for row in rows)
    print(f"{len(rows)} entries{' removed' if prune else ''}, {total / 1e6:.6g} MB")
    session.write_json(json, rows)
    return int(not prune and not all(row["valid"] for row in rows if ".tmp-" not in row["entry"]))
