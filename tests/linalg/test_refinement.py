"""Iterative refinement with solutions that are wrong by a known part, against dense numpy."""

import numpy as np
import pytest
from helpers import block_from, dense_model, gather

import hpcred
from hpcred.linalg.blocks import create_block, local_rows
from hpcred.linalg.refinement import IllConditioned, refine
from hpcred.parallel.failures import ComputationError

pytestmark = pytest.mark.mpi
KEY = "low_rank: {}; take less"
SIZES = np.array([1.0, 1e8, 1e-8])


def refined(comm, error, **settings):
    """The relative residual that is told, the true one of each column, and how many solutions were asked for."""
    with hpcred.solid((3, 2, 2), comm=comm) as model:
        K = dense_model(model.with_inputs([1]))[0]
        loads, asked = np.random.default_rng(1).standard_normal((len(K), 3)) * SIZES, []
        first, last = model.K.getOwnershipRange()

        def back_substitute(load, solution):
            asked.append(load)
            with local_rows(solution) as rows:
                exact = np.linalg.solve(K, gather(load))
                wrong = error @ exact if np.ndim(error) else error * exact
                rows[...] = (exact + wrong)[first:last]

        load, solution = block_from(model.K, loads), create_block(model.K, 3)
        back_substitute(load, solution)
        try:
            told = refine(model.K, back_substitute, load, solution, **settings)
            residual = np.linalg.norm(loads - K @ gather(solution), axis=0) / np.linalg.norm(loads, axis=0)
        finally:
            load.destroy()
            solution.destroy()
    return told, residual, len(asked) - 1


@pytest.mark.parametrize("error, steps, made", [(1e-12, 0, 0), (1e-12, 1, 1), (1e-6, 0, 1), (1e-4, 0, 2)])
def test_steps_are_made_until_the_residual_is_small(comm, error, steps, made):
    """Each step leaves the part `error` of the residual before it, in columns of any size."""
    told, residual, asked = refined(comm, error, steps=steps)
    assert asked == made
    assert told == pytest.approx(residual.max(), rel=0.5) and told < 1e-10
    assert (residual < max(2 * error ** (made + 1), 1e-12)).all()


def test_an_approximate_factor_takes_as_many_steps_as_it_needs(comm):
    """Also where its error is larger than 1 in some directions, in which plain refinement diverges."""
    scattered = np.random.default_rng(2).standard_normal((81, 81)) / 9  # whose norm is about 2
    few = np.outer(scattered[0], scattered[1])
    for error, least, most in ((0.05 * scattered, 4, 9), (3 * few + 1e-4 * scattered, 2, 6)):
        told, residual, asked = refined(comm, error, approximate=KEY)
        assert least <= asked <= most and told < 1e-10 and residual.max() < 1e-10
    with pytest.raises(ComputationError, match="^low_rank: the residual stays at .* after [1-9]+ steps of .*; take"):
        refined(comm, 40 * scattered, approximate=KEY)


@pytest.mark.parametrize("error", [0.3, 1.5, np.nan])
def test_a_residual_that_stays_large_is_refused(comm, error):
    with pytest.raises(IllConditioned, match="relative residual of (0.0|[2-9]|nan|inf)"):
        refined(comm, error)
