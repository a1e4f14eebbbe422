"""Write a report (plain values and arrays) as one HTML file that needs no network."""

from __future__ import annotations

import base64
import io
from importlib.resources import files

import numpy as np

from ..parallel.failures import InputError
from .mode_pictures import SWING, axes_of_view, first_elastic
from .surface import surface_of, thinned
from .tables import in_words

MOST_POINTS = 60_000  # of all bodies of a page together
MOST_EDGES = 150_000  # more are not seen as lines
KINDS = {"f4": "<f4", "f8": "<f8", "u4": "<u4"}


def render_page(page: dict, data: dict) -> str:
    """Return the text of the page: `page` is what its template shows, `data` what its plots and pictures draw."""
    try:
        import jinja2
    except ImportError as error:
        raise InputError("a report needs jinja2: pip install jinja2") from error
    assets = files("hpcred.report") / "assets"
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=False)
    environment.filters["told"] = in_words
    names = {"css": "report.css", "script": "report.js", "plotly": "plotly-basic.min.js", "three": "three.min.js"}
    parts = {key: (assets / name).read_text(encoding="utf-8") for key, name in names.items()}
    template = environment.from_string((assets / "report.html").read_text(encoding="utf-8"))
    return template.render(page=page, data=data, **parts)


def packed(array, dtype="f8") -> dict:
    """Return an array for the page: its type (f4, f8, u4), shape and base64 of its numbers."""
    array = np.ascontiguousarray(array, dtype=KINDS[dtype])
    return {"dtype": dtype, "shape": list(array.shape), "bdata": base64.b64encode(array.tobytes()).decode()}


def drawn_for_page(draw) -> str:
    """Return a PNG that `draw(file)` makes as an address for the page."""
    file = io.BytesIO()
    draw(file)
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def body_for_page(shapes, modes: int, most: int = MOST_POINTS) -> tuple[dict, str]:
    """Return the surface of a body and its first `modes` elastic shapes for the page, with at most `most` points, and a
    sentence.

    Displacements are relative to the largest of each shape; `swing` is what that is drawn as, in m. Rigid-body shapes
    come before; `start` is the place of the first elastic one.
    """
    whole = surface_of(shapes.points, shapes.cells)
    surface = thinned(whole, most)
    points = np.concatenate([surface.points, shapes.mark_points])
    start = first_elastic(shapes.frequencies)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    fields = []
    for k in range(min(start + modes, len(shapes.names))):
        field = shapes.displacement(k)
        moved = np.concatenate([field[surface.nodes], shapes.mark_displacement(k)])
        fields.append(packed(moved / max(np.linalg.norm(field, axis=1).max(), 1e-300), "f4"))
    edges = surface.edges if len(surface.edges) <= MOST_EDGES else surface.outline
    sentence = f"{len(fields)} of {len(shapes.names)} shapes, " + (
        f"{whole.whole} nodes on the surface" if len(whole.triangles)
        else f"{whole.whole} nodes as points, since the file says nothing of elements"
    )  # fmt: skip
    if surface is not whole:
        sentence += f", thinned out here to {len(surface.points)} points of {len(whole.points)}"
    return {
        "points": packed(points - middle, "f4"),  # about their middle, which 32 bits resolve better
        "triangles": packed(surface.triangles, "u4"),
        "outline": packed(surface.outline, "u4"),
        "edges": packed(edges, "u4"),
        "marks": packed(np.arange(len(surface.points), len(points)), "u4"),
        "mark_names": list(shapes.mark_names),
        "start": start,
        "fields": fields,
        "names": list(shapes.names[: len(fields)]),
        "swing": SWING * float(np.linalg.norm(np.ptp(points, axis=0))),
        "towards": (-axes_of_view(surface.points)[2]).tolist(),
    }, sentence
