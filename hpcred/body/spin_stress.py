"""Tell of bodies that spin whose reduction had no centrifugal load, which their stresses need.

Centrifugal forces load all nodes. They deform a reduced body through its coordinates; where none of these has the
static deflection that belongs to them, its stresses are off, by 10 % in a blade.
"""

from __future__ import annotations

import numpy as np

SEEN = 0.1  # of the largest strain, from which that by spinning counts
REMEDY = (
    "no input of the reduction is a centrifugal load, without which stresses under spin may be 10 % off: add a "
    "[[load]] of kind = 'centrifugal' to the job"
)


def lacks_spin(record) -> bool:
    """Tell whether no load of the Record of a reduction has centrifugal forces, or might have them as given columns."""
    return record is not None and not any(load.spins or load.kind == "given" for load in record.loads)


def warnings_of_spin(body, angular_velocity: np.ndarray, largest: float) -> list[str]:
    """Return a sentence where spinning with angular velocities (nt, 3) strains a Body, whose largest elastic energy in
    J is given, and its reduction had no such load."""
    if not lacks_spin(body.reduced.record):
        return []
    x, y, z = np.transpose(angular_velocity)
    force = np.array([x * x, y * y, z * z, x * y, y * z, x * z]).T @ body.floating_frame.Oe.T
    energy = (force * np.linalg.lstsq(body.reduced.K, force.T, rcond=None)[0].T).sum(axis=1) / 2
    if energy.max(initial=0.0) <= SEEN**2 * largest:
        return []
    speed = np.linalg.norm(angular_velocity, axis=1).max()
    return [f"stress: the body turns by up to {speed:.3g} rad/s, which strains it, and {REMEDY}"]
