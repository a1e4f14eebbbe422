"""Measure this machine; reproduce the results of the paper."""

from __future__ import annotations

from typing import Annotated

import typer

import hpcred

from ..parallel import kernels
from ..parallel.failures import InputError
from ..report.tables import in_words, show_table, show_timing
from . import session, values
from .options import JsonFile


def bench(
    cells: Annotated[tuple[int, int, int], typer.Option(help="Hexahedra of the block to try on.")] = (40, 16, 16),
    folder: Annotated[str | None, typer.Option(metavar="DIR", help="Where to try writing and reading.")] = None,
    save: Annotated[bool, typer.Option("--save", help="Keep the quickest kernels of OpenBLAS for later runs.")] = False,
    forget: Annotated[bool, typer.Option("--forget", help="Remove the kernels that --save has kept.")] = False,
    json: JsonFile = None,
):
    """Measure this machine: factorisation, solves, products, orthogonality, files, kernels of OpenBLAS.

    --save and --forget measure the kernels alone, or nothing; both are for this kind of processor.
    """
    if forget:
        if save or folder:
            raise InputError("--forget: cannot be combined with --save or --folder")
        damage, name = kernels.damage(), hpcred.forget_kernels()
        if damage:
            now = "written anew for other processors" if kernels.saved() else "removed"
            print(f"{kernels.place()} was damaged and is {now}")
        else:
            print(f"the kernels {name} are no longer kept" if name else "no kernels are kept for this processor")
        session.write_json(json, {"forgotten": name})
        return
    report = {"hints": []} if save else hpcred.bench(cells, folder=folder, progress=session.progress())
    show_table("This machine", [{"": key.replace("_", " "), " ": in_words(item)} for key, item in report.items()
                                if key != "hints"])  # fmt: skip
    report["kernels"] = found = hpcred.bench_kernels(cells, save=save)
    if found["why_none"]:
        print(found["why_none"])
    else:
        title = f"Kernels of {found['blas']}, which takes {found['own']} by itself; ratio: of the factor's time to its"
        show_table(title, found["table"])
        if found["not_here"]:
            print(f"not able to run here: {', '.join(found['not_here'])}")
        if found["kept"]:
            print(f"{found['kept']} is kept for later runs on this kind of processor; --forget removes it")
    session.list_all("hint", [*report["hints"], *found["hints"]])
    session.write_json(json, report)


def paper(
    output: Annotated[
        str, typer.Option("-o", "--output", metavar="DIR", help="Folder for figures and data.")
    ] = "paper",
    figures: Annotated[
        str, typer.Option(metavar="N1,N2,...", help="Figures to draw after the tables, or none; 5 takes minutes.")
    ] = "3,4,5",
    json: JsonFile = None,
):
    """Reproduce Section 5 of the paper on the built-in linkage: Tables 1 and 2, Figures 3 to 5."""
    progress = session.progress()
    chosen = [] if figures == "none" else [int(part) if part % 1 == 0 else part
                                           for part in values.numbers(figures, "--figures")]  # fmt: skip
    data = hpcred.reproduce(output, figures=chosen, show=_show_tables, progress=progress)
    show_table("Figure 5. u_y of node 20 in time, against all elastic modes", data.get("figure_5", ())[1:])
    drawn = f"figure{'s' * (len(chosen) > 1)} {', '.join(map(str, chosen))} (png, svg), " if chosen else ""
    print(f"{drawn}section5.h5 and section5.json written to {output}")
    show_timing(progress.timing())
    session.write_json(json, data)


def _show_tables(data):
    """Print the tables, before the figures."""
    show_table("Table 1. SISO: chord frame, force at node 20", data["table_1"])
    show_table("Table 2. MIMO: Buckens frame, seven inputs and outputs", data["table_2"])
