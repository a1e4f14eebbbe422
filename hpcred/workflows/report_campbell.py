"""Collect Campbell diagrams of results with parameters for reports: one for each parameter."""

from __future__ import annotations

from ..analysis.campbell import campbell
from ..analysis.campbell_diagram import Campbell
from ..files.result_file import Result
from ..parallel.failures import InputError
from ..report.campbell_figure import campbell_figure
from ..report.figures import has_matplotlib
from ..report.page import drawn_for_page
from .campbell import axis_of, rows_of_critical, rows_of_modes


def diagrams_of(result: Result, notes: list[str], at: dict[str, float]) -> list[Campbell]:
    """Return the diagrams of a result over each of its parameters, the others at values `at`, by default those of
    reference; `notes` gets a sentence where there is none. Collective.

    The direction of whirl is told where the job says the axis of a rotation.
    """
    axis = axis_of(result.reduced.record)
    nodes = () if axis is None else result.nodes
    try:
        return [campbell(result.reduced, parameter.name, nodes=nodes, axis=axis or "z",
                         at={name: value for name, value in at.items() if name != parameter.name})
                for parameter in getattr(result.reduced, "parameters", ())]  # fmt: skip
    except InputError as error:
        notes.append(f"{result.path}: no poles over parameters: {error}")
        return []


def shown_diagrams(sheet) -> list[dict]:
    """Return sentence, picture and rows of tables of the diagrams of a sheet, for the page; on one rank."""
    return [
        {
            "over": diagram.parameter,
            "sentence": diagram.sentence,
            "stable": diagram.stability_limit is None,
            "warnings": list(diagram.warnings),
            "picture": drawn_for_page(draw) if has_matplotlib() else None,
            "critical": rows_of_critical(diagram),
            "modes": rows_of_modes(diagram),
        }
        for diagram, (_, draw) in zip(sheet.diagrams, pictures_of_diagrams(sheet, "png"), strict=True)
    ]


def pictures_of_diagrams(sheet, kind):
    """Yield names, and functions of a path that draw the diagrams of a sheet."""
    for diagram in sheet.diagrams:
        title = f"{sheet.name} over {diagram.parameter}"
        yield f"poles_over_{diagram.parameter}", lambda path, f=diagram, t=title: campbell_figure(path, f, t, kind)
