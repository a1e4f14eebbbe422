"""Tell the direction of whirl: the way in which nodes go round an axis in a mode."""

from __future__ import annotations

import numpy as np

ACROSS = 1e-6  # of the squared motion: less across the axis is none
ROUND = 0.1  # of a circle: narrower orbits are straight lines


def orbits(displacements, axis) -> np.ndarray:
    """Return how round the orbits of nodes about an axis are, in each mode (u,): 1 for circles in the sense of a right
    hand, -1 for circles in the other, 0 for straight lines and where the nodes do not move across the axis.

    `displacements`: complex (k, 3, u) of k nodes in modes exp(i omega t) with omega > 0; `axis` (3,), a unit vector.
    For displacements u and v along two axes across, such that the third one is the axis, node by node the orbit
    encloses the area pi Im(u conj(v)), positive where v lags u by up to half a turn: the sum over the nodes counts,
    beside that of circles with the same (|u|^2 + |v|^2) / 2.
    """
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    u, v = (np.tensordot(vector, displacements, (0, 1)) for vector in (first, np.cross(axis, first)))
    across = (np.abs(u) ** 2 + np.abs(v) ** 2).sum(axis=0)
    whole = (np.abs(displacements) ** 2).sum(axis=(0, 1))
    moves = across > ACROSS * whole
    return np.divide(2 * (u * v.conj()).imag.sum(axis=0), across, out=np.zeros(len(across)), where=moves)


def in_words(orbit: float) -> str:
    """Return forward, backward or none for how round an orbit is, unknown for NaN."""
    if np.isnan(orbit):
        return "unknown"
    return "none" if abs(orbit) < ROUND else ("forward" if orbit > 0 else "backward")
