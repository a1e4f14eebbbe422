"""Find the stresses at integration points that a finite-element program printed, by element."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..parallel.failures import InputError
from ..parallel.lookup import look_up, require_once
from ..parallel.sums import joined
from .shape_functions import POINTS, integration_points

MOST_POINTS = 64  # more than any element has


class PointStresses:
    """Stresses (r, 6) at integration points, with numbers of elements (r,) and of points (r,) from 1, of this rank.

    Collective. Raises InputError for a point that occurs twice. `name`: of the file; `mesh`: of what has the elements.
    """

    def __init__(self, comm, element: np.ndarray, point: np.ndarray, stress: np.ndarray, name, mesh):
        self.comm, self.name, self.mesh, self.used = comm, name, mesh, 0
        self.key, self.stress = element.astype(np.int64) * MOST_POINTS + point, stress
        require_once(comm, self.key, lambda again: (
            f"{name}: found element {again // MOST_POINTS}, point {again % MOST_POINTS} twice, expected the stresses "
            "of one time, of each element once"))  # fmt: skip

    def of_elements(self, kind: str, number: np.ndarray, placed=True) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Yield each scheme of integration, which elements (e,) have its points, and their stresses (some, points, 6).

        `number` (e,): of the elements of a kind of this rank; `placed`: those that count. Collective. Raises InputError
        for elements without stresses at all points of a scheme.
        """
        left = np.ones(len(number), bool)
        for scheme in POINTS:
            if kind not in POINTS[scheme]:
                continue
            points = len(integration_points(kind, scheme)[1])
            wanted = number[:, None] * MOST_POINTS + np.arange(1, points + 2)  # and none more
            there, components = look_up(self.comm, self.key, list(self.stress.T), wanted.ravel())
            there = there.reshape(wanted.shape)
            mine = left & there[:, :-1].all(axis=1) & ~there[:, -1] & placed
            left &= ~mine
            self.used += int(mine.sum()) * points
            yield scheme, mine, np.stack(components, axis=-1).reshape(*wanted.shape, 6)[mine, :-1]
        if lost := joined(self.comm, number[left][:1].tolist()):
            raise InputError(
                f"{self.name}: found no stresses of element {lost[0]} ({kind}) of {self.mesh} at all its integration "
                "points, expected those of every solid; print S of all elements, or take the file of this mesh"
            )

    def require_all(self):
        """Raise InputError for stresses of other elements than those that were asked for. Collective."""
        printed, used = self.comm.allreduce(len(self.key)), self.comm.allreduce(self.used)
        if printed != used:
            raise InputError(
                f"{self.name}: found stresses at {printed} integration points, expected {used} as the solids of "
                f"{self.mesh} have; the file is that of another mesh"
            )
