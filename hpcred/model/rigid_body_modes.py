"""Rigid-body modes: from the positions of the nodes to an M-orthonormal basis of ker K, and what follows from it."""

from __future__ import annotations

import numpy as np

from ..linalg.basis import Basis
from ..linalg.blocks import add_product, apply, column_norms, copy_of, create_block, inner, local_rows, multiply
from ..parallel.decisions import decided
from ..parallel.failures import InputError, Owned
from ..parallel.petsc import PETSc, SLEPc
from .dofs import require_dofs

FORCE_FREE = 1e-8  # ||K R|| / (||K|| ||R||) below which a rigid-body motion counts as free of force
MOST_ROWS = 0.6  # share of rows in which supports are not believed


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
    rows of this rank, `count` over all ranks, that leave no rigid motion when held. `defect`: largest
    ||K R|| / (||K|| ||R||) of the six motions. Owns PETSc objects: call close(). Collective throughout.
    """

    def __init__(self, model):
        self._first, self._k = model.first_row, model.K
        self.R = self.MR = None
        _, centre, _ = rigid_body_quantities(model)
        with Owned(model.comm) as owned:
            motions = owned.owns(rigid_motions(model, centre))
            self.defect, free = decided(model.comm, _force_free, *_forces(model, motions))
            multiply(motions, free)
            self.count = free.shape[1]
            motions.setActiveColumns(0, self.count)
            basis = owned.owns(Basis(model.M, room=6))
            basis.extend(motions)
            if basis.size != self.count:
                raise InputError(
                    f"{model.name}: the mass matrix is singular for rigid-body motions "
                    f"({basis.size} independent ones of {self.count}); a free body needs mass and inertia"
                )
            if self.count:
                self.R = copy_of(basis.columns, model.M)
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


def _forces(model, motions):
    """Gram matrix (6, 6) of K R / (||K|| ||R||), and the norms (6,) of the motions R."""
    with Owned(model.comm) as owned:
        product = owned.owns(create_block(model.K, 6))
        apply(model.K, motions, product)
        sizes = np.maximum(column_norms(motions), 1e-300)
        norm = model.K.norm(PETSc.NormType.INFINITY)
        return inner(product, product) / np.outer(sizes, sizes) / norm**2, sizes


def _force_free(gram, sizes):
    """||K R|| / (||K|| ||R||) of the worst motion, and the combinations (6, count) that K does not resist."""
    values, vectors = np.linalg.eigh((gram + gram.T) / 2)
    free = np.sqrt(np.abs(values)) < FORCE_FREE
    return float(np.sqrt(np.maximum(np.diag(gram), 0.0)).max()), (vectors / sizes[:, None])[:, free]


def misfit_of_nodes(model) -> str | None:
    """A sentence where the nodes seem not to belong to the rows, or None. Collective.

    A rigid motion of the nodes meets no force but at supports. Where K resists rotations and no translation, or resists
    in most rows, the coordinates or the directions are those of other rows, or of other units than K.
    """
    with Owned(model.comm) as owned:
        motions = owned.owns(rigid_motions(model, _middle(model)))
        product = owned.owns(create_block(model.K, 6))
        apply(model.K, motions, product)
        gram, _ = _forces(model, motions)
        force = np.sqrt(np.maximum(np.diag(gram), 0.0))
        with local_rows(motions) as moved, local_rows(product) as forces:
            reach = np.max(model.comm.allgather(np.abs(moved.real).max(axis=0, initial=0.0)), axis=0)
            norm = model.K.norm(PETSc.NormType.INFINITY)
            resisted = (np.abs(forces.real) > FORCE_FREE * norm * np.maximum(reach, 1e-300)).any(axis=1)
        share = model.comm.allreduce(int(resisted.sum())) / model.size
    # a rotation of a line or a point about itself moves nothing
    translation, rotation = force[:3].max(), force[3:].max()
    found = f"||K R|| / (||K|| ||R||) = {max(translation, rotation):.1e} for rigid-body motions R of the nodes"
    if translation < FORCE_FREE <= rotation:
        return (
            f"{model.name}: {found}, though K resists no translation: the nodes are not those of the rows; check the "
            "order of nodes against that of rows, and that all coordinates are in one unit and one system of axes"
        )
    if share > MOST_ROWS:
        return (
            f"{model.name}: {found}, in {100 * share:.0f} % of the rows: the body is held almost everywhere, or the "
            "nodes or directions are not those of the rows"
        )
    return None


def _middle(model):
    """The mean position of the rows (3,). Collective."""
    dofs = require_dofs(model, "a rigid-body motion")
    return model.comm.allreduce(dofs.position.sum(axis=0)) / model.size
