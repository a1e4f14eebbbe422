"""Find where in a motion the stress of a reduced body is largest."""

from __future__ import annotations

import numpy as np

from ..body.recovery import von_mises
from ..files.result_file import Result
from ..parallel.failures import agreed
from .recover import coordinates_of

AT_ONCE = 2**24  # numbers of stresses that are held at a time


def state_of_largest_stress(result: Result, motion, comm) -> tuple[np.ndarray, str] | None:
    """The coordinates (m,) of the instant with the largest von Mises stress of a motion, and a title with its numbers;
    None on other ranks than the first. Collective. Raises InputError for another body, and without stress modes.
    """
    coordinates = coordinates_of(result, motion, comm)
    with agreed(comm):
        if comm.rank:
            return None
        modes = result.stress_modes()
        flat, largest, where = modes.stress.reshape(len(modes.stress), -1), -1.0, (0, 0)
        step = max(1, AT_ONCE // flat.shape[1])
        for first in range(0, len(coordinates.t), step):
            found = von_mises((coordinates.q[first : first + step] @ flat).reshape(-1, len(modes.node), 6))
            if found.max() > largest:
                largest = float(found.max())
                instant, place = np.unravel_index(found.argmax(), found.shape)
                where = first + int(instant), int(place)
        instant, place = where
        return coordinates.q[instant], (
            f"t = {coordinates.t[instant]:.4g} s: von Mises stress up to {largest / 1e6:.4g} MPa, at node "
            f"{modes.node[place]}"
        )
