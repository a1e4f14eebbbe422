"""Find the outputs whose responses are round-off: zero in exact arithmetic, for all that double precision tells.

Where every entry of A(s) is known to one unit of round-off u, the response c^T A^-1 b is known to u |y|^T |A| |x|, with
the states x = A^-1 b and y = A^-T c. This bound is small where the output is well isolated, and does not depend on
units: a factor on dofs multiplies all of its terms alike. (Higham, Accuracy and Stability of Numerical Algorithms,
2002, section 7.2.) A small model, whose coordinates are those of the whole body, tells no response below
u ||y|| ||x|| in the norm of the energies, nor below u/2 times its highest eigenvalue times |y| |x|: stiff columns mix
what is soft and apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...linalg.blocks import add_product, apply, create_block, local_rows
from ...linalg.csr import absolute
from ...parallel.decisions import decided
from ...parallel.sums import summed
from ..small.error_estimate import UNIFORM, grid, quietness

QUIET = 1e-8  # see quietness: below it round-off is computed
SURE = 100.0  # times a bound of round-off, up to which a response is decided by it
UNIT = float(np.finfo(float).eps)
AT_A_TIME = 8  # outputs


class Quiet(NamedTuple):
    """A column of C^T that hardly feels the inputs: its place, where it feels them most (`frequency`, Hz), the
    response there (`size`), the same over the energies (`ratio`), the round-off of it in the small model (`mixed`), and
    the states x and y (m,) in terms of the basis."""

    column: int
    frequency: float
    size: float
    ratio: float
    mixed: float
    x: np.ndarray
    y: np.ndarray


def silent_columns(projections, band) -> tuple[tuple[int, ...], bool]:
    """Return the columns of C^T whose responses over a band (Hz) are round-off, and whether others hardly feel the
    inputs. Collective."""
    quiet = quiet_columns(projections, band)
    silent = tuple(column for column, (ratio, limit) in quiet.items() if ratio <= limit)
    return silent, len(silent) < len(quiet)


def quiet_columns(projections, band) -> dict[int, tuple[float, float]]:
    """Return the columns of C^T that hardly feel the inputs over a band (Hz): their quietness, and that below which it
    is round-off. Collective."""
    if projections.io.are_same:
        return {}
    quiet, found = decided(projections.run.model.comm, _quiet, projections, band), {}
    for start in range(0, len(quiet), AT_A_TIME):
        some = quiet[start : start + AT_A_TIME]
        for output, bound in zip(some, _round_off(projections, some), strict=True):
            share = max(SURE * bound, output.mixed) / output.size if output.size else 0.0
            found[output.column] = output.ratio, max(share * output.ratio, SURE * UNIT)
    return found


def _quiet(projections, band):
    """Return the columns that may be silent; local."""
    model = projections.model()
    S = grid([model], band, UNIFORM // 4, None)
    ratio = quietness(model, S)  # (S, k, p)
    most = ratio.max(axis=(0, 2), initial=0.0)
    quiet = []
    for j in np.flatnonzero(most < QUIET):
        k, i = np.unravel_index(ratio[:, j].argmax(), ratio[:, j].shape)
        at = S[[k]]
        x, y = model.solve(at, model.B[:, [i]])[0, :, 0], model.solve(at, model.Ct[:, [j]], transposed=True)[0, :, 0]
        size = float(abs(model.Ct[:, j] @ x))
        mixed = float(UNIT / 2 * abs(model.eigenvalues).max() * np.linalg.norm(x) * np.linalg.norm(y))
        states = model.vectors @ x, model.vectors @ y
        quiet.append(Quiet(int(j), float(at[0]), size, float(ratio[k, j, i]), mixed, *states))
    return quiet


def _round_off(projections, quiet) -> np.ndarray:
    """Return u |y|^T |A| |x| of quiet columns. Collective."""
    model = projections.run.model
    frequencies = np.array([output.frequency for output in quiet])
    a, b, s = projections.damping.coefficients(frequencies)
    factors = zip(projections.beside, projections.beside.coefficients(s), strict=True)
    terms = [(model.K, a), (model.M, b), *((term.matrix, factor) for term, factor in factors)]
    x, y = (_magnitudes(projections, np.array([getattr(output, of) for output in quiet]).T) for of in ("x", "y"))
    product, found = create_block(model.K, len(quiet)), np.zeros(len(quiet))
    for mat, factor in terms:
        magnitude = absolute(mat)
        apply(magnitude, x, product)
        magnitude.destroy()
        with local_rows(product) as Ax, local_rows(y) as rows:
            found += np.abs(factor) * (rows * Ax).real.sum(axis=0)
    return UNIT * summed(model.comm, found)


def _magnitudes(projections, coefficients):
    """Return |V coefficients| entry by entry, of complex ones (m, k), as a block. Collective."""
    count = coefficients.shape[1]
    block = create_block(projections.run.model.K, 2 * count)
    add_product(block, projections.basis.columns, np.hstack([coefficients.real, coefficients.imag]), beta=0.0)
    found = create_block(projections.run.model.K, count)
    with local_rows(block) as both, local_rows(found) as rows:
        rows[...] = np.hypot(both[:, :count].real, both[:, count:].real)
    return found
