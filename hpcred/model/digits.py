"""Determine the digits of a stiffness matrix, and the uncertainty of natural frequencies that follows from them.

Text files of finite-element programs have fewer digits than the original numbers. Rounding the entries of K changes an
eigenvalue by x^T dK x with x^T M x = 1. This is negligible if the body is as stiff as its elements, but not if a
frequency is far below those of single elements, since entries then nearly cancel.
"""

from __future__ import annotations

import numpy as np

from ..linalg.blocks import local_rows
from ..linalg.csr import diagonal_of
from ..parallel.sums import summed

ROWS = 64  # of a rank that are looked at
FEWEST, MOST = 8, 15  # digits that say something: fewer have models made by hand, more have all
DISTINCT = 30  # values, below which nothing is said
NEARLY_ALL, MANY = 0.99, 0.5  # shares of values
SAME = 5e-16  # relative: a number times a power of ten, as in other units
ROUNDED = 0.13  # mean error of a rounded number, in units of its last digit and of its first
BESIDE = 6.0  # of all entries of a row to that of the diagonal, with those of equal elements, which are rounded alike
MODES = 12  # that are looked at
INACCURATE = 1e-5  # relative error of a frequency
ALL = 16  # digits of a double


def digits_of(mat, distinct=DISTINCT) -> int | None:
    """Return how many decimal digits the entries of a matrix were rounded to, or None where they have all, or fewer
    than `distinct` values. Collective."""
    first, last = mat.getOwnershipRange()
    rows = np.unique(np.linspace(first, last - 1, ROWS).astype(int)) if last > first else []
    values = np.unique(np.abs(np.concatenate([np.zeros(1), *(mat.getRow(int(row))[1].real for row in rows)])))[1:]
    return digits_of_numbers(mat.comm.tompi4py(), values, distinct=distinct)


def digits_of_numbers(
    comm, values: np.ndarray, fewest=FEWEST, distinct=DISTINCT, nearly_all=NEARLY_ALL, many=MANY
) -> int | None:
    """Return how many decimal digits numbers on all ranks, each rank its own, were rounded to, or None where they have
    all. Collective.

    Something is said of `distinct` numbers or more, where `nearly_all` have so many digits, the share `many` needs
    them, and they are `fewest` or more.
    """
    values = np.abs(values[values != 0])
    values = values[:: 1 + len(values) // 500]
    needed, rest = np.full(len(values), MOST + 1), np.arange(len(values))
    for digits in range(MOST, 0, -1):  # a value that rounding to these changes is changed by fewer too
        rounded = np.array([float(f"{value:.{digits - 1}e}") for value in values[rest]])
        rest = rest[np.abs(rounded - values[rest]) <= SAME * values[rest]]
        needed[rest] = digits
    counts = comm.allreduce(np.bincount(needed, minlength=MOST + 2))
    total = counts.sum()
    rounded = (counts >= many * total) & (np.cumsum(counts) >= nearly_all * total)
    digits = np.flatnonzero(rounded[fewest : MOST + 1])
    return fewest + int(digits[-1]) if total >= distinct and len(digits) else None


def warnings_of_digits(model, K, eigenvalues: np.ndarray, block) -> list[str]:
    """Return warnings of frequencies that are uncertain by the digits of K in the files. Collective.

    `eigenvalues` (m,) in (rad/s)^2, ascending, Inf for those that do not count, belong to the columns of `block` (n, m)
    with x^T M x = 1, and to K, which may be that of `model` without the dofs of a frame.
    """
    eigenvalues = eigenvalues[:MODES]
    digits = digits_of(model.K) if len(eigenvalues) else None
    if digits is None:
        return []
    errors = _of_frequencies(_errors_of_eigenvalues(K, len(eigenvalues), block, digits), eigenvalues)
    worst = int(np.argmax(errors))
    if errors[worst] <= INACCURATE:
        return []
    frequency = np.sqrt(max(eigenvalues[worst], 0.0)) / (2 * np.pi)
    return [
        f"{model.name}: K has {digits} digits, and little is left of them where stiff parts cancel: the frequency "
        f"{frequency:.4g} Hz is uncertain {_by(errors[worst])}, whatever its residual; take a form of the export "
        "with more digits, or larger elements"
    ]


def changes_by_last_digits(K, count: int, block) -> np.ndarray:
    """Return by how much (count,) in (rad/s)^2 the last digits of K, as doubles have them, change the eigenvalues of
    the first columns of a block (n, m), with x^T M x = 1. Collective."""
    return _errors_of_eigenvalues(K, count, block, ALL)


def warnings_of_peaks(model, eigenvalues: np.ndarray, changes: np.ndarray, ratios, tolerance: float) -> list[str]:
    """Return warnings of resonances so sharp that the last digits of K change the peak by more than a tolerance.

    `eigenvalues` (m,) in (rad/s)^2; `changes` (m,) of them (see changes_by_last_digits); `ratios` (m,): damping ratios,
    0 for modes that are not asked for.
    """
    errors = _of_frequencies(changes, eigenvalues)
    peaks = np.divide(errors, ratios, out=np.zeros_like(errors), where=ratios > 0)
    worst = int(np.argmax(peaks)) if len(peaks) else 0
    if not peaks.max(initial=0.0) > tolerance:
        return []
    frequency = np.sqrt(max(eigenvalues[worst], 0.0)) / (2 * np.pi)
    return [
        f"{model.name}: the resonance at {frequency:.4g} Hz has a damping ratio of {ratios[worst]:.1e}, and the last "
        f"digits of K, where stiff parts cancel, move its frequency by {errors[worst]:.0e} of itself: its peak is that "
        f"of K as stored, but uncertain {_by(peaks[worst])}, in full solves too; give more damping, or larger elements"
    ]


def changes_of_responses(changes: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return by what part of themselves the responses of modes change (F,) with their eigenvalues, by `changes` (m,).

    `stiffness` (F, m): lambda - omega^2 + i omega d of the modes at F frequencies.
    """
    size, moved = np.abs(stiffness), np.broadcast_to(changes, stiffness.shape)
    return np.divide(moved, size, out=np.full(size.shape, np.inf), where=size != 0).max(axis=1, initial=0.0)


def _by(error):
    return f"by up to about {error:.0e} of itself" if error < 1 else "altogether"


def _of_frequencies(moved: np.ndarray, eigenvalues: np.ndarray) -> np.ndarray:
    """Return the relative errors (m,) of frequencies whose eigenvalues have the errors `moved` (m,) in (rad/s)^2."""
    return moved / np.maximum(eigenvalues, np.finfo(float).tiny) / 2


def _errors_of_eigenvalues(K, count, block, digits) -> np.ndarray:
    """Return the errors (count,) in (rad/s)^2 of the eigenvalues of the first columns of a block by rounding K to so
    many digits. Collective."""
    diagonal = diagonal_of(K)
    with local_rows(block) as rows:
        moved = np.array([((np.abs(column) ** 2 * diagonal) ** 2).sum() for column in rows.T[:count]])
    return BESIDE * ROUNDED * 10.0 ** (1 - digits) * np.sqrt(summed(K.comm.tompi4py(), moved))
