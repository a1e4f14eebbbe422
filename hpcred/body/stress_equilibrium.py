"""Tell by the equilibrium of a state of load whether a matrix is the stiffness of its stress, and of which sign.

A small rotation of the whole body turns its stress, and so the nodal forces f that the stress holds: at each node
K_sigma (theta x r) = theta x f, for any element, and K_sigma is zero for translations. At nodes beside a support, whose
columns are missing, neither holds; these are found by the translations.
"""

from __future__ import annotations

import numpy as np

from ..fe.dofs import target_of
from ..linalg.blocks import local_rows, times
from ..model.rigid_body.modes import rigid_motions
from ..parallel.failures import InputError
from ..parallel.lookup import look_up
from ..parallel.petsc import PETSc
from ..parallel.sums import summed
from .unit_states import unit_loads

STRIDE = 8  # of keys of node and direction
NEAR = 1e-6  # of the norm of the matrix: rows that a translation loads stand beside a support
SAME = 0.02  # difference of forces, relative to all, that lumped masses and digits explain


def sign_of_stress_stiffness(model, stiffness: PETSc.Mat, state: str, value: float, name) -> float:
    """Return 1 for the stiffness (n, n) of the stress of a state of load with a value, and -1 for its opposite.

    `name` of its file, for messages. Collective. Raises InputError for a matrix of another state or value.
    """
    target = target_of(state)
    loads, names = unit_loads(model, np.zeros(3), [target[0]] if isinstance(target, tuple) else [])
    force = value * loads[:, names.index(state)]
    with local_rows(times(stiffness, rigid_motions(model))) as rows:
        held = rows.real.copy()  # (rows, 6)
    dofs = model.dofs
    moved = dofs.direction < 3
    key = STRIDE * dofs.node.astype(np.int64) + dofs.direction
    others = np.where(moved[:, None], key[:, None] - dofs.direction[:, None] + np.arange(3), 0)
    there, (found,) = look_up(model.comm, key, [force], others.ravel())
    there, found = there.reshape(-1, 3), found.reshape(-1, 3)
    inside = moved & there.all(axis=1)
    inside &= np.abs(held[:, :3]).max(axis=1) <= NEAR * stiffness.norm(PETSc.NormType.INFINITY)
    turned = np.cross(np.eye(3)[None], found[inside, None])  # (rows, 3, 3): of each theta, all components
    wanted = np.take_along_axis(turned, dofs.direction[inside, None, None].astype(np.int64), axis=2)[..., 0]
    given = held[inside, 3:]
    sums = [(given * wanted).sum(), (wanted**2).sum(), (given**2).sum()]
    both, square, of_given = model.comm.bcast(summed(model.comm, np.array(sums)))
    sign = 1.0 if both > 0 else -1.0
    left = max(of_given - 2 * sign * both + square, 0.0)
    if not square or not left <= SAME**2 * square:
        how = f"{np.sqrt(left / square):.1e} of its forces are left" if square else "its forces act on supports only"
        raise InputError(
            f"{name}: found a stiffness of stress that is not in equilibrium with the state '{state}' of {value:g} "
            f"({how}), expected that of its stress on the supports of {model.name}; check state, value and units"
        )
    return sign
