"""Make a model file, of matrices of another program or as an example."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated

import typer

import hpcred

from ..parallel.declared import Keywords
from ..parallel.failures import InputError
from ..parallel.messages import printable
from ..report.tables import say, show_table
from ..settings.declared_terms import DeclaredTerms
from ..workflows.keywords import FileUnits, InputsAndOutputs, Variables
from . import session
from .details import show_report
from .options import JsonFile, command

Output = Annotated[str, typer.Option("-o", "--output", help="The model file to write.")]


@dataclass(frozen=True, kw_only=True)
class Matrices(Keywords):
    """Options of single matrix files, with the names of the fields of a Source."""

    K: Annotated[str | None, typer.Option("-K", "--stiffness", metavar="FILE", help="Matrix file of K.")] = None
    M: Annotated[str | None, typer.Option("-M", "--mass", metavar="FILE", help="Matrix file of M.")] = None
    D: Annotated[str | None, typer.Option("-D", "--damping", metavar="FILE", help="Matrix file of D.")] = None
    B: Annotated[str | None, typer.Option("-B", metavar="FILE", help="Matrix file of B (n, p).")] = None
    C: Annotated[str | None, typer.Option("-C", metavar="FILE", help="Matrix file of C (r, n).")] = None
    Cv: Annotated[str | None, typer.Option("-Cv", metavar="FILE", help="Cv (r, n) of y = C q + Cv q' + Ca q''.")] = None
    Ca: Annotated[str | None, typer.Option("-Ca", metavar="FILE", help="Matrix file of Ca (r, n).")] = None
    nodes: Annotated[str | None, typer.Option(help="Lines of node, x, y, z; or .inp, .bdf, .unv, .cdb, .frd.")] = None
    dofs: Annotated[str | None, typer.Option(help="Lines of node, direction (1-6), one a row.")] = None


@command
def convert(
    files: Annotated[list[str] | None, typer.Argument(metavar="[EXPORT] MODEL.h5")] = None,
    output: Annotated[str | None, typer.Option("-o", "--output", help="The model file to write.")] = None,
    *,
    matrices: Matrices,
    ends: InputsAndOutputs,
    variables: Variables = None,
    units: FileUnits = "SI",
    terms: DeclaredTerms,
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

        rows = hpcred.workflows.list_formats()
        columns = {"a whole model": ("format", "told by", "with it"), "a matrix": ("format", "told by")}
        for holds, title in (("a whole model", "Whole models, by their main file"),
                             ("a matrix", "Matrices, by -K, -M and others, with --nodes and --dofs")):  # fmt: skip
            show_table(title, [{key: row[key] for key in columns[holds]} for row in rows if row["holds"] == holds])
        session.warn(READERS.broken)
        return
    # the last name is the model file, where -o does not give it
    files, stiffness, mass = list(files or []), matrices.K, matrices.M
    if output is None:
        if not files or (len(files) == 1 and not (stiffness or mass) and os.path.exists(files[0])):
            raise InputError("convert: no model file to write; give its name last or by -o")
        output = files.pop()
    # either one export or K and M
    if files and (len(files) > 1 or stiffness or mass):
        raise InputError("convert: expected one input file, or the matrices by -K and -M")
    if not files and not (stiffness and mass):
        given = "no matrices" if not (stiffness or mass) else f"only {'K' if stiffness else 'M'}"
        raise InputError(f"convert: {given}; give the main file of an export, or K and M by -K and -M")
    besides = [f"-{key}" if key[0].isupper() else f"--{key}" for key, name in matrices.given.items() if name]
    if files and besides:
        raise InputError(f"convert: {', '.join(besides)} belong to -K and -M only, found with {files[0]}")
    source = files[0] if files else hpcred.settings.Source(**matrices.given, variables=variables)
    # the tables of what was made
    report = hpcred.convert(source, output, variables=variables, units=units, superelement=superelement,
                            progress=session.progress(), **ends.given, **terms.given)  # fmt: skip
    session.warn(report["warnings"])  # first, as units that look wrong are those of the table
    show_report(output, {key: value for key, value in report.items() if key != "output"})
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
    say(f"{printable(output)}: {report['size']} dofs, {known}")
