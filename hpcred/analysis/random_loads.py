"""Compute responses of a reduced model to random and harmonic loads.

With the one-sided densities G (p, p) of the inputs, G_jk = E[conj(U_j) U_k], that of an output y = h u is
conj(h) G h^T. Its integral over the band follows the resonances: the panels begin around the poles of the small
model, and are bisected until Gauss' rule of 7 nodes agrees with that of 15. Everything is small and local.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from ..model.outputs.rates import combined
from ..parallel.as_html import as_html
from ..parallel.failures import ComputationError, InputError
from ..reduction.result.reduced_model import ReducedModel, require_finite
from .frequency_response import frequencies_to_draw, resonances_of

SEMIDEFINITE = 1e-6  # of the coherence matrix: eigenvalues down to minus this are digits of a file
UNDAMPED = 1e-10  # damping ratio below which a resonance has no finite response
SHOWN = 20  # outputs that are listed
EXACT, ROUNDS = 1e-8, 40  # relative error of mean squares, and bisections until it is reached
TOGETHER = 2**20  # numbers of the states that are computed in one call
(_FINE, _OF_FINE), (_COARSE, _OF_COARSE) = leggauss(15), leggauss(7)
NODES = np.concatenate([_FINE, _COARSE])
WEIGHTS = block_diag(_OF_FINE, _OF_COARSE)  # (2, 22) of Gauss' rules of 15 and of 7 nodes
COMPONENTS = ("xx", "yy", "zz", "xy", "yz", "zx")
DEVIATOR = np.zeros((6, 6))  # von Mises: s^T s with s = DEVIATOR sigma
DEVIATOR[:3, :3] = np.sqrt(1.5) * (np.eye(3) - 1 / 3)
DEVIATOR[3:, 3:] = np.sqrt(3) * np.eye(3)


@dataclass(frozen=True, eq=False)
class RandomResponse:
    """The response to random loads.

    Attributes
    ----------
    frequencies : ndarray, shape (F,)
        Hz, with all resonances.
    names : tuple of str
        Of the r outputs; of stresses such as "20:xx" and "20:mises".
    psd : ndarray, shape (F, r)
        One-sided densities, in the square of the unit of the output over Hz.
    rms : ndarray, shape (r,)
        Over the band.
    """

    frequencies: np.ndarray
    names: tuple[str, ...]
    psd: np.ndarray
    rms: np.ndarray

    @property
    def _title(self) -> str:
        return f"response to random loads, {self.frequencies[0]:.6g} to {self.frequencies[-1]:.6g} Hz"

    def __repr__(self):
        """Return the band, and the root mean squares of the first outputs."""
        shown = ", ".join(f"{name} {value:.6g}" for name, value in zip(self.names[:SHOWN], self.rms, strict=False))
        return f"<{self._title}: RMS of {shown}{', ...' * (len(self.names) > SHOWN)}>"

    def _repr_html_(self):
        """Return the same as a table for notebooks."""
        shown = zip(self.names[:SHOWN], self.rms.tolist(), strict=False)
        rows = [{"output": name, "RMS": value} for name, value in shown]
        rest = [f"and {len(self.names) - SHOWN} more outputs"] * (len(self.names) > SHOWN)
        return as_html(self._title, {}, rows, rest)


def random_response(
    reduced: ReducedModel, frequencies: ArrayLike, density: ArrayLike, *, band: tuple[float, float] | None = None,
    orders: ArrayLike | None = None, stress: Any = None,
) -> RandomResponse:  # fmt: skip
    """Return densities and root mean squares of the outputs under stationary random loads.

    Parameters
    ----------
    reduced : ReducedModel
    frequencies : array_like, shape (N,)
        Hz, ascending.
    density : array_like, shape (N, p) or (N, p, p)
        One-sided densities of the inputs, in the square of their SI unit over Hz: of loads that are not correlated, or
        with cross spectra E[conj(U_j) U_k]. Between the frequencies straight in logarithms, and zero outside.
    band : (float, float), optional
        Hz; by default all `frequencies`.
    orders : array_like of int, shape (p,), optional
        2 for inputs that are bases whose displacement the density is of, 1 for velocities; by default 0.
    stress : StressModes, optional
        Stresses of the same coordinates, whose components and von Mises stresses are outputs too.

    Returns
    -------
    RandomResponse
        The root mean square of von Mises is that of Segalman, the root of the mean of its square.

    Raises
    ------
    InputError
        For densities that are negative or not positive semidefinite, frequencies that do not ascend or do not reach
        over the band, and resonances without damping in the band.
    """
    require_finite(reduced)
    over, density = _checked(reduced, frequencies, density)
    low, high = (over[0], over[-1]) if band is None else band
    if not over[0] * (1 - 1e-9) <= low < high <= over[-1] * (1 + 1e-9):
        raise InputError(f"density: found {over[0]:g} to {over[-1]:g} Hz, expected frequencies over the band "
                         f"{low:g} to {high:g} Hz")  # fmt: skip
    orders = np.zeros(reduced.B.shape[1], int) if orders is None else np.asarray(orders)
    rows, names, squares = _rows(reduced, stress)

    def psd(f):
        step = max(TOGETHER // max(reduced.size * max(reduced.size, len(names)), 1), 1)
        return np.concatenate([_psd(reduced, chunk, over, density, orders, rows, squares)
                               for chunk in np.split(f, range(step, len(f), step))])  # fmt: skip

    # panels begin at the table, and around the resonances, which they resolve
    at, ratios = resonances_of(reduced)
    inside = (at > low) & (at < high)
    if (still := inside & (ratios < UNDAMPED)).any():
        raise InputError(f"damping: the resonance at {at[still][0]:g} Hz has none, and no finite response to random "
                         "loads; reduce with damping")  # fmt: skip
    width = at[inside] * ratios[inside]
    away = 0.5 * 3.0 ** np.arange(np.ceil(np.log(2 * (high - low) / width.min(initial=high - low)) / np.log(3)) + 1)
    near = (at[inside][:, None] + np.concatenate([-away, [0.0], away]) * width[:, None]).ravel()
    octaves = high * 0.5 ** np.arange(20)  # no peak is small beside its panel
    ends = np.union1d(np.concatenate([[low, high], over, octaves]), near)
    drawn = frequencies_to_draw((low, high), (at, ratios), over[(over > 0) & (over >= low) & (over <= high)])
    total = integral(psd, ends[(ends >= low) & (ends <= high)])
    return RandomResponse(drawn, names, psd(drawn), np.sqrt(np.maximum(total, 0.0)))


def harmonic_response(
    reduced: ReducedModel, frequencies: ArrayLike, amplitudes: ArrayLike, *, orders: ArrayLike | None = None
) -> np.ndarray:
    """Return complex amplitudes of the outputs under harmonic loads of all inputs together.

    Parameters
    ----------
    reduced : ReducedModel
    frequencies : array_like, shape (N,)
        Hz.
    amplitudes : array_like, complex, shape (N, p)
        Of the inputs, in SI units, with their phases.
    orders : array_like of int, shape (p,), optional
        2 for inputs that are bases whose displacement is given, 1 for velocities; by default 0.

    Returns
    -------
    ndarray, complex, shape (N, r)

    Raises
    ------
    InputError
        For other shapes, and at a pole.
    """
    s, amplitudes = 2j * np.pi * np.asarray(frequencies, dtype=float), np.asarray(amplitudes)
    if amplitudes.shape != (len(s), reduced.B.shape[1]):
        raise InputError(f"amplitudes: found an array {amplitudes.shape}, expected {(len(s), reduced.B.shape[1])}")
    factors = 1.0 if orders is None else s[:, None] ** np.asarray(orders)
    H = reduced.frequency_response(np.asarray(frequencies, dtype=float))
    return np.einsum("frp,fp->fr", H, factors * amplitudes)


def integral(function, ends: np.ndarray) -> np.ndarray:
    """Return the integral (r,) of a function of f (F,) with values (F, r), over panels with these ends, that are
    bisected until their error is 1e-8 of it. Raises ComputationError."""
    left, right = ends[:-1], ends[1:]
    done = lost = 0.0
    for _ in range(ROUNDS):
        middle, half = (left + right) / 2, (right - left) / 2
        values = function((middle[:, None] + half[:, None] * NODES).ravel()).reshape(len(middle), len(NODES), -1)
        fine, coarse = (half[:, None] * np.einsum("n,pnr->pr", rule, values) for rule in WEIGHTS)
        error = np.abs(fine - coarse)
        total = done + fine.sum(axis=0)
        share = (error / np.maximum(total, 1e-300)).max(axis=1, initial=0.0)
        split = share > EXACT / (4 * len(ends))
        if lost + share.sum() <= EXACT or not split.any():
            return total
        done, lost = done + fine[~split].sum(axis=0), lost + share[~split].sum()
        left, right = (np.concatenate(pair) for pair in ((left[split], middle[split]), (middle[split], right[split])))
    raise ComputationError("the integral of the densities does not converge; is there a resonance without damping?")


def _checked(reduced, frequencies, density):
    over, density = np.asarray(frequencies, dtype=float), np.asarray(density, dtype=complex)
    p = reduced.B.shape[1]
    if density.ndim == 2:
        density = density[:, :, None] * np.eye(p) if density.shape[1:] == (p,) else density
    if over.ndim != 1 or density.shape != (len(over), p, p) or len(over) < 2:
        raise InputError(f"density: found an array {density.shape} for {over.shape} frequencies and {p} inputs, "
                         "expected (N, p) or (N, p, p), and two frequencies or more")  # fmt: skip
    if not (np.isfinite(over).all() and np.isfinite(density).all()):
        raise InputError("density: found NaN or Inf, expected finite numbers")
    if over[0] < 0 or (np.diff(over) <= 0).any():
        raise InputError("density: found frequencies that do not ascend from 0 or more, expected ascending ones")
    if (np.einsum("fpp->fp", density).real < 0).any():
        raise InputError("density: found one below 0, expected none")
    scaled = _coherences(density)
    lost = (density != 0) & (scaled == 0)
    skew = np.abs(scaled - scaled.conj().transpose(0, 2, 1)).max(axis=(1, 2))
    least = np.linalg.eigvalsh(scaled).min(axis=1)
    wrong = np.flatnonzero(lost.any(axis=(1, 2)) | (skew > SEMIDEFINITE) | (least < -SEMIDEFINITE))
    if len(wrong):
        raise InputError(f"density: the cross spectra at {over[wrong[0]]:g} Hz are not Hermitian and positive "
                         "semidefinite, as of a coherence above 1; expected ones that loads can have")  # fmt: skip
    return over, density


def _coherences(density):
    """Return densities (N, p, p) over the roots of the own ones, 0 where one of these is."""
    root = np.sqrt(np.einsum("fpp->fp", density).real)
    with np.errstate(divide="ignore", invalid="ignore"):  # one after the other: their product may be below all numbers
        coherence = density / root[:, :, None] / root[:, None, :]
    return np.where((root[:, :, None] > 0) & (root[:, None, :] > 0), coherence, 0.0)


def _rows(reduced, stress):
    """Return rows (k, m) of displacements beside the outputs, the names of all, and which of all make up each."""
    names, squares = list(reduced.output_names), np.eye(len(reduced.output_names))
    if stress is None:
        return None, tuple(names), squares
    of_nodes = stress.stress.transpose(1, 2, 0)  # (s, 6, m)
    rows = np.concatenate([np.concatenate([rows_of_node, DEVIATOR @ rows_of_node]) for rows_of_node in of_nodes])
    for node in stress.node:
        names += [f"{node}:{component}" for component in (*COMPONENTS, "mises")]
    six = np.zeros((7, 12))
    six[:6, :6], six[6, 6:] = np.eye(6), 1.0
    return rows, tuple(names), block_diag(squares, *[six] * len(of_nodes))


def _psd(reduced, f, over, density, orders, rows, squares):
    """Return the densities (F, r) of outputs at f (F,) in Hz."""
    s = 2j * np.pi * f
    states = reduced.states(s)
    H = combined(reduced.output_parts, s) @ states
    if reduced.feedthrough is not None:
        H = H + reduced.feedthrough
    if rows is not None:
        H = np.concatenate([H, rows @ states], axis=1)
    H = H * s[:, None, None] ** orders
    values, vectors = np.linalg.eigh(_interpolated(f, over, density))
    loads = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return (np.abs(H @ loads.conj()) ** 2).sum(axis=2) @ squares.T


def _interpolated(f, over, density):
    """Return densities (F, p, p) at f (F,), which stay positive semidefinite: own ones straight in logarithms, or in
    numbers where one is zero, and coherences straight in numbers."""
    place = np.clip(np.searchsorted(over, f, side="right") - 1, 0, len(over) - 2)
    a, b = over[place], over[place + 1]
    share = ((f - a) / (b - a))[:, None]
    diagonal = np.einsum("fpp->fp", density).real
    low, high = diagonal[place], diagonal[place + 1]
    both = (low > 0) & (high > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        log = np.where(a > 0, np.log(f / a) / np.log(b / a), share[:, 0])[:, None]
        autopower = np.where(both, low ** (1 - log) * high**log, low + share * (high - low))
    coherence = _coherences(density)
    coherence = coherence[place] + share[:, :, None] * (coherence[place + 1] - coherence[place])
    coherence[:, np.arange(len(diagonal[0])), np.arange(len(diagonal[0]))] = 1.0
    root = np.sqrt(autopower)
    return coherence * root[:, :, None] * root[:, None, :]
