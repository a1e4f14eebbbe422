"""Rigid-body modes: from the positions of the nodes to an M-orthonormal basis of ker K, and what follows from it."""

from __future__ import annotations

import numpy as np

from ..linalg.basis import Basis
from ..linalg.blocks import add_product, apply, column_norms, copy_of, create_block, inner, local_rows, turn
from ..parallel.failures import InputError
from ..parallel.petsc import PETSc, SLEPc
from .dofs import require_dofs

FORCE_FREE = 1e-8  # ||K R|| / (||K|| ||R||) below which a rigid-body motion counts as free of force


def rigid_motions(model, centre=(0.0, 0.0, 0.0)) -> SLEPc.BV:
    """Unit translations and unit rotations about `centre` as a block (n, 6). Collective; the caller destroys it.

    Translational dofs move by e x (r - centre), rotational dofs by e. Raises InputError without nodes.
    """
    dofs = require_dofs(model, "a rigid-body motion")
    motions = create_block(model.K, 6)
    with local_rows(motions) as rows:
        axis = dofs.direction % 3
        moved = dofs.direction < 3
        rows[...] = 0.0
        arm = dofs.position - np.asarray(centre)
        for k in range(3):
            rows[moved & (axis == k), k] = 1.0
            rows[~moved & (axis == k), 3 + k] = 1.0
            # component `axis` of e_k x arm
            cross = np.cross(np.eye(3)[k], arm)
            rows[moved, 3 + k] = cross[moved, axis[moved]]
    return motions


def rigid_body_quantities(model):
    """Mass (kg), centre of mass (3,) (m) and inertia about it (3, 3) (kg m^2), from M and the nodes. Collective."""
    centre = np.zeros(3)
    for _ in range(2):
        motions = rigid_motions(model, centre)
        product = create_block(model.M, 6)
        apply(model.M, motions, product)
        gram = inner(motions, product)
        motions.destroy()
        product.destroy()
        mass = np.trace(gram[:3, :3]) / 3
        if mass <= 0:
            raise InputError(f"{model.name}: the translational mass is {mass:g} kg, expected a positive one")
        # S^T M R = m skew(c)^T
        coupling = gram[:3, 3:]
        offset = np.array([coupling[1, 2] - coupling[2, 1], coupling[2, 0] - coupling[0, 2],
                           coupling[0, 1] - coupling[1, 0]]) / (2 * mass)  # fmt: skip
        centre = centre + offset
    return mass, centre, gram[3:, 3:]


class RigidBodyModes:
    """The force-free rigid-body motions of a model, M-orthonormal: R^T M R = I, K R = 0.

    `R` (n, count) and `MR` = M R as blocks. `count`: 0 for a supported body to 6 for a free one. `supports`: global
    rows of this rank, `count` over all ranks, that leave no rigid motion when held. Owns PETSc objects:
    call close(). Collective throughout.
    """

    def __init__(self, model):
        self._first, self._k = model.first_row, model.K
        _, centre, _ = rigid_body_quantities(model)
        motions = rigid_motions(model, centre)
        self.defect, free = _force_free(model, motions)
        turn(motions, free)
        motions.setActiveColumns(0, free.shape[1])
        self.count = free.shape[1]
        basis = Basis(model.M)
        basis.extend(motions)
        motions.destroy()
        if basis.size != self.count:
            basis.close()
            raise InputError(
                f"{model.name}: the mass matrix is singular for rigid-body motions "
                f"({basis.size} independent ones of {self.count}); a free body needs mass and inertia"
            )
        self.R = copy_of(basis.columns, model.M) if self.count else None
        basis.close()
        self.MR = None
        if self.count:
            self.MR = create_block(model.M, self.count)
            apply(model.M, self.R, self.MR)
            self.supports = self._determinate_supports(model)

    def close(self):
        for block in (self.R, self.MR):
            if block is not None:
                block.destroy()
        self.R = self.MR = None

    def equilibrate(self, load: SLEPc.BV):
        """load <- (I - M R R^T) load: the part of a load that does not accelerate the body as a whole."""
        add_product(load, self.MR, inner(self.R, load), alpha=-1.0)

    def project(self, block: SLEPc.BV):
        """block <- (I - R R^T M) block: the M-orthogonal projection onto the elastic space (51)."""
        add_product(block, self.R, inner(self.MR, block), alpha=-1.0)

    def hold(self, rows):
        """Use these global rows (from 0) as statically determinate supports of inertia relief. Collective."""
        mine = [row for row in rows if 0 <= row - self._first < self._k.getLocalSize()[0]]
        self.supports = np.array(sorted(mine), dtype=PETSc.IntType)

    def _determinate_supports(self, model):
        """`count` rows whose rows of R are as independent as possible: Gram-Schmidt with row pivoting."""
        with local_rows(self.R) as view:
            rows = view.real.copy()
        taken = []
        for _ in range(self.count):
            sizes = (rows**2).sum(axis=1)
            best = int(sizes.argmax()) if sizes.size else -1
            size = float(sizes[best]) if sizes.size else -1.0
            sizes = model.comm.allgather(size)
            owner = int(np.argmax(sizes))
            pivot = model.comm.bcast(rows[best].copy() if model.comm.rank == owner else None, root=owner)
            if model.comm.rank == owner:
                taken.append(best + model.first_row)
            pivot /= np.linalg.norm(pivot)
            rows -= np.outer(rows @ pivot, pivot)
        return np.array(sorted(taken), dtype=PETSc.IntType)


def _force_free(model, motions):
    """Combinations of the six motions that K does not resist: (6, count), and ||K R|| / (||K|| ||R||) of all."""
    product = create_block(model.K, 6)
    apply(model.K, motions, product)
    norm = model.K.norm(PETSc.NormType.INFINITY)
    sizes = np.maximum(column_norms(motions), 1e-300)
    gram = inner(product, product) / np.outer(sizes, sizes) / norm**2
    product.destroy()
    forces = np.sqrt(np.maximum(np.diag(gram), 0.0))
    values, vectors = np.linalg.eigh((gram + gram.T) / 2)
    free = np.sqrt(np.abs(values)) < FORCE_FREE
    return float(forces.max()), (vectors / sizes[:, None])[:, free]
