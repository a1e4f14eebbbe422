"""Write a report (plain values and arrays) as one HTML file that needs no network."""

import base64
import io
from importlib.resources import files

import numpy as np

from ..body.stress import von_mises
from ..parallel.failures import InputError
from .mode_pictures import COLOUR_STOPS, MEGAPASCAL, SWING, axes_of_view, first_elastic, round_ticks
from .surface import surface_of, thinned
from .tables import in_words

MOST_POINTS = 60_000  # of all bodies of a page together
MOST_EDGES = 150_000  # more are not seen as lines
MOST_MOVING = 20_000  # points of a body whose motion is played
KINDS = {"f4": "<f4", "f8": "<f8", "u4": "<u4", "i2": "<i2"}
SIXTEEN = 2**15 - 1  # stands for 1 in arrays of i2
UNKNOWN = -1.0  # of a stress, where the file has none


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
    environment.globals["colours"] = ", ".join(COLOUR_STOPS)
    texts = {key: (assets / name).read_text(encoding="utf-8") for key, name in names.items()}
    template = environment.from_string((assets / "report.html").read_text(encoding="utf-8"))
    return template.render(page=page, data=data | {"stops": COLOUR_STOPS}, **texts)


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

    Displacements are relative to the largest of each shape; `swing` is what that is drawn as, in m. `stresses`: von
    Mises' relative to the largest of the shape, UNKNOWN where the file has none; none of a result without stress
    modes. Rigid-body shapes come before; `start` is the place of the first elastic one.
    """
    whole = surface_of(shapes.points, shapes.cells)
    surface = thinned(whole, most)
    start = first_elastic(shapes.frequencies)
    fields, stresses = [], []
    for k in range(min(start + modes, len(shapes.names))):
        field = shapes.displacement(k)
        moved = np.concatenate([field[surface.nodes], shapes.mark_displacement(k)])
        fields.append(packed(moved / max(np.linalg.norm(field, axis=1).max(), 1e-300), "f4"))
        if shapes.has_stress:  # that of a rigid-body motion is round-off
            stress = von_mises(shapes.stress(shapes.coordinates_of(k))) * (k >= start)
            stresses.append(_relative(stress[surface.nodes], np.nanmax(stress, initial=0.0), len(shapes.mark_points)))
    sentence = f"{len(fields)} of {len(shapes.names)} shapes, " + (
        f"{whole.whole} nodes on the surface" if len(whole.triangles)
        else f"{whole.whole} nodes as points, since the file says nothing of elements"
    )  # fmt: skip
    if surface is not whole:
        sentence += f", thinned out here to {len(surface.points)} points of {len(whole.points)}"
    drawn = _drawn_surface(shapes, surface)
    names = list(shapes.names[: len(fields)])
    return drawn | {"start": start, "fields": fields, "stresses": stresses, "names": names}, sentence


def motion_for_page(shapes, q, times, start: int) -> dict:
    """Return the surface of a body, its displacements and von Mises' stresses at the coordinates q (f, m) of the
    instants `times` (f,), for the page; `start`: the instant that is shown first.

    Displacements are relative to the largest of all instants, stresses to `largest` in MPa.
    """
    surface = thinned(surface_of(shapes.points, shapes.cells), MOST_MOVING)
    count = len(surface.nodes) + len(shapes.mark_points)
    moved, stress = np.zeros((len(q), count, 3)), np.zeros((len(q), len(surface.nodes), 6))
    for k, one in enumerate(np.eye(q.shape[1])):
        field, marks = shapes.moved(one)
        moved += q[:, k, None, None] * np.concatenate([field[surface.nodes], marks])
        stress += q[:, k, None, None] * shapes.stress(one)[surface.nodes]
    stress = von_mises(stress)
    largest = float(np.nanmax(stress, initial=0.0))
    moved /= max(np.linalg.norm(moved, axis=2).max(initial=0.0), 1e-300)
    return _drawn_surface(shapes, surface) | {
        "start": start,
        "fields": [packed(np.rint(SIXTEEN * field), "i2") for field in moved],
        "stresses": [_relative(values, largest, len(shapes.mark_points)) for values in stress],
        "names": [f"{t:.4g} s" for t in times],
        "times": [float(t) for t in times],
        "largest": largest / MEGAPASCAL,
        "ticks": round_ticks(largest / MEGAPASCAL),
    }


def _drawn_surface(shapes, surface) -> dict:
    """Return the points, lines and triangles of a body for the page."""
    points = np.concatenate([surface.points, shapes.mark_points])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    edges = surface.edges if len(surface.edges) <= MOST_EDGES else surface.outline
    return {
        "points": packed(points - middle, "f4"),  # about their middle, which 32 bits resolve better
        "triangles": packed(surface.triangles, "u4"),
        "outline": packed(surface.outline, "u4"),
        "edges": packed(edges, "u4"),
        "marks": packed(np.arange(len(surface.points), len(points)), "u4"),
        "mark_names": list(shapes.mark_names),
        "swing": SWING * float(np.linalg.norm(np.ptp(points, axis=0))),
        "towards": (-axes_of_view(surface.points)[2]).tolist(),
    }


def _relative(stress, largest, marks) -> dict:
    """Return stresses over the largest one as i2, UNKNOWN for NaN and for the `marks` that follow."""
    values = np.nan_to_num(stress / max(largest, 1e-300), nan=UNKNOWN)
    return packed(np.rint(SIXTEEN * np.append(values, np.full(marks, UNKNOWN))), "i2")
