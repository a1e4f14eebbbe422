"""Projected models in pseudo-modal coordinates: small matrices enter; responses and differences of nested models leave.

Everything is dense numpy, deterministic and local. For V^T M V = I and the columns L of [B, C^T]:

    A(s) = a K + b M + s D,   a = 1 + i eta + s beta,   b = s^2 + s alpha,   s = 2 pi i f          (41, 40)
    H(s) = C A(s)^-1 B = Lc^T (L^T A(s)^-1 L) Lb,       B = L Lb,   C^T = L Lc
    of a Caughey series s D = s M sum_k a_k (M^-1 K)^k, diagonal too                (39)
    H - H_V = R^T A^-1 R,   R = L - A V y_V,   y_V = A_V^-1 V^T L          (exact for symmetric A, W = V)

In a richer basis Q the difference H_Q - H_V is r^T A_Q^-1 r with r = L_Q - A_Q U y_V, V = Q U, without cancellation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

ROUGH = 1e-9  # accuracy of solves for r^T A^-1 r, on which their errors have no effect of first order
NUMBERS_AT_A_TIME = 2**22  # complex numbers of states held at a time


class Law(NamedTuple):
    """Proportional damping: D = alpha M + beta K and (1 + i eta) K; `higher`: a_2, a_3, ... of a Caughey series."""

    alpha: float = 0.0
    beta: float = 0.0
    eta: float = 0.0
    higher: tuple[float, ...] = ()

    def damping_at(self, squares: np.ndarray) -> np.ndarray:
        """The viscous damping (m,) of modes with omega^2 = squares (m,): alpha + beta omega^2 + a_2 omega^4 + ..."""
        return sum(a * squares**k for k, a in enumerate((self.alpha, self.beta, *self.higher)))


UNDAMPED = Law()


class PseudoModal(NamedTuple):
    """A projected model in its pseudo-modal coordinates, V^T M V = I, V^T K V = diag(squares).

    `squares` (m,): omega^2; `L` (m, l): the projected loads and measurements; `D` (m, m): a given damping matrix,
    projected, or None; `vectors` (m, m): from these coordinates to those of the basis; `inverse`: the poles, with D.
    """

    squares: np.ndarray
    L: np.ndarray
    D: np.ndarray | None
    vectors: np.ndarray
    inverse: Poles | None = None

    @property
    def frequencies(self) -> np.ndarray:
        """Pseudo-frequencies (m,) in Hz (52)."""
        return np.sqrt(np.maximum(self.squares, 0.0)) / (2 * np.pi)


def diagonalised(K: np.ndarray, L: np.ndarray, D: np.ndarray | None = None, law: Law = UNDAMPED) -> PseudoModal:
    """The model with V^T K V (m, m), V^T L (m, l), V^T D V (m, m) in pseudo-modal coordinates (53, 54)."""
    squares, vectors = np.linalg.eigh((K + K.T) / 2)
    if D is None:
        return PseudoModal(squares, vectors.T @ L, None, vectors)
    model = PseudoModal(squares, vectors.T @ L, vectors.T @ D @ vectors, vectors)
    try:
        return model._replace(inverse=poles(model, law))
    except np.linalg.LinAlgError:
        return model


def restricted(model: PseudoModal, U: np.ndarray, law: Law) -> tuple[PseudoModal, np.ndarray]:
    """The model on the orthonormal columns U (m, k) of its coordinates, and its embedding (m, k), U rotated."""
    K = U.T @ (model.squares[:, None] * U)
    inner = diagonalised(K, U.T @ model.L, None if model.D is None else U.T @ model.D @ U, law)
    return inner, U @ inner.vectors


def nested(inner: PseudoModal, outer: PseudoModal, columns=None) -> np.ndarray:
    """The embedding (m, k) of a model whose basis is k columns of the basis of `outer`, by default the first ones."""
    columns = slice(len(inner.vectors)) if columns is None else columns
    return outer.vectors[columns].T @ inner.vectors


def coefficients(law: Law, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """a, b, s (S,) of A(s) = a K + b M + s D at frequencies (S,) in Hz."""
    s = 2j * np.pi * np.asarray(frequencies)
    return 1 + 1j * law.eta + s * law.beta, s * s + s * law.alpha, s


def _diagonal(model, law, frequencies):
    """a omega^2 + b (S, m): A(s) without D."""
    a, b, s = coefficients(law, frequencies)
    found = a[:, None] * model.squares + b[:, None]
    if law.higher:
        found += s[:, None] * (law.damping_at(model.squares) - law.alpha - law.beta * model.squares)
    return found


class Poles(NamedTuple):
    """A(s)^-1 = right diag(1 / (s - poles)) left with a given D: poles (2m,), right (m, 2m), left (2m, m)."""

    poles: np.ndarray
    right: np.ndarray
    left: np.ndarray


def poles(model: PseudoModal, law: Law) -> Poles:
    """The eigenvectors of the first-order form with the state (y, s y)."""
    m = len(model.squares)
    D = model.D + np.diag(law.alpha + law.beta * model.squares)
    below = np.diag(-(1 + 1j * law.eta) * model.squares) if law.eta else np.diag(-model.squares)
    matrix = np.block([[np.zeros((m, m)), np.eye(m)], [below, -D]])
    values, vectors = np.linalg.eig(matrix)
    return Poles(values, vectors[:m], np.linalg.inv(vectors)[:, m:])


def solve(model: PseudoModal, law: Law, frequencies, right: np.ndarray, transposed=False, accuracy=1e-14) -> np.ndarray:
    """A(s)^-1 right (S, m, l), or A(s)^-T right; `right` (m, l) or (S, m, l).

    With a given D by its poles and at most two steps of refinement until the residual is below `accuracy`; where it
    stays above 1e3 `accuracy` (poles that coincide have no eigenvectors), by elimination.
    """
    if model.D is None:
        return right / _diagonal(model, law, frequencies)[:, :, None]
    right = np.broadcast_to(right, (len(frequencies), *right.shape[-2:]))
    inverse = model.inverse
    states, wrong = np.zeros(right.shape, dtype=complex), np.arange(len(frequencies))
    if inverse is not None:
        if transposed:
            inverse = Poles(inverse.poles, inverse.left.T, inverse.right.T)
        factor = _reciprocal(coefficients(law, frequencies)[2][:, None, None] - inverse.poles[:, None])
        size = _columns(right)
        rest = right
        for _ in range(3):
            states += times(inverse.right, factor * times(inverse.left, rest))
            rest = right - multiply(model, law, frequencies, states, transposed)
            scale = size + _columns(_diagonal(model, law, frequencies)[:, :, None] * states)
            if (_columns(rest) <= accuracy * scale).all():
                break
        wrong = np.flatnonzero(~(_columns(rest) <= 1e3 * accuracy * scale).all(axis=1))
    parts = 1 + len(wrong) * len(model.squares) ** 2 // NUMBERS_AT_A_TIME
    for part in np.array_split(wrong, parts) if len(wrong) else ():
        matrices = coefficients(law, frequencies[part])[2][:, None, None] * (model.D.T if transposed else model.D)
        index = np.arange(len(model.squares))
        matrices[:, index, index] += _diagonal(model, law, frequencies[part])
        states[part] = _eliminated(matrices, right[part])
    return states


def _columns(blocks):
    """Norms (S, l) of the columns of blocks (S, m, l), each of which may have units of its own."""
    return np.linalg.norm(blocks, axis=1)


def _reciprocal(values):
    """1 / values, 0 for 0: at a pole elimination follows."""
    return np.divide(1.0, values, out=np.zeros_like(values), where=values != 0)


def _eliminated(matrices, right):
    """matrices^-1 right (S, m, l), infinite where a matrix (m, m) is singular, as that of a free body is at 0 Hz."""
    try:
        return np.linalg.solve(matrices, right)
    except np.linalg.LinAlgError:  # which does not say where
        if len(matrices) == 1:
            return np.full(right.shape, np.inf, dtype=complex)
        return np.concatenate([_eliminated(*one) for one in zip(matrices[:, None], right[:, None], strict=True)])


def multiply(model: PseudoModal, law: Law, frequencies: np.ndarray, states: np.ndarray, transposed=False) -> np.ndarray:
    """A(s) states (S, m, l), or A(s)^T states."""
    result = _diagonal(model, law, frequencies)[:, :, None] * states
    if model.D is not None:
        s = coefficients(law, frequencies)[2]
        result += s[:, None, None] * times(model.D.T if transposed else model.D, states)
    return result


def chunks(model: PseudoModal, frequencies: np.ndarray):
    """Parts of the frequencies whose states (and matrices, with a given D) fit."""
    m, l = model.L.shape
    width = l if model.D is None else l + m
    return np.array_split(frequencies, max(1, -(-len(frequencies) * m * width // NUMBERS_AT_A_TIME)))


def response(model: PseudoModal, law: Law, frequencies: np.ndarray, ports) -> np.ndarray:
    """H (S, r, p); `ports` = (Lb (l, p), Lc (l, r))."""
    return responses(model, law, frequencies, ports)[0]


def responses(model: PseudoModal, law: Law, frequencies: np.ndarray, ports) -> tuple[np.ndarray, np.ndarray]:
    """H (S, r, p), and the drive-point responses b_i^T A^-1 b_i (S, p) of the inputs."""
    Lb, Lc = ports
    left, right = (model.L @ Lc).T, model.L @ Lb
    H, drive = [], []
    for part in chunks(model, frequencies):
        states = solve(model, law, part, right)
        H.append(left @ states)
        drive.append(np.einsum("mp,smp->sp", right, states) if Lc is not Lb else np.einsum("spp->sp", H[-1]))
    return np.concatenate(H), np.concatenate(drive)


def difference(inner: PseudoModal, outer: PseudoModal, embedding, law: Law, frequencies, ports) -> np.ndarray:
    """E = r^T A_Q^-1 r (S, r, p), equal to H_Q - H_V without its cancellation; V = Q embedding.

    Not for a Caughey series of more than two terms, whose powers of V^T K V are no projections: E = H_Q - H_V.
    """
    Lb, Lc = ports
    if law.higher:
        return response(outer, law, frequencies, ports) - response(inner, law, frequencies, ports)
    same = Lb is Lc and is_symmetric(outer.D)
    found = []
    for part in chunks(outer, frequencies):
        right = _residual(inner, outer, embedding, law, part, Lb)
        left = right if same else _residual(inner, outer, embedding, law, part, Lc, transposed=True)
        found.append(left.transpose(0, 2, 1) @ solve(outer, law, part, right, accuracy=ROUGH))
    return np.concatenate(found)


def _residual(inner, outer, embedding, law, frequencies, port, transposed=False):
    """r = L_Q - A_Q U y_V (S, m, p) for the columns L port."""
    states = times(embedding, solve(inner, law, frequencies, inner.L @ port, transposed, ROUGH))
    return outer.L @ port - multiply(outer, law, frequencies, states, transposed)


def times(matrix, states):
    """matrix (m, k) states (S, k, l), as one product."""
    count, size, width = states.shape
    flat = np.ascontiguousarray(states.transpose(1, 0, 2)).reshape(size, count * width)
    if np.isrealobj(matrix) and np.iscomplexobj(flat):
        flat = (np.ascontiguousarray(matrix) @ flat.view(float)).view(complex)
    else:
        flat = matrix @ flat
    return flat.reshape(len(matrix), count, width).transpose(1, 0, 2)


def columns(states: np.ndarray) -> np.ndarray:
    """Real and imaginary parts of states (S, m, l) side by side: (m, 2 S l), or (m, S l) of real ones."""
    flat = states.transpose(1, 0, 2).reshape(states.shape[1], states.shape[0] * states.shape[2])
    return np.hstack([flat.real, flat.imag]) if np.iscomplexobj(flat) else flat


def is_symmetric(D):
    return D is None or np.abs(D - D.T).max(initial=0.0) <= 1e-10 * np.abs(D).max(initial=0.0)


def norms(blocks: np.ndarray) -> np.ndarray:
    """Frobenius norms (S,) of blocks (S, r, p)."""
    return np.linalg.norm(blocks, axis=(1, 2))
