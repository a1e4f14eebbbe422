"""Compute the frequency response of a full model."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel.progress import counted
from ..report.tables import show_table, show_timing
from . import session, values
from .options import Frequencies, Inputs, JsonFile, LowRank, OutOfCore, Outputs, Package, Points, Seed


def response(
    model: Annotated[str, typer.Argument(metavar="MODEL.h5")],
    band: Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Hz.")] = None,
    points: Points = 2001,
    frequencies: Frequencies = None,
    tolerance: Annotated[float, typer.Option(help="Relative error of the response.")] = 1e-6,
    frame: Annotated[str, typer.Option(help="none, buckens, tangent:NODE or chord:N1,N2,N3[:AXES].")] = "none",
    damping: Annotated[
        str | None,
        typer.Option(help="none, given, rayleigh:ALPHA,BETA or loss:FACTOR; given by default where the model has a D."),
    ] = None,
    inputs: Inputs = None,
    outputs: Outputs = None,
    output: Annotated[str | None, typer.Option("-o", "--output", metavar="FILE", help="A .csv or HDF5 file.")] = None,
    polar: Annotated[bool, typer.Option("--polar", help="Magnitude and phase in the .csv.")] = False,
    figure: Annotated[str | None, typer.Option(metavar="FILE", help="A .png, .svg or .pdf.")] = None,
    check: Annotated[int, typer.Option(help="Factor at so many fresh frequencies, and compare.")] = 0,
    seed: Seed = None,
    groups: Annotated[int | None, typer.Option(help="Groups of ranks that share those of --check.")] = None,
    out_of_core: OutOfCore = None,
    low_rank: LowRank = None,
    package: Package = None,
    json: JsonFile = None,
):
    """Frequency response of the full model at many frequencies, to a tolerance, from a handful of factorisations."""
    progress = session.progress()
    report = hpcred.response_file(
        model, frequencies=values.numbers(frequencies, "--frequencies"), band=values.band(band), points=points,
        tolerance=tolerance, frame=values.frame(frame), damping=None if damping is None else values.damping(damping),
        inputs=values.targets(inputs, "--inputs"), outputs=values.targets(outputs, "--outputs"), check=check, seed=seed,
        groups=groups, factoring=values.factoring(out_of_core, low_rank, package), output=output, polar=polar,
        figure=figure, progress=progress,
    )  # fmt: skip
    told = [*([] if report["reached"] else ["NOT REACHED everywhere:"]), *report["sentences"]]
    session.verdict("\n".join(told), report["reached"])
    show_table("Proofs: the model before a point, at the point", report["proofs"])
    if check:
        show_table("Fresh frequencies", report["check"]["rows"])
    made = counted(report["factorisations"], "factorisation")
    print(f"{len(report['frequencies_hz'])} frequencies from {made} and "
          f"{report['columns']} columns for {report['size']} dofs")  # fmt: skip
    for name in (output, figure):
        if name:
            print(f"written to {name}")
    session.warn(report["warnings"])
    show_timing(progress.timing())
    session.write_json(json, report)
    return 0 if report["reached"] else 1
