"""Refuse models whose K or M is indefinite or has the wrong sign. All functions are collective."""

from __future__ import annotations

import numpy as np

from ..parallel.failures import InputError
from .digits import digits_of

ROUND_OFF = 1e-7  # of x^T |D| x, D the diagonal: less than this below zero the digits of files may be
ZERO = 1e-10  # of trace(K) / trace(M): eigenvalues that may be round-off
UNSTABLE = "K is indefinite, as of a body beyond buckling or in fast rotation, or of a damaged file: some motions grow"
EXPECTED = "expected M q'' + D q' + K q = B u"


def check_definite(model):
    """Raise InputError for a K of the other sign and for an M that is zero, or not positive semidefinite."""
    if not any(_signs(model, "M")):
        raise InputError(f"{model.name}: M is zero, expected a mass matrix; give one, and check units and the file")
    low, high = _signs(model, "K")
    for sentence in (_of_stiffness(model) if low < 0 and not high else None, _of_mass(model)):
        if sentence:
            raise InputError(sentence)


def warnings_of_definiteness(model) -> list[str]:
    """Return sentences on K and M where one of them has the other sign, or is indefinite."""
    return [sentence for sentence in (_of_stiffness(model), _of_mass(model)) if sentence]


def is_mass_indefinite(model) -> bool:
    """Return whether a direction was found in which M is negative."""
    return _signs(model, "M")[0] < 0


def growing(model, eigenvalues: np.ndarray) -> str | None:
    """Return a sentence where one of these eigenvalues omega^2 of (K, M), in (rad/s)^2, is negative, or None."""
    negative = eigenvalues < -zero_of(model)
    if not negative.any():
        return None
    lowest = np.sqrt(-eigenvalues.min()) / 2 / np.pi
    return growing_in_words(model, int(negative.sum()), f", the lowest -({lowest:.4g} Hz)^2")


def growing_in_words(model, count: int, more="") -> str:
    """Return a sentence on so many negative eigenvalues."""
    return f"{model.name}: found {count} negative eigenvalue{'s' * (count > 1)} of (K, M){more}: {UNSTABLE}"


def zero_of(model) -> float:
    """Return how far an eigenvalue, in (rad/s)^2, may be below zero by round-off and the digits of K."""
    digits = digits_of(model.K)
    return max(ZERO, 10.0 ** (2 - digits) if digits else 0.0) * abs(model.mean_eigenvalue)


def _signs(model, key):
    """Return lowest and highest quotient, those of round-off as zero; nothing is said of an unsymmetric M."""
    if key == "M" and not model.is_symmetric(key):
        return 0.0, 1.0
    low, high = model.extreme_quotients(key)
    size = ROUND_OFF * max(-low, high)
    return (low if low < -size else 0.0), (high if high > size else 0.0)


def _of_stiffness(model) -> str | None:
    low, high = _signs(model, "K")
    if low < 0 and not high:
        return f"{model.name}: K is negative definite, -K? {EXPECTED}, where K resists; multiply K by -1"
    if low < 0:
        return f"{model.name}: x^T K x comes down to {low:.1e} of its diagonal: {UNSTABLE}"
    return None


def _of_mass(model) -> str | None:
    low, high = _signs(model, "M")
    if not low:
        return None
    if not high:
        return f"{model.name}: M is negative definite, -M? {EXPECTED}; multiply M by -1"
    return (
        f"{model.name}: M is indefinite (x^T M x down to {low:.1e} of its diagonal), which no mass matrix is; the file "
        "is damaged, or entries of M belong to other rows"
    )
