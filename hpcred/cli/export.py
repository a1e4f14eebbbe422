"""Write a result in the format of another program."""

from __future__ import annotations

import os
from typing import Annotated, Any

import typer

import hpcred

from ..parallel.declared import Option
from ..parallel.failures import InputError
from ..parallel.messages import printable
from ..report.tables import say
from ..settings import texts
from ..workflows.keywords import At, Load
from ..writers.registry import PROGRAMS, WRITERS
from . import session
from .options import JsonFile, command

MOST = 12  # names that are listed: all directions of two interfaces


class ExportCommand(typer.core.TyperCommand):
    """Export with a help that ends with the formats of some models only, and those of other packages."""

    def format_epilog(self, ctx, formatter):
        writers = [WRITERS.load(entry) for entry in WRITERS.own]
        lists = {
            "Of a model in interface coordinates": [each.name for each in writers if each.needs == "superelement"],
            "Formats of other packages": [f"{entry.name} ({entry.package})" for entry in WRITERS.others],
        }
        for title, names in lists.items():
            if names:
                formatter.write_paragraph()
                formatter.write_text(f"{title}: {', '.join(names)}")


def _few(names) -> str:
    """Return the first names in a list; --json - has all."""
    further = f", and {len(names) - MOST} more" if len(names) > MOST else ""
    return ", ".join(map(str, names[:MOST])) + further


@command
def export(
    context: typer.Context,
    result: Annotated[str, typer.Argument(metavar="RESULT.h5")],
    kind: Annotated[
        str | None, typer.Option("--format", help=", ".join([*(entry.name for entry in WRITERS.own), *PROGRAMS]))
    ] = None,
    output: Annotated[str | None, typer.Option("-o", "--output", metavar="FILE")] = None,
    nodes: Annotated[
        Any, Option("Interface nodes 1,20 or by name, or sets; default: of inputs and outputs.", None, texts.labels)
    ] = None,
    units: Annotated[str, typer.Option(help="Units of the file: SI; mm,t,s; ...")] = "SI",
    modes: Annotated[Any, Option("Shapes of a picture, from 1, such as 7,8.", None, texts.whole_numbers)] = None,
    options: Annotated[
        list[str] | None, typer.Option("--set", metavar="FORMAT.KEY=VALUE", help="A setting of the format.")
    ] = None,
    preload: Load = None,
    at: At = None,
    base: Annotated[
        str | None, typer.Option(help="Inputs of bases that move: displacement, velocity or acceleration.")
    ] = None,
    json: JsonFile = None,
):
    """Hand a reduced body over to another program."""
    if unread := context.args:
        option = "-o" if os.path.splitext(unread[0])[1] else "--format"
        raise InputError(f"export: found '{unread[0]}' after {result}; a format is named by --format and the file to "
                         f"write by -o: hpcred export {result} {option} {unread[0]}")  # fmt: skip
    report = hpcred.export(
        result, kind, output, nodes=nodes, units=units, modes=modes, options=options, preload=preload, at=at,
        base=base, progress=session.progress(),
    )  # fmt: skip
    if "shapes" in report:
        say(f"{printable(report['output'])}: {_few(report['shapes'])}")
    else:
        ends = ", ".join(f"{key} {_few(report[key])}" for key in ("nodes", "inputs", "outputs") if key in report)
        say(f"{printable(report['output'])}: {report['coordinates']} coordinates, {ends}")
        for name in report.get("files", ()):
            say(f"with {name}")
        session.list_all("note", report["remarks"])
    session.write_json(json, report)
