"""Write a report on results, and perhaps their full model: one HTML file, and figures and tables for papers."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from ..files.folders import folder_for
from ..files.hdf5 import atomic_output
from ..files.outputs import HTML, check_outputs
from ..files.together import together
from ..parallel.declared import flattened
from ..parallel.failures import InputError, agreed
from ..parallel.progress import Progress
from ..report.page import MOST_POINTS, body_for_page, motion_for_page, render_page
from .keywords import At, Band, Folders, FullFile, Shown, Solving
from .pair_figures import check_drawing, pairs_by_name, pairs_to_show
from .report_files import draw_files, write_tables
from .report_page import page_of
from .report_sheets import Sheet, sheets_of
from .stress_state import stress_of_motion
from .workflow import workflow

MOST_PAIRS = 36  # responses on a page, the largest


@workflow
@flattened
def report_file(
    results, full: FullFile = None, *, output="report.html", band: Band = None, solves: int = 21, shown: Shown,
    folders: Folders, solving: Solving, at: At = None, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Write a report on results as one HTML file that needs no network. Collective.

    Parameters
    ----------
    results : sequence of str or PathLike
    full : str or PathLike, optional
        The model file that they were reduced from; its response is then computed at `solves` equally spaced frequencies
        and beside pseudo-frequencies, and its modes.
    output : str or PathLike
    band : sequence of 2 floats, optional
        Hz; by default that of the job.
    solves : int
    pairs : sequence of str
        Names "output/input" of responses; by default the largest.
    modes : int
        Number of shapes that can be looked at.
    motion : str or PathLike, optional
        Of a single result with stress modes, as for recover, drawn where its stress is largest.
    png, svg, csv : str or PathLike, optional
        Folders for figures and tables of the same.
    groups, factoring : optional
        Groups of ranks that share the frequencies (see frequency_response), and how full models are factored; by
        default as in the reduction.
    at : dict of float, optional
        Values of the parameters by name; by default those of reference.

    Returns
    -------
    dict
        The file, its size in MB, the names of figures and tables, and notes.

    Raises
    ------
    InputError
        For results that do not belong together.
    """
    if (ending := Path(output).suffix.lower()) not in (".html", ".htm") and Path(output).name:
        raise InputError(f"output {output}: found a name that ends in {ending or 'nothing'}, expected .html; figures "
                         "as files are written by --png and --svg")  # fmt: skip
    motion, into = shown.motion, {kind: folder for kind, folder in folders.given.items() if folder is not None}
    check_outputs({output: HTML}, comm, [*results, full, motion], progress=progress)
    if {"png", "svg"} & {*into}:
        check_drawing(comm)
    with ExitStack() as stack:
        for folder in into.values():
            stack.enter_context(folder_for(folder, comm))
        sheets = sheets_of(
            results, full, band=band, solves=solves, **solving.given, at=at, comm=comm, progress=progress
        )
        chosen = [choose_pairs(sheet, shown.pairs) for sheet in sheets]
        if motion is not None:
            if len(sheets) > 1:
                raise InputError(
                    f"--motion: found {len(sheets)} results, expected the one that moved so; report on it alone"
                )
            with progress.stage("motion", str(motion)):
                sheets[0].moved = stress_of_motion(sheets[0].result, motion, comm)
        report = None
        with together(comm), atomic_output(output, comm) as temporary, agreed(comm):
            if comm.rank == 0:
                for sheet in sheets:
                    _take_body(sheet, shown.modes, MOST_POINTS // len(sheets))
                text = render_page(*page_of(sheets, chosen, full))
                temporary.write_text(text, encoding="utf-8", errors="backslashreplace")  # of names in other bytes
                notes = list(dict.fromkeys(note for sheet in sheets for note in sheet.notes))
                size = temporary.stat().st_size / 1e6
                report = {"output": str(output), "megabytes": size, "notes": notes, "files": []}
                for kind, folder in into.items():
                    made = write_tables(folder, sheets) if kind == "csv" else draw_files(folder, kind, sheets, chosen)
                    report["files"] += made
        return comm.bcast(report)


def _take_body(sheet, modes, most):
    """Give a sheet the shapes of a result that has nodes; on one rank."""
    try:
        with sheet.result.shapes() as shapes:
            sheet.body, sheet.body_sentence = body_for_page(shapes, modes, most)
            sheet.has_stress = shapes.has_stress
            if (moved := sheet.moved) is not None:
                sheet.motion = motion_for_page(shapes, moved.q, moved.t[moved.shown], moved.worst_shown)
    except InputError as error:
        sheet.body_sentence = str(error)


def choose_pairs(sheet: Sheet, wanted=()) -> list[tuple[str, int, int]]:
    """Return name, output and input of the responses that are shown: the `wanted` ones, or else those of the
    directions, the worst first, and of pairs_to_show.

    Raises InputError."""
    outputs, inputs = sheet.reduced.output_names, sheet.reduced.input_names
    shown = pairs_by_name(wanted, outputs, inputs, sheet.name)
    if not shown:
        worst = [(outputs.index(direction.output), inputs.index(name)) for direction in sheet.directions
                 for name in dict.fromkeys((direction.input, direction.worst_input))]  # fmt: skip
        every = dict.fromkeys([*worst[:MOST_PAIRS], *pairs_to_show(sheet.response, outputs, inputs, MOST_PAIRS)])
        shown = list(every)[:MOST_PAIRS]
    if not wanted and len(shown) == MOST_PAIRS:
        sheet.notes.append(
            f"{sheet.name}: {MOST_PAIRS} responses are shown, the least accurate directions first, then the largest; "
            "--pairs chooses others"
        )
    return [(f"{outputs[i]}/{inputs[j]}", i, j) for i, j in shown]
