"""Make the reduced D of damping that has no sparse matrix: modal ratios (52) and the Caughey series (39)."""

import numpy as np

from ...model.damping import ModalDamping, caughey_terms


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
