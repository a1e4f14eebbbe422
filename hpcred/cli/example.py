"""Write a model to try things on."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from . import session

Output = Annotated[str, typer.Option("-o", "--output", help="The model file to write.")]


def solid(
    output: Output = "model.h5",
    cells: Annotated[tuple[int, int, int], typer.Option(help="Hexahedra along x, y, z.")] = (60, 24, 24),
    size: Annotated[tuple[float, float, float] | None, typer.Option(help="Edges in m.")] = None,
    inputs: Annotated[int, typer.Option(help="Forces at nodes of the face at the free end.")] = 6,
    free: Annotated[bool, typer.Option("--free", help="Do not clamp the face at x = 0.")] = False,
):
    """A block of 8-node hexahedra, clamped at x = 0."""
    _example("solid", output, cells=cells, size=size, inputs=inputs, clamped=not free)


def linkage(output: Output = "model.h5"):
    """The stabilisation linkage of the paper's Section 5, free, loaded at node 20 in z."""
    _example("linkage", output)


def crank(
    output: Output = "model.h5",
    dofs: Annotated[int, typer.Option(help="About so many dofs.")] = 20_000,
):
    """A free connecting rod of hexahedra, with its bearings as the node sets BIG_EYE and SMALL_EYE."""
    _example("crank", output, dofs=dofs)


def _example(name, output, **keywords):
    report = hpcred.write_example(name, output, progress=session.progress(), **keywords)
    known = "; ".join(f"{key} {', '.join(report[key])}" for key in ("inputs", "sets") if report[key])
    print(f"{output}: {report['size']} dofs, {known}")
