"""Tell the direction of whirl: the way in which nodes go round an axis in a mode."""

from __future__ import annotations

import numpy as np

STILL = 1e-6  # of the largest velocity of the nodes in a mode of the same energy: less is no motion of theirs
ACROSS = 1e-6  # of the squared motion: less across the axis is none
ROUND = 0.1  # of a circle: narrower orbits are straight lines


def motions_of(nodes) -> np.ndarray:
    """Return the shapes (k, 3, m) of NodeShapes: of their displacements, and, as more nodes, of their rotations times a
    length, such that both are as large in all coordinates together: in a whirl both go round in the same sense."""
    if not nodes:
        return np.zeros((0, 3, 0))
    phi = np.array([node.phi for node in nodes], dtype=float)
    psi = np.array([getattr(node, "psi", 0 * node.phi) for node in nodes], dtype=float)
    length = np.linalg.norm(phi) / (np.linalg.norm(psi) or 1.0)
    return np.concatenate([phi, (length or 1.0) * psi])


def are_seen(motions, poles) -> np.ndarray:
    """Return in which modes (u,) the nodes move, by their motions (k, 3, u) in modes of one energy with poles (u,)."""
    velocity = np.linalg.norm(motions, axis=(0, 1)) * np.abs(poles)
    return velocity > STILL * velocity.max(initial=0.0)


def orbits(motions, axis) -> np.ndarray:
    """Return how round the orbits of nodes about an axis are, in each mode (u,): 1 for circles in the sense of a right
    hand, -1 for circles in the other, 0 for straight lines and where the nodes do not move across the axis.

    `motions`: complex displacements (k, 3, u) of k nodes, and rotations as motions_of has them, in modes exp(i omega t)
    with omega > 0; `axis` (3,), a unit vector.
    For displacements u and v along two axes across, such that the third one is the axis, node by node the orbit
    encloses the area pi Im(u conj(v)), positive where v lags u by up to half a turn: the sum over the nodes counts,
    beside that of circles with the same (|u|^2 + |v|^2) / 2.
    """
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    u, v = (np.tensordot(vector, motions, (0, 1)) for vector in (first, np.cross(axis, first)))
    across = (np.abs(u) ** 2 + np.abs(v) ** 2).sum(axis=0)
    whole = (np.abs(motions) ** 2).sum(axis=(0, 1))
    moves = across > ACROSS * whole
    return np.divide(2 * (u * v.conj()).imag.sum(axis=0), across, out=np.zeros(len(across)), where=moves)


def in_words(orbit: float) -> str:
    """Return forward, backward or none for how round an orbit is, unknown for NaN."""
    if np.isnan(orbit):
        return "unknown"
    return "none" if abs(orbit) < ROUND else ("forward" if orbit > 0 else "backward")
