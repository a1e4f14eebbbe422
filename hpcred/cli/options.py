"""Define the options and the table titles that several commands share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from ..parallel.declared import Keywords
from . import session, values

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
Figure = Annotated[str | None, typer.Option(metavar="FILE", help="A .png, .svg or .pdf.")]
Output = Annotated[str | None, typer.Option("-o", "--output", metavar="FILE", help="A .csv or HDF5 file.")]
ResponseOutput = Annotated[
    str | None, typer.Option("-o", "--output", metavar="FILE", help="Write the responses: .csv, .h5, .unv, .npz.")
]
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


@dataclass(frozen=True, kw_only=True)
class Solving(Keywords):
    """Options on how models are factored."""

    out_of_core: OutOfCore = None
    low_rank: LowRank = None
    package: Package = None

    @property
    def given(self) -> dict:
        """The keywords of a workflow."""
        factoring = values.factoring(self.out_of_core, self.low_rank, self.package)
        return {"factoring": factoring, "progress": session.progress()}


@dataclass(frozen=True, kw_only=True)
class SharedSolving(Solving):
    """The same, with groups of ranks."""

    groups: Groups = None

    @property
    def given(self) -> dict:
        return super().given | {"groups": self.groups}


@dataclass(frozen=True, kw_only=True)
class Grid(Keywords):
    """Options on which frequencies."""

    frequencies: Frequencies = None
    band: Band = None
    points: Points = 61

    @property
    def given(self) -> dict:
        """The keywords of a workflow."""
        chosen = values.numbers(self.frequencies, "--frequencies")
        return {"frequencies": chosen, "band": values.band(self.band), "points": self.points}


@dataclass(frozen=True, kw_only=True)
class FineGrid(Grid):
    """The same, of many points."""

    band: Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Hz.")] = None
    points: Points = 2001


DIRECTIONS = "Directions by themselves, the least accurate first (|H| in SI units: m/N, rad/(N m))"
INTERFACES = "Interfaces, and where their reference nodes are (m)"
