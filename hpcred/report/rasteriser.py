"""Rasterise triangles and lines with a depth buffer.

Screen coordinates: x to the right and y down in pixels, z the depth, smaller in front. There is no loop over triangles:
the pixel rows of many triangles are processed together.
"""

import numpy as np

AT_ONCE = 2**21  # pixels that are looked at in one step
NOTHING = -1


class Canvas:
    """The front surface at each pixel: `depth` (h, w), inf without one, and the `triangle` (h, w) or NOTHING."""

    def __init__(self, width: int, height: int):
        self.width, self.height = width, height
        self.depth = np.full((height, width), np.inf)
        self.triangle = np.full((height, width), NOTHING)

    def fill(self, points, triangles):
        """Draw `triangles` (t, 3) of `points` (v, 3) in screen coordinates."""
        corners = points[triangles]
        low = np.ceil(corners[..., 1].min(axis=1)).clip(0).astype(int)
        rows = (np.floor(corners[..., 1].max(axis=1)).clip(max=self.height - 1).astype(int) - low + 1).clip(0)
        (ax, ay), b, c = corners[:, 0, :2].T, corners[:, 1, :2].T, corners[:, 2, :2].T
        rows[np.abs((b[0] - ax) * (c[1] - ay) - (b[1] - ay) * (c[0] - ax)) < 1e-12] = 0  # without area
        wide = np.ptp(corners[..., 0], axis=1).clip(max=self.width) + 2
        step = (np.cumsum(rows * wide) // AT_ONCE).astype(int)  # a bound of the pixels
        for group in np.split(np.arange(len(triangles)), np.flatnonzero(np.diff(step)) + 1):
            self._fill(corners[group], low[group], rows[group], group)

    def _fill(self, corners, low, rows, numbers):
        """Triangles (t, 3, 3) from their first row of pixels `low` (t,) on, so many `rows` (t,) of each."""
        triangle = np.repeat(np.arange(len(corners)), rows)
        y = low[triangle] + _ramp(rows)
        origin, b, c = corners[triangle, 0], corners[triangle, 1], corners[triangle, 2]
        b, c, down = b - origin, c - origin, y - origin[:, 1]
        double = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
        # the weights of the corners are linear in x: values below the first corner, and slopes
        values = np.stack([-down * c[:, 0] / double, down * b[:, 0] / double])
        slopes = np.stack([c[:, 1] / double, -b[:, 1] / double])
        depth, change = (sum(weight * z for weight, z in zip(weights, (b[:, 2], c[:, 2]), strict=True))
                         for weights in (values, slopes))  # fmt: skip
        left, right = np.zeros(len(y)), np.full(len(y), self.width - 1.0)
        for value, slope in zip([*values, 1 - values.sum(axis=0)], [*slopes, -slopes.sum(axis=0)], strict=True):
            with np.errstate(divide="ignore", invalid="ignore"):
                zero = origin[:, 0] - value / slope
            left = np.where(slope > 0, np.fmax(left, zero), left)
            right = np.where(slope < 0, np.fmin(right, zero), right)
            right = np.where((slope == 0) & (value < 0), -1.0, right)
        left, right = np.ceil(left - 1e-9).astype(int), np.floor(right + 1e-9).astype(int)
        count = (right - left + 1).clip(0)
        row, along = np.repeat(np.arange(len(y)), count), _ramp(count)
        first = depth + origin[:, 2] + change * (left - origin[:, 0])
        depth = first[row] + change[row] * along
        pixel = y[row] * self.width + left[row] + along
        nearer = np.flatnonzero(depth < self.depth.ravel()[pixel])
        far_first = nearer[np.argsort(-depth[nearer], kind="stable")]  # of several for a pixel the last one stays
        self.depth.ravel()[pixel[far_first]] = depth[far_first]
        self.triangle.ravel()[pixel[far_first]] = numbers[triangle[row[far_first]]]

    def weights(self, points, triangles):
        """Return pixels (2, k) that show a triangle, its number (k,), and weights (3, k) of its corners there."""
        y, x = place = np.nonzero(self.triangle != NOTHING)
        number = self.triangle[place]
        return place, number, _weights(points[triangles[number]], x[:, None], y[:, None])[..., 0].clip(0, 1)

    def strokes(self, points, pairs, width: int, towards: float) -> np.ndarray:
        """Return pixels (h, w) that lines show, `width` pixels wide, and not hidden; `towards`: by how much lines are
        put in front of the surfaces that they lie in."""
        shown = np.zeros((self.height, self.width), dtype=bool)
        ends = points[pairs]
        count = np.ceil(np.abs(ends[:, 1, :2] - ends[:, 0, :2]).max(axis=1, initial=0)).astype(int) + 1
        step = max(1, AT_ONCE // max(int(count.max(initial=1)), 1))
        order = np.argsort(count)  # lines of about the same length together
        for first in range(0, len(order), step):
            chunk = order[first : first + step]
            along = np.linspace(0, 1, int(count[chunk].max()))
            place = ends[chunk, 0, None] + along[None, :, None] * (ends[chunk, 1] - ends[chunk, 0])[:, None]
            self._stamp(shown, place.reshape(-1, 3), width, towards)
        return shown

    def discs(self, points, width: int, towards: float = 0.0) -> np.ndarray:
        """Return the pixels of single points, like strokes."""
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


def _ramp(counts):
    """Return 0, 1, ... counts - 1 for each count, end to end."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts)


def _weights(corners, x, y):
    """Barycentric coordinates (3, t, k) of pixels x, y (t, k) in triangles (t, 3, 3)."""
    ax, ay = corners[:, 0, 0, None], corners[:, 0, 1, None]
    bx, by = corners[:, 1, 0, None] - ax, corners[:, 1, 1, None] - ay
    cx, cy = corners[:, 2, 0, None] - ax, corners[:, 2, 1, None] - ay
    double = bx * cy - by * cx
    second = ((x - ax) * cy - (y - ay) * cx) / double
    third = (bx * (y - ay) - by * (x - ax)) / double
    return np.stack([1 - second - third, second, third])
