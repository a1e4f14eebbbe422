"""Project a model on one basis, V^T A V (20), in pseudo-modal coordinates (52-54) or those of interfaces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..linalg.eigensolver import congruent, eigenpairs_with_gram, symmetric_part
from ..model.definiteness import growing, warnings_of_definiteness
from ..model.digits import warnings_of_digits
from ..model.operator import Operator
from ..parallel.decisions import decided
from ..parallel.failures import ComputationError, InputError
from .interface_coordinates import to_interface_coordinates
from .result.massless import without_round_off
from .run.projection import (
    Projection,
    diagonalise,
    diagonalise_with_massless,
    project,
    project_columns,
    project_stiffness,
    separate_dampers,
)
from .small.damping import reduced_damping

ORTHONORMAL_TO = 1e-12


class PseudoModes(NamedTuple):
    """omega^2 (m,) of pseudo-modes, ascending, of which the last `static` ones have no mass."""

    eigenvalues: np.ndarray
    static: int = 0

    @property
    def frequencies(self) -> np.ndarray:
        """Pseudo-frequencies (m,) in Hz (52)."""
        return np.sqrt(np.maximum(self.eigenvalues, 0.0)) / (2 * np.pi)

    @property
    def moving(self) -> int:
        """How many have mass."""
        return len(self.eigenvalues) - self.static


def one_sided(model, framed, basis, run, settings) -> Projection:
    """Return V^T A V and V^T B of a model in its frame, and change the basis V to that of its coordinates. Collective.

    Raises InputError, and ComputationError for a basis that is not orthonormal.
    """
    full = framed.model
    # V <- V X with X^T V^T K V X = diag(omega^2) (53, 54), without what lies above a limit
    modes = _diagonalised(basis, run)
    if settings.drop_above is not None:
        modes = _up_to(settings.drop_above, modes, basis, run)
    if modes.static and "D" in full.matrices:
        separate_dampers(basis, full.matrices["D"], modes.static)
    # V^T M V = I (51), as it is
    mass, defect = _mass(modes, basis, run)
    columns = basis.columns
    # round-off of the product V X couples parts that hardly couple: the small matrices alone are turned once more
    X, again = np.eye(len(mass)), not run.tau and full.is_symmetric("K")
    if again:
        eigenvalues, X = decided(model.comm, eigenpairs_with_gram, _stiffness(columns, run), mass)
        mass, modes = congruent(mass, X), PseudoModes(eigenvalues)
    # what the digits of K leave of omega^2, and whether motion grows
    run.notes.remarks += warnings_of_digits(model, full.K, modes.eigenvalues, columns)
    if not warnings_of_definiteness(model) and (unstable := growing(model, modes.eigenvalues)):
        run.notes.remarks.append(unstable)
    # the terms and the columns in these coordinates
    operator = _operator(framed, modes, mass, columns, X, run)
    B = X.T @ project_columns(columns, full.B)
    C = (B if full.Ct is None else X.T @ project_columns(columns, full.Ct)).T.copy()
    if again:
        basis.multiply(X)
    projection = Projection(operator, B, C, modes.frequencies, columns, defect)
    if settings.coordinates == "interface":
        return to_interface_coordinates(framed, projection, run.tau)
    return projection


def _stiffness(columns, run) -> np.ndarray:
    """Return V^T K V (m, m)."""
    K = run.model.K
    return project_stiffness(K, columns, run.cancels) if run.model.is_symmetric("K") else project(K, columns)


def _diagonalised(basis, run) -> PseudoModes:
    """Replace V by V X so that V^T K V = diag(omega^2), and V^T M V = diag(I, 0) where M may be singular."""
    if run.tau:
        return PseudoModes(*diagonalise_with_massless(basis, run.mass, lambda V: _stiffness(V, run), run.tau))
    return PseudoModes(diagonalise(basis, _stiffness(basis.columns, run)))


def _up_to(limit, modes, basis, run) -> PseudoModes:
    """Leave out pseudo-modes above a limit (Hz)."""
    count, kept = len(modes.eigenvalues), int((modes.frequencies <= limit).sum())
    if kept == 0:
        raise InputError(f"drop_above: no pseudo-frequency lies below {limit:g} Hz")
    run.note(f"pseudo-frequencies up to {limit:g} Hz", count, kept)
    basis.multiply(np.eye(count)[:, :kept])
    return PseudoModes(modes.eigenvalues[:kept], max(modes.static - count + kept, 0))


def _mass(modes, basis, run) -> tuple[np.ndarray, float]:
    """Return V^T M V (m, m) and max |V^T M V - I| (51). Raises ComputationError."""
    # the part of each column that has mass: the digits of the rest are missing in M x
    weights = 1 / np.sqrt(1 + run.tau**2 * np.maximum(modes.eigenvalues, 0.0))
    mass, defect = basis.gram(run.mass, weights * (np.arange(len(weights)) < modes.moving))
    if defect > ORTHONORMAL_TO:
        raise ComputationError(
            f"the basis has lost its orthonormality: max |V^T M V - I| = {defect:.1e}, allowed is {ORTHONORMAL_TO:g}"
        )
    return mass, defect


def _operator(framed, modes, mass, columns, X, run) -> Operator:
    """Return M, D, K and the added terms (m, m): of V^T A V, which X turns, with what is known of them exactly."""
    full, moving = framed.model, modes.moving
    small = {"M": mass, "K": np.diag(modes.eigenvalues)}
    # without mass: V^T M V = 0, V^T K V = I / tau^2
    if modes.static:
        mass[moving:] = mass[:, moving:] = 0.0
        small["K"][moving:, moving:] = np.eye(modes.static) / run.tau**2
    # circulatory forces are the skew-symmetric part of K
    if not full.is_symmetric("K"):
        K = _stiffness(columns, run)
        small["K"] += (K - K.T) / 2
    # a matrix D is projected, other damping made from omega^2
    if "D" in full.matrices:
        small["D"] = without_round_off(congruent(project(full.matrices["D"], columns), X), modes.static, run.tau)
    else:
        small["D"] = reduced_damping(framed.damping, small["K"], modes.frequencies, mass)
    small = {key: symmetric_part(matrix) if full.is_symmetric(key) else matrix for key, matrix in small.items()}
    added = full.added.map(lambda mat: congruent(symmetric_part(project(mat, columns)), X))
    return Operator.of(**small, added=added)
