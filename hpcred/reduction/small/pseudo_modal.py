"""Solve projected models in pseudo-modal coordinates, and compute exact differences of nested ones.

Everything is dense NumPy, deterministic and local. For V^T M V = I and the columns L of [B, C^T]:

    A(s) = a K + b M + s D,   a = 1 + i eta + s beta,   b = s^2 + s alpha,   s = 2 pi i f          (41, 40)
    H(s) = C A(s)^-1 B = Lc^T (L^T A(s)^-1 L) Lb,       B = L Lb,   C^T = L Lc
    of a Caughey series s D = s M sum_k a_k (M^-1 K)^k, diagonal too                (39)
    also + sum c(s) K_v of added terms
    H - H_V = R^T A^-1 R,   R = L - A V y_V,   y_V = A_V^-1 V^T L          (exact for symmetric A, W = V)

Where dofs have no mass the basis is orthonormal in G = M + tau^2 K. Then pseudo-modal coordinates are those with
V^T G V = I in which M is diagonal too, V^T M V = diag(masses), and the mass of a motion may be zero.

For an unsymmetric A the R on the left is that of A^T. Pseudo-modal coordinates are those of the symmetric part of K.

In a richer basis Q the difference H_Q - H_V is r^T A_Q^-1 r with r = L_Q - A_Q U y_V, V = Q U, without cancellation.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...linalg.eigensolver import congruent, eigenpairs_with_gram, graded_eigenpairs
from ...linalg.pencil import LEAST_MASS, squared_frequencies, with_masses
from ...model.operator import NOTHING, Operator, times
from ...model.outputs.rates import Rates

ROUGH = 1e-9  # accuracy of solves for r^T A^-1 r, on which their errors have no effect of first order
NEARLY_ZERO = 1e-12  # eigenvalue, relative to the largest, that round-off may have made of zero
PUSHED = 1e-11  # of the norm of a load, or of a damping matrix: less on a motion is round-off
COUPLED = 1e-12  # of the damping of two motions: less between them is round-off
MIXED = 1e-8  # lowest eigenvalue, relative to the highest, that combinations of both have few digits of
NUMBERS_AT_A_TIME = 2**22  # complex numbers of states held at a time
NUMBERS_IN_CACHE = 2**16  # the same where each is passed over several times for little arithmetic
FEW_PRODUCTS = 2**21  # numbers c_j b_i of all modes, outputs and inputs that are quicker than states of all inputs
NUMBERS_KEPT = 2**24  # complex numbers of inverses that a model keeps


class Proportional(NamedTuple):
    """Proportional damping: D = alpha M + beta K and (1 + i eta) K; `higher`: a_2, a_3, ... of a Caughey series."""

    alpha: float = 0.0
    beta: float = 0.0
    eta: float = 0.0
    higher: tuple[float, ...] = ()

    def at(self, eigenvalues: np.ndarray) -> np.ndarray:
        """Return the viscous damping (m,) of modes with omega^2 = eigenvalues: alpha + beta omega^2 + a_2 omega^4 + ...
        """
        return sum(a * eigenvalues**k for k, a in enumerate((self.alpha, self.beta, *self.higher)))

    def coefficients(self, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """a, b, s (S,) of A(s) = a K + b M + s D at frequencies (S,) in Hz."""
        s = 2j * np.pi * np.asarray(frequencies)
        return 1 + 1j * self.eta + s * self.beta, s * s + s * self.alpha, s


UNDAMPED = Proportional()


class InputsOutputs(NamedTuple):
    """Inputs and outputs in terms of independent loads L: B = L `inputs` (l, p), C^T = L `outputs` (l, r), which are
    one array where C = B^T; `rates`: what the outputs are of them; `silent`: the columns of C^T whose responses are
    round-off, None where that was not computed; `quiet`: whether others hardly feel the inputs; `limits`: the
    quietness of columns below which it is round-off, where that is known (see silent_outputs)."""

    inputs: np.ndarray
    outputs: np.ndarray
    rates: Rates = Rates()
    silent: tuple[int, ...] | None = None
    quiet: bool = False
    limits: dict[int, float] = {}

    @property
    def output_count(self) -> int:
        return self.rates.count(self.outputs.shape[1])

    def column_scales(self, s, scales: np.ndarray) -> np.ndarray:
        """Return scales (S, k) of the columns C^T, from those of the outputs (S, r): the least that an output has."""
        if not self.rates:
            return scales
        weights = np.abs(self.rates.measured_at(s)) * _reciprocal(scales)[:, :, None]
        return _reciprocal(weights.max(axis=1, initial=0.0))

    def measured(self, s, rows: np.ndarray) -> np.ndarray:
        """Return what errors are measured of (S, r, p), from what is known of the columns C^T (S, k, p) at s (S,)."""
        return self.rates.measured(s, rows)

    @property
    def are_same(self) -> bool:
        """Whether C = B^T."""
        return self.inputs is self.outputs

    @property
    def measured_are_same(self) -> bool:
        """Whether what errors are measured of has C = B^T: outputs are displacements where inputs act, or rates of
        these."""
        return self.are_same and self.rates.are_columns


class Poles(NamedTuple):
    """A(s)^-1 = right diag(1 / (s - values)) left with a given D: values (2m,), right (m, 2m), left (2m, m)."""

    values: np.ndarray
    right: np.ndarray
    left: np.ndarray


@dataclass(frozen=True, eq=False)
class Keeping:
    """What has computed arrays once keeps them, by name, in its `memory` (see kept), which stays behind where it is
    sent, copied or replaced."""

    memory: dict = field(default_factory=dict, init=False, repr=False, compare=False)

    def __getstate__(self):
        return vars(self) | {"memory": {}}


@dataclass(frozen=True, eq=False)
class PseudoModal(Keeping):
    """A projected model in its pseudo-modal coordinates, V^T M V = I, V^T K V = diag(eigenvalues).

    `eigenvalues` (m,): omega^2, ascending; `L` (m, l): the projected loads, of which `io` makes inputs and outputs;
    `damping`: proportional; `operator`: what A(s) has beside, a given damping matrix D and added terms (m, m),
    projected; `N` (m, m): the skew-symmetric part of V^T K V, or None; `vectors` (m, m): from these coordinates to
    those of the basis; `poles`: of the first-order form, with D or N; `masses` (m,): of the coordinates, which then
    have V^T (M + tau^2 K) V = I, None where they are all 1.
    """

    eigenvalues: np.ndarray
    L: np.ndarray
    vectors: np.ndarray
    io: InputsOutputs
    damping: Proportional = UNDAMPED
    operator: Operator = NOTHING
    poles: Poles | None = None
    N: np.ndarray | None = None
    masses: np.ndarray | None = None
    tau: float = 0.0

    def __len__(self) -> int:
        return len(self.eigenvalues)

    @property
    def frequencies(self) -> np.ndarray:
        """Pseudo-frequencies (m,) in Hz (52); without mass the least that counts as such."""
        return np.sqrt(np.maximum(squared_frequencies(self.eigenvalues, self.masses, self.tau), 0.0)) / (2 * np.pi)

    @property
    def D(self) -> np.ndarray | None:
        """The given damping matrix (m, m), projected, or None."""
        return self.operator.get("D")

    @property
    def added(self) -> Operator:
        """The terms beside M, D and K, projected, with which A(s)^-1 is by elimination."""
        return self.operator.added

    @property
    def B(self) -> np.ndarray:
        """The projected inputs (m, p)."""
        return self.L @ self.io.inputs

    @property
    def Ct(self) -> np.ndarray:
        """The projected outputs (m, r)."""
        return self.L @ self.io.outputs

    @property
    def is_reciprocal(self) -> bool:
        """Whether C = B^T and A(s) is symmetric."""
        return self.io.are_same and self.N is None and (self.D is None or np.array_equal(self.D, self.D.T))

    @cached_property
    def is_diagonal(self) -> bool:
        """Whether A(s) is diagonal, as it is also with a D of modal damping."""
        D = self.D
        return self.N is None and not self.added and (D is None or np.count_nonzero(D) == np.count_nonzero(np.diag(D)))

    @cached_property
    def idle(self) -> np.ndarray:
        """Which coordinates (m,) nothing pushes: no load, and no other coordinate."""
        pushed = self.L.any(axis=1)
        for matrix in (self.N, *self.operator.matrices.values()):
            if matrix is not None:
                beside = (matrix != 0) & ~np.eye(len(self), dtype=bool)
                pushed = pushed | beside.any(axis=0) | beside.any(axis=1)
        return ~pushed

    def coordinates_of(self, columns: np.ndarray) -> np.ndarray:
        """Return combinations (m, k) of the columns of the basis in these coordinates."""
        return self.vectors.T @ columns if self.masses is None else np.linalg.solve(self.vectors, columns)

    def with_unit_masses(self, scale: np.ndarray) -> PseudoModal:
        """Return the model in coordinates that are multiplied by `scale` (m,), with masses of 1 whatever they are."""
        both = np.outer(scale, scale)
        return replace(
            self, eigenvalues=self.eigenvalues * scale**2, L=self.L * scale[:, None], vectors=self.vectors * scale,
            N=None if self.N is None else self.N * both, operator=self.operator.map(both.__mul__), masses=None, tau=0.0,
        )  # fmt: skip

    def without_D(self) -> PseudoModal:
        """Return the same without any damping."""
        return replace(self, operator=NOTHING, poles=None, damping=UNDAMPED)

    def restricted(self, U: np.ndarray) -> tuple[PseudoModal, np.ndarray]:
        """Return the model on the orthonormal columns U (m, k) of its coordinates, and its embedding (m, k), U rotated.
        """
        M = None if self.masses is None else U.T @ (self.masses[:, None] * U)
        K, turn = U.T @ (self.eigenvalues[:, None] * U), None
        # where columns may mix soft coordinates and stiff ones, or parts that hardly couple, pseudo-modes keep these
        if M is None and (self.io.quiet or abs(self.eigenvalues[0]) < MIXED * abs(self.eigenvalues[-1])):
            turn = np.linalg.eigh(K)[1]
            U = U @ turn
            K = U.T @ (self.eigenvalues[:, None] * U)
        K = K if self.N is None else (K + K.T) / 2 + U.T @ self.N @ U
        rest = self.operator.projected(U)
        given = rest.get("D"), self.damping, self.io, rest.added, self.N is None
        inner = diagonalised(K, U.T @ self.L, *given, M, self.tau, U.T @ U)
        embedding = U @ inner.vectors
        return inner if turn is None else replace(inner, vectors=turn @ inner.vectors), embedding

    def solve(self, frequencies, right: np.ndarray, transposed=False, accuracy=1e-14) -> np.ndarray:
        """A(s)^-1 right (S, m, l), or A(s)^-T right; `right` (m, l) or (S, m, l).

        With a given D by its poles and at most two steps of refinement until the residual is below `accuracy`; where it
        stays above 1e3 `accuracy` (poles that coincide have no eigenvectors), by elimination. With added terms
        by inverses, which are kept as there is room, and by elimination beyond that.
        """
        if self.is_diagonal:
            return right / self._diagonal_with_D(frequencies)[:, :, None]
        right = np.broadcast_to(right, (len(frequencies), *right.shape[-2:]))
        states, wrong = np.zeros(right.shape, dtype=complex), np.arange(len(frequencies))
        if (nearly := self._nearly_inverse(frequencies, transposed)) is not None:
            size, diagonal = _column_norms(right), self._diagonal(frequencies)[:, :, None]
            rest = right
            for _ in range(3):
                states += nearly(rest)
                most = diagonal * states
                rest, scale = right - most, size + _column_norms(most)
                self._add_coupled(rest, frequencies, states, transposed, -1.0)
                if (_column_norms(rest) <= accuracy * scale).all() and not self.io.quiet:
                    break
            wrong = np.flatnonzero(~(_column_norms(rest) <= 1e3 * accuracy * scale).all(axis=1))
        chunks = 1 + len(wrong) * len(self) ** 2 // NUMBERS_AT_A_TIME
        for chunk in np.array_split(wrong, chunks) if len(wrong) else ():
            matrices = self.matrices(frequencies[chunk], transposed)
            states[chunk] = _scaled(matrices, right[chunk]) if self.added else _eliminated(matrices, right[chunk])
        return states

    def matrices(self, frequencies, transposed=False):
        """Return A(s) (S, m, m), or A(s)^T."""
        (a, _, s), m = self.damping.coefficients(frequencies), len(self)
        matrices = self.operator.at(s) if self.operator else np.zeros((len(s), m, m), dtype=complex)
        if transposed:
            matrices = matrices.transpose(0, 2, 1)
        if self.N is not None:
            matrices += a[:, None, None] * (self.N.T if transposed else self.N)
        matrices[:, np.arange(m), np.arange(m)] += self._diagonal(frequencies)
        return matrices

    def terms(self) -> Operator:
        """Return A(s) but for powers of a Caughey series as a sum of terms: of M, of K, and what there is beside."""
        mass = np.eye(len(self)) if self.masses is None else np.diag(self.masses)
        K = np.diag(self.eigenvalues) if self.N is None else np.diag(self.eigenvalues) + self.N
        return Operator.of(mass, self.D, K, self.added)

    def factors(self, frequencies) -> np.ndarray:
        """Return the factors (terms, S) of these at frequencies (S,) in Hz."""
        a, b, s = self.damping.coefficients(frequencies)
        of = dict(zip("MKD", (b, a, s), strict=True))
        return np.array([of[key] if key in of else term.law.coefficient(s) for key, term in self.terms().terms.items()])

    def _nearly_inverse(self, frequencies, transposed):
        """Return a function that takes columns (S, m, l) to A(s)^-1 times these, but for round-off; or None."""
        if self.added:
            inverses = self._kept_inverses(frequencies)
            if inverses is None:
                return None
            return (inverses.transpose(0, 2, 1) if transposed else inverses).__matmul__
        if self.poles is None:
            return None
        inverse = Poles(self.poles.values, self.poles.left.T, self.poles.right.T) if transposed else self.poles
        s = self.damping.coefficients(frequencies)[2]
        factor = _reciprocal(s[:, None, None] - inverse.values[:, None])
        # coordinates that have no poles there, which only residuals push, are diagonal
        idle = np.flatnonzero(self.idle)
        own = _reciprocal(self._diagonal_with_D(frequencies)[:, idle])[:, :, None]

        def nearly(columns):
            same = columns.strides[0] == 0  # at all frequencies
            left = inverse.left @ columns[:1] if same else times(inverse.left, columns)
            found = times(inverse.right, factor * left)
            found[:, idle] = own * columns[:, idle]
            return found

        return nearly

    def _kept_inverses(self, frequencies):
        """Return A(s)^-1 (S, m, m), which are kept, or None where there is no room for them."""
        m, (known, inverses) = len(self), self.memory.get("inverses", (np.zeros(0), None))
        new = np.setdiff1d(frequencies, known)
        if (len(known) + len(new)) * m * m > NUMBERS_KEPT:
            return None
        if len(new):
            one = np.broadcast_to(np.eye(m, dtype=complex), (len(new), m, m))
            made = _scaled(self.matrices(new), one)
            made[~np.isfinite(made)] = 0.0  # for elimination to follow
            order = np.argsort(np.concatenate([known, new]))
            inverses = made if inverses is None else np.concatenate([inverses, made])[order]
            known = np.concatenate([known, new])[order]
            self.memory["inverses"] = known, inverses
        return inverses if np.array_equal(known, frequencies) else inverses[np.searchsorted(known, frequencies)]

    def multiply(self, frequencies: np.ndarray, states: np.ndarray, transposed=False) -> np.ndarray:
        """A(s) states (S, m, l), or A(s)^T states."""
        if self.is_diagonal:
            return self._diagonal_with_D(frequencies)[:, :, None] * states
        result = self._diagonal(frequencies)[:, :, None] * states
        self._add_coupled(result, frequencies, states, transposed)
        return result

    def _add_coupled(self, result, frequencies, states, transposed, sign=1.0):
        """Add to the result what A(s) has beside its diagonal of K and M, times states (S, m, l)."""
        a, _, s = self.damping.coefficients(frequencies)
        if self.N is not None:
            result += (sign * a)[:, None, None] * times(self.N.T if transposed else self.N, states)
        if self.operator:
            result += sign * self.operator.apply(s, states, transposed)

    def _diagonal(self, frequencies):
        """a omega^2 + b (S, m): A(s) without D."""
        damping = self.damping
        a, b, s = damping.coefficients(frequencies)
        found = a[:, None] * self.eigenvalues + b[:, None] * (1.0 if self.masses is None else self.masses)
        if damping.higher:
            found += s[:, None] * (damping.at(self.eigenvalues) - damping.alpha - damping.beta * self.eigenvalues)
        return found

    def _diagonal_with_D(self, frequencies):
        """The diagonal (S, m) of A(s) without added terms."""
        found = self._diagonal(frequencies)
        if self.D is not None:
            found += self.damping.coefficients(frequencies)[2][:, None] * np.diag(self.D)
        return found

    def parts_of(self, frequencies: np.ndarray) -> list[np.ndarray]:
        """Parts of the frequencies whose states (and matrices, with a given D) fit."""
        m, l = self.L.shape
        width, most = (l, NUMBERS_IN_CACHE) if self.is_diagonal else (l + m, NUMBERS_AT_A_TIME)
        return np.array_split(frequencies, max(1, -(-len(frequencies) * m * width // most)))

    def response(self, frequencies: np.ndarray) -> np.ndarray:
        """Return H (S, r, p)."""
        return self.responses(frequencies)[0]

    def quick_response(self, frequencies: np.ndarray) -> np.ndarray:
        """Return H (S, r, p) as quick_responses() does, and with added terms by elimination: what is asked for once."""
        if not self.added:
            return self.quick_responses(frequencies)[0]

        def states(chunk, right):
            return _scaled(self.matrices(chunk), np.broadcast_to(right, (len(chunk), *right.shape)))

        return self._by_states(frequencies, states)[0]

    def responses(self, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return H (S, r, p), without the factor s^k of rates, and the drive-point responses b_i^T A^-1 b_i
        (S, p) of the inputs; they are kept as there is room."""
        return kept(self, "responses", frequencies, self.responses_once, (self.io.output_count + 1) * self.B.shape[1])

    def quick_responses(self, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the same, with a given D by its poles alone, without refinement: where round-off is looked at, or no
        matter."""
        if self.poles is None or not self._has_few_products:
            return self.responses(frequencies)
        left, right, values = self.poles.left @ self.B, self.poles.right, self.poles.values

        def inverse(chunk):
            return _reciprocal(self.damping.coefficients(chunk)[2][:, None] - values)

        return self._by_poles(frequencies, inverse, self.Ct.T @ right, self.B.T @ right, left)

    def responses_once(self, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the same, which is not kept."""
        if not (self.is_diagonal and self._has_few_products):
            return self._by_states(frequencies, self.solve)
        return self._by_poles(frequencies, lambda f: 1 / self._diagonal_with_D(f), self.Ct.T, self.B.T, self.B)

    @property
    def _has_few_products(self):
        return self.Ct.size * self.B.shape[1] <= FEW_PRODUCTS

    def _by_poles(self, frequencies, inverse, left, own, right):
        """Return responses() of which each of q modes or poles adds c b^T over its own number, for all frequencies in
        one product: `inverse(frequencies)` (S, q), c `left` (r, q) or `own` (p, q), b `right` (q, p)."""
        products = np.hstack([(left.T[:, :, None] * right[:, None, :]).reshape(len(right), -1), own.T * right])
        H, drive = [], []
        for chunk in self.parts_of(frequencies):
            rows = inverse(chunk) @ products if np.iscomplexobj(products) else _times_real(inverse(chunk), products)
            rows, at = np.split(rows, [len(left) * right.shape[1]], axis=1)
            rows = rows.reshape(len(chunk), len(left), right.shape[1])
            H.append(self.io.rates.responses(2j * np.pi * chunk, rows))
            drive.append(at)
        return np.concatenate(H), np.concatenate(drive)

    def _by_states(self, frequencies, solve):
        """Return responses() by states A(s)^-1 B, as `solve` has them."""
        left, right = self.Ct.T, self.B
        H, drive = [], []
        for chunk in self.parts_of(frequencies):
            states = solve(chunk, right)
            rows = left @ states
            H.append(self.io.rates.responses(2j * np.pi * chunk, rows))
            by_itself = self.io.are_same
            drive.append(np.einsum("spp->sp", rows) if by_itself else np.einsum("mp,smp->sp", right, states))
        return np.concatenate(H), np.concatenate(drive)


def kept(owner: Keeping, name: str, frequencies, compute, size: int) -> tuple[np.ndarray, ...]:
    """Return the arrays (S, ...) that `compute` gives at frequencies (S,), of `size` numbers at each: those that an
    object has computed before and keeps, as there is room, and new ones."""
    known, *arrays = owner.memory.get(name, (np.zeros(0),))
    new = np.setdiff1d(frequencies, known)
    if not len(frequencies) or (len(known) + len(new)) * size > NUMBERS_AT_A_TIME:
        return compute(frequencies)
    if len(new):
        made = compute(new)
        if len(known):
            made = [np.concatenate(pair) for pair in zip(arrays, made, strict=True)]
        known = np.concatenate([known, new])
        order = np.argsort(known)
        known, *arrays = owner.memory[name] = [array[order] for array in (known, *made)]
        for array in arrays:
            array.flags.writeable = False  # what is kept goes to all that ask for it
    if np.array_equal(known, frequencies):
        return tuple(arrays)
    at = np.searchsorted(known, frequencies)
    return tuple(array[at] for array in arrays)


def diagonalised(
    K: np.ndarray, L: np.ndarray, D: np.ndarray | None = None, damping: Proportional = UNDAMPED,
    io: InputsOutputs | None = None, added: Operator = NOTHING, symmetric=True,
    M: np.ndarray | None = None, tau=0.0, gram: np.ndarray | None = None,
) -> PseudoModal:  # fmt: skip
    """Return the model with V^T K V (m, m), V^T L (m, l), V^T D V (m, m) and added terms (m, m) in pseudo-modal
    coordinates (53, 54); by default the columns L are its inputs and outputs. `symmetric`: whether K is, but for
    round-off. `M` (m, m) = V^T M V and `tau`: where V is orthonormal in M + tau^2 K; `gram` (m, m): V^T M V where it is
    I but for round-off, of which the couplings of parts that hardly couple are made."""
    io = io or InputsOutputs(*[np.eye(L.shape[1])] * 2)
    masses = None
    if M is None:
        eigenvalues, vectors = graded_eigenpairs((K + K.T) / 2) if gram is None else eigenpairs_with_gram(K, gram)
    else:
        eigenvalues, masses, vectors = with_masses((K + K.T) / 2, (M + M.T) / 2, tau)
    still = np.flatnonzero(np.abs(eigenvalues) <= NEARLY_ZERO * np.abs(eigenvalues).max(initial=0.0))
    L = _free_of_round_off(vectors.T @ L, still, np.linalg.norm(L, axis=0))

    def turned(matrix):
        own = _free_of_round_off(congruent(matrix, vectors), still, size := np.linalg.norm(matrix))
        return _free_of_round_off(own.T, still, size).T

    N = None if symmetric else turned((K - K.T) / 2)
    rest = Operator.of(D=D if D is None else _free_of_couplings(turned(D)), added=added.map(turned))
    model = PseudoModal(eigenvalues, L, vectors, io, damping, rest, N=N, masses=masses, tau=tau)
    if added or model.is_diagonal:
        return model
    try:
        return replace(model, poles=poles_of(model))
    except np.linalg.LinAlgError:
        return model


def _free_of_couplings(D):
    """Return D (m, m), diagonal where its couplings are round-off: those of modal damping."""
    size = np.sqrt(np.abs(np.diag(D)))
    couplings = D - np.diag(np.diag(D))
    return D if (np.abs(couplings) > COUPLED * np.outer(size, size)).any() else np.diag(np.diag(D))


def _free_of_round_off(rows, still, size):
    """Return rows (m, k) with zeros where those of motions without stiffness are round-off of `size` (k,), or one
    number: nothing but round-off pushes such a motion then, which K does not bound at 0 Hz."""
    if len(still):
        rows[still] = np.where(np.abs(rows[still]) <= PUSHED * size, 0.0, rows[still])
    return rows


def poles_of(model: PseudoModal) -> Poles:
    """Return the poles of a model with a D or N, and the eigenvectors of its first-order form with the state (y, s y).

    What has no mass is given LEAST_MASS: poles at infinity have no eigenvectors. Those of coordinates that nothing
    pushes are left out: on the axis, as of free parts, they would make states of round-off.
    """
    if model.masses is not None:
        scale = 1 / np.sqrt(np.maximum(model.masses, LEAST_MASS))
        found = poles_of(model.with_unit_masses(scale))
        return Poles(found.values, scale[:, None] * found.right, found.left * scale)
    damping, pushed = model.damping, np.flatnonzero(~model.idle)
    m, K = len(pushed), np.diag(model.eigenvalues) if model.N is None else np.diag(model.eigenvalues) + model.N
    D = damping.alpha * np.eye(len(model)) + damping.beta * K + (0.0 if model.D is None else model.D)
    K, D = (matrix[np.ix_(pushed, pushed)] for matrix in (K, D))
    below = -(1 + 1j * damping.eta) * K if damping.eta else -K
    matrix = np.block([[np.zeros((m, m)), np.eye(m)], [below, -D]])
    values, vectors = np.linalg.eig(matrix)
    right, left = np.zeros((len(model), 2 * m), vectors.dtype), np.zeros((2 * m, len(model)), vectors.dtype)
    right[pushed], left[:, pushed] = vectors[:m], np.linalg.inv(vectors)[:, m:]
    return Poles(values, right, left)


def nested(inner: PseudoModal, outer: PseudoModal, columns=None) -> np.ndarray:
    """Return the embedding (m, k) of a model whose basis is k columns of the basis of `outer`, by default the first
    ones."""
    columns = np.arange(len(inner.vectors)) if columns is None else columns
    if outer.masses is None:
        return outer.vectors[columns].T @ inner.vectors
    return outer.coordinates_of(np.eye(len(outer))[:, columns] @ inner.vectors)


def difference(inner: PseudoModal, outer: PseudoModal, embedding, frequencies) -> np.ndarray:
    """E = r^T A_Q^-1 r (S, r, p), equal to H_Q - H_V without its cancellation; V = Q embedding.

    Not for a Caughey series of more than two terms, whose powers of V^T K V are no projections: E = H_Q - H_V.
    """
    if outer.damping.higher:
        return outer.response(frequencies) - inner.response(frequencies)
    loads, measures, found = (inner.B, outer.B), (inner.Ct, outer.Ct), []
    same = outer.is_reciprocal
    for chunk in outer.parts_of(frequencies):
        right = _residual(inner, outer, embedding, chunk, *loads)
        left = right if same else _residual(inner, outer, embedding, chunk, *measures, transposed=True)
        rows = left.transpose(0, 2, 1) @ outer.solve(chunk, right, accuracy=ROUGH)
        found.append(outer.io.measured(2j * np.pi * chunk, rows))
    return np.concatenate(found)


def _residual(inner, outer, embedding, frequencies, load_of_inner, load, transposed=False):
    """r = L_Q - A_Q U y_V (S, m, p)."""
    states = times(embedding, inner.solve(frequencies, load_of_inner, transposed, ROUGH))
    return load - outer.multiply(frequencies, states, transposed)


def columns(states: np.ndarray) -> np.ndarray:
    """Return real and imaginary parts of states (S, m, l) side by side: (m, 2 S l), or (m, S l) of real ones."""
    flat = states.transpose(1, 0, 2).reshape(states.shape[1], states.shape[0] * states.shape[2])
    return np.hstack([flat.real, flat.imag]) if np.iscomplexobj(flat) else flat


def _times_real(matrix, real):
    """Return a complex matrix times a real one, without complex arithmetic."""
    product = np.empty((len(matrix), real.shape[1]), dtype=complex)
    product.real = np.ascontiguousarray(matrix.real) @ real
    product.imag = np.ascontiguousarray(matrix.imag) @ real
    return product


def _column_norms(blocks):
    """Return norms (S, l) of the columns of blocks (S, m, l), each of which may have units of its own."""
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


def _scaled(matrices, right):
    """Return matrices^-1 right (S, m, l), with the rows and columns of high modes scaled to the size of the others."""
    scale = 1 / np.sqrt(np.maximum(np.abs(np.einsum("smm->sm", matrices)), np.finfo(float).tiny))[:, :, None]
    matrices *= scale
    matrices *= scale.transpose(0, 2, 1)
    return scale * _eliminated(matrices, scale * right)
