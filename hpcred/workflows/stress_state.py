"""Find when and where in a motion the stress of a reduced body is largest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..body.stress import von_mises
from ..files.result_file import Result
from ..parallel.failures import agreed
from .recover import coordinates_of

AT_ONCE = 2**24  # numbers of stresses that are held at a time
CURVES = 4  # nodes whose stress over time is kept
SHOWN = 48  # instants of the motion that a page plays
APART = 0.1  # of the diagonal of the body, between these nodes: the neighbours of the worst node show nothing new


@dataclass(frozen=True)
class StressOfMotion:
    """Coordinates (m,) at the `worst` instant, that of the largest von Mises stress, a `title` with its numbers, and
    `curves` over the times `t` (nt,): a label and the stress in MPa (nt,) of the nodes with the largest peaks.

    `q` (f, m): coordinates at the instants `shown` (f,) of t, equally spaced ones and the worst; `worst_shown`: its
    place among them."""

    worst: np.ndarray
    title: str
    t: np.ndarray
    curves: list[tuple[str, np.ndarray]]
    q: np.ndarray
    shown: np.ndarray
    worst_shown: int


def stress_of_motion(result: Result, motion, comm) -> StressOfMotion | None:
    """Return the stresses of a motion that figures show; None on other ranks than the first.

    Collective. Raises InputError for the motion of another body, and without stress modes.
    """
    coordinates = coordinates_of(result, motion, comm)
    with agreed(comm):
        if comm.rank:
            return None
        modes, q = result.stress_modes(), coordinates.q
        flat, peaks, instants = modes.stress.reshape(len(modes.stress), -1), -1.0, 0
        step = max(1, AT_ONCE // flat.shape[1])
        for first in range(0, len(q), step):
            equivalent = von_mises((q[first : first + step] @ flat).reshape(-1, len(modes.node), 6))
            instants = np.where(equivalent.max(axis=0) > peaks, first + equivalent.argmax(axis=0), instants)
            peaks = np.maximum(equivalent.max(axis=0), peaks)
        with result.shapes() as shapes:
            place = np.searchsorted(shapes.nodes, modes.node).clip(max=len(shapes.nodes) - 1)
            there = shapes.nodes[place] == modes.node  # a program also has stresses of nodes that follow others
            places = np.where(there[:, None], shapes.points[place], np.nan)
            chosen = _apart(peaks, places, APART * np.linalg.norm(np.ptp(shapes.points, axis=0)))
        equivalent = von_mises(np.einsum("tm,msc->tsc", q, modes.stress[:, chosen])) / 1e6
        worst = instants[chosen[0]]
        spaced = np.linspace(0, len(q) - 1, min(SHOWN, len(q))).round().astype(int)
        shown = np.unique([*spaced, worst])
        return StressOfMotion(
            q[worst],
            f"t = {coordinates.t[worst]:.4g} s: von Mises stress up to {equivalent.max():.4g} MPa, at node "
            f"{modes.node[chosen[0]]}",
            coordinates.t,
            [(f"node {node}", values) for node, values in zip(modes.node[chosen], equivalent.T, strict=True)],
            q[shown],
            shown,
            int(np.searchsorted(shown, worst)),
        )


def _apart(peaks, places, distance) -> list[int]:
    """Return which nodes have the largest peaks (s,), the largest first, at a distance from each other."""
    chosen, left = [], np.ones(len(peaks), bool)
    while left.any() and len(chosen) < CURVES:
        chosen.append(int(np.argmax(np.where(left, peaks, -np.inf))))
        left &= np.linalg.norm(places - places[chosen[-1]], axis=1) > distance
    return chosen
