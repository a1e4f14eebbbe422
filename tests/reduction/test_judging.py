"""How many columns a search is away from its goal, and what its judge keeps."""

from types import SimpleNamespace

import numpy as np
import pytest

import hpcred
from hpcred.reduction.search.judging import Judge, _columns_ahead


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
