"""Find the cylinders among the faces of a surface: holes and pins, whole or in part, however they lie.

From a face on, neighbours that may belong to a cylinder with it give a first guess of the axis; a cylinder is fitted to
their corners by least squares, and grows over the faces that lie on it, within a tolerance that becomes smaller, until
nothing changes. Cones, spheres, tori and free forms fill the tolerance wherever they begin, and are left by that. Faces
are arrays on one rank.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..fe.cylinders import DIGITS, NEAR, Cylinder, normals_of, on_cylinder, slack_of
from ..fe.faces import Faces

SMOOTH = np.cos(np.radians(55.0))  # of the angle between neighbouring faces of one cylinder, at most
FLAT = np.cos(np.radians(0.3))  # and at least
GUESSES = (np.cos(np.radians(55.0)), np.cos(np.radians(25.0)))  # of the angle between a face and those of its patch
COARSE = np.cos(np.radians(15.0))  # of the angle to a neighbour that is enough for a guess
ACROSS = 0.4  # cosine between the normals of a patch and a guess of its axis, at most
PATCH = 400  # faces of a patch
TOLERANCES = (0.04, 0.015, 0.006, NEAR)  # of the radius, one after the other
SIDES = np.cos(np.radians(10.0))  # around a face where nothing was found no other is tried
ROUGH = 0.01  # of the radius: mean distance of the corners of a patch, to begin with, at most
FILLED = 0.4  # of the tolerance: root mean square of the distances in a region that ends for no other reason
EXACT = 3e-4  # of the radius: root mean square of the distances of the corners from their cylinder
LEAST = 8  # corners, by which five numbers are more than known: those of three quadrilaterals side by side
STRAIGHT = 1e-3  # of the length of an edge: distance of its middle from the chord
SHARP = np.cos(np.radians(30.0))  # of the angle at the rim of a row of faces that is no belt of a sphere, at least
PARTS = {  # of curved faces of three and four corners, which are places 0 to 3, the middles 4 to 7
    3: [(0, 4, 6), (4, 1, 5), (6, 5, 2), (4, 5, 6)],
    4: [(0, 4, 7), (1, 5, 4), (2, 6, 5), (3, 7, 6), (4, 5, 6), (4, 6, 7)],
}
ROUND = 359.0  # degrees that count as a whole turn


@dataclass(frozen=True, eq=False)
class Found:
    """A cylinder between `start` and `end` (3,) of its axis; `inwards`: around a hole, None on shells; `turn` in
    degrees; `faces` (k,): which of the surface."""

    start: np.ndarray
    end: np.ndarray
    radius: float
    inwards: bool | None
    turn: float
    faces: np.ndarray


def find_cylinders(faces: Faces, points: np.ndarray, least_turn: float) -> list[Found]:
    """Return the cylinders of at least so many degrees on a surface; `faces`: indices of points (v, 3) in m."""
    search = _Search(faces, points)
    return [cylinder for cylinder in search.all() if cylinder.turn >= least_turn]


class _Search:
    """The pieces of a surface, which of them belong to no cylinder yet, and which are next to which."""

    def __init__(self, faces, points):
        self.faces, self.points = faces, points
        self.largest = float(np.abs(points).max(initial=0.0))
        self.size = float(np.ptp(points, axis=0).max(initial=0.0)) if len(points) else 0.0
        self.pieces, self.whole = _pieces(faces, points)
        self.normals = normals_of(self.pieces, points)
        self.face_normals = normals_of(faces, points)
        self.shell = self.pieces.behind < 0
        self.first, self.beside, self.cosine = _neighbours(self.pieces.corners, self.normals, self.shell)
        self.free = (np.abs(self.normals) > 0).any(axis=1)
        self.waiting = np.zeros(len(self.free), bool)  # pieces to begin from

    def all(self):
        """Yield cylinders, one after the other."""
        owner = np.repeat(np.arange(len(self.free)), np.diff(self.first))
        bent = (self.cosine >= SMOOTH) & (self.cosine <= FLAT)
        self.waiting[owner[bent]] = True
        for seed in np.flatnonzero(self.waiting):
            if not (self.waiting[seed] and self.free[seed]):
                continue
            cylinder = self._from(seed)
            if cylinder is None:
                alike = self._flood(seed, lambda new, seed=seed: self._cosine(new, seed) >= SIDES, PATCH)
                self.waiting[alike] = False
                self.waiting[seed] = False
                continue
            yield cylinder

    def _from(self, seed):
        """Return the cylinder that a piece belongs to, or None; its pieces are no longer free."""
        for guess in self._guesses(seed):
            if (grown := self._grown(seed, guess)) is not None:
                return self._whole(*grown)
        return None

    def _cosine(self, pieces, seed):
        """Return the cosines between the normals of pieces (k,) and that of one, without sign for shells."""
        cosine = self.normals[pieces] @ self.normals[seed]
        return np.where(self.shell[pieces] | self.shell[seed], np.abs(cosine), cosine)

    def _flood(self, seed, fits, most=np.inf):
        """Return the free pieces (k,) that are reached from one over smooth edges, all of which `fits(pieces)`; at most
        about `most`. Empty where the first does not fit."""
        seen = ~self.free
        front, fronts = np.array([seed]), [np.zeros(0, int)]
        while len(front) and sum(map(len, fronts)) < most:
            seen[front] = True
            front = front[fits(front)]
            fronts.append(front)
            edges = self._edges(front)
            front = np.unique(self.beside[edges[self.cosine[edges] >= SMOOTH]])
            front = front[~seen[front]]
        return np.concatenate(fronts)

    def _edges(self, pieces):
        """Return the places in `beside` of the neighbours of pieces (k,)."""
        count = self.first[pieces + 1] - self.first[pieces]
        start = np.repeat(self.first[pieces] - np.cumsum(count) + count, count)
        return start + np.arange(len(start))

    def _guesses(self, seed):
        """Yield cylinders through pieces around one, as far as they fit these."""
        axes = []
        for cosine in GUESSES:
            patch = self._flood(seed, lambda new, cosine=cosine: self._cosine(new, seed) >= cosine, PATCH)
            axes.append((_least_direction(self.normals[patch]), cosine))
        mine = slice(self.first[seed], self.first[seed + 1])
        for other, cosine in zip(self.beside[mine], self.cosine[mine], strict=True):
            if SMOOTH <= cosine <= COARSE:
                axis = np.cross(self.normals[seed], self.normals[other])
                axes.append((axis / np.linalg.norm(axis), GUESSES[0]))
        for axis, cosine in axes:
            patch = self._flood(seed, lambda new, axis=axis, cosine=cosine: (self._cosine(new, seed) >= cosine)
                                & (np.abs(self.normals[new] @ axis) <= ACROSS), PATCH)  # fmt: skip
            if len(patch) > 1:
                corners = self._corners(patch)
                cylinder = fitted(corners, around(corners, _least_direction(self.normals[patch])), 1e-4)
                if cylinder and np.abs(_distances(corners, cylinder)).mean() <= ROUGH * cylinder.radius:
                    yield cylinder

    def _grown(self, seed, cylinder):
        """Return the cylinder that grows from a piece, with one to begin with, its pieces, and whether it is a hole;
        None where it does not end, or does not fit."""
        for share in TOLERANCES:
            before = None
            for _ in range(4):
                if cylinder.radius > self.size:
                    return None
                tolerance = max(share * cylinder.radius, DIGITS * self.largest)
                inwards = (cylinder.outwards(self.points[self.pieces.corners[seed, :1]]) @ self.normals[seed])[0] < 0
                region = self._region(seed, cylinder, tolerance, inwards)
                if len(region) < 2:
                    return None
                cylinder = fitted(self._corners(region), cylinder, 1e-6)
                if cylinder is None:
                    return None
                if before is not None and np.array_equal(before, np.sort(region)):
                    break
                before = np.sort(region)
            distance = np.abs(_distances(self._corners(region), cylinder))
            if np.sqrt(np.mean(distance**2)) > FILLED * tolerance:
                return None
        # what touches the cylinder, such as the beginning of a fillet, lies farther away than most
        bound = max(4 * float(np.median(distance)), DIGITS / 2 * self.largest, 1e-6 * cylinder.radius)
        if bound < tolerance:
            core = self._corners(region)[distance <= bound]
            cylinder = fitted(core, cylinder)
            if cylinder is None:
                return None
            distance = np.abs(_distances(core, cylinder))
        exact = np.sqrt(np.mean(distance**2)) <= max(EXACT * cylinder.radius, DIGITS / 2 * self.largest)
        if not exact or len(distance) < LEAST:
            self.waiting[region] = False  # whence the same would grow
            return None
        bound = max(bound, EXACT * cylinder.radius, DIGITS * self.largest)
        region = self._region(seed, cylinder, bound, inwards)
        return (cylinder, region, inwards) if len(region) >= 2 else None

    def _corners(self, pieces):
        corners = self.pieces.corners[pieces]
        return self.points[np.unique(corners[corners >= 0])]

    def _region(self, seed, cylinder, tolerance, inwards):
        """Return the pieces (k,) on a cylinder that hang together with one."""
        on = on_cylinder(self.pieces, self.points, self.normals, cylinder, tolerance, bool(inwards))
        return self._flood(seed, lambda new: on[new])

    def _whole(self, cylinder, region, inwards):
        """Return the cylinder with all faces of the surface that lie on it between its ends, or None for a belt of a
        sphere; their pieces are no longer free."""
        self.free[region] = False
        if self._is_belt(region, cylinder):
            return None
        # towards positive x, or y, or z: the largest of its parts would be chosen by round-off, where two are alike
        axis = cylinder.axis * np.sign(cylinder.axis[np.abs(cylinder.axis) > 1e-3][0])
        cylinder = replace(cylinder, axis=axis)
        tolerance = slack_of(cylinder.radius, self.largest)
        on = np.flatnonzero(on_cylinder(self.faces, self.points, self.face_normals, cylinder, tolerance, bool(inwards)))
        low, high = self._extents(on, cylinder)
        along = cylinder.along(self._corners(region))
        start, end = along.min(), along.max()
        # parts beside each other, as of a bore with a keyway, are one
        for faces in _parts(self.faces.corners[on]):
            a, b = low[faces].min(), high[faces].max()
            if min(b, end) - max(a, start) > 0.5 * min(b - a, end - start):
                start, end = min(a, start), max(b, end)
        on = on[(low >= start - tolerance) & (high <= end + tolerance)]
        if not len(on):
            return None
        self.free[np.isin(self.whole, on)] = False
        middle = cylinder.point + np.array([[start], [end]]) * axis
        shells = (self.faces.behind[on] < 0).mean() > 0.5
        return Found(middle[0], middle[1], cylinder.radius, None if shells else bool(inwards),
                     self._turn(on, cylinder), on)  # fmt: skip

    def _extents(self, faces, cylinder):
        """Return the lowest and the highest coordinates along the axis of faces (k,)."""
        corners = self.faces.corners[faces]
        along = cylinder.along(self.points[np.where(corners < 0, corners[:, :1], corners)])
        return along.min(axis=1, initial=np.inf), along.max(axis=1, initial=-np.inf)

    def _is_belt(self, region, cylinder):
        """Test whether pieces are a single row between others that go on smoothly, as around a sphere."""
        along = cylinder.along(self._corners(region))
        low, high = along.min(), along.max()
        if (np.minimum(along - low, high - along) > 0.05 * (high - low)).any():
            return False
        edges = self._edges(region)
        outside = edges[~np.isin(self.beside[edges], region)]
        return bool(len(outside)) and (self.cosine[outside] >= SHARP).mean() > 0.5

    def _turn(self, faces, cylinder):
        """Return the degrees around the axis that faces (k,) cover."""
        corners = self.faces.corners[faces]
        arm = cylinder.outwards(self.points[np.where(corners < 0, corners[:, :1], corners)])
        first, second = _across(cylinder.axis)
        angle = np.arctan2(arm @ second, arm @ first)
        near = angle[:, :1] + (angle - angle[:, :1] + np.pi) % (2 * np.pi) - np.pi
        low, width = near.min(axis=1) % (2 * np.pi), np.ptp(near, axis=1)
        order = np.argsort(low)
        low, high = low[order], (low + width)[order]
        reach = np.maximum.accumulate(high)
        gaps = np.append(low[1:], low[0] + 2 * np.pi) - np.maximum(reach, high.max() - 2 * np.pi)
        turn = 360.0 - float(np.degrees(gaps.clip(0).sum()))
        return 360.0 if turn >= ROUND else turn


def _pieces(faces, points):
    """Return faces without middles, and which face (k,) each belongs to: curved ones are parted into triangles at their
    middles; middles on the chords say nothing."""
    ends = _ends(faces.corners)
    there = (faces.middles >= 0) & (ends >= 0)
    a, b, m = (points[np.where(there, nodes, 0)] for nodes in (faces.corners, ends, faces.middles))
    off = np.linalg.norm(m - (a + b) / 2, axis=2) > STRAIGHT * np.linalg.norm(b - a, axis=2)
    curved, three = (there & off).any(axis=1), faces.corners[:, 3] < 0
    both, number = np.hstack([faces.corners, faces.middles, np.full((len(three), 1), -1)]), np.arange(len(three))
    corners, whole = [faces.corners[~curved]], [number[~curved]]
    for chosen, pattern in ((curved & three, PARTS[3]), (curved & ~three, PARTS[4])):
        for places in pattern:
            corners.append(both[chosen][:, [*places, 8]])
            whole.append(number[chosen])
    corners, whole = np.concatenate(corners), np.concatenate(whole)
    return Faces(corners, np.full_like(corners, -1), faces.behind[whole]), whole


def _ends(corners):
    """Return the ends (f, 4) of the edges that begin at corners (f, 4), -1 where there is none."""
    ends = np.roll(corners, -1, axis=1)
    three = corners[:, 3] < 0
    ends[three, 2:] = np.stack([corners[three, 0], corners[three, 3]], axis=1)
    return ends


def _neighbours(corners, normals, shell):
    """Return neighbours over the edges of faces: where those of each begin (f + 1,), their numbers (e,), and the
    cosines (e,) of the angles between the normals."""
    ends = _ends(corners)
    there = (corners >= 0) & (ends >= 0) & (corners != ends)
    face = np.broadcast_to(np.arange(len(corners))[:, None], corners.shape)[there]
    pairs = np.sort(np.stack([corners[there], ends[there]], axis=1), axis=1)
    order = np.lexsort(pairs.T)
    same = (pairs[order[1:]] == pairs[order[:-1]]).all(axis=1)
    first, second = face[order[:-1]][same], face[order[1:]][same]
    first, second = np.concatenate([first, second]), np.concatenate([second, first])
    order = np.lexsort((second, first))
    first, second = first[order], second[order]
    cosine = (normals[first] * normals[second]).sum(axis=1)
    cosine = np.where(shell[first] | shell[second], np.abs(cosine), cosine)
    return np.searchsorted(first, np.arange(len(corners) + 1)), second, cosine


def _parts(corners):
    """Return lists of the numbers of faces (k, 4) that hang together by their corners."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    face, place = np.nonzero(corners >= 0)
    _, node = np.unique(corners[face, place], return_inverse=True)
    total = len(corners) + node.max(initial=-1) + 1
    links = coo_array((np.ones(len(face)), (face, len(corners) + node.reshape(-1))), shape=(total, total))
    _, label = connected_components(links, directed=False)
    label = label[: len(corners)]
    return [np.flatnonzero(label == number) for number in np.unique(label)]


def _least_direction(normals):
    """Return the unit vector to which unit vectors (k, 3) are most nearly at right angles."""
    return np.linalg.eigh(normals.T @ normals)[1][:, 0]


def _across(axis):
    """Return two unit vectors (2, 3) at right angles to a unit vector, and to each other."""
    helper = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first = helper / np.linalg.norm(helper)
    return np.stack([first, np.cross(axis, first)])


def around(points, axis) -> Cylinder:
    """Return the cylinder with a given axis that is nearest to points (k, 3), by its circle in the plane across."""
    centre = points.mean(axis=0)
    plane = _across(axis)
    x = (points - centre) @ plane.T
    size = max(np.abs(x).max(initial=0.0), 1e-300)
    x = x / size
    # |x|^2 = 2 c x + (r^2 - |c|^2), linear in c and the bracket
    solution = np.linalg.lstsq(np.column_stack([2 * x, np.ones(len(x))]), (x**2).sum(axis=1), rcond=None)[0]
    square = max(solution[2] + solution[:2] @ solution[:2], 0.0)
    return Cylinder(centre + size * solution[:2] @ plane, axis, size * float(np.sqrt(square)))


def fitted(points, cylinder: Cylinder, to: float = 1e-12) -> Cylinder | None:
    """Return the cylinder nearest to points (k, 3) by Gauss and Newton from another on, or None where it runs away;
    `to`: the relative size of the last step."""
    point, axis, radius = points.mean(axis=0), cylinder.axis, cylinder.radius
    point = point - cylinder.outwards(point[None])[0]
    for _ in range(10):
        plane = _across(axis)
        arm = points - point
        along, x = arm @ axis, arm @ plane.T
        distance = np.linalg.norm(x, axis=1)
        unit = x / np.maximum(distance, 1e-300)[:, None]
        length = max(np.abs(along).max(initial=0.0), 1e-300)
        slopes = np.column_stack([unit, unit * (along / length)[:, None], np.ones(len(points))])
        step = np.linalg.lstsq(slopes, distance - radius, rcond=1e-9)[0]
        point = point + step[:2] @ plane
        axis = axis + (step[2:4] / length) @ plane
        axis = axis / np.linalg.norm(axis)
        radius = radius + float(step[4])
        if not np.isfinite(radius) or radius <= 0:
            return None
        if np.abs(step).max() <= to * radius:
            break
    return Cylinder(point, axis, radius)


def _distances(points, cylinder):
    """Return the distances of points (k, 3) from the cylinder, positive outside."""
    return np.linalg.norm(cylinder.outwards(points), axis=1) - cylinder.radius
