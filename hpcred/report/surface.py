"""Extract the visible surface of a body: triangles, edges and outline.

Faces of solid elements that occur once bound the body; shells are visible from both sides; beams become tubes. Without
elements every node is a point.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..fe.elements import FACES, all_faces, edges, equal_rows, free, triangles_of

SHARP = np.cos(np.radians(40.0))  # of the angle between two faces whose edge belongs to the outline
SIDES = 8  # of a tube
THICK = 0.008  # radius of a tube relative to the diagonal of the body, at most


@dataclass(frozen=True, eq=False)
class DrawnSurface:
    """`points` (v, 3) in m; `nodes` (v,): which node of the body each of them moves with; `triangles` (t, 3), `edges`
    (e, 2) of the elements and `outline` (o, 2), the sharp ones of them: indices of points. Without triangles the
    points are all there is. `whole`: number of points before they were thinned out."""

    points: np.ndarray
    nodes: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray
    outline: np.ndarray
    whole: int


def surface_of(points, cells: dict) -> DrawnSurface:
    """Return the surface of a body: `points` (k, 3), `cells` by kind (of fe.elements) as indices of points."""
    corners, middles, solid = all_faces(cells)
    seen = free(corners, solid)
    corners, middles = corners[seen], middles[seen]
    triangles = triangles_of(corners, middles)
    sides, outline = _sides(points, corners, middles)
    lines = _lines(cells)
    if not len(triangles) and not len(lines):
        none = np.zeros((0, 2), dtype=int)
        return DrawnSurface(points, np.arange(len(points)), np.zeros((0, 3), dtype=int), none, none, len(points))
    used = np.unique(np.concatenate([triangles.ravel(), lines.ravel()]))
    triangles, sides, outline, axes = (np.searchsorted(used, numbers) for numbers in (triangles, sides, outline, lines))
    tube_points, tube_owner, tube_triangles = _tubes(points[used], axes)
    return DrawnSurface(
        np.concatenate([points[used], tube_points]), np.concatenate([used, used[tube_owner]]),
        np.concatenate([triangles, tube_triangles + len(used)]), sides,
        np.concatenate([outline, axes]), len(used),
    )  # fmt: skip


def _sides(points, corners, middles):
    """Return edges of faces, each once, and those of the outline: of one face only, or with an angle between faces."""
    if not len(corners):
        return np.zeros((0, 2), dtype=int), np.zeros((0, 2), dtype=int)
    last = np.where(corners[:, 3] < 0, corners[:, 2], corners[:, 3])
    normals = np.cross(points[corners[:, 2]] - points[corners[:, 0]], points[last] - points[corners[:, 1]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    following = np.roll(corners, -1, axis=1)
    following[:, 2] = np.where(corners[:, 3] < 0, corners[:, 0], following[:, 2])
    there = (corners >= 0) & (following >= 0) & (corners != following)
    pairs = np.stack([corners[there], following[there]], axis=1)
    middle = middles[there]
    face = np.broadcast_to(np.arange(len(corners))[:, None], corners.shape)[there]
    numbers = equal_rows(np.sort(pairs, axis=1))
    order = np.argsort(numbers, kind="stable")
    first = order[np.concatenate([[True], np.diff(numbers[order]) > 0])]  # of the faces at each edge
    count = np.bincount(numbers)
    agree = np.abs((normals[face] * normals[face[first[numbers]]]).sum(axis=1)) >= SHARP
    smooth = (count == 2) & (np.bincount(numbers, weights=~agree) == 0)
    return _through_middles(pairs[first], middle[first]), _through_middles(pairs[first][~smooth],
                                                                           middle[first][~smooth])  # fmt: skip


def _through_middles(pairs, middle):
    """Return straight pieces of edges: one, or two for edges with a midpoint node."""
    curved = middle >= 0
    halves = [np.stack([pairs[curved, k], middle[curved]], axis=1) for k in (0, 1)]
    return np.concatenate([pairs[~curved], *halves])


def _lines(cells):
    pairs = [np.asarray(nodes)[:, list(pair)] for kind, nodes in cells.items() if kind not in FACES
             for pair in (edges(kind) if kind != "vertex" else ())]  # fmt: skip
    return np.concatenate([np.zeros((0, 2), dtype=int), *pairs])


def _tubes(points, axes):
    """Return points (l * 2 SIDES, 3), the end that each belongs to, and triangles of the tubes around lines (l, 2)."""
    if not len(axes):
        return np.zeros((0, 3)), np.zeros(0, dtype=int), np.zeros((0, 3), dtype=int)
    along = points[axes[:, 1]] - points[axes[:, 0]]
    length = np.linalg.norm(along, axis=1)
    radius = min(THICK * np.linalg.norm(np.ptp(points, axis=0)), 0.25 * np.median(length))
    along /= np.maximum(length, 1e-300)[:, None]
    helper = np.eye(3)[np.abs(along).argmin(axis=1)]
    across = np.cross(along, helper)
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * np.cross(along, across)[:, None]
    # a little beyond the ends, so that tubes which meet at an angle leave no gap
    beyond = 0.5 * radius * np.array([-1.0, 1.0])[None, :, None] * along[:, None]
    place = points[axes][:, :, None] + radius * ring[:, None] + beyond[:, :, None]
    k, after = np.arange(SIDES), np.roll(np.arange(SIDES), -1)
    pattern = [np.stack([k, after, SIDES + after], axis=1), np.stack([k, SIDES + after, SIDES + k], axis=1)]
    inner = np.arange(1, SIDES - 1)
    pattern += [start + np.stack([0 * inner, inner, inner + 1], axis=1) for start in (0, SIDES)]
    triangles = np.concatenate(pattern)[None] + 2 * SIDES * np.arange(len(axes))[:, None, None]
    return place.reshape(-1, 3), np.repeat(axes.ravel(), SIDES), triangles.reshape(-1, 3)


def thinned(surface: DrawnSurface, most: int) -> DrawnSurface:
    """Return a surface with at most `most` points: in each cell of a grid, the one nearest to their middle stands for
    all."""
    if len(surface.points) <= most:
        return surface
    low, size = surface.points.min(axis=0), np.ptp(surface.points, axis=0).max()
    fine, coarse = size / most, size  # edge of a cell: too many points, few enough
    while coarse / fine > 1.02:
        edge = np.sqrt(fine * coarse)
        count = equal_rows(((surface.points - low) / edge).astype(np.int64)).max() + 1
        fine, coarse = (fine, edge) if count <= most else (edge, coarse)
    group = equal_rows(((surface.points - low) / coarse).astype(np.int64))
    middle = np.stack([np.bincount(group, weights=x) for x in surface.points.T], axis=1) / np.bincount(group)[:, None]
    order = np.lexsort((np.linalg.norm(surface.points - middle[group], axis=1), group))
    kept = order[np.concatenate([[True], np.diff(group[order]) > 0])]

    def mapped(joined):
        joined = group[joined]
        ends = np.sort(joined, axis=1)
        joined = joined[(np.diff(ends, axis=1) > 0).all(axis=1)]
        return joined[np.unique(np.sort(joined, axis=1), axis=0, return_index=True)[1]]

    return replace(
        surface, points=surface.points[kept], nodes=surface.nodes[kept], triangles=mapped(surface.triangles),
        edges=mapped(surface.edges), outline=mapped(surface.outline),
    )  # fmt: skip
