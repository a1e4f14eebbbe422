"""Make the rigid-body motions of the nodes of a model as columns."""

from __future__ import annotations

import numpy as np

from ...fe.dofs import SCALAR, require_dofs
from ...linalg.blocks import create_block, local_rows
from ...parallel.petsc import SLEPc


def rigid_motions(model, centre=(0.0, 0.0, 0.0)) -> SLEPc.BV:
    """Return unit translations and unit rotations about `centre` as a block (n, 6). Collective.

    Translational dofs move by e x (r - centre), rotational dofs by e, others not at all. Raises InputError without
    nodes.
    """
    dofs = require_dofs(model, "a rigid-body motion")
    motions = create_block(model.K, 6)
    with local_rows(motions) as rows:
        axis = dofs.direction % 3
        moved, turned = dofs.direction < 3, (dofs.direction >= 3) & (dofs.direction < SCALAR)
        rows[...] = 0.0
        arm = dofs.position - np.asarray(centre)
        for k in range(3):
            rows[moved & (axis == k), k] = 1.0
            rows[turned & (axis == k), 3 + k] = 1.0
            # component `axis` of e_k x arm
            cross = np.cross(np.eye(3)[k], arm)
            rows[moved, 3 + k] = cross[moved, axis[moved]]
    return motions


def middle(model):
    """Return the mean position of the rows (3,). Collective."""
    dofs = require_dofs(model, "a rigid-body motion")
    return model.comm.allreduce(dofs.position.sum(axis=0)) / model.size
