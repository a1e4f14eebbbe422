"""Compare the estimate of an error with full solves at random frequencies.

The frequencies are drawn at random over the band, and some right beside resonances, where errors are largest.
The full model is factored there with the damping that the accuracy was measured with.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass

import numpy as np

from ..linalg.pencil import modes_of
from ..linalg.solvers.settings import Factoring
from ..model.damping import GivenDamping, Structural
from ..model.digits import changes_of_responses
from ..model.second_order_model import SecondOrderModel, require_model
from ..parallel.declared import declared
from ..parallel.failures import InputError
from ..parallel.progress import counted
from ..parallel.ranges import SAMPLES, within
from ..reduction.interface_coordinates import elastic_part
from ..reduction.result.accuracy import Accuracy, in_percent
from ..reduction.result.reduced_model import ReducedModel, as_measured
from ..reduction.small.error_estimate import at_poles
from .error import relative_error
from .frequency_response import measured_response, response_and_drive

BESIDE = 0.3  # of its damping ratio: how far from a resonance
SHARPEST = 1e-7  # damping ratio that counts as such
SOME = 3  # resonances at most
KNOWN = 0.1  # change of a response by the last digits of K, above which its error is not asked for


@dataclass(frozen=True, kw_only=True)
class Check:
    """The estimated error beside that of full solves at random frequencies.

    Attributes
    ----------
    seed : int
        What drew the frequencies.
    bound : float
        The eps that holds.
    frequencies : tuple of float
        Hz.
    estimated, measured : tuple of float
        The relative errors at these frequencies.
    beside_resonances : int
        How many of the frequencies are there, besides those that the user asked for.
    digits : tuple of float
        By what part the last digits of K change the full response there, in which no model is better; empty where
        nothing is known.
    """

    seed: int
    bound: float
    frequencies: tuple[float, ...]
    estimated: tuple[float, ...]
    measured: tuple[float, ...]
    beside_resonances: int = 0
    digits: tuple[float, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether no measured error is above the bound, but for what the last digits of K decide where they leave the
        response known to KNOWN."""
        return not self._above.any() and not self._unknown.any()

    @property
    def _beyond(self) -> np.ndarray:
        return ~(np.array(self.measured) <= self.bound)

    @property
    def _by_digits(self) -> np.ndarray:
        return np.array(self.digits) if self.digits else np.zeros(len(self.measured))

    @property
    def _above(self) -> np.ndarray:
        return ~(np.array(self.measured) <= self.bound + self._by_digits)

    @property
    def _unknown(self) -> np.ndarray:
        """Where neither the model nor the full solve is right or wrong, as K does not say what the response is."""
        return self._beyond & ~self._above & (self._by_digits > KNOWN)

    @property
    def rows(self) -> list[dict]:
        """Frequency, estimated and measured error, for a table."""
        values = zip(self.frequencies, self.estimated, self.measured, strict=True)
        return [dict(zip(("f (Hz)", "estimated", "measured"), row, strict=True)) for row in values]

    @property
    def sentence(self) -> str:
        """The verdict."""
        above, unknown = int(self._above.sum()), int(self._unknown.sum())
        undecided = int(self._beyond.sum()) - above - unknown
        worst = int(np.argmax(self.measured))
        measured, estimated, bound = (
            in_percent(error, self.bound) for error in (self.measured[worst], self.estimated[worst], self.bound)
        )
        verdict = "" if not above else f"ABOVE at {above} of them, "
        if undecided:
            verdict += f"above at {undecided} where the last digits of K decide, "
        if unknown:
            share = in_percent(min(float(self._by_digits[self._unknown].max()), 1.0), self.bound)
            verdict += (
                f"NOT KNOWN at {unknown}, where the last digits of the matrix K change the response by {share} or more "
                "of itself, so that full solves do not know it either (give more damping, or larger elements), "
            )
        where = f", {self.beside_resonances} of them beside resonances" if self.beside_resonances else ""
        return (
            f"{counted(len(self.frequencies), 'full solve')}{where} (--seed {self.seed}): {verdict}largest error "
            f"{measured} (tolerance {bound}), at {self.frequencies[worst]:.6g} Hz (estimated {estimated})"
        )


def fresh_frequencies(band, resonances, count: int, seed: int | None, comm) -> tuple[int, np.ndarray]:
    """Return the seed, a new one unless given, and in Hz `count` frequencies of the band and up to SOME beside
    `resonances`, which are frequencies (k,) with damping ratios, sharp ones more often; ascending. Collective."""
    within("check", declared("check", count, int), SAMPLES)
    if count < 1:
        raise InputError(f"check: found {count}, expected at least 1 frequency")
    if (declared("seed", seed, int | None) or 0) < 0:
        raise InputError(f"seed: found {seed}, expected a whole number of at least 0")
    low, high = band
    seed = comm.bcast(secrets.randbelow(10**6) if seed is None else seed)
    random = np.random.default_rng(seed)
    drawn = random.uniform(low, high, count)
    near, ratio = np.broadcast_arrays(*resonances)
    ratio = np.maximum(ratio, SHARPEST)
    near = near * (1 + BESIDE * ratio)
    inside = (near > max(low, 0.0)) & (near < high)
    near, sharp = near[inside], 1 / ratio[inside]
    if len(near):
        near = random.choice(near, min(SOME, len(near)), replace=False, p=sharp / sharp.sum())
    return seed, comm.bcast(np.unique(np.concatenate([drawn, near])))


def estimate_at(accuracy: Accuracy, frequencies) -> np.ndarray:
    """Return the stored curve of an accuracy at frequencies (F,) of its band, by linear interpolation of its logarithm.
    """
    frequencies = np.asarray(frequencies, dtype=float)
    low, high = accuracy.band
    if frequencies.min() < low * (1 - 1e-12) or frequencies.max() > high * (1 + 1e-12):
        raise InputError(f"frequencies: found {frequencies.min():g} to {frequencies.max():g} Hz, expected "
                         f"{low:g} to {high:g} Hz, where the error is known")  # fmt: skip
    curve = np.maximum(accuracy.eps, np.finfo(float).tiny)
    return np.exp(np.interp(frequencies, accuracy.frequencies, np.log(curve)))


def measuring_damping(accuracy: Accuracy, damping):
    """Return the damping that an accuracy was measured with, for a full response."""
    if not accuracy.loss_factor:
        return damping
    return (GivenDamping if accuracy.beside_damping else Structural)(loss_factor=accuracy.loss_factor)


def check_reduced(
    reduced: ReducedModel, model: SecondOrderModel, count: int = 5, *, seed: int | None = None,
    groups: int | None = None, factoring: Factoring | None = None, progress=None,
) -> Check:  # fmt: skip
    """Compare the estimated error of a reduction to a tolerance with full solves at random frequencies. Collective.

    Parameters
    ----------
    reduced : ReducedModel
    model : SecondOrderModel
        The model that was reduced, with the same inputs and outputs.
    count : int, default 5
        Random frequencies over the band; some beside resonances are added.
    seed : int, optional
        Of the random frequencies.
    groups : int, optional
        Groups of ranks that share the frequencies (see frequency_response).
    factoring : Factoring, optional
        How to factor, and in how much memory.

    Raises
    ------
    InputError
        If the reduced model was not made to a tolerance.
    """
    declared("reduced", reduced, ReducedModel)
    require_model(model)
    accuracy, record, reduced = accuracy_of(reduced), reduced.record, elastic_part(reduced)
    seed, frequencies = fresh_frequencies(accuracy.band, _resonances(reduced, accuracy), count, seed, model.comm)
    full, drive = response_and_drive(
        model, frequencies, record.frame, measuring_damping(accuracy, record.damping), factoring=factoring,
        groups=groups, progress=progress, measured=True,
    )  # fmt: skip
    measured = measured_response(as_measured(reduced, accuracy), frequencies, model.rates)
    errors = relative_error(full, measured, accuracy.measure, drive=drive)
    digits = _changes_by_last_digits(reduced, accuracy, frequencies)
    return Check(
        seed=seed, bound=bound_of(accuracy), frequencies=tuple(frequencies.tolist()),
        estimated=tuple(estimate_at(accuracy, frequencies).tolist()), measured=tuple(errors.tolist()),
        beside_resonances=len(frequencies) - count, digits=tuple(digits.tolist()),
    )  # fmt: skip


def _resonances(reduced, accuracy):
    """Return the frequencies (k,) in Hz where the response may peak as it is measured, and the damping ratios there: by
    the poles, which a given D moves off the pseudo-frequencies."""
    if accuracy.loss_factor and not (accuracy.beside_damping or reduced.added):
        return reduced.frequencies, accuracy.loss_factor / 2
    f, ratios = at_poles(reduced.poles())
    return f, ratios + accuracy.loss_factor / 2


def _changes_by_last_digits(reduced, accuracy, frequencies) -> np.ndarray:
    """Return by what part the last digits of K change resonances of the band at frequencies (F,); empty where nothing
    is known of them."""
    count = len(accuracy.last_digits)
    if not count:
        return np.zeros(0)
    small, omega = as_measured(reduced, accuracy), 2 * np.pi * frequencies[:, None]
    if small.interfaces:  # in pseudo-modal coordinates
        small = small.in_coordinates(modes_of(small.K, small.M)[1])
    eigenvalues, damping = (np.diag(matrix)[:count] for matrix in (small.K, small.D))
    stiffness = (1 + 1j * accuracy.loss_factor) * eigenvalues - omega**2 + 1j * omega * damping
    return changes_of_responses(np.array(accuracy.last_digits), stiffness)


def bound_of(accuracy: Accuracy) -> float:
    """Return the bound of the error: the tolerance, or the error that was reached instead."""
    return accuracy.tolerance if accuracy.reached else accuracy.largest + accuracy.noise


def accuracy_of(reduced: ReducedModel, name="the reduced model") -> Accuracy:
    """Return the accuracy of an automatic reduction. Raises InputError for other ones."""
    accuracy = reduced.record.accuracy if reduced.record is not None else None
    if accuracy is None:
        raise InputError(
            f"{name}: its basis was chosen by hand, so that nothing is known of its error; compare with the full model "
            "(--full MODEL.h5), or reduce to a tolerance"
        )
    return accuracy
