"""Write the contents of a report for papers: figures (png, svg, pdf) and tables (csv) of its sheets in a folder."""

from __future__ import annotations

import csv
from dataclasses import asdict
from pathlib import Path

from ..files.campbell_file import write_campbell
from ..files.hdf5 import atomic_output
from ..files.names import FileNames
from ..files.response_file import Responses, write_responses
from ..parallel.petsc import MPI
from ..report.figures import errors_figure, pair_figure, time_figure
from ..report.mode_pictures import draw_shapes, draw_state
from .report_campbell import pictures_of_diagrams
from .report_page import directions_of, frequency_rows


def draw_files(folder, kind, sheets, chosen) -> list[str]:
    """Draw responses of every pair, errors, and shapes of every result with nodes, on one rank; return the names."""
    written, once = [], FileNames()

    def into(name, draw):
        path = Path(folder) / f"{once.of(name)}.{kind}"
        with atomic_output(path, MPI.COMM_SELF) as temporary:
            draw(temporary)
        written.append(str(path))

    # one figure for each pair of output and input, with all results
    names = list(dict.fromkeys(name for pairs in chosen for name, _, _ in pairs))
    loads = [load for sheet in sheets for load in sheet.record.loads]
    for name in names:
        curves = _curves_of(name, sheets, chosen)
        into(f"response_{name.replace('/', '-')}", lambda path, c=curves, n=name: pair_figure(
            path, c, *n.split("/", 1), loads=loads, kind=kind))  # fmt: skip
    # the errors of all results, with the tolerance where it is the same
    errors = _errors_of(sheets)
    if errors:
        tolerances = {sheet.record.accuracy.tolerance for sheet in sheets if sheet.record.accuracy is not None}
        common = tolerances.pop() if len(tolerances) == 1 else None
        into("error", lambda path: errors_figure(path, errors, "relative error of all outputs and inputs", common,
                                                 kind=kind))  # fmt: skip
    # of each result its diagrams and shapes
    for sheet in sheets:
        for name, draw in pictures_of_diagrams(sheet, kind):
            into(f"{name}_{sheet.name}", draw)
        if sheet.body is not None:
            with sheet.result.shapes() as shapes:
                into(f"shapes_{sheet.name}", lambda path, s=shapes: draw_shapes(path, s, kind=kind))
                for name, draw in stress_pictures(sheet, shapes, kind):
                    into(f"{name}_{sheet.name}", draw)
    return written


def stress_pictures(sheet, shapes, kind):
    """Names, and functions of a path that draw pictures of stresses: of the pseudo-modes, and of a motion at its
    worst instant and over time."""
    if sheet.has_stress:
        yield "stress", lambda path: draw_shapes(path, shapes, kind=kind, colour="stress")
    if (moved := sheet.moved) is not None:
        yield "stress_of_motion", lambda path: draw_state(path, shapes, moved.worst, moved.title, kind)
        if len(moved.t) > 1:
            panels = [("von Mises stress (MPa)", moved.curves)]
            yield "stress_over_time", lambda path: time_figure(path, moved.t, panels, kind)


def _curves_of(name, sheets, chosen):
    curves = []
    for sheet, pairs in zip(sheets, chosen, strict=True):
        for known, i, j in pairs:
            if known == name:
                curves.append((sheet.name, sheet.frequencies, sheet.response[:, i, j]))
                if sheet.full is not None and not sheet.full_as_before:
                    curves.append(("full model", sheet.full.frequencies, sheet.full.response[:, i, j]))
    return curves


def _errors_of(sheets):
    curves = []
    for sheet in sheets:
        accuracy = sheet.record.accuracy
        if accuracy is not None:
            curves.append((f"{sheet.name}, estimate", accuracy.frequencies, accuracy.eps))
        if sheet.errors is not None:
            curves.append((f"{sheet.name}, measured", sheet.full.frequencies, sheet.errors.eps))
    return curves


def write_tables(folder, sheets) -> list[str]:
    """Write responses, errors, points and frequencies of every result as .csv, on one rank; return the names."""
    written, once = [], FileNames()

    def target(key, sheet):
        return str(Path(folder) / f"{once.of(f'{key}_{sheet.name}')}.csv")

    # error, points and directions of a model that was reduced to a tolerance
    for sheet in sheets:
        accuracy, reduced = sheet.record.accuracy, sheet.reduced
        tables = {"frequencies": frequency_rows(sheet)}
        if accuracy is not None:
            rows = zip(accuracy.frequencies, accuracy.eps, strict=True)
            tables["error"] = [{"f_hz": f, "eps": eps} for f, eps in rows]
            tables["points"] = [asdict(point) for point in accuracy.points]
        if directions := directions_of(sheet):
            tables["directions"] = directions
        if sheet.errors is not None:
            rows = zip(sheet.full.frequencies.tolist(), sheet.errors.eps.tolist(), strict=True)
            tables["error_measured"] = [{"f_hz": f, "eps": eps} for f, eps in rows]
        for diagram in sheet.diagrams:
            written.append(target(f"poles_over_{diagram.parameter}", sheet))
            write_campbell(written[-1], diagram, MPI.COMM_SELF)
        if sheet.record.joints:
            tables["joints"] = [joint.row for joint in sheet.record.joints]
        for key, rows in tables.items():
            if rows:  # a machine has no points
                written.append(target(key, sheet))
                _write_table(written[-1], rows)
        # responses in the form that `evaluate -o` writes
        names = {"input_names": reduced.input_names, "output_names": reduced.output_names}
        responses = {"response": (sheet.frequencies, {"reduced": sheet.response})}
        if sheet.full is not None:
            responses["response_full"] = sheet.full.frequencies, {"full": sheet.full.response}
        for key, (frequencies, arrays) in responses.items():
            written.append(target(key, sheet))
            write_responses(written[-1], Responses(frequencies=frequencies, **arrays, **names), MPI.COMM_SELF)
    return written


def _write_table(target, rows):
    with atomic_output(target, MPI.COMM_SELF) as path, open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
