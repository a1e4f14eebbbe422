"""Choose the damping that responses are measured with, and make the reduced D of damping without a sparse matrix."""

from __future__ import annotations

import numpy as np

from ...model.damping import Caughey, GivenDamping, ModalDamping, NoDamping, Rayleigh, Structural, caughey_terms
from .error_estimate import UNIFORM
from .pseudo_modal import Proportional

UNDAMPED = 1e-8  # damping ratio up to which a mode counts as undamped


def measured_damping(damping, zeta0: float, band, added="") -> tuple[Proportional, bool, str]:
    """Return the damping with which responses are measured: its proportional part, whether a given D is added, and a
    sentence; `added`: what the added terms of the model are called, which always act."""
    if added:
        return _beside_added(damping, zeta0, band, added)
    if isinstance(damping, GivenDamping):
        loss = damping.loss_factor
        words = "measured with the damping matrix of the model"
        return Proportional(eta=loss), True, f"{words} and the loss factor {loss:g}" if loss else words
    if isinstance(damping, Structural) and damping.loss_factor:
        return Proportional(eta=damping.loss_factor), False, f"measured with the loss factor {damping.loss_factor:g}"
    if isinstance(damping, Rayleigh | Caughey) and smallest_ratio(damping.coefficients, band) > UNDAMPED:
        return proportional(damping.coefficients), False, "measured with the damping of the model"
    ratio, why = zeta0, "undamped"
    if isinstance(damping, ModalDamping):
        ratio = max(float(damping.at(np.linspace(*band, UNIFORM)).min()), 1e-6)
        why = "the smallest modal ratio"
    return Proportional(eta=2 * ratio), False, f"measured with the loss factor {2 * ratio:g} ({why})"


def _beside_added(damping, zeta0, band, added):
    """Return the same of a model with added terms, which damp it."""
    words = f"measured with the {added} of the model"
    if isinstance(damping, Rayleigh | Caughey):
        return proportional(damping.coefficients), False, f"{words} and its damping"
    if isinstance(damping, NoDamping) or (isinstance(damping, Structural) and not damping.loss_factor):
        return Proportional(), False, words
    proportional_part, given, of_damping = measured_damping(damping, zeta0, band)
    return proportional_part, given, words + of_damping.replace("measured with", " and", 1)


def proportional(coefficients) -> Proportional:
    """Return the damping of a Caughey series (39), of which Rayleigh damping is the first two terms."""
    alpha, beta, *higher = (*coefficients, 0.0)[: max(len(coefficients), 2)]
    return Proportional(alpha, beta, 0.0, tuple(higher) if any(higher) else ())


def smallest_ratio(coefficients, band) -> float:
    """Return the smallest damping ratio of a series over a band (Hz), without its sign."""
    omega = 2 * np.pi * np.linspace(max(band[0], 1e-3 * band[1]), band[1], UNIFORM)
    return float(np.abs(sum(a * omega ** (2 * k - 1) for k, a in enumerate(coefficients)) / 2).min())


def reduced_damping(damping, stiffness: np.ndarray, frequencies: np.ndarray, mass=None) -> np.ndarray:
    """Return D (m, m) of a reduced model with V^T M V = `mass` (m, m), by default I, and V^T K V = `stiffness` (m, m);
    zero without damping, and of modal ratios for coordinates without mass.

    A series holds in the reduced coordinates: D = sum_k a_k (V^T K V)^k. This is how rational Krylov subspaces
    approximate A(s)^-1 = p_s(M^-1 K)^-1 M^-1, and it needs no mode that the basis has not; V^T M (M^-1 K)^k V would
    add the damping of the full model at the highest frequencies of the mesh. `frequencies` (m,) of the diagonalised
    model in Hz.
    """
    if isinstance(damping, ModalDamping):
        modal = 4 * np.pi * frequencies * damping.at(frequencies)
        return np.diag(modal if mass is None else np.where(np.diag(mass) > 0, modal, 0.0))
    D, power = np.zeros_like(stiffness), np.eye(len(stiffness)) if mass is None else mass
    for coefficient in caughey_terms(damping) or ():
        D, power = D + coefficient * power, power @ stiffness
    return D
