"""The reduced D of the damping laws that have no sparse matrix: modal ratios (52) and the Caughey series (39)."""

import numpy as np

from ..linalg.blocks import apply, copy_of, create_block, inner
from ..linalg.factorisation import SingularMatrix
from ..model.damping import ModalDamping, caughey_terms
from ..parallel.failures import InputError


def reduced_damping(damping, run, right, frequencies, left=None):
    """D (m, m) of a reduced model with the basis `right`, and `left` if it is another; zero without damping.

    `frequencies` (m,) of the diagonalised model in Hz. Collective.
    """
    if isinstance(damping, ModalDamping):
        return np.diag(4 * np.pi * frequencies * damping.at(frequencies))
    if (terms := caughey_terms(damping)) is not None:
        return _project_caughey(terms, run, right, left)
    return np.zeros((len(frequencies), len(frequencies)))


def _project_caughey(terms, run, right, left):
    """W^T M sum_k a_k (M^-1 K)^k V (39), by solves with M."""
    model = run.model
    try:
        solver = run.factored(np.inf, "infinity")
    except SingularMatrix as error:
        raise InputError(
            f"damping.coefficients: found {len(terms)}, but the mass matrix of {model.name} is singular, and a "
            "series of more than two has its inverse; take two, or other damping"
        ) from error
    power = copy_of(right, model.M)  # (M^-1 K)^k V
    left = left if left is not None else right
    momentum = run.times_mass(power)
    result = terms[0] * inner(left, momentum)
    momentum.destroy()
    for coefficient in terms[1:]:
        force = create_block(model.K, power.getSizes()[1])
        apply(model.K, power, force)
        result += coefficient * inner(left, force)
        solver.solve(force, power)
        force.destroy()
    power.destroy()
    return result
