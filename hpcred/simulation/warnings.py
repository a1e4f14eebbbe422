"""Warn of simulations: places that look like mm, and motions beyond what the equations describe.

Deformations are linear in the elastic coordinates. A deflection of a twentieth of the body in its mean axes, about a
third of the length at the tip of a clamped beam, is large: the foreshortening that is left out is a tenth of it. One of
the size of the body means nothing. Without geometric stiffness nothing stiffens a body that turns: at an angular
velocity Omega the squares of its frequencies are too low by about Omega^2, so that a body which turns faster than its
first frequency has no stability.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh, null_space

from ..body.geometric_stiffness import StiffenedFrame
from ..body.rotations import rotation

OUTSIDE = 1e-6  # of a generalised force: more outside of those of the inputs belongs to none of them
STILL = 1e-9  # of the largest: below it a direction does not move, and an input is none
KINDS = ("forces", "moments")
STEPS_OF_A_PERIOD = 3.0  # of the stiffest mode, once the body vibrates; 1.4 to 6 were counted
GONE = 10.0  # time constants after which a vibration is below the tolerance
MANY_STEPS = 20_000
FOLLOWED = 30.0  # absolute tolerances: the integrator damps vibrations of smaller amplitudes; 20 to 100 were seen
FAR = 100.0  # radii of gyration: what is m away from a part is a thousand times as far in mm
# what is seen, the fraction of its scale from which on it is told, and how
LIMITS = (
    ("deflection", 0.05, "large deflection: at t = {t:.4g} s {where} is {value:.3g} m from its place in the undeformed "
     "body, more than a twentieth of the size of the body, {scale:.3g} m; deformations are linear"),
    ("deflection", 1.0, "the simulation diverges: at t = {t:.4g} s {where} is {value:.3g} m from its place in the "
     "undeformed body, whose size is {scale:.3g} m; the motion means nothing from there on"),
    ("speed", 1 / 3, "fast rotation: at t = {t:.4g} s the body turns by {value:.3g} rad/s, more than a third of its "
     "first frequency as joints hold it, {scale:.3g} rad/s ({hz:.3g} Hz); turning does not stiffen it here, and "
     "deflections err by a ninth or more"),
    ("speed", 1.0, "rotation too fast: at t = {t:.4g} s the body turns by {value:.3g} rad/s, faster than its first "
     "frequency as joints hold it, {scale:.3g} rad/s ({hz:.3g} Hz); without stiffening it may have no stability"),
)  # fmt: skip
UNITS = {"deflection": "m", "speed": "rad/s"}


def gyration(frame) -> float:
    """Return the radius of gyration (m) about the centre of mass."""
    centre = frame.mc / frame.mass
    return float(np.sqrt(max(np.trace(frame.J) / frame.mass / 2 - centre @ centre, 0.0)))


def warnings_of_places(body, setup, start: dict) -> list[str]:
    """Return sentences on places so far from their nodes, which start at `start` {number: (3,)}, that they look like
    mm."""
    size, labels = gyration(body.floating_frame), {shape.node: shape.label for shape in body.nodes}
    declared = [("spring.at", entry.node, entry.at) for entry in setup.spring]
    declared += [("constraint.at", entry.node, entry.at) for entry in setup.constraint]
    declared += [("drive.through", entry.node, entry.through) for entry in setup.drive]
    far = [(key, node, place, np.linalg.norm(np.subtract(place, start[node])))
           for key, node, place in declared if place is not None]  # fmt: skip
    return [
        f"{key}: found {list(place)} m, {distance:.3g} m from where node {labels[node]} starts, while the body "
        f"has a radius of gyration of {size:.3g} m; places are in m"
        for key, node, place, distance in far if 0 < FAR * size < distance
    ]  # fmt: skip


def warnings_of_inputs(body, setup, holds, start: dict, turned) -> list[str]:
    """Return sentences on nodes at which joints, drives, springs or loads act in directions that are no inputs of the
    reduction, whose basis need not follow their forces.

    `holds`: the constraints of joints and drives; `start`: rotations (3, 3) of the nodes at first, `turned` (3, 3) that
    of the body. A force is one of the inputs where its generalised force is a combination of theirs.
    """
    # generalised forces of unit forces and moments at nodes, in inertial axes; and the space of those of the inputs
    units = {shape.node: np.stack([turned @ shape.phi, turned @ shape.psi]) for shape in body.nodes}
    _, values, inputs = np.linalg.svd(body.reduced.B.T, full_matrices=False)
    inputs = inputs[values > STILL * values.max(initial=0.0)]

    def are_inputs(node, kind, directions):
        """Return which of the directions (k, 3) that move the body are inputs."""
        forces = directions @ units[node][kind]
        rest, size = (np.linalg.norm(vectors, axis=1) for vectors in (forces - forces @ inputs.T @ inputs, forces))
        largest = max(np.abs(vectors[kind]).max(initial=0.0) for vectors in units.values())
        return (rest <= OUTSIDE * size)[size > STILL * largest]

    # of joints and drives each direction counts; of springs and loads, which may turn, one that is an input is enough
    untold = {}
    for hold in holds:
        for kind, vectors in enumerate(np.split(hold.directions(0.0, start[hold.shape.node]), 2, axis=1)):
            if not are_inputs(hold.shape.node, kind, vectors[vectors.any(axis=1)]).all():
                untold.setdefault(hold.shape.node, {}).setdefault(kind, hold.label)
    for key in ("force", "moment", "spring"):
        for entry in getattr(setup, key):
            kind = int(key == "moment")
            there = are_inputs(entry.node, kind, np.eye(3))
            if len(there) and not there.any():
                untold.setdefault(entry.node, {}).setdefault(kind, key)
    labels = {shape.node: shape.label for shape in body.nodes}
    return [
        f"node {labels[node]}: {' and '.join(KINDS[kind] for kind in kinds)} there "
        f"({', '.join(dict.fromkeys(kinds.values()))}) are no inputs of the reduction, whose basis need not follow "
        "them: motion and stresses may be wrong; reduce with the directions in which they act among `inputs`"
        for node, kinds in untold.items()
    ]


def first_frequency(system, r, p, q) -> float:
    """Return the lowest elastic circular frequency (rad/s) of the body as joints and drives hold it; inf without one.

    Springs to the ground count as free. It is inf too for a body that its rotation stiffens.
    """
    if isinstance(system.floating_frame, StiffenedFrame) and system.floating_frame.stiffened_by_rotation:
        return np.inf
    values, _, G = _held_modes(system, r, p, q)
    free = 6 - np.linalg.matrix_rank(G[:, :6]) if len(G) else 6  # rigid motions, at frequency zero
    return float(np.sqrt(max(values[free], 0.0))) if len(values) > free else np.inf


def _held_modes(system, r, p, q):
    """Return eigenvalues (k,) and vectors (6 + m, k) of the body as joints and drives hold it at first, and their
    constraints (c, 6 + m)."""
    G, _ = system.constraints(0.0, system.node_motions(r, rotation(p), q))
    Z = null_space(G) if len(G) else np.eye(G.shape[1])
    K = (system.K + system.K.T) / 2
    values, X = eigh(Z[6:].T @ K @ Z[6:], Z.T @ system.floating_frame.mass_matrix(q) @ Z)
    return values, Z @ X, G


def note_on_steps(system, setup, y0, yp0) -> str | None:
    """Return a sentence where the start sets the body vibrating, and its stiffest modes are so stiff that the
    integrator will take very many steps; None where the start is at rest to the tolerance."""
    r, p, q, z, *_ = system.split(y0)
    rates = system.split(yp0)[3]
    values, X, _ = _held_modes(system, r, p, q)
    M = system.floating_frame.mass_matrix(q)
    omega = np.sqrt(np.maximum(values, 0.0))
    elastic = omega > np.finfo(float).eps ** 0.5 * omega.max(initial=0.0)
    omega, X = omega[elastic], X[:, elastic]
    # amplitudes in the elastic coordinates, by the velocities and accelerations that the start has in each mode
    speed, push = (X.T @ M @ vector for vector in (z, rates))
    amplitude = np.hypot(speed / omega, push / omega**2) * np.abs(X[6:]).max(axis=0, initial=0.0)
    decay = np.einsum("ik,ij,jk->k", X[6:], system.D, X[6:]) / 2
    lasting = np.minimum(setup.end, GONE / np.maximum(decay, 1e-300))
    followed = amplitude > FOLLOWED * setup.absolute_tolerance
    if not followed.any():
        return None
    f, steps = omega / (2 * np.pi), followed * STEPS_OF_A_PERIOD * omega / (2 * np.pi) * lasting
    k = int(steps.argmax())
    if steps[k] < MANY_STEPS:
        return None
    f, limit, fewer = f[k], f[k] / 3, steps[f < f[k] / 3].max(initial=0.0)
    return (
        f"steps: the start sets the body vibrating, which as joints hold it has {f:.4g} Hz in its stiffest mode that "
        f"is hardly damped: a period of {1e6 / f:.3g} us, for output steps of {1e6 * setup.end / setup.steps:.3g} us; "
        f"the integrator will take about {steps[k]:.0e} steps; without the modes above {limit:.2g} Hz (drop_above in "
        f"the job of the reduction) these would be about {max(fewer, 20):.0e}; start = 'static', damping, damp_above, "
        "or relative_tolerance = 1e-3 with absolute_tolerance = 1e-6 take far fewer too"
    )


class Limits:
    """Tells at which steps of the integrator a motion leaves what the equations describe.

    `first`: see first_frequency; `tell` takes each sentence while the simulation runs.
    """

    def __init__(self, body, system, first: float, tell):
        frame = body.floating_frame
        reach = [np.linalg.norm(shape.position - frame.origin - frame.mc / frame.mass) for shape in body.nodes]
        self._scales = {"deflection": 2 * max([gyration(frame), *reach]), "speed": first}
        self._places = [*(f"node {shape.label}" for shape in body.nodes), "the body on average"]
        self._phi = np.array([shape.phi for shape in body.nodes]).reshape(-1, 3, body.reduced.size)
        self._system, self._tell = system, tell
        self._largest, self._found = dict.fromkeys(UNITS, 0.0), {}

    def __call__(self, t, y):
        _, _, q, z, *_ = self._system.split(y)
        frame = self._system.floating_frame
        moved = np.append(np.linalg.norm(self._phi @ q, axis=1), np.sqrt(max(q @ frame.Me @ q, 0.0) / frame.mass))
        values = {"deflection": float(moved.max()), "speed": float(np.linalg.norm(z[3:6]))}
        for key, value in values.items():
            self._largest[key] = max(self._largest[key], value)
        for limit in LIMITS:
            key, fraction, sentence = limit
            if values[key] > fraction * self._scales[key] and limit not in self._found:
                scale, where = self._scales[key], self._places[int(moved.argmax())]
                self._found[limit] = sentence.format(
                    t=t, value=values[key], scale=scale, hz=scale / (2 * np.pi), where=where
                )
                self._tell(self._found[limit])

    @property
    def warnings(self) -> list[str]:
        """What was told, with the largest value of all."""
        return [f"{text} (largest: {self._largest[key]:.3g} {UNITS[key]})" for (key, *_), text in self._found.items()]
