"""Reduce small models by methods of the literature, in dense matrices: the rivals of benchmarks/rivals.py.

A model is M, D, K (n, n), B (n, p), C, Cv (r, n); modal coordinates (`prepared`) have M = I and a diagonal K. Balanced
truncation: Reis and Stykel, Math. Comput. Model. Dyn. Syst. 14 (2008) 391; in a band: Gawronski and Juang, Int. J.
Systems Sci. 21 (1990) 349. Craig and Bampton, AIAA J. 6 (1968) 1313. Modal truncation augmentation: Dickens, Nakagawa
and Wittbrodt, Comput. Struct. 62 (1997) 985.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse.linalg

DEPENDENT = 1e-10  # singular value, of the largest, below which columns depend on each other


@dataclass
class Model:
    """M x'' + D x' + K x = B u, y = C x + Cv x' + residual u, by dense or sparse matrices."""

    M: np.ndarray
    D: np.ndarray
    K: np.ndarray
    B: np.ndarray
    C: np.ndarray
    Cv: np.ndarray
    residual: np.ndarray | float = 0.0

    def projected(self, V, W=None):
        """The model on columns V (n, m), with the equations of W."""
        W = V if W is None else W
        M, D, K = (W.T @ (matrix @ V) for matrix in (self.M, self.D, self.K))
        return Model(M, D, K, W.T @ self.B, self.C @ V, self.Cv @ V)

    def response(self, frequencies):
        """H (S, r, p) at frequencies in Hz."""
        return self.states.response(frequencies) + self.residual

    def unstable(self):
        """How many poles have a positive real part."""
        return self.states.unstable()

    @cached_property
    def states(self):
        return States(*first_order(self))


@dataclass
class States:
    """x' = A x + B u, y = C x: a model of first order, which counts as half as many coordinates."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray

    @cached_property
    def modes(self):
        """Poles (n,), their outputs (r, n) and inputs (n, p)."""
        poles, X = np.linalg.eig(self.A)
        return poles, self.C @ X, np.linalg.solve(X, self.B)

    def response(self, frequencies):
        poles, outputs, inputs = self.modes
        return np.matmul(outputs, (1 / (2j * np.pi * frequencies[:, None] - poles))[:, :, None] * inputs)

    def unstable(self):
        poles = self.modes[0]
        return int((poles.real > 1e-9 * np.abs(poles)).sum())


def prepared(model, count, frequencies=()):
    """The model on its lowest `count` modes, all static deflections, and all responses at some frequencies (Hz), in
    modal coordinates; M may be singular."""
    V, factor = lowest_modes(model.M, model.K, count)
    loads = np.hstack([model.B, model.C.T, model.Cv.T])
    loads = loads[:, loads.any(axis=0)]
    columns = [V, factor.solve(loads)]
    for s in 2j * np.pi * np.asarray(frequencies):
        found = scipy.sparse.linalg.splu((s * s * model.M + s * model.D + model.K).tocsc()).solve(loads.astype(complex))
        columns += [found.real, found.imag]
    return modal(model, np.hstack(columns))


def lowest_modes(M, K, count):
    """The lowest modes (n, count at most) of sparse matrices, of which M may be singular, and the factor of K."""
    factor = scipy.sparse.linalg.splu(K.tocsc())
    n = K.shape[0]
    if 2 * count >= n:
        inverse, V = scipy.linalg.eigh(M.toarray(), K.toarray(), subset_by_index=(max(n - count, 0), n - 1))
    else:  # the inverse problem
        solver = scipy.sparse.linalg.LinearOperator(K.shape, factor.solve, dtype=float)
        inverse, V = scipy.sparse.linalg.eigsh(M, count, K, which="LA", Minv=solver, v0=np.ones(n))
    order = np.argsort(-inverse)
    return V[:, order[inverse[order] > 1e-14 * inverse.max()]], factor


def modal(model, V):
    """The model on the span of V in its modal coordinates, by which M = I and K is diagonal."""
    norms = np.sqrt(np.einsum("ij,ij->j", V, model.K @ V))
    V = (V / np.where(norms > 0, norms, 1))[:, norms > 0]
    gram = V.T @ (model.K @ V)
    values, U = np.linalg.eigh((gram + gram.T) / 2)
    good = values > DEPENDENT * values[-1]
    V = V @ (U[:, good] / np.sqrt(values[good]))  # K-orthonormal
    mass = V.T @ (model.M @ V)
    inverse, U = np.linalg.eigh((mass + mass.T) / 2)
    good = inverse > 1e-14 * inverse[-1]
    V = (V @ (U[:, good] / np.sqrt(inverse[good])))[:, ::-1]
    small = model.projected(V)
    small.M, small.K = np.eye(V.shape[1]), np.diag(1 / inverse[good][::-1])
    return small


def first_order(model):
    """A, B, C of x' = A x + B u with x = (q, q')."""
    n = len(model.M)
    solved = scipy.linalg.solve(model.M, np.hstack([-model.K, -model.D, model.B]))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [solved[:, : 2 * n]]])
    return A, np.vstack([np.zeros_like(model.B), solved[:, 2 * n :]]), np.hstack([model.C, model.Cv])


def gramians(A, B, C, band=None):
    """Square roots R, L (n, k) of the Gramians R R^T and L L^T of states; in a band (Hz) up to that frequency only.

    By eigenvectors of A, which make the Lyapunov equations divisions.
    """
    poles, X = np.linalg.eig(A)
    left = np.linalg.inv(X)
    within = np.ones(len(poles)) / 2
    if band is not None:
        top = 2j * np.pi * band[1]
        within = (np.log(top - poles) - np.log(-top - poles)) / (2j * np.pi)
    return _root(poles, left @ B, X, within), _root(poles.conj(), (C @ X).conj().T, left.conj().T, within.conj())


def _root(poles, b, X, within):
    """The square root of X P X^*, with P of poles and inputs b that are diagonal."""
    P = -(b @ b.conj().T) / (poles[:, None] + poles.conj()) * (within[:, None] + within.conj())
    gramian = (X @ P @ X.conj().T).real
    values, U = np.linalg.eigh((gramian + gramian.T) / 2)
    good = values > 1e-16 * values[-1]
    return (U[:, good] * np.sqrt(values[good]))[:, ::-1]


def balanced(A, B, C, roots):
    """States(size) by balanced truncation with the square roots of Gramians, and the Hankel singular values."""
    R, L = roots
    U, values, Vt = np.linalg.svd(L.T @ R)

    def reduced(size):
        size = min(size, int((values > 1e-13 * values[0]).sum()))  # the rest is round-off
        T, W = R @ Vt[:size].T / np.sqrt(values[:size]), L @ U[:, :size] / np.sqrt(values[:size])
        return States(W.T @ A @ T, W.T @ B, C @ T)

    return reduced, values


def balanced_second_order(model, roots, kind):
    """Model(size) by second-order balanced truncation: "position", "velocity" or "position-velocity", two-sided, or
    "free velocity", one-sided. The model has M = I."""
    n = len(model.M)
    (Rp, Rv), (Lp, Lv) = ((root[:n], root[n:]) for root in roots)
    right, left = {"velocity": (Rv, Lv), "position-velocity": (Rp, Lv)}.get(kind, (Rp, Lp))
    U, values, Vt = np.linalg.svd(left.T @ right)
    if kind == "position":
        U = np.linalg.svd(Lv.T @ Rv)[0]

    def reduced(size):
        size = min(size, len(values), U.shape[1])
        V = np.linalg.qr(right @ Vt[:size].T)[0]
        if kind == "free velocity":
            return model.projected(V)
        return model.projected(V, np.linalg.qr(Lv @ U[:, :size])[0])

    return reduced, values


def craig_bampton(model, most):
    """Model(size) on constraint modes of the dofs with inputs or outputs, and fixed-interface modes; None where nearly
    all dofs have some. `model` has the sparse matrices of the finite elements."""
    held = np.flatnonzero(np.abs(np.hstack([model.B, model.C.T, model.Cv.T])).max(axis=1))
    if len(held) > most:
        return None, len(held)
    inside = np.setdiff1d(np.arange(model.M.shape[0]), held)
    K, M = (matrix.tocsc()[inside][:, inside] for matrix in (model.K, model.M))
    modes, factor = lowest_modes(M, K, most)
    V = np.zeros((model.M.shape[0], len(held) + modes.shape[1]))
    V[held, range(len(held))] = 1.0
    V[np.ix_(inside, range(len(held)))] = -factor.solve(model.K.tocsc()[inside][:, held].toarray())
    V[np.ix_(inside, range(len(held), V.shape[1]))] = modes
    whole = model.projected(V)

    def reduced(size):
        return whole.projected(np.eye(V.shape[1])[:, :size])

    return reduced, len(held)


def modes_with_residual(model):
    """Model(size) on modes, and the static deflection of all others as a direct path from u to y (mode acceleration).

    `model` is in modal coordinates.
    """
    inverse = 1 / np.diag(model.K)

    def reduced(size):
        small = model.projected(np.eye(len(inverse))[:, :size])
        small.residual = (model.C[:, size:] * inverse[size:]) @ model.B[size:]
        return small

    return reduced


def truncation_augmentation(model):
    """Model(size) on modes and the static deflections of what loads they leave: modal truncation augmentation (MTA).

    Its space is that of modes and static corrections. `model` is in modal coordinates.
    """
    inverse = 1 / np.diag(model.K)
    loads = model.B if np.array_equal(model.C.T, model.B) else np.hstack([model.B, model.C.T])

    def reduced(size):
        count = size - loads.shape[1]
        if count < 0:
            return None
        rest = loads.copy()
        rest[:count] = 0.0
        return modal(model, np.hstack([np.eye(len(inverse))[:, :count], inverse[:, None] * rest]))

    return reduced
