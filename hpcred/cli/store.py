"""List, check and prune a store of expansion points."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel.failures import InputError
from ..report.tables import show_table
from . import session, values
from .options import JsonFile


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
