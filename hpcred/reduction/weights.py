"""Weights of outputs and inputs: a projected model enters; with what leaves, all directions count alike in eps.

eps (55) is then that of diag(outputs) H diag(inputs): no soft direction, and no choice of units, hides a stiff one.
"""

from __future__ import annotations

import numpy as np

from .error_estimate import UNIFORM
from .pseudo_modal import Law, PseudoModal, chunks, solve

SILENT = 1e-10  # of |C_i| |x|, below which an output does not feel the states x, but for round-off
ROUNDS = 50  # of equilibration, each of which halves the logarithm of what is left
Weights = tuple[tuple[float, ...], tuple[float, ...]]


def equal_weights(model: PseudoModal, law: Law, band, ports) -> Weights:
    """Of the r outputs and the p inputs: the largest response of each, as its geometric mean over the band, becomes 1.

    By equilibration in the maximum norm, which exists also where outputs feel some of the inputs only, and keeps a
    symmetric H symmetric (Ruiz, 2001). An output that feels no input, or an input that no output feels, keeps the
    weight 1. To three digits, the same on any number of ranks.
    """
    low, high = band
    Lb, Lc = ports
    total, feels = 0.0, False
    measures = (model.L @ Lc).T
    for part in chunks(model, low + (high - low) * (np.arange(UNIFORM) + 0.5) / UNIFORM):
        states = solve(model, law, part, model.L @ Lb)
        size = np.abs(measures @ states)
        bound = np.linalg.norm(measures, axis=1)[:, None] * np.linalg.norm(states, axis=1)[:, None, :]
        feels = feels | (size > SILENT * bound).any(axis=0)
        total = total + np.log(np.maximum(size, np.finfo(float).tiny)).sum(axis=0)
    mean = np.where(feels, np.exp(total / UNIFORM), 0.0)
    outputs, inputs = np.ones(mean.shape[0]), np.ones(mean.shape[1])
    for _ in range(ROUNDS):
        now = outputs[:, None] * mean * inputs
        outputs, inputs = outputs / _root_of_largest(now.T), inputs / _root_of_largest(now)
    return tuple(tuple(float(f"{value:.3g}") for value in each) for each in (outputs, inputs))


def _root_of_largest(matrix):
    """Square roots of the largest entries of its columns, 1 where a column is 0."""
    largest = matrix.max(axis=0)
    return np.sqrt(np.where(largest > 0, largest, 1.0))


def weighed_ports(ports, weights: Weights | None):
    """(Lb (l, p), Lc (l, r)) of weighed inputs and outputs; as they are without weights."""
    if weights is None:
        return ports
    outputs, inputs = weights
    Lb, Lc = ports
    weighed = Lb * np.array(inputs)
    return weighed, weighed if Lc is Lb and outputs == inputs else Lc * np.array(outputs)


def weighed(H: np.ndarray, weights: Weights | None) -> np.ndarray:
    """Responses (S, r, p), or what is left of them, with weights; as they are without."""
    if weights is None:
        return H
    outputs, inputs = weights
    return np.array(outputs)[:, None] * H * np.array(inputs)
