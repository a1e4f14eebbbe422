"""Estimate the error of a model from a richer one that contains it, and choose frequencies to look at.

The error curve is smooth but for the poles of the two models: between two frequencies of a grid nothing is hidden where
their distance is a fraction of that to the nearest pole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ...linalg.known import ModeCount
from ...linalg.pencil import LEAST_MASS
from ...parallel.decisions import Place, Team
from ..result.measure import Measure, Paper, drive_points
from ..result.oscillating_poles import places_of_poles
from .pseudo_modal import NUMBERS_AT_A_TIME, Keeping, Proportional, PseudoModal, difference, kept

UNIFORM = 200  # frequencies of a band, beside those around resonances
APART = 0.02  # of the band between points
GAP = 2e-3  # of a frequency between a point and pseudo-frequencies, but at most
NARROW = 0.1  # of the band
ROUNDOFF = 1e-14  # of the measure: what two computers need not agree on
STEP, FINE = 1.0, 0.4  # between frequencies of a grid, in distances from the nearest pole
SAME_POLE = 0.3  # of its distance from the axis, within which a pole needs no frequencies of its own
SHARPEST = 1e-9  # of its frequency: the least distance of a pole from the axis that a grid resolves
SILENT = 1e-12  # see quietness: below it a response counts as round-off where that was not computed
SMALL = 0.1  # of the static stiffness: what added terms add to it where the response is linear in that
LOWEST = 200  # decades below the band, in which that is sought
WIDE = 4.0  # ratio of the ends of an interval that is parted on a logarithmic scale
CLEAR = 1e2  # times the round-off of plain subtraction, above which an error is known by it
WORTH_SHARING = 2**23  # multiplications, which take as long as to send the models to other ranks
ALONE = Team()
PLACES = 1000  # of a curve that are refined at once; one of round-off has maxima everywhere, and grids must end


class Errors(NamedTuple):
    """Errors of a model at frequencies (S,): the `total` eps (S,), the largest of every output (S, r), the `worst`
    input for it (S, r), the largest of every input (S, p), the scales h (S, r) and g (S, p), and the noise (S,)."""

    total: np.ndarray
    outputs: np.ndarray
    inputs: np.ndarray
    worst: np.ndarray
    h: np.ndarray
    g: np.ndarray
    noise: np.ndarray


@dataclass(frozen=True)
class Comparison(Keeping):
    """A model `inner` inside of a richer one, `outer`, by its `embedding` (see pseudo_modal.nested), and the measure of
    how far its responses are from those of that. Local, on rank 0 of a `team` that computes the errors with it, where
    they are many."""

    inner: PseudoModal
    outer: PseudoModal
    embedding: np.ndarray
    measure: Measure
    team: Team = field(default=ALONE, compare=False, repr=False)

    def __getstate__(self):
        return super().__getstate__() | {"team": ALONE}

    def within(self, U) -> Comparison:
        """Return the comparison of the model on orthonormal columns U (m, k) of the coordinates of `outer` with that.
        """
        inner, embedding = self.outer.restricted(U)
        return replace(self, inner=inner, embedding=embedding)

    def difference(self, frequencies) -> np.ndarray:
        """Return H_outer - H_inner (S, r, p)."""
        return difference(self.inner, self.outer, self.embedding, frequencies)

    def responses(self, frequencies) -> tuple[np.ndarray, np.ndarray]:
        """Return H_outer (S, r, p) and its drive-point responses (S, p), of which the measure makes scales."""
        return self.outer.responses_once(frequencies)

    def noise_of(self, frequencies, E, H, drive) -> np.ndarray:
        """Return the noise (S,) of differences E of responses H (S, r, p): what plain subtraction differs by. A Caughey
        series of more than two terms has no other difference to compare with."""
        return self.measure.eps(H - self.inner.responses_once(frequencies)[0] - E, H, drive)

    def errors(self, frequencies) -> Errors:
        """Return the errors of the inner model at frequencies (S,), which are kept as there is room."""
        io = self.outer.io
        r, p = io.output_count, io.inputs.shape[1]
        return Errors(*kept(self, "errors", frequencies, self._errors, 2 + 3 * r + 2 * p))

    def _errors(self, frequencies) -> Errors:
        io = self.outer.io
        work = len(frequencies) * len(self.outer) * io.inputs.shape[1] * (io.output_count + len(self.inner))
        if work < WORTH_SHARING or len(frequencies) < self.team.size:
            return self._errors_here(frequencies)
        parts, found = self.team.each(_errors_of_share, self, frequencies), []
        for arrays in zip(*parts, strict=True):
            merged = np.empty((len(frequencies), *arrays[0].shape[1:]), arrays[0].dtype)
            for rank, array in enumerate(arrays):
                merged[rank :: len(parts)] = array
            found.append(merged)
        return Errors(*found)

    def _errors_here(self, frequencies) -> Errors:
        numbers = len(frequencies) * self.outer.io.output_count * self.outer.io.inputs.shape[1]
        chunks = np.array_split(frequencies, max(1, -(-numbers // NUMBERS_AT_A_TIME)))
        return Errors(*map(np.concatenate, zip(*map(self._errors_of_few, chunks), strict=True)))

    def _errors_of_few(self, frequencies) -> Errors:
        E, (H, drive) = self.difference(frequencies), self.responses(frequencies)
        h, g = self.measure.scales(H, drive)
        noise = self.noise_of(frequencies, E, H, drive)
        each = self.measure.scaled(E, h, g)
        worst = np.where(np.isnan(each), np.inf, each).argmax(axis=2)
        return Errors(self.measure.total(each), each.max(axis=2), each.max(axis=1), worst, h, g, noise)

    def curve(self, frequencies) -> np.ndarray:
        """Return the error eps (S,) of the inner model."""
        return self.errors(frequencies).total

    def noise(self, frequencies) -> np.ndarray:
        """Return the noise (S,) of the two models (see noise_of)."""
        return self.errors(frequencies).noise

    def curve_and_dips(self, frequencies) -> tuple[np.ndarray, np.ndarray]:
        """Return curve(), and the largest error that may be beside each frequency (S,), 0 unless a scale has a minimum
        there."""
        found, floors = self.errors(frequencies), self.measure.floors
        most = np.zeros_like(found.total)
        if floors is None:
            return found.total, most
        for scale, floor, error in zip((found.h, found.g), floors, (found.outputs, found.inputs), strict=True):
            low = maxima(-scale) & (scale > floor) & (floor > 0) & np.isfinite(scale)
            grows = np.divide(scale, floor, out=np.ones_like(scale), where=floor > 0) ** 2
            most = np.maximum(most, np.where(low, error * grows, 0.0).max(axis=1))
        return found.total, most

    def by(self, measure: Measure) -> Comparison:
        """Return the same by another measure."""
        return self if measure == self.measure else replace(self, measure=measure)

    def with_damping(self, damping: Proportional) -> Comparison:
        """Return the same with another proportional damping."""
        inner, outer = (replace(model, damping=damping) for model in (self.inner, self.outer))
        return replace(self, inner=inner, outer=outer)


def _errors_of_share(place: Place, pair: Comparison, frequencies) -> Errors:
    return pair._errors_here(place.share(frequencies))


@dataclass(frozen=True)
class Plain(Comparison):
    """The same by plain subtraction of responses, which is quick, and has their round-off."""

    def difference(self, frequencies) -> np.ndarray:
        return self.responses(frequencies)[0] - self.inner.quick_response(frequencies)

    def responses(self, frequencies) -> tuple[np.ndarray, np.ndarray]:
        return self.outer.quick_responses(frequencies)

    def noise_of(self, frequencies, E, H, drive) -> np.ndarray:
        return np.full(len(frequencies), np.nan)  # there is nothing to compare with


def largest_error(pair: Comparison, look: Callable, some: np.ndarray, little=0.0) -> tuple[float, float]:
    """Return the largest error, and where it is, on the curve (S,) at frequencies (S,) that `look` makes of a
    comparison.

    The curve is that of plain subtraction, where its round-off at the frequencies `some` (k,), and where it is largest,
    is no matter beside the largest error, or beside a `little` one.
    """
    plain = Plain(pair.inner, pair.outer, pair.embedding, pair.measure)
    S, curve = look(plain)
    at = np.union1d(some, S[curve.argmax()])
    exact = pair.curve(at)
    if not (np.abs(exact - plain.curve(at)) <= max(curve.max() / CLEAR, little)).all():  # or a NaN, as at 0 Hz
        at, exact = look(pair)
    return float(exact.max()), float(at[exact.argmax()])


def measure_over(measure: Measure, band, model: PseudoModal, uniform=UNIFORM) -> Measure:
    """Return a measure with what it takes from the responses of a model at `uniform` points of a band (Hz), such as
    floors."""
    if isinstance(measure, Paper):
        return measure
    frequencies = np.linspace(*band, uniform)
    of = drive_points(model.io.inputs, model.io.rates.static(model.io.outputs))
    silent = _silent(model, band) if (of[0] < 0).any() else ()
    return measure.over(frequencies, *model.quick_responses(frequencies), of, silent)  # of which medians are taken


def _silent(model, band) -> list[int]:
    """Return the outputs whose responses over a band (Hz) are round-off: as it is known of the model, or by a bound
    that serves any."""
    columns = model.io.silent
    if columns is None:
        most = quietness(model, grid([model], band, UNIFORM // 4, None)).max(axis=(0, 2))
        columns = [j for j, ratio in enumerate(most) if ratio < model.io.limits.get(j, SILENT)]
    return model.io.rates.outputs_of_only(columns)


def quietness(model: PseudoModal, frequencies) -> np.ndarray:
    """Return |c^T x| / (||y|| ||x||) (S, k, p) of the columns c of C^T and the states x = A^-1 b and y = A^-T c, in the
    norm of the energies of the band: by how much more responses may change than A does; 0 for 0 / 0.

    Free of units, as pseudo-modal coordinates are.
    """
    energy = np.sqrt(np.abs(model.eigenvalues) + (2 * np.pi * frequencies[-1]) ** 2)[:, None]
    ratios = []
    for chunk in model.parts_of(frequencies):
        x, y = model.solve(chunk, model.B), model.solve(chunk, model.Ct, transposed=True)
        size = np.linalg.norm(energy * y, axis=1)[:, :, None] * np.linalg.norm(energy * x, axis=1)[:, None, :]
        response = np.abs(model.Ct.T @ x)
        ratios.append(np.divide(response, size, out=np.zeros_like(size), where=(size > 0) & np.isfinite(size)))
    return np.concatenate(ratios)


def upper_poles(model: PseudoModal) -> np.ndarray:
    """Return the poles (k,) of a model that are not below the real axis, in rad/s; the model keeps them."""
    if "upper poles" not in model.memory:
        model.memory["upper poles"] = _upper_poles(model)
    return model.memory["upper poles"]


def _upper_poles(model):
    if model.masses is not None:
        model = model.with_unit_masses(1 / np.sqrt(np.maximum(model.masses, LEAST_MASS)))
    if model.added:
        D = np.diag(model.damping.at(model.eigenvalues)) + (0.0 if model.D is None else model.D)
        return places_of_poles(model.eigenvalues, D, model.added, model.damping.eta)[0]
    if model.poles is not None:
        poles = model.poles.values
    else:
        given = 0.0 if model.D is None else np.diag(model.D)
        half = (model.damping.at(model.eigenvalues) + given) / 2
        root = np.sqrt(half**2 - (1 + 1j * model.damping.eta) * model.eigenvalues + 0j)
        poles = np.concatenate([-half + root, -half - root])
    return poles[poles.imag >= 0]


def resonances(model: PseudoModal) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (k,) in Hz, ascending, where the response may peak, and their damping ratios (k,)."""
    return at_poles(upper_poles(model))


def at_poles(poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (k,) in Hz, ascending, and damping ratios (k,) of the poles (m,) above the real axis, in
    rad/s."""
    poles = poles[poles.imag > 0]
    poles = poles[np.argsort(poles.imag)]
    return poles.imag / (2 * np.pi), np.abs(poles.real) / np.abs(poles)


def grid(models, band, uniform=UNIFORM, step: float | None = STEP) -> np.ndarray:
    """Return S: `uniform` points over the band (Hz), and around every pole of the models as many as let the distance of
    two frequencies be `step` times that to the nearest pole; without a step the places of the poles alone. With
    added terms also points towards 0 Hz (see towards_zero)."""
    low, high = band
    points = [np.linspace(low, high, uniform)]
    for model in models:
        if model.added:
            points.append(towards_zero(model, high, step or STEP))
        # poles of the band (Hz), those that lie in the resonance of the one before left out
        poles = upper_poles(model) / (2 * np.pi)
        poles = poles[np.argsort(poles.imag)]
        at, width = poles.imag, np.maximum(np.abs(poles.real), SHARPEST * np.abs(poles))
        near = np.flatnonzero((at > low - 0.1 * high) & (at < 1.1 * high) & (width > 0) & (width < high))
        own, last = [], -np.inf
        for j in near:  # in ascending order
            if at[j] - last > SAME_POLE * width[j]:
                own.append(j)
                last = at[j]
        if not own:
            continue
        # around each, as far as the middle to the next: f = at + width sinh(step k)
        middles = (at[own][1:] + at[own][:-1]) / 2
        for j, left, right in zip(own, np.append(low, middles), np.append(middles, high), strict=True):
            if step is None:
                points.append(at[[j]])
                continue
            ends = np.arcsinh(np.array([left, right] - at[j]) / width[j]) / step
            points.append(at[j] + width[j] * np.sinh(step * np.arange(np.ceil(ends[0]), np.floor(ends[1]) + 1)))
    points = np.unique(np.concatenate(points))
    points = points[(points >= low) & (points <= high)]
    return points[np.diff(points, prepend=-1.0) > 1e-13 * points]


def towards_zero(model: PseudoModal, high: float, step: float) -> np.ndarray:
    """Return frequencies (k,) from close to 0 up to `high` Hz on a logarithmic scale, for a model with added
    terms.

    Of these the real poles, which oscillating_poles leaves out, and the branch point at 0 Hz of fractional laws are at
    and below 0 on the axis of (i omega)^exponent, where the response is analytic otherwise. The lowest frequency is
    that below which what is added to the static stiffness is SMALL, so that the response is linear in it.
    """
    added = model.added.where(lambda law: law.power > 0)
    if not added:
        return np.zeros(0)
    # every term over the static stiffness, mode by mode
    least = model.eigenvalues[model.eigenvalues > 0].min(initial=np.inf)
    scale = 1 / np.sqrt(np.maximum(model.eigenvalues, least))
    sizes = np.array([np.linalg.norm(scale[:, None] * term.matrix * scale) for term in added])
    D = np.diag(model.damping.at(model.eigenvalues)) + (0.0 if model.D is None else model.D)
    # the highest decade in which their sum is small
    decades = high * 10.0 ** -np.arange(LOWEST)
    omega = 2 * np.pi * decades
    total = sizes @ np.abs(added.coefficients(1j * omega))
    total += omega * np.linalg.norm(scale[:, None] * D * scale)
    lowest = decades[min(int((total > SMALL).sum()), LOWEST - 1)]
    exponent = max(term.law.power for term in added)
    return np.geomspace(lowest, high, 1 + int(np.ceil(exponent * np.log(high / lowest) / step)))


def beside(frequencies: np.ndarray, places, parts=4) -> np.ndarray:
    """Return new frequencies in the two intervals beside the frequencies at `places`."""
    intervals = np.unique(np.concatenate([places - 1, places]))
    intervals = intervals[(intervals >= 0) & (intervals < len(frequencies) - 1)]
    lower, upper = frequencies[intervals, None], frequencies[intervals + 1, None]
    return between(lower, upper, np.arange(1, parts) / parts).ravel()


def between(lower, upper, share):
    """Return frequencies that part intervals; where one is wide beside its lower end, on a logarithmic scale."""
    wide = (lower > 0) & (upper > WIDE * lower)
    ratio = np.divide(upper, lower, out=np.ones_like(upper), where=wide)
    return np.where(wide, lower * ratio**share, lower + (upper - lower) * share)


def maxima(values: np.ndarray) -> np.ndarray:
    """Return for each of the values (S, ...) whether it is a maximum along the first axis."""
    end = np.full((1, *values.shape[1:]), -np.inf)
    padded = np.concatenate([end, values, end])
    return (values >= padded[:-2]) & (values >= padded[2:])


def largest(pair: Comparison, frequencies, little=0.0, rounds=4):
    """Return grid and error of a model on it, refined `rounds` times around the highest maxima, and where a scale of
    the measure dips, as at zeros of a response, if the error may grow to be one of them there.

    What is below `little` is not looked at again: the error of a complete model is round-off, with maxima everywhere.
    """
    curve, dips = pair.curve_and_dips(frequencies)
    for _ in range(rounds):
        high = max(curve.max() / 3, little)
        places = np.flatnonzero((maxima(curve) & (curve > high)) | (dips > high))
        places = places[np.argsort(-np.maximum(curve, dips)[places], kind="stable")[:PLACES]]
        more = np.setdiff1d(beside(frequencies, places), frequencies)
        if not more.size:
            break
        frequencies = np.union1d(frequencies, more)
        curve, dips = pair.curve_and_dips(frequencies)
    return frequencies, curve


def resolved(pair: Comparison, frequencies, curve, above: float, step=1.5, rounds=5):
    """Return the curve (S,) with more frequencies, so that it can be interpolated: intervals are halved, at most
    `rounds` times, where it changes by more than the factor `step`, and beside its extrema; all where it is `above`."""
    for _ in range(rounds):
        height = np.log(np.maximum(curve, max(above, 1e-300)))
        change = np.diff(height)
        extremum = np.flatnonzero(change[:-1] * change[1:] < 0)
        halved = np.abs(change) > np.log(step)
        halved[extremum] = halved[extremum + 1] = True
        halved &= np.diff(frequencies) > SHARPEST * frequencies[1:]
        if halved.sum() > PLACES:  # those that change most
            halved[np.argsort(np.where(halved, np.abs(change), -1.0), kind="stable")[:-PLACES]] = False
        if not halved.any():
            break
        more = between(frequencies[:-1], frequencies[1:], 0.5)[halved]
        frequencies, curve = np.append(frequencies, more), np.append(curve, pair.curve(more))
        order = np.argsort(frequencies)
        frequencies, curve = frequencies[order], curve[order]
    return frequencies, curve


def apart(frequencies, taken, band) -> np.ndarray:
    """Return which of the frequencies (S,) are APART of the band from all points that are taken."""
    return (np.abs(np.subtract.outer(frequencies, taken)) >= APART * (band[1] - band[0])).all(axis=1)


def next_point(frequencies, curve, taken, model: PseudoModal, band) -> float | None:
    """Return the frequency of the largest estimate, APART of the band from other points and off pseudo-frequencies.
    Estimates below ROUNDOFF tell nothing: there it is the one farthest from other points and the ends of the band."""
    free = np.flatnonzero(apart(frequencies, taken, band))
    distance = np.abs(np.subtract.outer(frequencies[free], [*taken, *band])).min(axis=1) / (band[1] - band[0])
    height = np.where(curve[free] > ROUNDOFF, curve[free], 0.0)
    for k in free[np.lexsort((-np.round(distance, 6), -height))]:
        if (f := off_poles(frequencies[k], model, band)) is not None:
            return f
    return None


def off_poles(f: float, model: PseudoModal, band, outwards=0) -> float | None:
    """Return f, or the nearest frequency of the band that is GAP f away from all pseudo-frequencies, less in narrow
    bands; or one out of it in the direction `outwards` (1, -1)."""
    gap = min(GAP, NARROW * (band[1] - band[0]) / band[1])
    poles = model.frequencies
    steps = np.array([0, 1, -1, 2, -2, 3, -3, 5, -5, 8, -8])
    for trial in f * (1 + gap * (np.unique(np.abs(steps)) * outwards if outwards else steps)):
        free = trial > 0 and (np.abs(poles - trial) >= 0.999 * gap * trial).all()
        if free and (outwards or band[0] <= trial <= band[1]):
            return float(trial)
    return None


def rounded(f: float, band, inside=True) -> float:
    """Return a frequency that a search chose, to six digits, of the band (Hz) if that is narrow: the same on any number
    of ranks, whose last digits differ; `inside` of the band."""
    low, high = band
    digits = 6 + max(0, int(np.ceil(-np.log10((high - low) / high))))
    found = float(f"{f:.{digits}g}")
    return float(np.clip(found, low, high)) if inside else found


def missing(model: PseudoModal, counts: list[ModeCount], band, before: Callable[[], PseudoModal]) -> int:
    """Return the number of modes of the band (Hz) that are counted below points and the model misses; 0 or less where
    it misses none.

    Pseudo-frequencies lie above the frequencies that they stand for, one by one. Where modes below the band may be
    missing, counted up to its lower end, those of the band are pseudo-frequencies that the model `before()` has too.
    """
    poles, (low, high) = model.frequencies, band
    end = min((count.below for count in counts if count.below >= high), default=high)
    counts = [count for count in counts if count.below <= end]
    found = max((count.modes - int((poles < count.below).sum()) for count in counts), default=0)
    bottom = max((count for count in counts if count.below <= low), key=lambda count: count.below, default=None)
    if found <= 0 or bottom is None:
        return found
    moving = unsettled(model, before(), end, len(poles))
    poles = poles[(poles >= bottom.below) & ~np.isin(np.arange(len(poles)), moving)]
    return max(count.modes - bottom.modes - int((poles < count.below).sum()) for count in counts)


def is_free(model: PseudoModal, frequencies, zero: float) -> bool:
    """Test whether the response at the first of the frequencies, 0 Hz, is infinite but for round-off.

    `zero`: eigenvalues below it, relative to the largest, count as round-off.
    """
    if not model.eigenvalues[0] < zero * model.eigenvalues[-1]:
        return False
    size = np.linalg.norm(model.response(np.array([0.0, frequencies[-1] / 200])), axis=(1, 2))
    return not size[0] < 1e6 * size[1]


def is_silent(model: PseudoModal, band) -> bool:
    """Test whether the outputs do not feel the inputs over a band (Hz)."""
    return len(_silent(model, band)) == model.io.output_count


def unsettled(model: PseudoModal, before: PseudoModal, top: float, most=4, bottom=0.0, still=2e-5) -> np.ndarray:
    """Return up to `most` pseudo-modes (indices) from `bottom` to `top` Hz whose frequency was not there before.

    Those whose relative change is above `still`, the largest first; rigid-body modes and others far below the top are
    judged by their absolute change.
    """
    f, old = model.frequencies, before.frequencies
    f = f[f < top]
    moved = np.abs(f[:, None] - old).min(axis=1, initial=np.inf) / np.maximum(f, 0.01 * top)
    order = np.argsort(-moved, kind="stable")
    return order[(moved[order] > still) & (f[order] >= bottom)][:most]
