"""Define the options and the table titles that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

from . import session

JsonFile = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the numbers; - prints them.", callback=session.checked),
]
Frequencies = Annotated[str | None, typer.Option(metavar="F1,F2,...", help="Frequencies in Hz.")]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Replace a key of the file: tolerance=1e-6, basis.0.order=2"),
]
Pairs = Annotated[
    str | None, typer.Option(metavar="OUT/IN,...", help="Responses to draw, such as 20:z/20:z,20:z/1:x.")
]
FullFile = Annotated[str | None, typer.Option(metavar="MODEL.h5", help="Compare with this full model.")]
Band = Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Hz; default: that of the job.")]
Points = Annotated[int, typer.Option(help="Number of equally spaced frequencies in the band.")]
Groups = Annotated[int | None, typer.Option(help="Groups of ranks that share the frequencies.")]
Seed = Annotated[int | None, typer.Option(help="The fresh frequencies of an earlier --check.")]
Inputs = Annotated[str | None, typer.Option("--inputs", help="Unit loads: 20:z,1:x or dof numbers 115,1")]
Outputs = Annotated[str | None, typer.Option("--outputs", help="Outputs: 20:z,velocity 20:z,acceleration dof 115")]
OutOfCore = Annotated[str | None, typer.Option(metavar="DIR", help="Keep the factors in files there.")]
LowRank = Annotated[float | None, typer.Option(metavar="EPS", help="Block low rank factors, such as 1e-8.")]
Package = Annotated[str | None, typer.Option(help="What factors: auto, mumps, cudss, superlu_dist or petsc.")]
PreloadTable = Annotated[
    str | None, typer.Option("--preload", metavar="TABLE", help="Constant load: '{omega = [0, 0, 300]}' (rad/s).")
]
AtValues = Annotated[
    str | None, typer.Option("--at", metavar="P=V,...", help="Values of parameters; default: the reference values.")
]
Details = Annotated[bool, typer.Option("--details", help="Show basis, points, time and memory too.")]
DIRECTIONS = "Directions by themselves, the least accurate first (|H| in SI units: m/N, rad/(N m))"
INTERFACES = "Interfaces, and where their reference nodes are (m)"
