"""Decide whether a body is free or held: how K resists the rigid-body motions of the nodes.

What K makes of a motion R is compared row by row with what the entries of the row would give if they did not cancel,
|K| |R|. Round-off, the digits of K in its file, and those of the nodes, leave a part of that which is bounded; a spring
to the ground leaves more in its rows, however large the body is. Everything that asks whether a body is free asks here.
All functions are collective.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fe.dofs import SCALAR
from ...linalg.blocks import column_norms, inner, local_rows, multiply, times
from ...linalg.csr import diagonal_of
from ...linalg.matrix_estimates import entries_of
from ...parallel.decisions import decided
from ...parallel.petsc import MPI, PETSc
from ..digits import digits_of, digits_of_numbers
from .motions import middle, rigid_motions
from .rows_alone import rows_alone

ROUND_OFF = 5e-11  # of |K| |R|: more than elements leave of motions, where those of most rows leave less
SOFT = 1e-7  # of |K| |R|: supports that meet less may be left out of a frame, which says so
MOST_ROUND_OFF = 3e-8  # of |K| |R|, that half of the rows meet a MANY-th of: round-off of a program
MANY = 100.0
FEWEST_ENTRIES = 10  # distinct ones of K that tell its digits
OF_NODES = {"fewest": 4, "distinct": 10, "nearly_all": 0.8, "many": 0.1}  # digits of coordinates: fewer were chosen
SINGLE = 2.0**-24  # relative round-off of single precision
LAST_BITS = 0xFF  # of a number of single precision, which those that were chosen do not need
SAME_MOTION = 1e-10  # squared sine of the angle between motions of nodes on a line that are one
AT_ONCE = 10_000  # rows
BINS, PER_DECADE, LOWEST = 80, 4, -18.0  # of a histogram of the decimal logarithm of forces


@dataclass(frozen=True, eq=False)
class Support:
    """How K resists rigid-body motions R of the nodes: translations along and rotations about x, y, z, about `centre`.

    `residuals` (6,): ||K R|| / (||K|| ||R||), NaN where no dof moves; `forces` (6,): the largest part of |K| |R| that
    a row meets; `round_off` (2,): how much of that is none, for translations and for rotations; `node_digits`: decimal
    digits of the coordinates, or None where they have all; `free` (6, f): the combinations of R, independent, that meet
    no force but for that; `movable` (6, m): those that meet none or next to none, SOFT; `resisting`: share of the rows
    that meet a force.
    """

    centre: np.ndarray
    residuals: np.ndarray
    forces: np.ndarray
    round_off: np.ndarray
    node_digits: int | None
    free: np.ndarray
    movable: np.ndarray
    resisting: float

    @property
    def resists_translations(self) -> bool:
        """Whether a translation meets a force."""
        return bool((self.forces[:3] > self.round_off[0]).any())

    @property
    def softness(self) -> float:
        """The largest part of |K| |R| that translations meet of a softly held body, else 0."""
        soft = self.movable.shape[1] > self.free.shape[1]
        return float(self.forces[:3].max()) if soft else 0.0

    @property
    def by_digits(self) -> bool:
        """Whether rotations are free only since the nodes have so few digits."""
        rotations = self.forces[3:]
        return self.node_digits is not None and self.round_off[0] < rotations.max() <= self.round_off[1]


def support_of(model) -> Support:
    """Return how K of a model with nodes resists rigid-body motions."""
    comm, centre = model.comm, middle(model)
    motions = rigid_motions(model, centre)
    reach = _reach(model, centre)
    # rotations by 1 / reach, which move nodes by 1 at most
    unit = np.repeat([1.0, 1.0 / reach], 3)
    multiply(motions, np.diag(unit))
    product = times(model.K, motions)
    with local_rows(product) as rows, local_rows(motions) as moved:
        met = np.abs(rows.real) / _scale_of_rows(model, reach)[:, None]
        # rows by themselves, such as drilling rotations of flat shells, do not hold others
        alone = np.isin(np.arange(len(met)), rows_alone(model))
        others = np.any(comm.allgather((np.abs(moved[~alone]) > 0).any(axis=0)), axis=0)
        met[np.ix_(alone, others)] = 0.0
        signed = np.sign(rows.real) * met
    # what round-off and digits leave
    digits, of_nodes = _error_of_rotations(model, reach)
    least = max(ROUND_OFF, _error_of_entries(model.K))
    common = [MANY * _median(comm, met[:, directions].max(axis=1)) for directions in (slice(3), slice(3, 6))]
    seen = np.minimum(common, MOST_ROUND_OFF)
    # few digits of nodes leave forces in most rows, supports in some: those of a grid are few, without an error
    round_off = np.array([max(least, seen[0]), max(least, seen[1], min(of_nodes, common[1]))])
    # combinations that no row resists, but for that
    overlaps, sizes = inner(motions, motions), column_norms(motions)
    none, little = np.repeat(round_off, 3), np.maximum(np.repeat(round_off, 3), SOFT)
    free, movable = (_unresisted(comm, signed, limit, overlaps, unit) for limit in (none, little))
    with np.errstate(invalid="ignore", divide="ignore"):
        residuals = column_norms(product) / sizes / (model.K.norm(PETSc.NormType.INFINITY) or 1.0)
    resisting = comm.allreduce(int((met > none).any(axis=1).sum())) / model.size
    largest = np.max(comm.allgather(met.max(axis=0, initial=0.0)), axis=0)
    return Support(centre, np.where(_moves(overlaps), residuals, np.nan), largest, round_off, digits, free, movable,
                   resisting)  # fmt: skip


def _reach(model, centre) -> float:
    """Return the largest distance of a node from the centre; of a single node the length by which its rotations are as
    stiff as its translations."""
    dofs = model.dofs
    far = model.comm.allreduce(float(np.abs(dofs.position - centre).max(initial=0.0)), op=MPI.MAX)
    if far > np.finfo(float).eps * np.abs(centre).max():
        return far
    stiffness = np.abs(diagonal_of(model.K))
    sums = [float(stiffness[chosen].sum()) for chosen in (dofs.direction < 3, _turns(dofs))]
    moved, turned = model.comm.allreduce(np.array(sums))
    return float(np.sqrt(turned / moved)) if moved and turned else 1.0


def _turns(dofs):
    return (dofs.direction >= 3) & (dofs.direction < SCALAR)


def _moves(overlaps):
    """Return which motions (6,) move a dof: rotations of nodes at one place, or on a line, may not."""
    sizes = np.diag(overlaps).real
    return sizes > SAME_MOTION**2 * sizes.max(initial=0.0)


def _scale_of_rows(model, reach):
    """Return |K| |R| of the rows of this rank for motions of 1, at least the geometric mean of rows of its kind: a weak
    spring on a dof that nothing else holds is no support. Infinite where K has nothing."""
    indptr, indices, values = model.K.getValuesCSR()
    moved = model.K.createVecRight()
    moved.setArray(np.select([model.dofs.direction < 3, _turns(model.dofs)], [1.0, 1.0 / reach], 0.0))
    of_columns = entries_of(moved, indices)
    moved.destroy()
    sizes = np.zeros(len(indptr) - 1)
    for start in range(0, len(sizes), AT_ONCE):  # what is made of all at once takes as much memory as K
        ends = indptr[start : start + AT_ONCE + 1]
        here = slice(ends[0], ends[-1])
        rows = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
        products = np.abs(values[here]) * of_columns(indices[here])
        sizes[start : start + AT_ONCE] = np.bincount(rows, products, len(ends) - 1)
    for kind in (model.dofs.direction < 3, _turns(model.dofs)):
        there = kind & (sizes > 0)
        total, count = model.comm.allreduce(np.array([np.log(sizes[there]).sum(), there.sum()]))
        if count:
            sizes[there] = np.maximum(sizes[there], np.exp(total / count))
    return np.where(sizes > 0, sizes, np.inf)


def _error_of_entries(K) -> float:
    """Return how much of |K| |R| the digits of K may leave."""
    digits = digits_of(K, distinct=FEWEST_ENTRIES)
    if digits is not None:
        return 5.0 * 10.0**-digits
    return SINGLE if is_single(K) else 0.0


def is_single(mat) -> bool:
    """Test whether the entries of a matrix were rounded to single precision: half of them to all of its bits."""
    first, last = mat.getOwnershipRange()
    values = np.concatenate([np.zeros(1), *(mat.getRow(row)[1].real for row in range(first, min(last, first + 16)))])
    with np.errstate(over="ignore"):
        short = values.astype(np.float32)
    all_bits, there = (short.view(np.uint32) & LAST_BITS) > 0, values != 0
    counts = [(values != short).sum(), all_bits.sum(), there.sum()]
    others, rounded, total = mat.comm.tompi4py().allreduce(np.array(counts))
    return bool(not others and 0 < total <= 2 * rounded)


def _error_of_rotations(model, reach) -> tuple[int | None, float]:
    """Return the digits of the coordinates, None for many, and how much of |K| |R| they leave of rotations."""
    position = model.dofs.position[model.dofs.direction < SCALAR]
    digits = digits_of_numbers(model.comm, np.unique(position), **OF_NODES)
    sizes = np.abs(position[position != 0])
    if digits is None:
        error = float(np.spacing(sizes).max(initial=0.0))
    else:
        error = float((5.0 * 10.0 ** (np.floor(np.log10(sizes)) - digits)).max(initial=0.0))
    return digits, model.comm.allreduce(error, op=MPI.MAX) / reach


def _median(comm, values) -> float:
    """Return the median of numbers on all ranks within the width of a bin of a histogram, 0 for most of them zero."""
    places = np.log10(np.maximum(values, 10.0**LOWEST)) - LOWEST
    counts = comm.allreduce(np.bincount(np.minimum(PER_DECADE * places, BINS - 1).astype(int), minlength=BINS))
    place = int(np.searchsorted(np.cumsum(counts), counts.sum() / 2))
    return 10.0 ** (LOWEST + (place + 1) / PER_DECADE) if place else 0.0


def _unresisted(comm, met, limit, overlaps, unit):
    """Return the combinations (6, count) of unit motions of which no row meets more than `limit` (6,).

    `met` (rows of this rank, 6): parts of |K| |R| that rows meet; `overlaps`: R^T R of the same motions, `unit` (6,)
    their size. By QR of the rows that resist, rank by rank, since squares would lose half of the digits.
    """
    rows = met[(np.abs(met) > limit).any(axis=1)] / limit
    triangles = comm.gather((np.linalg.qr(rows, mode="r"), len(rows)))
    return decided(comm, _null_space, triangles, limit, overlaps) * unit[:, None]


def _null_space(triangles, limit, overlaps):
    """Return the combinations of motions that meet no more than the limit in the rows of all ranks; local."""
    # independent motions: a turn about the line on which all nodes are is none
    moves = _moves(overlaps)
    scale = np.where(moves, 1 / np.sqrt(np.where(moves, np.diag(overlaps), 1.0)), 0.0)
    values, vectors = np.linalg.eigh(overlaps * np.outer(scale, scale))
    moving = scale[:, None] * vectors[:, values > SAME_MOTION]
    # in units of the limit
    basis = np.linalg.qr(limit[:, None] * moving)[0]
    resist, count = np.concatenate([triangle for triangle, _ in triangles]), sum(rows for _, rows in triangles)
    sizes, turn = np.zeros(basis.shape[1]), np.eye(basis.shape[1])
    if count:
        met, turn = np.linalg.svd(resist @ basis)[1:]
        sizes[: len(met)] = met
    return (basis @ turn.T)[:, sizes <= np.sqrt(count)] / limit[:, None]
