"""Triangles and lines become pixels with a depth buffer: screen coordinates enter, what each pixel shows leaves.

Screen coordinates: x to the right and y down in pixels, z the depth, smaller in front. No loop over triangles: those
of about the same size are looked at together.
"""

from __future__ import annotations

import numpy as np

AT_ONCE = 2**22  # pixels that are tried in one step
NOTHING = -1


class Canvas:
    """What is in front at each pixel: `depth` (h, w), inf where nothing is, and the `triangle` (h, w) or NOTHING."""

    def __init__(self, width: int, height: int):
        self.width, self.height = width, height
        self.depth = np.full((height, width), np.inf)
        self.triangle = np.full((height, width), NOTHING)

    def fill(self, points, triangles):
        """Draw `triangles` (t, 3) of `points` (v, 3) in screen coordinates."""
        corners = points[triangles]
        low = np.floor(corners[..., :2].min(axis=1)).astype(int).clip(0)
        high = np.ceil(corners[..., :2].max(axis=1)).astype(int).clip(max=[self.width - 1, self.height - 1])
        span = (high - low + 1).max(axis=1, initial=0)
        there = (high >= low).all(axis=1) & (np.abs(_double_area(corners)) > 1e-12)
        size = 2
        while there.any():
            chosen = np.flatnonzero(there & (span <= size))
            step = max(1, AT_ONCE // size**2)
            for first in range(0, len(chosen), step):
                part = chosen[first : first + step]
                self._try(corners[part], low[part], part, size)
            there[chosen] = False
            size *= 2

    def _try(self, corners, low, numbers, size):
        """Triangles that fit into squares of `size` pixels from their corner `low`."""
        y, x = np.divmod(np.arange(size * size), size)
        x, y = low[:, :1] + x, low[:, 1:] + y
        weights = _weights(corners, x, y)
        inside = (weights >= -1e-9).all(axis=0) & (x < self.width) & (y < self.height)
        depth = sum(weights[k] * corners[:, k, 2, None] for k in range(3))[inside]
        pixel = (y * self.width + x)[inside]
        number = np.broadcast_to(numbers[:, None], inside.shape)[inside]
        nearer = depth < self.depth.ravel()[pixel]
        far_first = np.argsort(-depth[nearer], kind="stable")  # of several values for a pixel the last one stays
        pixel = pixel[nearer][far_first]
        self.depth.ravel()[pixel] = depth[nearer][far_first]
        self.triangle.ravel()[pixel] = number[nearer][far_first]

    def weights(self, points, triangles):
        """Pixels (2, k) that show a triangle, its number (k,), and weights (3, k) of its corners there."""
        y, x = place = np.nonzero(self.triangle != NOTHING)
        number = self.triangle[place]
        return place, number, _weights(points[triangles[number]], x[:, None], y[:, None])[..., 0].clip(0, 1)

    def strokes(self, points, pairs, width: int, towards: float) -> np.ndarray:
        """Pixels (h, w) that lines show, `width` pixels wide, and not hidden; `towards`: by how much lines are put in
        front of the surfaces that they lie in."""
        shown = np.zeros((self.height, self.width), dtype=bool)
        ends = points[pairs]
        count = np.ceil(np.abs(ends[:, 1, :2] - ends[:, 0, :2]).max(axis=1, initial=0)).astype(int) + 1
        step = max(1, AT_ONCE // max(int(count.max(initial=1)), 1))
        order = np.argsort(count)  # lines of about the same length together
        for first in range(0, len(order), step):
            part = order[first : first + step]
            along = np.linspace(0, 1, int(count[part].max()))
            place = ends[part, 0, None] + along[None, :, None] * (ends[part, 1] - ends[part, 0])[:, None]
            self._stamp(shown, place.reshape(-1, 3), width, towards)
        return shown

    def discs(self, points, width: int, towards: float = 0.0) -> np.ndarray:
        """As strokes, for single points."""
        shown = np.zeros((self.height, self.width), dtype=bool)
        self._stamp(shown, points, width, towards)
        return shown

    def _stamp(self, shown, place, width, towards):
        middle = (width - 1) / 2
        for dy in range(width):
            for dx in range(width):
                if (dx - middle) ** 2 + (dy - middle) ** 2 > (width / 2) ** 2 + 0.3:
                    continue
                x = np.rint(place[:, 0] + dx - middle).astype(int)
                y = np.rint(place[:, 1] + dy - middle).astype(int)
                fits = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
                x, y, depth = x[fits], y[fits], place[fits, 2]
                seen = depth - towards <= self.depth[y, x]
                shown[y[seen], x[seen]] = True


def _double_area(corners):
    a, b, c = (corners[:, k, :2] for k in range(3))
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


def _weights(corners, x, y):
    """Barycentric coordinates (3, t, k) of pixels x, y (t, k) in triangles (t, 3, 3)."""
    ax, ay = corners[:, 0, 0, None], corners[:, 0, 1, None]
    bx, by = corners[:, 1, 0, None] - ax, corners[:, 1, 1, None] - ay
    cx, cy = corners[:, 2, 0, None] - ax, corners[:, 2, 1, None] - ay
    double = bx * cy - by * cx
    second = ((x - ax) * cy - (y - ay) * cx) / double
    third = (bx * (y - ay) - by * (x - ax)) / double
    return np.stack([1 - second - third, second, third])
