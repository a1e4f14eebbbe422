"""Compute the rigid-body modes of a body from the positions of its nodes: an M-orthonormal basis of ker K."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fe.dofs import SCALAR
from ...linalg.basis import Basis
from ...linalg.blocks import add_product, column_norms, copy_of, create_block, inner, local_rows, multiply, times
from ...linalg.csr import diagonal_of
from ...parallel.decisions import decided
from ...parallel.failures import InputError
from ...parallel.petsc import MPI, PETSc, SLEPc
from .motions import middle, rigid_motions
from .support import Support, support_of

NO_MASS = 1e-12  # of the largest mass: round-off
SAME_MASS = 1e-6  # relative difference of the masses in x, y, z that the digits of a text file explain
ROUND_OFF = 1e-10
EXACTLY_FREE = 32 * np.finfo(float).eps  # of the entries of a row: what motions that are guessed may meet of force
SILENT = 1e-6  # sum of a row over that of its absolute values, below which it is zero to the digits of a file
ON_DIAGONAL = 0.5  # of the diagonal of a mass matrix: less than any element's mass, more than what supports resist
FEW = 0.02  # share of rows of a mass matrix that may be so
FEWEST_NODES = 3  # of a body of which something can be said by the rows that resist
MOST_ROWS = 0.6  # share of rows in which supports are not believed
COMPARED = 600  # dofs at which forces are compared, on one rank
MOST_NODES = 1 / 3  # of all may differ, or nothing is said
SOLVED = 1e-5  # of the forces that may be left
DIFFERS = 1e-4  # of the largest change of a node
NULL = 1e-10  # singular value, relative to the largest
ROUNDS = 60  # of reweighting
NAMED = 5


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
        motions = rigid_motions(model, centre)
        body = rigid_body_of(inner(motions, times(model.M, motions)))
        if body.masses.min() < 0 or body.mass == 0:
            listed = ", ".join(f"{mass:g}" for mass in body.masses)
            raise InputError(
                exchange_of_matrices(model)
                or f"{model.name}: the translational masses in x, y, z are {listed} kg, expected none negative and not "
                "all zero; check the mass matrix and the order of its rows"
            )
        centre = centre + np.nan_to_num(body.centre)
    return RigidBody(body.masses, np.where(np.isnan(body.centre), np.nan, centre), body.inertia)


class RigidBodyModes:
    """The force-free rigid-body motions of a model, M-orthonormal: R^T M R = I, K R = 0.

    `R` (n, count) and `MR` = M R as blocks. `count`: 0 for a supported body to 6 for a free one. `supports`: global
    rows of this rank, `count` over all ranks, that leave no rigid motion when held. `support`: how K resists the six
    motions; `defect`: their largest ||K R|| / (||K|| ||R||). With `soft` those that meet next to no force count as
    well. Collective throughout.
    """

    def __init__(self, model, soft=False):
        self._first, self._k = model.first_row, model.K
        self.R = self.MR = None
        self.support = support_of(model)
        self.defect = float(np.nanmax(self.support.residuals))
        free = self.support.movable if soft else self.support.free
        motions = rigid_motions(model, self.support.centre)
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


def acts_on_free_motions(model, mat) -> bool:
    """Test whether a matrix (n, n), on the pattern of K, resists or pushes rigid-body motions that K leaves free.
    Collective."""
    norm, size = (each.norm(PETSc.NormType.INFINITY) for each in (model.K, mat))
    if not size or model.dofs is None:
        return False
    both = model.K.copy()
    both.axpy((norm or 1.0) / size, mat, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
    with model.with_fields(K=both) as supported:
        return support_of(supported).movable.shape[1] < support_of(model).movable.shape[1]


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
        support = support_of(model)
        motions, free = rigid_motions(model, support.centre), support.free
    if not free.shape[1]:
        return np.zeros((0, loads.getActiveColumns()[1]))
    mass = free.T @ inner(motions, times(model.M, motions)) @ free
    work = free.T @ inner(motions, loads)
    size = np.sqrt(np.diag(free.T @ inner(motions, motions) @ free))[:, None] * column_norms(loads)
    work[np.abs(work) <= ROUND_OFF * size] = 0.0
    values, vectors = np.linalg.eigh(mass)
    moving = values > NO_MASS * values[-1]
    return (vectors[:, moving] / np.sqrt(values[moving])).T @ work


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
    forced, moves = (model.comm.allreduce(flags, op=MPI.BOR) for flags in (forced, moves))
    return np.eye(len(forced))[:, moves & ~forced]


def _sizes_of_rows(mat):
    """Return sums of the absolute values of the rows of this rank."""
    indptr, _, values = mat.getValuesCSR()
    return np.bincount(np.repeat(np.arange(len(indptr) - 1), np.diff(indptr)), np.abs(values), len(indptr) - 1)


def warnings_of_nodes(model) -> list[str]:
    """Return sentences where the nodes seem not to belong to the rows, or the masses in x, y and z differ. Collective.

    A direction in which no node has a dof has no mass to compare. Dofs that are held in some directions only make a
    difference of masses that is none of the nodes.
    """
    misfit, masses = misfit_of_nodes(model), rigid_body_quantities(model).masses
    warnings = [misfit] if misfit else []
    there = masses[masses > 0]
    held = model.comm.allreduce(0 if model.held is None else len(model.held.node))
    if there.size and not held and np.ptp(there) > SAME_MASS * there.max():
        names = _enumerated([name for name, mass in zip("xyz", masses, strict=True) if mass > 0])
        warnings.append(
            f"{model.name}: the masses in {names} are {_enumerated([f'{mass:.6g}' for mass in there])} kg, expected "
            "the same: nodes or directions are not those of the rows, supports hold some directions only, or the mass "
            "matrix is not one of a body"
        )
    return warnings


def exchange_of_matrices(model) -> str | None:
    """Return a sentence where M is a stiffness and K a mass matrix, or None. Collective.

    A translation loads a stiffness at supports only, and a mass matrix in all rows of its direction: where it loads K
    in nearly all and M in few they have been exchanged. Without nodes that is asked of equal displacements of all dofs,
    which are a translation where dofs are displacements.
    """
    known = model.dofs is not None
    motions = rigid_motions(model, middle(model)) if known else create_block(model.K, 1)
    with local_rows(motions) as rows:
        if not known:
            rows[...] = 1.0
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
        f"{model.name}: K AND M ARE EXCHANGED: {'a translation' if known else 'an equal displacement of all dofs'} "
        f"meets nothing in {100 * of_m / total:.0f} % of the rows of M, as in a stiffness matrix, and in "
        f"{100 * of_k / total:.0f} % of those of K; give each for the other"
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
    in most rows, the coordinates or the directions are those of other rows, or of other units than K. Where K has as
    many motions without force as a free body, these name the nodes that differ.
    """
    support = support_of(model)
    moving = np.isfinite(support.residuals)
    if support.movable.shape[1] == moving.sum() or not support.resisting:
        return None
    residual = f"||K R|| / (||K|| ||R||) = {np.nanmax(support.residuals):.1e}"
    fault = f"{model.name}: {residual} for rigid-body motions R of the nodes"
    if named := nodes_that_differ(model, support):
        return f"{fault}: {named}"
    if not support.resists_translations:
        return (
            f"{fault}, though K resists no translation: the nodes are not those of the rows; check the "
            "order of nodes against that of rows, and that all coordinates are in one unit and one system of axes"
        )
    if support.resisting > MOST_ROWS and model.node_count >= FEWEST_NODES:
        return (
            f"{fault}, in {100 * support.resisting:.0f} % of the rows: the body is held almost "
            "everywhere, or the nodes or directions are not those of the rows, or K is that of a preloaded or spinning "
            "body" + ("" if model.is_symmetric("K") else ", or unsymmetric forces act nearly everywhere")
        )
    return None


def remark_on_digits(support: Support) -> str | None:
    """Return a sentence where a body is free only to the digits of its nodes, or None."""
    if not support.by_digits:
        return None
    return (
        f"the coordinates of the nodes have {support.node_digits} digits, which is why rotations meet up to "
        f"{support.forces[3:].max():.0e} of K; take a list with more digits where rigid-body motions matter"
    )


# Name the nodes at which the motions that K lets happen without force are not the rigid motions of the node list.
# A node whose rows are in other axes, or whose coordinates are others, makes K resist the rigid motions R of the nodes.
# If K is that of a free body, R + E d meets no force, with a change d of the motion of these nodes alone: K E d = - K R
# is solved for all nodes in whose rows there is a force, which are these nodes and their neighbours.


def nodes_that_differ(model, support) -> str | None:
    """Return a sentence that names them, or None where K is not that of a free body, or they are many. Collective."""
    comm, dofs = model.comm, model.dofs
    motions = rigid_motions(model, support.centre)
    forces = times(model.K, motions)
    # the rows of all nodes that meet a force
    limit = np.repeat(support.round_off, 3)
    with local_rows(forces) as view:
        rows = view.real.copy()
    sizes = np.abs(model.K.getDiagonal().getArray().real)
    met = np.abs(rows) > np.maximum(limit, DIFFERS**2) * np.maximum(sizes, np.finfo(float).tiny)[:, None]
    nodes = np.unique(np.concatenate(comm.allgather(np.unique(dofs.node[met.any(axis=1)])[: COMPARED + 1])))
    mine = np.flatnonzero(np.isin(dofs.node, nodes) & (dofs.direction < SCALAR))
    if not 0 < comm.allreduce(len(mine)) <= COMPARED:
        return None
    entries = [model.K.getRow(int(model.first_row + row)) for row in mine]
    resisted = np.any(comm.allgather(met.any(axis=0)), axis=0)
    by_rank = comm.gather((
        model.first_row + mine, dofs.node[mine], rows[np.ix_(mine, resisted)],
        [(columns, values.real) for columns, values in entries],
    ))  # fmt: skip
    # translations do not depend on coordinates
    return decided(comm, _named, by_rank, model.node_count, bool(resisted[:3].any()))


def _named(by_rank, count, turned):
    """Return the sentence from what the ranks have of the rows: their numbers, nodes, forces, and entries of K; of
    `count` nodes; `turned`: whether axes differ, or else places; local."""
    row, node, forces = (np.concatenate([of_rank[k] for of_rank in by_rank]) for k in range(3))
    entries = [entry for of_rank in by_rank for entry in of_rank[3]]
    # K E by the symmetry of K, on all rows that it reaches
    reached = np.unique(np.concatenate([row, *[columns for columns, _ in entries]]))
    K = np.zeros((len(reached), len(row)))
    for k, (columns, values) in enumerate(entries):
        K[np.searchsorted(reached, columns), k] = values
    right = np.zeros((len(reached), forces.shape[1]))
    right[np.searchsorted(reached, row)] = -forces
    # rows and columns of about one size
    unit = 1 / np.sqrt(np.maximum(np.abs(K[np.searchsorted(reached, row), np.arange(len(row))]), 1e-300))
    sizes = np.abs(K * unit).sum(axis=1)
    scale = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > 0)[:, None]
    size = np.maximum(np.linalg.norm(right * scale, axis=0), 1e-300)
    change, null = _solutions(K * unit * scale, right * scale / size)
    left = K * unit * scale @ change - right * scale / size
    if np.linalg.norm(left, axis=0).max() > SOLVED:
        return None  # supports resist
    places = [np.flatnonzero(node == number) for number in np.unique(node)]
    change = unit[:, None] * _on_few(change, null, places) * size
    # nodes whose motion changes
    sizes = np.array([np.linalg.norm(change[place]) for place in places])
    differ = np.flatnonzero(sizes > DIFFERS * sizes.max())
    if len(differ) > MOST_NODES * count:  # without the others nothing is known of these
        return None
    numbers = [str(int(np.unique(node)[k])) for k in differ]
    listed = ", ".join(numbers[:NAMED]) + (f" and {len(numbers) - NAMED} more" if len(numbers) > NAMED else "")
    many, why = len(numbers) > 1, "in other axes" if turned else "those of another place"
    return (
        f"K is that of a free body, whose motions without force are rigid ones of all nodes but {listed}: the rows of "
        f"{'these nodes' if many else 'this node'} are {why} than the list of nodes says"
        + ("; give all rows in the axes of the coordinates" if turned else "; check the coordinates")
    )


def _solutions(matrix, right):
    """Return the smallest least-squares solution, and the null vectors (columns, k) of a matrix."""
    left, values, turn = np.linalg.svd(matrix, full_matrices=False)
    there = values > NULL * values[0]
    return turn[there].T @ ((left[:, there].T @ right) / values[there, None]), turn[~there].T


def _on_few(change, null, places):
    """Return the solution change + null c that is zero at most places, by reweighted least squares."""
    if not null.shape[1]:
        return change
    corrected = change
    for _ in range(ROUNDS):
        sizes = np.array([np.linalg.norm(corrected[place]) for place in places])
        weights = np.zeros(len(change))
        for place, size in zip(places, sizes, strict=True):
            weights[place] = 1 / np.sqrt(size + 1e-8 * sizes.max())
        c = np.linalg.lstsq(weights[:, None] * null, -weights[:, None] * change, rcond=None)[0]
        corrected = change + null @ c
    return corrected
