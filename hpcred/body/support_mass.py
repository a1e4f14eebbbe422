"""Measure the inertia forces that are missing where matrices lack the rows of supports.

The forces -M a of accelerations a of a whole body need the mass between held and free dofs, which went with the rows of
the held ones. Its part follows from the densities and shape functions of the solid elements at the supports.
"""

from __future__ import annotations

import numpy as np

from ..fe.shape_functions import integration_points, shape_functions
from ..fe.strain_matrices import strain_matrices
from ..model.loads.columns import mass_times
from ..parallel.sums import summed


def remark_on_supports(model, solids, acceleration) -> str:
    """Return a sentence on the forces that a function of accelerations (k, 3) at points (k, 3) lacks; "" where M has
    them all, or is lumped. Collective."""
    forces, count, coupled = mass_times(model, acceleration)
    if not count or not coupled:
        return ""
    held = solids.rows < 0
    still = np.where(held, acceleration(solids.position), 0.0)
    unknown = any(group.material.density is None and still[group.nodes].any() for group in solids.groups)
    lost = sum(np.abs(np.where(held[group.nodes], 0.0, _forces(group, solids.position, still))).sum()
               for group in solids.groups if group.material.density is not None)  # fmt: skip
    lost, whole, unknown = summed(model.comm, np.array([lost, np.abs(forces).sum(), unknown], dtype=float))
    size = "how much that is needs densities" if unknown else f"{lost / whole:.2g} of all forces"
    return (
        f"preload: the inertia of the mass at {count} held dofs is not in M ({size}): export the body without "
        "supports and hold it by a frame where that counts"
    )


def _forces(group, position, still) -> np.ndarray:
    """Return M_e a (e, k, 3) of the elements of a group, for accelerations (l, 3) of all nodes."""
    _, volumes = strain_matrices(group.kind, group.rule, position[group.nodes])
    points = integration_points(group.kind, "reduced" if group.rule.strain == "mean" else group.rule.scheme)[0]
    N = shape_functions(group.kind, points)[0]
    return group.material.density * np.einsum("eg,ga,eg...->ea...", volumes, N, N @ still[group.nodes])
