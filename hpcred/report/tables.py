"""Tables and JSON for people and scripts; rank 0 only."""

import json
import shutil
import sys

from rich import box
from rich.console import Console
from rich.table import Table

from ..formats.hdf5 import atomic_output
from ..parallel.failures import agreed


def show_table(comm, title, columns, rows):
    """Print a table on rank 0; numbers are right-aligned."""
    if comm.rank:
        return
    table = Table(box=box.SIMPLE_HEAD, header_style="")
    for i, column in enumerate(columns):
        numeric = all(isinstance(row[i], (int, float)) for row in rows)
        table.add_column(column, justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        table.add_row(*(f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in row))
    if title:
        print(title)
    # launchers of MPI programs offer a terminal of no particular width
    width = None if sys.stdout.isatty() and shutil.get_terminal_size().columns > 100 else 140
    Console(file=sys.stdout, width=width, highlight=False).print(table)


def write_json(comm, path, data):
    """Write data as JSON on rank 0, whole or not at all. Collective. Raises InputError."""
    if path is None:
        return
    with atomic_output(path, comm) as temporary, agreed(comm):
        if comm.rank == 0:
            temporary.write_text(json.dumps(data, indent=1) + "\n")


def show_timings(comm, run, factorisations=()):
    """Where the time of a run went, the share of MUMPS in it, and its memory."""
    if comm.rank:
        return
    total = run["elapsed"]
    parts = sorted(run["seconds"].items(), key=lambda item: -item[1])
    listed = ", ".join(f"{name} {value:.2f} s ({100 * value / total:.0f} %)" for name, value in parts if value > 0)
    memory = max(run["memory_mb_per_rank"])
    print(f"time {total:.2f} s: {listed}; at most {memory:.0f} MB a rank")
    if factorisations:
        keys = ("analysis_seconds", "factor_seconds", "solve_seconds")
        mumps = [sum(item[key] for item in factorisations) for key in keys]
        used = max(item["memory_mb_used_max_rank"] for item in factorisations)
        print(
            f"MUMPS {sum(mumps):.2f} s of it ({100 * sum(mumps) / total:.0f} %): analysis {mumps[0]:.2f} s, "
            f"factorisations {mumps[1]:.2f} s, solves {mumps[2]:.2f} s; {used} MB a rank"
        )
