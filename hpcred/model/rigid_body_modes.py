"""Compute the rigid-body modes of a body from the positions of its nodes: an M-orthonormal basis of ker K."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..linalg.basis import Basis
from ..linalg.blocks import (
    add_product,
    column_norms,
    copy_of,
    create_block,
    inner,
    local_rows,
    multiply,
    times,
)
from ..linalg.csr import diagonal_of
from ..parallel.decisions import decided
from ..parallel.failures import InputError
from ..parallel.petsc import MPI, PETSc, SLEPc
from .digits import digits_of
from .dofs import SCALAR, require_dofs

NO_MASS = 1e-12  # of the largest mass: round-off
SAME_MASS = 1e-6  # relative difference of the masses in x, y, z that the digits of a text file explain
ROUND_OFF = 1e-10
FORCE_FREE = 1e-8  # ||K R|| / (||K|| ||R||) below which a rigid-body motion counts as free of force
EXACTLY_FREE = 32 * np.finfo(float).eps  # of the entries of a row: what motions that are guessed may meet of force
SOFTLY = 1e-9  # of the diagonal: more than the round-off of translations in rows of slender and flat elements
SILENT = 1e-6  # sum of a row over that of its absolute values, below which it is zero to the digits of a file
ON_DIAGONAL = 0.5  # of the diagonal of a mass matrix: less than any element's mass, more than what supports resist
FEW = 0.02  # share of rows of a mass matrix that may be so
MOST_ROWS = 0.6  # share of rows in which supports are not believed


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


@dataclass(frozen=True)
class RigidBody:
    """`masses` (3,) in kg that M has in x, y and z, `centre` (3,) of mass in m, `inertia` (3, 3) in kg m^2 about it.

    A direction in which no node can move has no mass. What M then does not contain is NaN: without z the inertia
    about x and about y and their product; without y and z also the place of the centre along x.
    """

    masses: np.ndarray
    centre: np.ndarray
    inertia: np.ndarray

    @property
    def mass(self) -> float:
        """The largest of the masses: dofs that are left out or held take mass away from a direction."""
        return float(self.masses.max())

    @property
    def complete(self) -> bool:
        """Whether there is a mass in each direction."""
        return bool((self.masses > 0).all())

    @property
    def uniform(self) -> bool:
        """Whether the directions that have a mass have the same."""
        return bool(self.masses[self.masses > 0].min(initial=self.mass) >= (1 - SAME_MASS) * self.mass)


def rigid_body_of(gram: np.ndarray) -> RigidBody:
    """Return Mass, centre and inertia about the reference point, from R^T M R (6, 6) of the motions of
    rigid_motions."""
    masses, cross = np.diag(gram)[:3].copy(), gram[:3, 3:]
    masses[np.abs(masses) <= NO_MASS * np.abs(masses).max()] = 0.0
    # integral of e_a . (e_b x r) dm is that of r_c in the mass of direction a
    after, last = np.array([1, 2, 0]), np.array([2, 0, 1])
    weight = masses[after] + masses[last]
    moment = cross[after, last] - cross[last, after]
    centre = np.divide(moment, weight, out=np.full(3, np.nan), where=weight != 0)
    inertia = gram[3:, 3:].copy()
    for missing in np.flatnonzero(masses == 0):
        others = np.delete(np.arange(3), missing)
        inertia[np.ix_(others, others)] = np.nan
    return RigidBody(masses, centre, inertia)


def rigid_body_quantities(model) -> RigidBody:
    """Return Mass, centre of mass and inertia about it, from M and the nodes. Collective. Raises InputError without
    mass."""
    centre = np.zeros(3)
    for _ in range(2):
        found = rigid_body_of(_rigid_gram(model, centre))
        if found.masses.min() < 0 or found.mass == 0:
            listed = ", ".join(f"{mass:g}" for mass in found.masses)
            raise InputError(
                exchange_of_matrices(model)
                or f"{model.name}: the translational masses in x, y, z are {listed} kg, expected none negative and not "
                "all zero; check the mass matrix and the order of its rows"
            )
        centre = centre + np.nan_to_num(found.centre)
    return RigidBody(found.masses, np.where(np.isnan(found.centre), np.nan, centre), found.inertia)


def _rigid_gram(model, centre):
    """Return R^T M R (6, 6) of the rigid motions about `centre`. Collective."""
    motions = rigid_motions(model, centre)
    return inner(motions, times(model.M, motions))


class RigidBodyModes:
    """The force-free rigid-body motions of a model, M-orthonormal: R^T M R = I, K R = 0.

    `R` (n, count) and `MR` = M R as blocks. `count`: 0 for a supported body to 6 for a free one. `supports`: global
    rows of this rank, `count` over all ranks, that leave no rigid motion when held. `defect`: largest
    ||K R|| / (||K|| ||R||) of the six motions. Collective throughout.
    """

    def __init__(self, model):
        self._first, self._k = model.first_row, model.K
        self.R = self.MR = None
        # where the centre is not known along an axis, any point of the axis will do
        motions = rigid_motions(model, np.nan_to_num(rigid_body_quantities(model).centre))
        self.defect, free = decided(model.comm, _force_free, *_forces(model, motions))
        multiply(motions, free)
        self.count = free.shape[1]
        motions.setActiveColumns(0, self.count)
        basis = Basis(model.M, room=6)
        basis.extend(motions)
        if basis.size != self.count:
            raise InputError(
                f"{model.name}: the mass matrix is singular for rigid-body motions "
                f"({basis.size} independent ones of {self.count}); a free body needs mass and inertia"
            )
        if self.count:
            self.R = copy_of(basis.columns, model.M)
            self.MR = times(model.M, self.R)
            self.supports = self._determinate_supports(model)

    def equilibrate(self, load: SLEPc.BV):
        """Replace a load by (I - M R R^T) load, the part that does not accelerate the body as a whole."""
        add_product(load, self.MR, inner(self.R, load), alpha=-1.0)

    def project(self, block: SLEPc.BV):
        """Replace a block by (I - R R^T M) block, its M-orthogonal projection onto the elastic space (51)."""
        add_product(block, self.R, inner(self.MR, block), alpha=-1.0)

    def hold(self, rows):
        """Use these global rows (from 0) as statically determinate supports of inertia relief. Collective."""
        mine = [row for row in rows if 0 <= row - self._first < self._k.getLocalSize()[0]]
        self.supports = np.array(sorted(mine), dtype=PETSc.IntType)

    def _determinate_supports(self, model):
        """Return `count` rows whose rows of R are as independent as possible: Gram-Schmidt with row pivoting."""
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
    """Return gram matrices (6, 6) of the forces K R / (||K|| ||R||) and of R / ||R||, and the norms (6,) of the motions
    R.

    The norm of a rotation that moves no node is infinite: it is no motion.
    """
    product = times(model.K, motions)
    sizes = column_norms(motions)
    far = model.comm.allreduce(float(np.abs(model.dofs.position).max(initial=0.0)), op=MPI.MAX)
    nothing = ROUND_OFF * sizes[:3].max()
    sizes[sizes <= nothing * np.array([1, 1, 1, far, far, far])] = np.inf
    scale = np.outer(sizes, sizes)
    norm = model.K.norm(PETSc.NormType.INFINITY)
    return inner(product, product) / scale / norm**2, inner(motions, motions) / scale, sizes


def free_motions(model, motions) -> int:
    """Return how many independent rigid-body motions (see rigid_motions) meet no force. Collective."""
    return decided(model.comm, _force_free, *_forces(model, motions))[1].shape[1]


def acts_on_free_motions(model, mat) -> bool:
    """Test whether a matrix (n, n), on the pattern of K, resists or pushes rigid-body motions that K leaves free.
    Collective."""
    norm, size = (each.norm(PETSc.NormType.INFINITY) for each in (model.K, mat))
    if not size or model.dofs is None:
        return False
    motions, both = rigid_motions(model, _middle(model)), model.K.copy()
    both.axpy((norm or 1.0) / size, mat, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
    with model.with_fields(K=both) as other:
        return free_motions(other, motions) < free_motions(model, motions)


def soft_supports(model) -> np.ndarray:
    """Return the force that each translation in x, y and z that moves the body meets in its worst row, relative to the
    diagonal of that row; zero where it may be round-off. Collective.

    So springs to the ground show that are too few or too soft for ||K R||, in which all rows of the body have a share.
    Of a K with fewer digits than a double has nothing is known, and all are zero.
    """
    if digits_of(model.K) is not None or _single(model):
        return np.zeros(1)
    motions = rigid_motions(model)
    motions.setActiveColumns(0, 3)
    size = np.abs(diagonal_of(model.K))[:, None]
    with local_rows(times(model.K, motions)) as rows, local_rows(motions) as moved:
        met = (np.abs(rows) / np.where(size > 0, size, np.inf)).max(axis=0, initial=0.0)
        moves = (moved != 0).any(axis=0)
    met = np.max(model.comm.allgather(met), axis=0)[np.any(model.comm.allgather(moves), axis=0)]
    return np.where(met > SOFTLY, met, 0.0)


def _single(model) -> bool:
    """Test whether the entries of K are numbers of single precision. Collective."""
    rows = range(model.first_row, model.first_row + min(model.local_rows, 16))
    values = np.concatenate([np.zeros(1), *(model.K.getRow(row)[1].real for row in rows)])
    with np.errstate(over="ignore"):
        single = bool((values == values.astype(np.float32)).all())
    return model.comm.allreduce(single, op=MPI.LAND)


def pushed_motions(model, loads) -> np.ndarray:
    """Return parts (motions, loads) of the loads on rigid motions that meet no force, which are M-orthonormal.
    Collective.

    `loads`: a block (n, loads). Parts that are round-off of a load are zero. Without nodes the motions are guessed to
    be translations of rows that go node by node.
    """
    if model.dofs is None:
        motions = _translations_of_rows(model)
        free = _exactly_free(model, motions)
    else:
        motions = rigid_motions(model, _middle(model))
        free = decided(model.comm, _force_free, *_forces(model, motions))[1]
    if not free.shape[1]:
        return np.zeros((0, loads.getActiveColumns()[1]))
    mass = free.T @ inner(motions, times(model.M, motions)) @ free
    parts = free.T @ inner(motions, loads)
    size = np.sqrt(np.diag(free.T @ inner(motions, motions) @ free))[:, None] * column_norms(loads)
    parts[np.abs(parts) <= ROUND_OFF * size] = 0.0
    values, vectors = np.linalg.eigh(mass)
    moving = values > NO_MASS * values[-1]
    return (vectors[:, moving] / np.sqrt(values[moving])).T @ parts


def _translations_of_rows(model) -> SLEPc.BV:
    """Return translations in each direction, a column each, of nodes with 1, 2, 3 and 6 rows one after the other."""
    kinds = [(count, direction) for count in (1, 2, 3, 6) for direction in range(min(count, 3))]
    motions = create_block(model.K, len(kinds))
    with local_rows(motions) as rows:
        row = model.first_row + np.arange(model.local_rows)
        for column, (count, direction) in enumerate(kinds):
            rows[:, column] = row % count == direction
    return motions


def _exactly_free(model, motions):
    """Return a selection (columns, count) of the columns that meet no force in any row, but for its round-off.
    Collective."""
    with local_rows(times(model.K, motions)) as rows, local_rows(motions) as moved:
        forced = (np.abs(rows) > EXACTLY_FREE * _sizes_of_rows(model.K)[:, None]).any(axis=0)
        moves = (moved != 0).any(axis=0)
    forced, moves = (model.comm.allreduce(part, op=MPI.BOR) for part in (forced, moves))
    return np.eye(len(forced))[:, moves & ~forced]


def _sizes_of_rows(mat):
    """Return sums of the absolute values of the rows of this rank."""
    indptr, _, values = mat.getValuesCSR()
    return np.bincount(np.repeat(np.arange(len(indptr) - 1), np.diff(indptr)), np.abs(values), len(indptr) - 1)


def _force_free(forces, overlaps, sizes):
    """Return ||K R|| / (||K|| ||R||) of the worst motion, and the combinations (6, count) that K does not resist."""
    # orthonormal combinations; a turn about the line on which all nodes are is none, in whatever direction it lies
    values, vectors = np.linalg.eigh(overlaps)
    moving = vectors[:, values > ROUND_OFF] / np.sqrt(values[values > ROUND_OFF])
    values, vectors = np.linalg.eigh(moving.T @ forces @ moving)
    free = np.sqrt(np.abs(values)) < FORCE_FREE
    return float(np.sqrt(np.abs(np.diag(forces)).max())), (moving @ vectors / sizes[:, None])[:, free]


def rigid_body_residuals(model) -> tuple[np.ndarray, int]:
    """Return ||K R|| / (||K|| ||R||) (6,) of the rigid motions R, and how many independent combinations meet no force.

    Rotations are about the middle of the nodes; a turn about a support is a combination. NaN stands for motions that
    move no dof. Collective.
    """
    forces, overlaps, sizes = _forces(model, rigid_motions(model, _middle(model)))
    free = decided(model.comm, _force_free, forces, overlaps, sizes)[1]
    return np.where(np.isinf(sizes), np.nan, np.sqrt(np.abs(np.diag(forces)))), free.shape[1]


def warnings_of_nodes(model) -> list[str]:
    """Return sentences where the nodes seem not to belong to the rows, or the masses in x, y and z differ. Collective.

    A direction in which no node has a dof has no mass to compare. Dofs that are held in some directions only make a
    difference of masses that is none of the nodes.
    """
    misfit, masses = misfit_of_nodes(model), rigid_body_quantities(model).masses
    found = [misfit] if misfit else []
    there = masses[masses > 0]
    held = model.comm.allreduce(0 if model.held is None else len(model.held.node))
    if there.size and not held and np.ptp(there) > SAME_MASS * there.max():
        names = _enumerated([name for name, mass in zip("xyz", masses, strict=True) if mass > 0])
        found.append(
            f"{model.name}: the masses in {names} are {_enumerated([f'{mass:.6g}' for mass in there])} kg, expected "
            "the same: nodes or directions are not those of the rows, supports hold some directions only, or the mass "
            "matrix is not one of a body"
        )
    return found


def exchange_of_matrices(model) -> str | None:
    """Return a sentence where M is a stiffness and K a mass matrix, or None. Collective. Raises InputError without
    nodes.

    A translation loads a stiffness at supports only, and a mass matrix in all rows of its direction: where it loads K
    in nearly all and M in few they have been exchanged.
    """
    motions = rigid_motions(model, _middle(model))
    with local_rows(motions) as rows:
        moved = rows.real[:, :3] > 0
    if _weighs(model, motions, moved):
        return None
    silent = []
    for mat in (model.K, model.M):
        sizes = _sizes_of_rows(mat)
        with local_rows(times(mat, motions)) as rows:
            none = np.abs(rows.real[:, :3]) <= SILENT * sizes[:, None]
            silent.append(int((moved & none & (sizes > 0)[:, None]).sum()))
    of_k, of_m, total = (model.comm.allreduce(count) for count in (*silent, int(moved.sum())))
    if of_k > FEW * total or of_m <= (1 - MOST_ROWS) * total:
        return None
    return (
        f"{model.name}: K AND M ARE EXCHANGED: a translation meets nothing in {100 * of_m / total:.0f} % of the rows "
        f"of M, as in a stiffness matrix, and in {100 * of_k / total:.0f} % of those of K; give each for the other"
    )


def _weighs(model, motions, moved) -> bool:
    """Test whether M gives translations about the mass that is on its diagonal, which is quick to see. Collective."""
    with local_rows(times(model.M, motions)) as rows:
        masses = (rows.real[:, :3] * moved).sum(axis=0)
    masses, sizes = model.comm.allreduce(np.array([masses, np.abs(diagonal_of(model.M)) @ moved]))
    return model.comm.bcast(bool((masses >= ON_DIAGONAL * sizes).all()))


def _enumerated(words) -> str:
    """ "x, y and z"."""
    return f"{', '.join(words[:-1])} and {words[-1]}"


def misfit_of_nodes(model) -> str | None:
    """Return a sentence where the nodes seem not to belong to the rows, or None. Collective.

    A rigid motion of the nodes meets no force but at supports. Where K resists rotations and no translation, or resists
    in most rows, the coordinates or the directions are those of other rows, or of other units than K.
    """
    motions = rigid_motions(model, _middle(model))
    force = np.sqrt(np.abs(np.diag(_forces(model, motions)[0])))
    with local_rows(times(model.K, motions)) as forces, local_rows(motions) as moved:
        reach = np.max(model.comm.allgather(np.abs(moved.real).max(axis=0, initial=0.0)), axis=0)
        norm = model.K.norm(PETSc.NormType.INFINITY)
        resisted = (np.abs(forces.real) > FORCE_FREE * norm * np.maximum(reach, 1e-300)).any(axis=1)
    share = model.comm.allreduce(int(resisted.sum())) / model.size
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
            "nodes or directions are not those of the rows, or K is that of a preloaded or spinning body"
            + ("" if model.is_symmetric("K") else ", or circulatory forces act nearly everywhere")
        )
    return None


def _middle(model):
    """Return the mean position of the rows (3,). Collective."""
    dofs = require_dofs(model, "a rigid-body motion")
    return model.comm.allreduce(dofs.position.sum(axis=0)) / model.size
