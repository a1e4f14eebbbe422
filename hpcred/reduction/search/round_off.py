"""Measure the round-off of a projection by models of one basis that differ by nothing else.

It is large where the response is much softer than the stiffest parts, such as that of a nearly free body close to 0 Hz,
and no comparison of models made from one projection shows it. The columns times factors have other digits, and so other
round-off of K and D on them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...parallel.petsc import MPI
from ..result.accuracy import Accuracy
from ..result.reduced_model import ReducedModel, as_measured
from ..small.pseudo_modal import PseudoModal
from .projections import Projections

SAMPLES = 3
FACTORS = (0.7, 1.4)
EACH = 4  # of the frequencies of the curve, which are close where it has extrema: round-off is smooth between poles
CHUNK = 2**20  # numbers of matrices that are solved with at a time


def projected_again(projections: Projections) -> Iterator[PseudoModal]:
    """Yield models of the columns that the basis has now, which changes their lengths, from SAMPLES projections.
    Collective."""
    basis, damping, damped = projections.basis, projections.damping, projections.damped
    lengths, random = np.ones(basis.size), np.random.default_rng(0)
    for _ in range(SAMPLES):
        factors = random.uniform(*FACTORS, basis.size)
        basis.multiply(np.diag(factors / lengths))
        lengths = factors
        again, scale = Projections(projections.run, basis, damping, damped, measured=True), np.outer(lengths, lengths)
        again.io = projections.io
        operator = again.operator.map(lambda matrix: matrix / scale)  # noqa: B023  (used here)
        yield again.model_of(operator, again.L / lengths[:, None])


def with_round_off(accuracy: Accuracy, elastic: ReducedModel, projections: Projections) -> Accuracy:
    """Return the accuracy of a reduced model with the round-off of its projection in the noise. Collective.

    The noise is at least the largest difference between responses of its `elastic` part and those of models that are
    projected again from the same basis, by the `projections` of its search. The columns of the basis are scaled then.
    """
    measured = as_measured(elastic, accuracy)
    comm, noise = projections.run.model.comm, accuracy.noise
    # responses of the model at the frequencies of this rank, in parts that fit
    mine = np.array(accuracy.frequencies)[:: EACH][comm.rank :: comm.size]
    chunks = np.array_split(mine, 1 + len(mine) * measured.size**2 // CHUNK) if len(mine) else []
    responses = [measured.measured_response(2j * np.pi * chunk, projections.io.rates) for chunk in chunks]
    # their differences from models with other round-off
    for again in projected_again(projections):
        for chunk, H in zip(chunks, responses, strict=True):
            other, drive = again.responses(chunk)
            noise = max(noise, float(accuracy.measure.eps(other - H, other, drive).max()))
    return accuracy.with_noise(comm.allreduce(noise, op=MPI.MAX))
