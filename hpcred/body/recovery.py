"""Recover the motion of nodes from the reduced coordinates, a block of instants at a time: u = V q.

In the body frame, or in inertial axes, where a node is at x = r + A (c + V q): c from the origin of the body frame, r
and A place and rotation of the frame. Each rank does it for its nodes; nothing here is collective.
"""

from __future__ import annotations

import numpy as np

from ..parallel.failures import InputError
from .coordinates import Coordinates
from .rotations import rotation
from .stress import von_mises

QUANTITIES = ("displacement", "velocity", "acceleration")  # u, its first and its second derivative


def require_frame(path, coordinates: Coordinates):
    """Raise InputError where the motion of the body frame is not known."""
    if coordinates.frame is None:
        raise InputError(
            f"{path}: it does not have the motion of the body frame, which places in inertial axes need; give the "
            "simulation.h5 of hpcred simulate, or leave out --inertial"
        )


class Recovery:
    """Products of coordinates and shapes, whose results are overwritten by those of the next block of instants: fresh
    memory would take longer than the product."""

    def __init__(self, coordinates: Coordinates, step: int):
        arrays = coordinates.q, coordinates.velocity, coordinates.acceleration
        self._given = dict(zip(QUANTITIES, arrays, strict=True))
        self._step, self._room = step, {}

    def motion(self, shapes, instants: slice, quantities) -> dict[str, np.ndarray]:
        """Return quantities (b, k, 3) of the nodes of shapes (m, 3 k) in the body frame, at the instants of a part."""
        motion = {key: self._product(key, self._given[key][instants], shapes) for key in quantities}
        return {key: values.reshape(len(values), -1, 3) for key, values in motion.items()}

    def stresses(self, modes, instants: slice) -> dict[str, np.ndarray]:
        """Return the stresses (b, s, 6) of modes (m, 6 s), and von Mises' (b, s), at the instants of a part."""
        stresses = self._product("stress", self._given["displacement"][instants], modes)
        stresses = stresses.reshape(len(stresses), -1, 6)
        return {"stress": stresses, "von_mises": von_mises(stresses)}

    def _product(self, key, values, shapes):
        room = self._room.setdefault(key, np.empty((self._step, shapes.shape[1])))
        return np.matmul(values, shapes, out=room[: len(values)])


def start_places(local, coordinates: Coordinates) -> np.ndarray:
    """Return where the nodes of the undeformed body are at the first instant, in inertial axes; `local` (k, 3)."""
    return coordinates.frame.position[0] + local @ rotation(coordinates.frame.quaternion[0]).T


def inertial_motion(motion: dict, local, start, coordinates: Coordinates, instants: slice) -> dict[str, np.ndarray]:
    """Return what Recovery.motion found in inertial axes, with the places and the elastic part of the displacements.

    `local` (k, 3): undeformed places from the origin of the body frame, in its axes; `start` (k, 3): start_places of
    the first instant of the whole motion.
    """
    frame = coordinates.frame
    axes = rotation(frame.quaternion[instants])
    turn = axes.transpose(0, 2, 1)
    u = motion["displacement"]
    place = (local + u) @ turn + frame.position[instants, None]
    result = {"displacement": place - start, "place": place, "elastic": u @ turn}
    if "velocity" in motion:
        spin = _spin(frame.angular_velocity[instants])
        rates = frame.velocity[instants, None] + (local + u) @ spin + motion["velocity"]
        result["velocity"] = rates @ turn
    if "acceleration" in motion:
        # v' + w x v of the frame, and what turning adds to a node that moves in it
        v, w, dw = frame.velocity[instants], frame.angular_velocity[instants], frame.angular_acceleration[instants]
        spin = _spin(w)
        rates = (frame.acceleration[instants] + np.cross(w, v))[:, None] + (local + u) @ (_spin(dw) + spin @ spin)
        result["acceleration"] = (rates + 2 * motion["velocity"] @ spin + motion["acceleration"]) @ turn
    return {key: result[key] for key in ("place", "elastic", *motion)}


def _spin(w) -> np.ndarray:
    """Return matrices (b, 3, 3) with x @ matrix = w x x for rows x."""
    matrices = np.zeros((len(w), 3, 3))
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = w[:, 2], -w[:, 1], w[:, 0]
    return matrices - matrices.transpose(0, 2, 1)
