"""Make row labels from grid and scalar points of Nastran, and rotate matrices from their displacement systems.

Each point has a position in the basic system, optionally a displacement system of its own (CD), in whose directions its
dofs are counted, and marks on dofs that have no row: dependent (m), held (s), omitted (o), and free supports (r).
"""

from dataclasses import dataclass, field

import numpy as np

from ...fe.dofs import OWN, SCALAR
from ...parallel.lookup import look_up, number_over_ranks
from ..entries import label_of
from ..nodal_systems import Turn

RECTANGULAR, CYLINDRICAL, SPHERICAL = 1, 2, 3
DEPENDENT, HELD, OMITTED, SUPPORTED = 1, 2, 4, 8
# marks of dofs that have no row in a matrix of a set: the letter of KAA, KLL, ...
SETS = {
    "A": DEPENDENT | HELD | OMITTED, "L": DEPENDENT | HELD | OMITTED | SUPPORTED, "F": DEPENDENT | HELD,
    "N": DEPENDENT, "G": 0,
}  # fmt: skip
ALIGNED = 1e-12
TINY = 1e-14


@dataclass(frozen=True)
class System:
    """A coordinate system: its `kind`, `origin` (3,) in the basic one, and its axes as the columns of `axes` (3, 3)."""

    kind: int = RECTANGULAR
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))

    @classmethod
    def from_points(cls, kind, origin, on_axis, in_plane):
        """Make a system from the origin, a point on the z axis, and one in the plane of x and z; None if collinear."""
        z = on_axis - origin
        y = np.cross(z, in_plane - origin)
        if not np.linalg.norm(y) > ALIGNED * np.linalg.norm(z) * np.linalg.norm(in_plane - origin):
            return None
        z, y = z / np.linalg.norm(z), y / np.linalg.norm(y)
        return cls(kind, origin, np.stack([np.cross(y, z), y, z], axis=1))

    def to_basic(self, coordinates: np.ndarray) -> np.ndarray:
        """Return positions (points, 3) in the basic system of coordinates in this one; angles in degrees."""
        first, second, third = coordinates.T
        if self.kind == CYLINDRICAL:
            angle = np.deg2rad(second)
            local = [first * np.cos(angle), first * np.sin(angle), third]
        elif self.kind == SPHERICAL:
            polar, angle = np.deg2rad(second), np.deg2rad(third)
            out = first * np.sin(polar)
            local = [out * np.cos(angle), out * np.sin(angle), first * np.cos(polar)]
        else:
            local = [first, second, third]
        return self.origin + np.stack(local, axis=1) @ self.axes.T

    def directions(self, positions: np.ndarray) -> np.ndarray:
        """Return the directions 1, 2, 3 of displacements (points, 3, 3) at basic positions, as columns."""
        axes = np.broadcast_to(self.axes, (len(positions), 3, 3))
        if self.kind == RECTANGULAR:
            return axes.copy()
        x, y, z = ((positions - self.origin) @ self.axes).T
        radius = np.hypot(x, y)
        angle = np.arctan2(np.where(radius > TINY * np.abs(positions).max(initial=1.0), y, 0.0), x)
        cos, sin, zero, one = np.cos(angle), np.sin(angle), np.zeros(len(x)), np.ones(len(x))
        if self.kind == CYLINDRICAL:
            local = [[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]]
        else:
            polar = np.arctan2(radius, z)
            down, out = np.cos(polar), np.sin(polar)
            local = [[out * cos, down * cos, -sin], [out * sin, down * sin, cos], [down, -out, zero]]
        return axes @ np.moveaxis(np.array(local), 2, 0)


@dataclass
class Points:
    """Points of this rank, in the order of their rows over the ranks.

    `label` (points,), `position` (points, 3), `scalar` (points,) whether one dof or six, `marks` (points, 6) of the
    dofs (only the first of a scalar point). `turned` (t,): points with directions of their own, and `axes` (t, 3, 3)
    these directions as columns. `rough`: places and directions have 7 digits only.
    """

    label: np.ndarray
    position: np.ndarray
    scalar: np.ndarray
    marks: np.ndarray
    turned: np.ndarray
    axes: np.ndarray
    rough: bool = False

    @classmethod
    def in_systems(cls, label, position, scalar, marks, system, systems: dict[int, System], rough=False):
        """Return points whose displacements are in the `systems` of the numbers `system` (points,), 0 for the basic."""
        turned = np.flatnonzero((system != 0) & ~scalar)
        axes = np.zeros((len(turned), 3, 3))
        for number in np.unique(system[turned]):
            mine = system[turned] == number
            axes[mine] = systems[number].directions(position[turned[mine]])
        axes[np.abs(axes) < TINY] = 0.0
        same = (axes == np.eye(3)).all(axis=(1, 2))
        return cls(label, position, scalar, marks, turned[~same], axes[~same], rough)

    def there(self) -> np.ndarray:
        """Return which dofs (points, 6) there are before any is removed."""
        return ~self.scalar[:, None] | (np.arange(6) == 0)

    def of_set(self, letter: str) -> np.ndarray:
        """Return which dofs (points, 6) have a row in a matrix of a set."""
        return self.there() & (self.marks & SETS[letter] == 0)

    def count(self, comm, mask) -> int:
        """Return how many dofs a mask has. Collective."""
        return comm.allreduce(int(np.count_nonzero(mask)))

    def local_labels(self) -> np.ndarray:
        """Return labels (points, 6) of the dofs, in the directions of the points."""
        return label_of(self.label[:, None], np.where(self.scalar[:, None], SCALAR, np.arange(6)))


def refined(comm, points: Points, finer: Points) -> Points:
    """Return the points with places and directions of other ones, if these have them all. Collective."""
    there, place = look_up(comm, finer.label, list(finer.position.T), points.label)
    if not all(comm.allgather(bool((there | points.scalar).all()))):
        return points
    place = np.where(points.scalar[:, None], points.position, np.stack(place, axis=1))
    there, axes = look_up(comm, finer.label[finer.turned], list(finer.axes.reshape(-1, 9).T), points.label)
    turned = np.flatnonzero(there & ~points.scalar)
    axes = np.stack(axes, axis=1)[turned].reshape(-1, 3, 3)
    return Points(points.label, place, points.scalar, points.marks, turned, axes)


@dataclass
class PointTurn(Turn):
    """And `label` (points, 6) of all dofs after it; `own`: number of dofs that stay in directions of their own."""

    label: np.ndarray
    own: int


def turn_of(points: Points, mask: np.ndarray, names: np.ndarray, by_label: bool) -> PointTurn:
    """Return how the dofs of a mask (points, 6), which have rows or labels `names` (points, 6), become dofs in x, y, z.

    Three directions of a point turn together. Where some have no row, dofs along x, y or z only change their name; the
    others stay in their own directions and are labelled so. `by_label`: whether `names` are labels, which change.
    """
    label = points.local_labels()
    keys, targets, factors, own = [], [], [], 0
    for low in (0, 3):
        have = mask[points.turned, low : low + 3]
        whole = have.all(axis=1)
        at = points.turned[whole]
        triple = names[at, low : low + 3]
        for k in range(3):
            keys.append(triple[:, k])
            targets.append(triple)
            factors.append(points.axes[whole, :, k])
        # the direction of x, y, z that each own direction is, if it is one
        axis = np.abs(points.axes).argmax(axis=1)
        sign = np.take_along_axis(points.axes, axis[:, None, :], axis=1)[:, 0]
        straight = (~have | (np.abs(sign) > 1 - ALIGNED)).all(axis=1)
        for k in range(3):
            for which, direction, scale in (
                (straight, low + axis[:, k], np.round(sign[:, k])),
                (~straight, np.full(len(axis), OWN + low + k), np.ones(len(axis))),
            ):
                which = which & ~whole & have[:, k]
                at = points.turned[which]
                keys.append(names[at, low + k])
                label[at, low + k] = label_of(points.label[at], direction[which])
                new = label[at, low + k] if by_label else names[at, low + k]
                targets.append(np.stack([new, *np.full((2, len(new)), -1)], axis=1))
                factors.append(np.stack([scale[which], *np.zeros((2, len(new)))], axis=1))
            own += int(np.count_nonzero(~straight & ~whole & have[:, k]))
    return PointTurn(np.concatenate(keys), np.concatenate(targets), np.concatenate(factors), label, own)


def present(comm, points: Points, labels: np.ndarray) -> np.ndarray:
    """Return which dofs (points, 6) occur among labels, some on each rank. Collective."""
    distinct, _ = number_over_ranks(comm, labels)
    mine = points.local_labels()
    there, _ = look_up(comm, distinct, [distinct], mine.ravel())
    return there.reshape(mine.shape) & points.there()
