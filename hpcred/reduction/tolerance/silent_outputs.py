"""Find the outputs whose responses are round-off: zero in exact arithmetic, for all that double precision tells.

Where every entry of A(s) is known to one unit of round-off u, the response c^T A^-1 b is known to u |y|^T |A| |x|, with
the states x = A^-1 b and y = A^-T c. This bound follows a response that is small since the output is well isolated, and
does not depend on units: a factor on dofs multiplies all of its terms alike. (Higham, Accuracy and Stability of
Numerical Algorithms, 2002, section 7.2.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...linalg.blocks import add_product, apply, create_block, local_rows
from ...model.viscoelastic import excesses
from ...parallel.decisions import decided
from ...parallel.petsc import PETSc
from ...parallel.sums import summed
from .error_estimate import UNIFORM, grid, quietness

QUIET = 1e-8  # see quietness: below it round-off is computed
SURE = 10.0  # times the bound, up to which a response is round-off
AT_A_TIME = 8  # outputs


class Quiet(NamedTuple):
    """A column of C^T that hardly feels the inputs: its place, where it feels them most (`frequency`, Hz), the response
    there, and the states x and y (m,) in terms of the basis."""

    column: int
    frequency: float
    size: float
    x: np.ndarray
    y: np.ndarray


def silent_columns(projections, band, felt: set[int]) -> tuple[int, ...]:
    """Return the columns of C^T whose responses over a band (Hz) are round-off; those that are not join `felt`, which
    are not looked at again. Collective."""
    comm, io = projections.run.model.comm, projections.io
    if io.are_same or len(felt) == io.outputs.shape[1]:
        return ()
    model, quiet, loud = decided(comm, _quiet, projections, band)
    felt |= loud
    quiet = [item for item in quiet if item.column not in felt]
    silent = []
    for start in range(0, len(quiet), AT_A_TIME):
        some = quiet[start : start + AT_A_TIME]
        sure = SURE * _round_off(projections, model, some)
        silent += [item.column for item, limit in zip(some, sure, strict=True) if item.size <= limit]
    felt |= {item.column for item in quiet} - set(silent)
    return tuple(sorted(silent))


def _quiet(projections, band):
    """Return the coefficients (a, b, s) of A at the frequencies of the quiet columns, these, and the other columns."""
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
        quiet.append(Quiet(int(j), float(at[0]), size, model.vectors @ x, model.vectors @ y))
    return model.damping, quiet, set(np.flatnonzero(~(most < QUIET)).tolist())


def _round_off(projections, damping, quiet) -> np.ndarray:
    """Return u |y|^T |A| |x| of quiet columns. Collective."""
    model = projections.run.model
    a, b, s = (np.abs(part) for part in damping.coefficients([item.frequency for item in quiet]))
    terms = [(model.K, a), (model.M, b)]
    if projections.D is not None:
        terms.append((model.D, s))
    added = np.abs(excesses(model.viscoelastic, 2j * np.pi * np.array([item.frequency for item in quiet])))
    terms += [(part.matrix, factor) for part, factor in zip(model.viscoelastic, added, strict=True)]
    x, y = (_magnitudes(projections, np.array([getattr(item, of) for item in quiet]).T) for of in ("x", "y"))
    product, found = create_block(model.K, len(quiet)), np.zeros(len(quiet))
    for mat, factor in terms:
        magnitude = _magnitude(mat)
        apply(magnitude, x, product)
        magnitude.destroy()
        with local_rows(product) as Ax, local_rows(y) as rows:
            found += factor * (rows * Ax).real.sum(axis=0)
    return np.finfo(float).eps * summed(model.comm, found)


def _magnitudes(projections, coefficients):
    """Return |V coefficients| entry by entry, of complex ones (m, k), as a block. Collective."""
    count = coefficients.shape[1]
    parts = create_block(projections.run.model.K, 2 * count)
    add_product(parts, projections.basis.columns, np.hstack([coefficients.real, coefficients.imag]), beta=0.0)
    found = create_block(projections.run.model.K, count)
    with local_rows(parts) as both, local_rows(found) as rows:
        rows[...] = np.hypot(both[:, :count].real, both[:, count:].real)
    return found


def _magnitude(mat):
    """Return |A| entry by entry. Collective."""
    indptr, indices, values = mat.getValuesCSR()
    return PETSc.Mat().createAIJ(mat.getSizes(), csr=(indptr, indices, np.abs(values)), comm=mat.comm)
