"""Plan a reduction on a cluster."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel.messages import printable
from ..parallel.progress import counted
from ..report.tables import say, show_table
from . import session
from .options import JsonFile


def plan(
    file: Annotated[str, typer.Argument(metavar="MODEL.h5|JOB.toml")],
    ranks: Annotated[int | None, typer.Option(help="Ranks of the job; default: those of this run.")] = None,
    nodes: Annotated[int, typer.Option(help="Nodes that they are on.")] = 1,
    memory: Annotated[float | None, typer.Option(metavar="GB", help="Memory of a node.")] = None,
    gflops: Annotated[float, typer.Option(help="GFlop/s of a rank, see hpcred bench.")] = 10.0,
    analyse: Annotated[bool, typer.Option("--analyse", help="Ask MUMPS also above 10^6 dofs.")] = False,
    json: JsonFile = None,
):
    """Say what a reduction will take, and print a script for SLURM."""
    report = hpcred.plan(
        file, ranks=ranks, nodes=nodes, memory_gb=memory, gflops=gflops, analyse=analyse, progress=session.progress()
    )
    say(f"{printable(report['model'])}: {report['dofs']} dofs, {report['nonzeros']} nonzeros")
    say(f"a factor: {report['operations']:.1e} operations, {report['entries']:.1e} entries")
    say(f"  {report['source']}")
    say(f"{counted(report['factors'], 'factor')} {report['points']}")
    rows = report["rows"]
    shown = [key for key in rows[0] if key not in ("remark", "hours") and (key != "fits" or memory is not None)]
    title = f"{counted(report['ranks'], 'rank')} on {counted(nodes, 'node')}"
    show_table(title, [{key: row[key] for key in shown} for row in rows])
    for row in rows:
        if row["remark"]:
            say(f"{row['way']}: {row['remark']}")
    if report["best"]:
        print(f"\nFor {report['best']}:\n{report['script']}")
    else:
        say("nothing fits: take more nodes, or multigrid on fewer ranks")
    session.warn(report["warnings"])
    session.write_json(json, report)
