"""Compute shock response spectra: the largest absolute acceleration of oscillators on a base with a given history.

By the ramp-invariant recursion of Smallwood (Shock and Vibration Bulletin 51, 1981), which is exact for histories that
are linear between their samples; the free vibration after the end is known in closed form.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..parallel.failures import InputError
from ..reduction.result.reduced_model import ReducedModel

SAMPLES = 64  # a period of an oscillator, between which a peak is lost by 0.1 % at most
MOST = 20_000_000  # samples of a history
STATES = 100_000_000  # numbers of the states of a response over time


class ShockSpectrum(NamedTuple):
    """A shock response spectrum, in the unit of the acceleration.

    Attributes
    ----------
    frequencies : ndarray, shape (F,)
        Natural frequencies in Hz.
    positive, negative : ndarray, shape (F,)
        Largest and smallest absolute acceleration.
    maximax : ndarray, shape (F,)
        The larger size of both.
    """

    frequencies: np.ndarray
    positive: np.ndarray
    negative: np.ndarray
    maximax: np.ndarray

    def __repr__(self):
        """Return the frequencies, and where the spectrum is largest."""
        at = int(np.argmax(self.maximax))
        return (f"<shock spectrum at {len(self.frequencies)} frequencies, {self.frequencies[0]:.6g} to "
                f"{self.frequencies[-1]:.6g} Hz: largest {self.maximax[at]:.6g} at {self.frequencies[at]:.6g} Hz>"
                )  # fmt: skip


def half_sine(amplitude: float, duration: float, samples: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,) in s and values (n,) of a half-sine pulse.

    Parameters
    ----------
    amplitude : float
    duration : float
        In s.
    samples : int, default 400

    Returns
    -------
    tuple of two ndarray

    Raises
    ------
    InputError
        For a duration that is not positive.
    """
    if not 0 < duration < np.inf:
        raise InputError(f"half-sine: duration: found {duration:g} s, expected more than 0")
    times = np.linspace(0.0, duration, samples + 1)
    return times, amplitude * np.sin(np.pi * np.linspace(0.0, 1.0, samples + 1))


def shock_spectrum(
    times: ArrayLike, acceleration: ArrayLike, frequencies: ArrayLike, *, q: float | None = None,
    damping: float | None = None,
) -> ShockSpectrum:  # fmt: skip
    """Return the shock response spectrum of absolute accelerations, during and after the shock.

    Parameters
    ----------
    times : array_like, shape (n,)
        In s, ascending; linear between them, and zero before the first and after the last.
    acceleration : array_like, shape (n,)
    frequencies : array_like, shape (F,)
        Natural frequencies of the oscillators in Hz.
    q : float, optional
        Amplification 1 / (2 damping); 10 unless `damping` is given.
    damping : float, optional
        Damping ratio, 0 to less than 1.

    Returns
    -------
    ShockSpectrum
        In the unit of `acceleration`.

    Raises
    ------
    InputError
        For times and frequencies that do not ascend or are not positive, and a damping out of range.
    """
    from scipy.signal import lfilter  # which few runs need

    t, a = np.asarray(times, dtype=float), np.asarray(acceleration, dtype=float)
    f = np.atleast_1d(np.asarray(frequencies, dtype=float))
    if t.ndim != 1 or t.shape != a.shape or len(t) < 2 or not (np.isfinite(t).all() and np.isfinite(a).all()):
        raise InputError(f"times: found {t.shape} for {a.shape} values, expected two or more finite numbers each")
    if (np.diff(t) <= 0).any():
        raise InputError("times: found ones that do not ascend, expected ascending times in s")
    if not len(f) or not (np.isfinite(f).all() and (f > 0).all()):
        raise InputError("frequencies: found none, or one that is not positive, expected natural frequencies in Hz")
    ratio = damping_ratio(q, damping)
    extremes = np.zeros((2, len(f)))
    for k, frequency in enumerate(f):
        omega = 2 * np.pi * frequency
        step = min(np.diff(t).min(), 1 / (SAMPLES * frequency))
        count = int(np.ceil((t[-1] - t[0]) / step))
        if count > MOST:
            raise InputError(f"times: {count} samples are needed at {frequency:g} Hz, expected at most {MOST}; leave "
                             "out instants that follow each other more closely than others")  # fmt: skip
        step = (t[-1] - t[0]) / count
        # the ramp-invariant filter of the oscillator
        damped = omega * np.sqrt(1 - ratio**2)
        E = np.exp(-ratio * omega * step)
        C, S = E * np.cos(damped * step), E * np.sinc(damped * step / np.pi)
        x = np.concatenate([np.interp(t[0] + step * np.arange(count + 1), t, a), [0.0, 0.0]])
        y = lfilter([1 - S, 2 * (S - C), E * E - S], [1.0, -2 * C, E * E], x)
        # from the last two samples on it is e^(-z w t) (A cos + B sin), whose first two extremes are the largest
        A = y[-2]
        B = (y[-1] / E - A * np.cos(damped * step)) / np.sin(damped * step)
        decay = ratio * omega
        first = np.arctan2(damped * B - decay * A, damped * A + decay * B) % np.pi / damped
        after = first + np.pi / damped * np.arange(2)
        rest = np.exp(-decay * after) * (A * np.cos(damped * after) + B * np.sin(damped * after))
        extremes[:, k] = max(y.max(), rest.max(), 0.0), min(y.min(), rest.min(), 0.0)
    return ShockSpectrum(f, extremes[0], extremes[1], np.abs(extremes).max(axis=0))


def damping_ratio(q: float | None = None, damping: float | None = None) -> float:
    """Return the damping ratio of an amplification Q, 10 by default, or the one given. Raises InputError."""
    if q is not None and damping is not None:
        raise InputError("q: found it beside a damping ratio, expected one of them")
    if q is not None and not q > 0.5:
        raise InputError(f"q: found {q:g}, expected more than 0.5, of an oscillator that vibrates")
    ratio = 1 / (2 * (10.0 if q is None else q)) if damping is None else damping
    if not 0 <= ratio < 1:
        raise InputError(f"damping: found {ratio:g}, expected a ratio from 0 to less than 1")
    return ratio


def time_response(reduced: ReducedModel, times: ArrayLike, loads: ArrayLike) -> np.ndarray:
    """Return the outputs over time of a model at rest at the first instant.

    Parameters
    ----------
    reduced : ReducedModel
    times : array_like, shape (n,)
        In s, in equal steps.
    loads : array_like, shape (n, p)
        Of the inputs, in SI units, linear between the times; without error then.

    Returns
    -------
    ndarray, shape (n, r)

    Raises
    ------
    InputError
        For structural damping, which has no meaning in time, other shapes, and more instants than fit in memory.
    """
    from scipy.linalg import expm  # which few runs need

    t, u = np.asarray(times, dtype=float), np.asarray(loads, dtype=float)
    steps = np.diff(t)
    if u.shape != (len(t), reduced.B.shape[1]) or len(t) < 2 or np.ptp(steps) > 1e-6 * abs(steps.mean()):
        raise InputError(f"times: found {t.shape} and loads {u.shape}, expected equal steps and (n, inputs)")
    require_size(reduced, len(t), steps.mean())
    space = reduced.to_state_space()
    (n, p), step = space.B.shape, steps.mean()
    whole = np.zeros((n + 2 * p, n + 2 * p))  # of the states, the loads, and what these grow by in a step
    whole[:n, :n], whole[:n, n : n + p], whole[n : n + p, n + p :] = space.A * step, space.B * step, np.eye(p)
    whole = expm(whole)
    A, pushed = whole[:n, :n], u[:-1] @ whole[:n, n : n + p].T + np.diff(u, axis=0) @ whole[:n, n + p :].T
    states = np.zeros((len(t), n))
    for k in range(len(pushed)):
        states[k + 1] = A @ states[k] + pushed[k]
    return states @ space.C.T + u @ space.D.T


def require_size(reduced: ReducedModel, count: float, step: float):
    """Raise InputError for more instants in equal steps (s) than fit in memory, or than are followed in a minute."""
    most = min(STATES // (2 * max(reduced.size, 1)), MOST)
    if count > most:
        raise InputError(f"times: {count:.3g} equal steps of {step:.3g} s are needed, expected at most {most}; leave "
                         "out instants that follow each other more closely than others, or begin the band higher"
                         )  # fmt: skip
