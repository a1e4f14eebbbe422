"""The error of a model seen from a richer one: two nested models enter; eps(f), its noise, the next point leave."""

from __future__ import annotations

import numpy as np

from .pseudo_modal import Law, PseudoModal, difference, norms, relative, response, solve

UNIFORM = 200  # frequencies of a band, beside those around resonances
APART = 0.02  # of the band between points
GAP = 2e-3  # of a frequency between a point and pseudo-frequencies, but at most
NARROW = 0.1  # of the band
CLUSTER = np.array([-3.0, -1.5, -0.6, 0.0, 0.6, 1.5, 3.0])  # places around a resonance, in units of its damping ratio


def estimate(inner: PseudoModal, outer: PseudoModal, embedding: np.ndarray, law: Law, frequencies, ports):
    """Relative error (S,) of `inner` seen from `outer`, and the noise (S,): what plain subtraction differs by."""
    E = difference(inner, outer, embedding, law, frequencies, ports)
    H = response(outer, law, frequencies, ports)
    noise = H - response(inner, law, frequencies, ports) - E
    return relative(E, H), relative(noise, H)


def error_seen(inner: PseudoModal, outer: PseudoModal, embedding, law: Law, frequencies, ports) -> np.ndarray:
    """Relative error (S,) of `inner` seen from `outer`."""
    return relative(
        difference(inner, outer, embedding, law, frequencies, ports), response(outer, law, frequencies, ports)
    )


def ratios(model: PseudoModal, law: Law) -> np.ndarray:
    """Damping ratios (m,) of the pseudo-modes, 0 at squares <= 0."""
    omega = np.sqrt(np.maximum(model.squares, 0.0))
    inverse = np.divide(1.0, omega, out=np.zeros_like(omega), where=omega > 0)
    given = 0.0 if model.D is None else np.abs(np.diag(model.D))
    return (law.eta + (law.alpha + given) * inverse + law.beta * omega) / 2


def resonances(model: PseudoModal, law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (k,) in Hz, ascending, where the response may peak, and their damping ratios (k,).

    Those of the pseudo-modes; with a given D, which moves them and may leave some of close ones undamped, of the poles.
    """
    if model.inverse is None:
        return model.frequencies, ratios(model, law)
    return at_poles(model.inverse.poles)


def at_poles(poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (k,) in Hz, ascending, and damping ratios (k,) of the poles (m,) above the real axis, in rad/s."""
    poles = poles[poles.imag > 0]
    poles = poles[np.argsort(poles.imag)]
    return poles.imag / (2 * np.pi), np.abs(poles.real) / np.abs(poles)


def grid(models, law: Law, band, uniform=UNIFORM, around=CLUSTER) -> np.ndarray:
    """S: `uniform` points over the band (Hz) and 7 around every resonance of the models, one set a cluster.

    `around`: where, in damping ratios.
    """
    low, high = band
    points = [np.linspace(low, high, uniform)]
    for model in models:
        f, ratio = resonances(model, law)
        width, cluster = np.clip(ratio, 1e-5, 0.1), 0.3 * np.minimum(ratio, 0.1)
        near = np.flatnonzero((f > low * 0.9) & (f < high * 1.1))
        last = -np.inf
        for j in near:  # in ascending order
            if f[j] - last > cluster[j] * f[j]:
                last = f[j]
                points.append(f[j] * (1 + width[j] * np.asarray(around)))
    points = np.unique(np.concatenate(points))
    points = points[(points >= low) & (points <= high)]
    return points[np.diff(points, prepend=-1.0) > 1e-9 * high]


def finer(frequencies: np.ndarray, times=4) -> np.ndarray:
    """The grid with every interval split into `times` parts."""
    steps = np.arange(times) / times
    inside = (frequencies[:-1, None] + np.diff(frequencies)[:, None] * steps).ravel()
    return np.append(inside, frequencies[-1])


def around_peaks(frequencies: np.ndarray, curve: np.ndarray, above: float, parts=4) -> np.ndarray:
    """New frequencies in the two intervals beside every local maximum of the curve (S,) that exceeds `above`."""
    padded = np.concatenate([[-np.inf], curve, [-np.inf]])
    peak = np.flatnonzero((curve >= padded[:-2]) & (curve >= padded[2:]) & (curve > above))
    beside = np.unique(np.concatenate([peak - 1, peak]))
    beside = beside[(beside >= 0) & (beside < len(frequencies) - 1)]
    steps = np.arange(1, parts) / parts
    return (frequencies[beside, None] + np.diff(frequencies)[beside, None] * steps).ravel()


def largest(inner: PseudoModal, outer: PseudoModal, embedding, law: Law, frequencies, ports, rounds=3):
    """Grid and relative error of `inner` seen from `outer` on it, refined `rounds` times around the highest maxima."""
    curve = error_seen(inner, outer, embedding, law, frequencies, ports)
    for _ in range(rounds):
        more = around_peaks(frequencies, curve, curve.max() / 10)
        if not more.size:
            break
        frequencies, curve = _merged(frequencies, curve, more, error_seen(inner, outer, embedding, law, more, ports))
    return frequencies, curve


def resolved(inner, outer, embedding, law: Law, frequencies, curve, ports, above: float, step=1.5, rounds=5):
    """The curve (S,) with more frequencies, so that it can be interpolated: intervals are halved, at most `rounds`
    times, where it changes by more than the factor `step`, and beside its extrema; all where it is `above`."""
    for _ in range(rounds):
        height = np.log(np.maximum(curve, max(above, 1e-300)))
        change = np.diff(height)
        extremum = np.flatnonzero(change[:-1] * change[1:] < 0)
        halved = np.abs(change) > np.log(step)
        halved[extremum] = halved[extremum + 1] = True
        halved &= np.diff(frequencies) > 1e-6 * frequencies[1:]
        if not halved.any():
            break
        more = ((frequencies[:-1] + frequencies[1:]) / 2)[halved]
        frequencies, curve = _merged(frequencies, curve, more, error_seen(inner, outer, embedding, law, more, ports))
    return frequencies, curve


def _merged(frequencies, curve, more, found):
    """Both curves as one, in the order of the frequencies."""
    frequencies, curve = np.append(frequencies, more), np.append(curve, found)
    order = np.argsort(frequencies)
    return frequencies[order], curve[order]


def apart(frequencies, taken, band) -> np.ndarray:
    """Which of the frequencies (S,) are APART of the band from all points that are taken."""
    return (np.abs(np.subtract.outer(frequencies, taken)) >= APART * (band[1] - band[0])).all(axis=1)


def next_point(frequencies, curve, taken, model: PseudoModal, band) -> float | None:
    """The frequency of the largest estimate, APART of the band from other points and off pseudo-frequencies."""
    free = apart(frequencies, taken, band)
    order = np.argsort(-np.where(free, curve, -np.inf))
    for k in order[: free.sum()]:
        if (f := off_poles(frequencies[k], model, band)) is not None:
            return f
    return None


def off_poles(f: float, model: PseudoModal, band) -> float | None:
    """f, or the nearest frequency of the band that is GAP f away from all pseudo-frequencies, less in narrow bands."""
    gap = min(GAP, NARROW * (band[1] - band[0]) / band[1])
    poles = model.frequencies
    tries = f * (1 + gap * np.array([0, 1, -1, 2, -2, 3, -3, 5, -5, 8, -8]))
    for trial in tries:
        if band[0] <= trial <= band[1] and trial > 0 and (np.abs(poles - trial) >= 0.999 * gap * trial).all():
            return float(trial)
    return None


def rounded(f: float) -> float:
    """A frequency that a search chose, to six digits: the same on any number of ranks, whose last digits differ."""
    return float(f"{f:.6g}")


def missing(model: PseudoModal, counts) -> int:
    """Modes below the points that inertia counts and the model has not; `counts`: (f, number of modes below f)."""
    poles = model.frequencies
    return max((count - int((poles < f).sum()) for f, count in counts), default=0)


def is_free(model: PseudoModal, law: Law, frequencies, ports, zero: float) -> bool:
    """Whether the response at the first of the frequencies, 0 Hz, is infinite but for round-off.

    `zero`: squares of pseudo-frequencies below it, relative to the largest, count as round-off.
    """
    if not model.squares[0] < zero * model.squares[-1]:
        return False
    size = norms(response(model, law, np.array([0.0, frequencies[-1] / 200]), ports))
    return not size[0] < 1e6 * size[1]


def is_silent(model: PseudoModal, law: Law, frequencies, ports) -> bool:
    """Whether the outputs do not feel the inputs: |C x| is round-off of |C| |x| at all frequencies."""
    Lb, Lc = ports
    states = solve(model, law, frequencies, model.L @ Lb)
    size = norms((model.L @ Lc).T @ states)
    return bool((size <= 1e-13 * np.linalg.norm(model.L @ Lc) * norms(states)).all())


def unsettled(model: PseudoModal, before: PseudoModal, top: float, most=4, still=2e-5) -> np.ndarray:
    """Up to `most` pseudo-modes (indices) below `top` Hz whose frequency was not there before, to `still`.

    Largest change first; rigid-body modes and others far below the top are judged by their absolute change.
    """
    f, old = model.frequencies, before.frequencies
    f = f[f < top]
    moved = np.abs(f[:, None] - old).min(axis=1, initial=np.inf) / np.maximum(f, 0.01 * top)
    order = np.argsort(-moved, kind="stable")
    return order[moved[order] > still][:most]
