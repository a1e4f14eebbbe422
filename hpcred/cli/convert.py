"""Make a model file, of matrices of another program or as an example."""

from __future__ import annotations

import os
from typing import Annotated

import typer

import hpcred

from ..parallel.failures import InputError
from ..parallel.messages import printable
from ..report.tables import show_table
from ..settings.viscoelastic import viscoelastic_of
from . import session, values
from .details import show_report
from .options import Inputs, JsonFile, Outputs

Viscoelastic = Annotated[
    list[str] | None,
    typer.Option(metavar="TABLE", help='Part g(s) K_v: \'{file = "Kv.mtx", law = {kind = "maxwell", ...}}\''),
]
Output = Annotated[str, typer.Option("-o", "--output", help="The model file to write.")]


def convert(
    files: Annotated[list[str] | None, typer.Argument(metavar="[EXPORT] MODEL.h5")] = None,
    output: Annotated[str | None, typer.Option("-o", "--output", help="The model file to write.")] = None,
    stiffness: Annotated[str | None, typer.Option("-K", "--stiffness", help="Matrix file of K.")] = None,
    mass: Annotated[str | None, typer.Option("-M", "--mass", help="Matrix file of M.")] = None,
    damping: Annotated[str | None, typer.Option("-D", "--damping", help="Matrix file of D.")] = None,
    input_file: Annotated[str | None, typer.Option("-B", help="Matrix file of B (n, p).")] = None,
    output_file: Annotated[str | None, typer.Option("-C", help="Matrix file of C (r, n).")] = None,
    velocity_file: Annotated[str | None, typer.Option("-Cv", help="Of Cv (r, n), y = C q + Cv q' + Ca q''.")] = None,
    acceleration_file: Annotated[str | None, typer.Option("-Ca", help="Matrix file of Ca (r, n).")] = None,
    nodes: Annotated[str | None, typer.Option(help="Lines of node, x, y, z; or .inp, .bdf, .unv, .cdb, .frd.")] = None,
    dofs: Annotated[str | None, typer.Option(help="Lines of node, direction (1-6), one a row.")] = None,
    inputs: Inputs = None,
    outputs: Outputs = None,
    variables: Annotated[str | None, typer.Option(metavar="K=...,M=...", help="Names of matrices in a file.")] = None,
    units: Annotated[str, typer.Option(help="Units of the files: SI; mm,t,s; mm-kg-ms; inch-lbf-s; ...")] = "SI",
    viscoelastic: Viscoelastic = None,
    circulatory: Annotated[bool, typer.Option("--circulatory", help="K may be unsymmetric.")] = False,
    superelement: Annotated[
        bool, typer.Option("--superelement", help="The body is reduced already: write a result.")
    ] = False,
    list_formats: Annotated[bool, typer.Option("--list-formats", help="Say what can be read, and stop.")] = False,
    json: JsonFile = None,
):
    """Bring matrices of another program into a model file.

    Either the main file of a whole export (an Abaqus or CalculiX input file, ...), whose other files are found beside
    it, or single matrices given by -K and -M. See --list-formats.
    """
    if list_formats:
        from ..readers.registry import READERS

        show_table("Formats, each told by what the file begins with", hpcred.workflows.list_formats())
        session.warn(READERS.broken)
        return
    # the last name is the model file, where -o does not give it
    files = list(files or [])
    if output is None:
        if not files or (len(files) == 1 and not (stiffness or mass) and os.path.exists(files[0])):
            raise InputError("convert: no model file to write; give its name last or by -o")
        output = files.pop()
    # either one export or K and M
    if files and (len(files) > 1 or stiffness or mass):
        raise InputError("convert: expected one input file, or the matrices by -K and -M")
    if not files and not (stiffness and mass):
        found = "no matrices" if not (stiffness or mass) else f"only {'K' if stiffness else 'M'}"
        raise InputError(f"convert: {found}; give the main file of an export, or K and M by -K and -M")
    given = {"-D": damping, "-B": input_file, "-C": output_file, "-Cv": velocity_file, "-Ca": acceleration_file,
             "--nodes": nodes, "--dofs": dofs}  # fmt: skip
    if files and (besides := [option for option, value in given.items() if value]):
        raise InputError(f"convert: {', '.join(besides)} belong to -K and -M only, found with {files[0]}")
    # the tables of what was made
    names = values.names(variables, "--variables")
    source = files[0] if files else hpcred.settings.Source(
        stiffness, mass, damping, input_file, output_file, nodes, dofs, names, velocity_file, acceleration_file
    )  # fmt: skip
    report = hpcred.convert(
        source, output, inputs=values.targets(inputs, "--inputs"), outputs=values.targets(outputs, "--outputs"),
        variables=names, units=units, viscoelastic=viscoelastic_of(viscoelastic), circulatory=circulatory,
        superelement=superelement, progress=session.progress(),
    )  # fmt: skip
    show_report(output, {key: value for key, value in report.items() if key != "output"})
    session.warn(report["warnings"])
    session.write_json(json, report)


def solid(
    output: Output = "model.h5",
    cells: Annotated[
        tuple[int, int, int] | None, typer.Option(help="Hexahedra along x, y, z; default: 60 24 24.")
    ] = None,
    dofs: Annotated[int | None, typer.Option(help="About so many dofs, in place of cells.")] = None,
    size: Annotated[tuple[float, float, float] | None, typer.Option(help="Edges in m.")] = None,
    inputs: Annotated[int, typer.Option(help="Forces at nodes of the face at the free end.")] = 6,
    free: Annotated[bool, typer.Option("--free", help="Do not clamp the face at x = 0.")] = False,
):
    """A block of 8-node hexahedra, clamped at x = 0."""
    _example("solid", output, cells=cells, dofs=dofs, size=size, inputs=inputs, clamped=not free)


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
    report = hpcred.example(name, output, progress=session.progress(), **keywords)
    known = "; ".join(f"{key} {', '.join(report[key])}" for key in ("inputs", "sets") if report[key])
    print(f"{printable(output)}: {report['size']} dofs, {known}")
