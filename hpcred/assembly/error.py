"""Estimate the error of a machine's responses from those of its bodies, and what each body would have to be.

With receptances Y of the bodies, Y_r of the reduced ones and E = Y - Y_r, the error of the machine is, exactly,

    H - H_r = L E (I + K E)^-1 R,    L = I - Y_r K, R = I - K Y_r, K = G_i W G_o (see coupling),

and |E_ji| <= eps_b h_j g_i in every body b. So |H - H_r| <= |L| h eps (I - N eps)^-1 g |R|, N = g |K| h, a matrix of as
many rows as bodies: a bound, where its spectral radius is below one. The errors of several directions have one sign at
worst, and any signs mostly: their sums are taken between both, as norms of exponent SIGNS. At a resonance of a free
body this may be far too large, since |L| has no signs; the error of the machine has no pole there. By the principle of
the maximum it is at most the largest one on a circle without poles of the machine: the smaller of both is taken, an
estimate. See docs/theory/assembly.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from ..analysis.frequency_response import frequencies_to_draw, resonances_of, slices_of
from ..model.outputs.rates import combined, orders_of
from ..parallel.failures import InputError
from ..reduction.result.accuracy import Accuracy
from ..reduction.result.measure import Directions, Measure, drive_points, silent_outputs
from ..reduction.result.reduced_model import ReducedModel
from .coupling import Machine, blocks
from .parts import UNDAMPED

CIRCLE, ANGLES = 0.5, 6  # radius over the distance to the nearest pole of the machine, and points on it
SIGNS = 1.4  # exponent of sums over directions: 1 for errors of one sign, 2 for errors of random signs
LEAST = 1e-4  # of the band's upper end: free bodies have no response at 0 Hz
MOST = 150  # frequencies at which the error is estimated, besides those at resonances
ROUNDS = 60  # in which errors are made smaller until the machine has its tolerance


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensitivity:
    """How errors of bodies become one of the machine at frequencies (S,) in Hz and at C places around each: `out`
    |L| h (S, C, r, b), `between` N (S, C, b, b), `into` g |R| (S, C, b, p), with the errors of today; `scale` (S, r,
    p) of its responses. Factors (b,) are those by which the errors of the bodies change."""

    frequencies: np.ndarray
    out: np.ndarray
    between: np.ndarray
    into: np.ndarray
    scale: np.ndarray
    measure: Measure

    def bounds(self, factors: np.ndarray) -> np.ndarray:
        """Return the bound of the error of every response at every place (S, C, r, p); inf where there is none."""
        N = self.between * factors
        radius = np.abs(np.linalg.eigvals(N)).max(axis=-1)
        known = radius < 1
        inverse = np.linalg.inv(np.eye(len(factors)) - np.where(known[..., None, None], N, 0.0))
        errors = np.where(known[..., None, None], (self.out * factors) @ inverse @ self.into, np.inf)
        return errors / self.scale[:, None]

    def each(self, factors: np.ndarray) -> np.ndarray:
        """Return the estimated error of every response (S, r, p); inf where it is not known."""
        bounds = self.bounds(factors)
        return np.minimum(bounds[:, 0], bounds[:, 1:].max(axis=1))

    def curve(self, factors=None) -> np.ndarray:
        """Return the estimated error (S,) of the machine, by default with the errors of today."""
        return self.measure.total(self.each(np.ones(self.between.shape[-1]) if factors is None else factors))

    def shares(self) -> np.ndarray:
        """Return what each body (b,) has in the largest error, at most and to first order."""
        one = self.out[..., :, None, :] * np.swapaxes(self.into, -1, -2)[..., None, :, :]  # (S, C, r, p, b)
        one = np.minimum(one[:, 0], one[:, 1:].max(axis=1)) / self.scale[..., None]
        return one.max(axis=(0, 1, 2))

    def needed(self, tolerance: float) -> np.ndarray:
        """Return factors (b,), at most 1, with which the machine has the tolerance."""
        if self.curve().max() <= tolerance:
            return np.ones(self.between.shape[-1])
        # who takes less than its share of the tolerance leaves the rest to the others
        use = np.maximum(self.shares(), 1e-300)
        wanting, share = np.ones(len(use), dtype=bool), tolerance
        for _ in use:
            share = max(tolerance - use[~wanting].sum(), 0.0) / max(wanting.sum(), 1)
            wanting &= use > share
        share_of = np.where(wanting, share / use, 1.0)
        for _ in range(ROUNDS):  # second order, and bodies whose largest parts are at other frequencies
            now = self.curve(share_of).max()
            if now <= tolerance:
                break
            smaller = wanting if wanting.any() else np.ones(len(use), dtype=bool)
            step = max(0.9 * tolerance / now, 0.1) if np.isfinite(now) else 0.5
            share_of = np.where(smaller, share_of * step, share_of)
        return share_of


def sensitivity(machine: Machine, reduced: ReducedModel, band: tuple[float, float]) -> Sensitivity:
    """Return the sensitivity of a machine with its `reduced` model, both with the damping that the errors of its bodies
    were measured with, over a band (Hz)."""
    # where: between resonances and beside them, and on circles that reach half the way to the nearest pole
    low = max(band[0], LEAST * band[1])
    at, ratios = resonances_of(reduced)
    inside = (at >= band[0]) & (at <= band[1])
    drawn = frequencies_to_draw((low, band[1]), (at[inside], ratios[inside]))
    frequencies = np.union1d(drawn[:: max(len(drawn) // MOST, 1)], at[inside])
    frequencies = frequencies[(frequencies >= low) & (frequencies <= band[1])]
    s, poles = 2j * np.pi * frequencies, reduced.poles()
    radius = CIRCLE * np.minimum(np.abs(s[:, None] - poles).min(axis=1, initial=np.inf), np.abs(s))
    turns = np.exp(2j * np.pi * (np.arange(ANGLES) + 0.5) / ANGLES)
    places = np.concatenate([s[:, None], s[:, None] + radius[:, None] * turns], axis=1)
    # sizes of L, R and K, and of what the errors of the bodies may be
    flat = places.ravel()
    f = np.repeat(frequencies, len(turns) + 1)
    reach = np.repeat(radius / (2 * np.pi), len(turns) + 1) * np.tile([0.0, *np.ones(len(turns))], len(frequencies))
    largest = max(*machine.outputs.matrix.shape, *machine.inputs.matrix.shape, len(machine.conditions))
    made = [_sizes(machine, flat[chunk], f[chunk], reach[chunk]) for chunk in slices_of(len(flat), largest)]
    out, into, between = map(np.concatenate, zip(*made, strict=True))
    shaped = [sizes.reshape(*places.shape, *sizes.shape[1:]) for sizes in (out, between, into)]
    # the measure of the machine's own responses, of displacements as those of the bodies
    outputs = reduced.output_parts
    orders = orders_of(outputs)
    states = reduced.states(s)
    H, drive = combined(outputs, s, orders) @ states, np.einsum("ip,sip->sp", reduced.B, states)
    measure = Directions().over(frequencies, H, drive, drive_points(reduced.B, outputs.sum(axis=0).T),
                                silent_outputs(outputs.sum(axis=0), [states]))  # fmt: skip
    hm, gm = measure.scales(H, drive)
    rates = np.abs(s)[:, None] ** np.maximum(orders, 0)
    return Sensitivity(frequencies=frequencies, out=shaped[0], between=shaped[1], into=shaped[2],
                       scale=(hm * rates)[:, :, None] * gm[:, None, :], measure=measure)  # fmt: skip


def _sizes(machine, s, f, reach):
    """Return |L| h (S, r, b), g |R| (S, b, p) and N (S, b, b) at s (S,); see Part.scales for `f` and `reach`."""
    L, R, K = machine.coupled(s, machine.receptances(s))
    scales = [part.scales(s, f, reach) for part in machine.parts.values()]
    h, g = (blocks([scale[side][..., None] for scale in scales]) for side in (0, 1))  # (S, r, b), (S, p, b)
    g = np.swapaxes(g, 1, 2)
    return (_added(machine.outputs.matrix @ L, h), _added(g, R @ machine.inputs.matrix.T), _added(g, K, h))


def _added(*matrices) -> np.ndarray:
    """Return the product of the sizes of matrices, whose sums are norms of exponent SIGNS."""
    return reduce(np.matmul, (np.abs(matrix) ** SIGNS for matrix in matrices)) ** (1 / SIGNS)


def why_not_known(machine: Machine, band) -> str:
    """Return why the error of a machine over a band cannot be estimated, "" where it can."""
    for name, part in machine.parts.items():
        if part.exact:
            continue
        if part.accuracy is None:
            return (f"the error of body '{name}' is not known; reduce it to a tolerance, or say exact = true of it "
                    "where it counts as exact")  # fmt: skip
        low, high = part.accuracy.band
        if band[0] < low or band[1] > high:
            return (f"the error of body '{name}' is known over {low:g} to {high:g} Hz, not over {band[0]:g} to "
                    f"{band[1]:g} Hz; reduce it over this band")  # fmt: skip
    return ""


def damping_of_errors(machine: Machine) -> float | None:
    """Return the loss factor with which the errors of all bodies were measured, None where they have no common one."""
    accuracies = [(part.accuracy, part.model.D.any()) for part in machine.parts.values()
                  if part.accuracy is not None]
    factors = {accuracy.loss_factor for accuracy, _ in accuracies}
    undamped = any(accuracy.loss_factor and not accuracy.beside_damping and damped for accuracy, damped in accuracies)
    return None if len(factors) > 1 or undamped else max(factors, default=UNDAMPED)


def accuracy_of_machine(machine: Machine, tau: float, band, tolerance: float | None) -> tuple[Accuracy, list[dict]]:
    """Return the estimated accuracy of a machine, and a row for each body: its error, by how much it is multiplied,
    what it would have to be for the tolerance; inf where nothing bounds it. Raises InputError where it cannot be
    estimated."""
    if why := why_not_known(machine, band):
        raise InputError(f"tolerance: {why}")
    measured = machine.as_measured()
    reduced = measured.model(tau)[0]
    sensed = sensitivity(measured, reduced, band)
    eps = np.array([part.eps for part in machine.parts.values()])
    curve = sensed.curve()
    largest = float(curve.max())
    asked = largest if tolerance is None else tolerance
    needed = eps * (1.0 if tolerance is None else sensed.needed(asked))
    rows = [
        {"body": name, "error": e, "in the machine": a} | ({} if tolerance is None else {"needs": n})
        for name, e, a, n in zip(machine.parts, eps.tolist(), sensed.shares().tolist(), needed.tolist(), strict=True)
    ]  # fmt: skip
    # a machine that moves freely has no response at 0 Hz
    over = (sensed.frequencies[0], band[1]) if (reduced.frequencies == 0).any() else band
    again = [f"'{row['body']}' to {row['needs']:.1e}" for row in rows if tolerance and row["needs"] < row["error"]]
    accuracy = Accuracy(
        tolerance=asked, band=tuple(map(float, over)),
        reached=bool(tolerance is None or largest <= tolerance),
        stopped="" if not again else f"reduce {', '.join(again)}",
        largest=largest, worst=float(sensed.frequencies[curve.argmax()]), mean=float(curve.mean()),
        noise=0.0, measured="estimated from the errors of the bodies, with the damping that these were measured with"
        + machine.exact,
        uncompressed_size=sum(part.size for part in machine.parts.values()), highest=band[1], missing_modes=None,
        points=(), proofs=(), frequencies=tuple(sensed.frequencies.tolist()), eps=tuple(curve.tolist()),
        unproven=f"an estimate from the errors of the bodies{machine.exact}", measure=sensed.measure,
        loss_factor=damping_of_errors(machine) or 0.0, beside_damping=True,
    )  # fmt: skip
    return accuracy, rows
