"""Take coordinates without mass for what they are: static deflection, or states of first order.

Of dofs without mass a reduced model has coordinates that no mass belongs to. In its own coordinates M = diag(I, 0),
K is diagonal, and so is D among those without mass. Responses and second-order forms keep them; where states are needed
they are eliminated exactly. What no damping acts on follows the forces at once,

    K_z x_z = B_z u - K_zo x_o,      y = ... + C_z K_z^-1 B_z u   (feedthrough),

and what is damped, D_f x_f' + K_f x_f = B_f u - ..., is a state of first order: with w' = x_f it is of second order in
w, whose own value acts on nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...linalg.eigensolver import symmetric_part
from ...linalg.pencil import MASSLESS, time_of
from ...model.operator import Operator
from ...parallel.failures import InputError

NO_MASS = 1e-12  # of M with a unit diagonal of M + tau^2 K: eigenvalues up to it are round-off
ROUND_OFF = 1e-9  # of damping beside stiffness, and of what has no place in states


class WithMass(NamedTuple):
    """An equal model (`reduced`) whose M is regular, the `feedthrough` (r, p) of its outputs, and how many of its last
    coordinates are integrals of displacements, with their integral alone in no equation (`integrals`)."""

    reduced: object
    feedthrough: np.ndarray
    integrals: int


def without_round_off(D: np.ndarray, static: int, tau: float) -> np.ndarray:
    """Return D (m, m) with zeros for those of the last `static` coordinates, with tau^2 K = 1, that it does not act
    on."""
    free = np.flatnonzero(np.diag(D)[len(D) - static :] * tau <= MASSLESS) + len(D) - static
    sizes = np.sqrt(np.maximum(np.diag(D), 0.0))
    rest = np.maximum(np.abs(D), np.abs(D).T)[free]
    # of a semidefinite D what couples is at most the root of both
    if (rest <= np.outer(np.maximum(sizes[free], np.sqrt(MASSLESS / tau)) if tau else 0.0, sizes + 1e-300)).all():
        D[free] = D[:, free] = 0.0
    return D


def static_coordinates(reduced) -> int:
    """Return how many coordinates of a model have no mass."""
    return int((~reduced.M.any(axis=0)).sum())


def require_mass(reduced, where: str):
    """Raise InputError for a model with coordinates without mass, which `where` (such as "a SID file") cannot contain.
    """
    if count := static_coordinates(reduced):
        finite = reduced.frequencies[:-count].max(initial=0.0)
        leave = f"drop_above = {1.01 * finite:.4g} leaves them out, and counts what that does to the error: "
        raise InputError(
            f"the reduced body has {count} coordinates without mass, the static deflection or the dampers of dofs "
            f"without mass, for which {where} has no place; {leave * bool(finite)}reduce again, give these dofs some "
            "mass, or take a state space, an FMU or arrays (npz, mat), which hold all"
        )


def with_mass(reduced, where="a state space") -> WithMass:
    """Return a model with a regular M that has the same responses. Raises InputError, which names `where` it was to go,
    for outputs that are rates of static deflections, and for damping that couples them."""
    none = np.zeros((len(reduced.C), reduced.B.shape[1]))
    still, others = _kernel(reduced)
    if not still.shape[1]:
        return WithMass(reduced, none, 0)
    # coordinates: with mass, damped without mass, static
    tau = time_of(reduced.K, reduced.M)
    K = still.T @ reduced.K @ still
    factor = np.linalg.inv(np.linalg.cholesky((K + K.T) / 2))
    still = still @ factor.T
    of_still = still.T @ reduced.D @ still
    _, times_of, turn = np.linalg.svd(np.vstack([of_still, of_still.T]))  # symmetric but for two-sided projections
    still, damped = still @ turn.T, int((times_of > MASSLESS * tau).sum())
    X, m = np.hstack([others, still]), others.shape[1]
    stop = m + damped
    M, D, K = (X.T @ getattr(reduced, key) @ X for key in "MDK")
    B, outputs = X.T @ reduced.B, reduced.output_parts @ X
    M[m:] = M[:, m:] = 0.0
    K, D, B, outputs, feedthrough = _without_static(K, D, B, outputs, stop, where)
    C, Cv, Ca = outputs
    # what is damped as w' = x_f, of second order in w
    if damped:
        if np.abs(Ca[:, m:]).max() > ROUND_OFF * max(np.abs(Ca).max(), 1e-300):
            raise InputError(_refused(where, "accelerations of dampers without mass"))
        zero = np.zeros((damped, damped))
        M, D, K = (
            np.block([[M[:m, :m], D[:m, m:]], [np.zeros((damped, m)), D[m:, m:]]]),
            np.block([[D[:m, :m], K[:m, m:]], [D[m:, :m], K[m:, m:]]]),
            np.block([[K[:m, :m], np.zeros((m, damped))], [K[m:, :m], zero]]),
        )
        C, Cv, Ca = (np.hstack(pair) for pair in (
            (C[:, :m], np.zeros((len(C), damped))), (Cv[:, :m], C[:, m:]), (Ca[:, :m], Cv[:, m:]),
        ))  # fmt: skip
    else:
        M = M[:m, :m]
    regular = replace(
        reduced, operator=Operator.of(M, D, K, reduced.added), B=B, C=C, Cv=Cv if Cv.any() else None,
        Ca=Ca if Ca.any() else None, frequencies=np.resize(reduced.frequencies[:m], len(M)), interfaces=(),
        columns=None, left_columns=None, model=None,
    )  # fmt: skip
    return WithMass(regular, feedthrough, damped)


def first_order(reduced) -> dict:
    """Return A, B, C, D of x' = A x + B u, y = C x + D u, and E, EA, EB of E x' = EA x + EB u, of a model with
    coordinates without mass; x is that of with_mass() and its rate, without the integrals. Raises InputError."""
    regular = with_mass(reduced)
    model, m = regular.reduced, regular.reduced.size
    kept = np.delete(np.arange(2 * m), np.arange(m - regular.integrals, m))
    zero, one = np.zeros((m, m)), np.eye(m)
    E = np.block([[one, zero], [zero, model.M]])
    EA, EB = np.block([[zero, one], [-model.K, -model.D]]), np.vstack([np.zeros_like(model.B), model.B])
    A, B = np.linalg.solve(E, EA), np.linalg.solve(E, EB)
    C, Cv, Ca = model.output_parts
    C = np.hstack([C, Cv]) + Ca @ A[m:]
    square = np.ix_(kept, kept)
    return {"A": A[square], "B": B[kept], "C": C[:, kept], "D": regular.feedthrough + Ca @ B[m:], "E": E[square],
            "EA": EA[square], "EB": EB[kept]}  # fmt: skip


def _without_static(K, D, B, outputs, stop, where):
    """Eliminate the coordinates from `stop` on, with K = I among them; return K, D, B, C..., and the feedthrough."""
    a, z = slice(stop), slice(stop, None)
    size = max(np.abs(D).max(initial=0.0), 1e-300)
    if max(np.abs(D[z, a]).max(initial=0.0), np.abs(D[a, z]).max(initial=0.0)) > 1e-6 * size:
        raise InputError(_refused(where, "static deflections that gyroscopic terms couple"))
    rate = outputs[1:, :, z] @ B[z]
    if np.abs(rate).max(initial=0.0) > ROUND_OFF * max(np.abs(outputs[1:] @ B).max(initial=0.0), 1e-300):
        raise InputError(_refused(where, "velocities or accelerations of static deflections"))
    feedthrough = outputs[0][:, z] @ B[z]
    outputs = outputs[:, :, a] - outputs[:, :, z] @ K[z, a]
    return K[a, a] - K[a, z] @ K[z, a], D[a, a], B[a] - K[a, z] @ B[z], outputs, feedthrough


def _refused(where, what):
    return (
        f"the reduced model has {what}, which follow the rates of forces and have no place in {where}; give the dofs "
        "that they belong to some mass, or take its second-order form (npz, mat)"
    )


def _kernel(reduced):
    """Return a basis of the motions without mass (m, z), and of the others (m, m - z)."""
    M, one = symmetric_part(reduced.M), np.eye(reduced.size)
    moving = np.abs(M).any(axis=0)  # the others are coordinates of the model, to the last digit
    diagonal = np.abs(np.diag(M)) + time_of(reduced.K, M) ** 2 * np.abs(np.diag(reduced.K))
    scale = (1 / np.sqrt(np.maximum(diagonal, 1e-300)))[moving]
    values, vectors = np.linalg.eigh(M[np.ix_(moving, moving)] * np.outer(scale, scale))
    still = values <= NO_MASS * values.max(initial=0.0)
    if not still.any():
        return one[:, ~moving], one[:, moving]
    vectors = one[:, moving] @ (scale[:, None] * vectors)
    return np.hstack([one[:, ~moving], vectors[:, still]]), vectors[:, ~still]
