"""How many columns a search is away from its goal, and what its judge keeps."""

from types import SimpleNamespace

import numpy as np
import pytest

import hpcred
from hpcred.linalg.solvers.shifted import NEARBY
from hpcred.parallel.petsc import is_complex
from hpcred.reduction.search.judging import Blocks, Judge, _columns_ahead
from hpcred.reduction.small.pseudo_modal import Proportional


def test_columns_ahead_at_the_rate_of_the_last_block():
    """Two powers of ten with each block of 3 columns, of which four are left; none where the goal is reached."""
    assert _columns_ahead([1e-2, 1e-4], 1e-8, 3) == pytest.approx(6.0)
    assert _columns_ahead([1.0, 1e-2, 1e-3], 1e-8, 2) == pytest.approx(10.0)
    assert _columns_ahead([1e-2, 1e-9], 1e-8, 3) == 0.0
    for history in ([1e-2], [1e-4, 1e-4], [1e-4, 1e-2], [1e-2, 0.0]):
        assert _columns_ahead(history, 1e-8, 3) == np.inf


def test_of_what_the_basis_lost_the_larger_is_kept():
    projections = SimpleNamespace(run=SimpleNamespace(solvers=SimpleNamespace(multigrid=False)))
    judge = Judge(projections, hpcred.Adaptive(tolerance=1e-4, band=(0.0, 1.0)))
    for error in (2.0**-20, 2.0**-10, 2.0**-30):
        judge.note_loss(error)
    assert judge.lost == 2.0**-10


def unseen(damping, f=1.0, nearby=8.0, order=0, same=True):
    io, run = SimpleNamespace(are_same=same), SimpleNamespace(solvers=SimpleNamespace(multigrid=False))
    projections = SimpleNamespace(run=run, damping=damping, io=io)
    judge = Judge(projections, hpcred.Adaptive(tolerance=1e-4, band=(0.0, 8.0)))
    return judge._unseen(Blocks(f, True, nearby, order))


@pytest.mark.parametrize(
    "damping", [Proportional(), Proportional(eta=0.1), Proportional(alpha=20.0), Proportional(alpha=10.0, beta=1e-2)]
)
def test_what_a_rough_solution_leaves_of_a_damped_response_is_bounded(damping):
    """Modes above the factor's point, against the projection on an approximate undamped solution."""
    rng, omega, bound = np.random.default_rng(3), 2 * np.pi, unseen(damping)
    assert NEARBY < bound * (1 + 1e-12) < 1.5
    for _ in range(200):
        squares = (8 * omega) ** 2 * (1 + 10 ** rng.uniform(-3, 3, 20))
        load, undamped = rng.standard_normal(20), squares - omega**2
        x = load / undamped
        error = rng.standard_normal(20) / np.sqrt(undamped)
        error -= x * (error @ (undamped * x)) / (x @ (undamped * x))  # and e^T A (x - e) = 0 below, as of Galerkin's
        ratio = NEARBY * x @ (undamped * x) / (error @ (undamped * error))
        error = (NEARBY * x + np.sqrt(ratio) * error) / (1 + NEARBY)
        found = x - error
        assert np.isclose(error @ (undamped * error), NEARBY * found @ (undamped * found))
        a, b, _ = damping.coefficients(1.0)
        A = a * squares + b
        seen = (load @ found) ** 2 / (found @ (A * found))
        assert abs((load / A) @ load - seen) <= (1 + 1e-9) * bound * abs(seen)


def test_what_is_left_is_not_known_of_strong_damping_later_blocks_and_other_outputs():
    for damping in (Proportional(alpha=1e4), Proportional(higher=(1e-6,))):
        assert unseen(damping) == np.inf
    for given in ({"order": 1}, {"nearby": None}, {"same": False}):
        assert unseen(Proportional(), **given) == np.inf
    assert unseen(Proportional(alpha=1.0), f=7.99) > 10 * NEARBY > unseen(Proportional(alpha=1.0))


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.skipif(is_complex(), reason="modes are not counted, so that each point has a factor")
@pytest.mark.parametrize("damping, blocks", [(hpcred.Rayleigh(20.0, 1e-8), 1), (hpcred.Rayleigh(3e7, 0.0), 2)])
@pytest.mark.costly
def test_one_input_is_verified_by_one_block_unless_damping_is_strong(comm, damping, blocks):
    with hpcred.solid((4, 2, 3), inputs=1, comm=comm) as model:
        rom = hpcred.reduce(model, damping=damping, tolerance=1e-4, band=(0.0, 30000.0))
        accuracy = rom.record.accuracy
    first, second = accuracy.points[:2]
    assert accuracy.reached and second.factor_of == first.frequency
    assert (second.columns == 1) == (blocks == 1)
    assert accuracy.proofs[0].uncertainty <= max(accuracy.proofs[0].measured / 10, 1e-7)
