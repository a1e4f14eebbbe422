"""Reduce a model by a two-sided projection (20), with bi-orthogonal bases: W^T M V = I."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from ..linalg.blocks import inner
from ..linalg.pencil import MASSLESS, squared_frequencies
from ..model.damping import ModalDamping
from ..model.digits import warnings_of_digits
from ..model.operator import Operator
from ..parallel.decisions import decided
from ..parallel.failures import ComputationError, InputError
from .basis_reductor import BasisReductor
from .result.massless import ROUND_OFF
from .run.projection import Projection, diagonalise, diagonalise_with_massless, project, project_columns
from .small.damping import reduced_damping

LOST = 1e-10  # singular value of W^T M V below which a pair of directions cannot be made bi-orthogonal


@dataclass(frozen=True, kw_only=True)
class TwoSidedReductor(BasisReductor):
    """Reduce by a two-sided projection: W from the output Krylov subspaces (33), so that more moments match."""

    projection = "two_sided"

    def check(self, model):
        if self.settings.drop_above is not None or isinstance(self.damping, ModalDamping):
            raise InputError(
                "projection: 'two_sided' leaves no diagonal model, which drop_above and modal damping need; "
                "take 'one_sided'"
            )
        if self.settings.coordinates == "interface":
            raise InputError("projection: interface coordinates belong to a one-sided projection; leave it out")
        if model.added:
            raise InputError(f"projection: 'two_sided' has no place for the {model.added.plural} of {model.name}; take "
                             "'one_sided', or a tolerance")  # fmt: skip
        return super().check(model)

    def project(self, setup, spaces):
        return two_sided(setup.model, setup.framed, *spaces.bases, spaces.runs[0])


def two_sided(model, framed, right, left, run) -> Projection:
    """Return W^T A V (20), W^T B and C V of a model in its frame, and change both bases so that W^T M V = I.
    Collective. Raises ComputationError."""
    full, static = framed.model, 0
    # V^T K V = diag(omega^2) (53, 54), of which the digits of K leave so many
    if run.tau:
        eigenvalues, _ = diagonalise_with_massless(right, run.mass, partial(project, full.K), run.tau)
    else:
        eigenvalues = diagonalise(right, project(full.K, right.columns))
    run.notes.remarks += warnings_of_digits(model, full.K, eigenvalues, right.columns)
    # W^T M V = I, but for the last columns where some have no mass
    if run.tau:
        static = biorthogonal_with_massless(left, right, run)
        moving = right.size - static
        gram = project(run.mass, right.columns, left.columns)[:moving, :moving]
        defect = float(np.abs(gram - np.eye(moving)).max(initial=0.0))
    else:
        defect = biorthogonal(left, right, run)
    # W^T A V of the terms, and squared pseudo-frequencies
    V, W = right.columns, left.columns
    small = {key: project(mat, V, W) for key, mat in full.matrices.items()}
    moving = len(small["K"]) - static
    squares = np.sort(np.abs(np.linalg.eigvals(small["K"][:moving, :moving])))
    if static:
        only_static(small, static, run.tau)
        squares = np.append(squares, squared_frequencies(np.ones(static), np.zeros(static), run.tau))
    frequencies = np.sqrt(squares) / (2 * np.pi)
    if "D" not in small:
        small["D"] = reduced_damping(framed.damping, small["K"], frequencies, small["M"])
    B, C = project_columns(W, full.B), project_columns(V, full.Ct).T.copy()
    return Projection(Operator.of(**small), B, C, frequencies, V, defect, W)


def biorthogonal(left, right, run) -> float:
    """Change the mass-orthonormal bases W and V so that W^T M V = I; returns max |W^T M V - I|. Collective.

    Directions of one space that are M-orthogonal to the other one are dropped and reported; where the spaces have
    different sizes, the larger loses the difference.
    """
    u, values, vt = decided(run.model.comm, np.linalg.svd, inner(left.columns, run.times_mass(right.columns)))
    kept = int((values > LOST).sum())
    if kept == 0:
        raise ComputationError("the input and the output subspace are M-orthogonal: no two-sided model exists")
    scale = 1.0 / np.sqrt(values[:kept])
    run.note("bi-orthogonal pairs", max(left.size, right.size), kept)
    left.multiply(u[:, :kept] * scale)
    right.multiply(vt[:kept].T * scale)
    gram = inner(left.columns, run.times_mass(right.columns))
    return float(np.abs(gram - np.eye(kept)).max())


def biorthogonal_with_massless(left, right, run) -> int:
    """Change bases W and V so that W^T M V = diag(I, 0) and W^T K V = diag(K_m, I / tau^2), and W^T D V has a block of
    zeros for what it does not damp among the last columns, which have no mass; returns how many these are. Collective.

    Directions of one space that have no partner in the other one are dropped and reported, as in biorthogonal().
    """
    V, W, full, size = right.columns, left.columns, run.model, max(left.size, right.size)
    D = project(full.matrices["D"], V, W) if "D" in full.matrices else None
    K, M = (project(mat, V, W) for mat in (full.K, run.mass))
    to_left, to_right, static = decided(run.model.comm, _paired, K, M, D, run.tau)
    run.note("bi-orthogonal pairs", size, to_left.shape[1])
    left.multiply(to_left)
    right.multiply(to_right)
    return static


def _paired(K, M, D, tau):
    """Return factors (l, k) of W and (m, k) of V for biorthogonal_with_massless(), of W^T K V (l, m) and so on, and how
    many columns have no mass."""
    # pairs of the inner product
    left, right = _scaled_pairs(M + tau**2 * K)
    if not left.shape[1]:
        raise ComputationError("the input and the output subspace are orthogonal: no two-sided model exists")
    # those with mass first
    u, masses, vt = np.linalg.svd(left.T @ M @ right)
    moving = int((masses > MASSLESS).sum())
    scale = 1 / np.sqrt(masses[:moving])
    W, V = left @ u[:, :moving] * scale, right @ vt[:moving].T * scale
    still = left @ u[:, moving:], right @ vt[moving:].T
    # stiffness of those without, what D does not act on last
    factors = _scaled_pairs(tau**2 * still[0].T @ K @ still[1])
    still = [block @ factor for block, factor in zip(still, factors, strict=True)]
    if D is not None:
        turns = _undamped_last(still[0].T @ D @ still[1], tau)
        still = [block @ turn for block, turn in zip(still, turns, strict=True)]
    # nothing between both
    W0, V0 = still
    coupled = W.T @ K @ V0, W0.T @ K @ V
    W, V = W - tau**2 * W0 @ coupled[0].T, V - tau**2 * V0 @ coupled[1]
    return np.hstack([W, W0]), np.hstack([V, V0]), W0.shape[1]


def _scaled_pairs(matrix):
    """Return factors (l, k) and (m, k) that make the identity of a matrix (l, m), without its smallest singular values.
    """
    u, values, vt = np.linalg.svd(matrix, full_matrices=False)
    kept = values > LOST
    scale = 1 / np.sqrt(values[kept])
    return u[:, kept] * scale, vt[kept].T * scale


def _undamped_last(D, tau):
    """Return factors L and R (k, k), L^T R = I, with L^T D R = diag(D_1, 0) but for round-off."""
    from scipy.linalg import schur  # which most models do without

    if not len(D):
        return D, D
    least = max(MASSLESS / tau, ROUND_OFF * np.abs(D).max())
    T, Z, count = schur(D, sort=lambda re, im: np.hypot(re, im) > least)
    coupled = np.eye(len(D))
    coupled[:count, count:] = -np.linalg.solve(T[:count, :count], T[:count, count:])
    right = Z @ coupled
    return np.linalg.inv(right).T, right


def only_static(small, static, tau):
    """Put in what the last `static` coordinates have: no mass, the stiffness 1 / tau^2, and damping where there is
    some."""
    moving = len(small["K"]) - static
    for key, block in (("M", np.zeros((static, static))), ("K", np.eye(static) / tau**2)):
        small[key][moving:] = small[key][:, moving:] = 0.0
        small[key][moving:, moving:] = block
    if "D" in small:
        D = small["D"]
        undamped = np.arange(moving, len(D))[np.abs(D[moving:, moving:]).max(axis=1) * tau <= np.sqrt(MASSLESS)]
        rest = max(np.abs(D[undamped]).max(initial=0.0), np.abs(D[:, undamped]).max(initial=0.0))
        if rest <= ROUND_OFF * np.abs(D).max():
            D[undamped] = D[:, undamped] = 0.0
