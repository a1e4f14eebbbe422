"""When the search for modes that no load moves ends: by a count of modes, or after pairs of columns without news."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse

import hpcred
from hpcred.reduction.search import hidden_modes, point_solver
from hpcred.reduction.search import search as searches
from hpcred.reduction.search.hidden_modes import PASSES, UNCOUNTED, find_hidden


def rounds(monkeypatch, counts, answers, room, doubtful=None, multigrid=False):
    """Which columns were added, and their numbers; `answers`: (moving, missing) a time, before the first too;
    `doubtful`: what seems to be no mode then."""
    basis, taken, first = SimpleNamespace(size=0), [], answers[0][1] if answers else 1

    def extend(kind):
        def add(*arguments):
            width = arguments[2] if kind == "random" else 2
            taken.append((kind, width))
            basis.size += width
            return width

        return add

    answers = iter(answers[1:])
    monkeypatch.setattr(hidden_modes, "extend_by_random", extend("random"))
    monkeypatch.setattr(hidden_modes, "_extend_by_modes", extend("modes"))
    monkeypatch.setattr(hidden_modes, "_moving", lambda *_: next(answers, (None, 1)))
    monkeypatch.setattr(hidden_modes, "_change", lambda *_: 0.0)
    monkeypatch.setattr(hidden_modes, "doubtful_modes", lambda *_: doubtful)
    run = SimpleNamespace(note=lambda *_: None, model=SimpleNamespace(comm=SimpleNamespace(size=1)))
    solver = SimpleNamespace(projections=SimpleNamespace(basis=basis), run=run, multigrid=multigrid)
    judge = SimpleNamespace(settings=SimpleNamespace(band=(0.0, 10.0)))
    find_hidden(solver, judge, (0.0, 10.0), (lambda _: first) if counts else None, lambda: basis.size >= room)
    return taken


PAIR, MODES = ("random", 2), ("modes", 2)


@pytest.mark.parametrize(
    "counts, answers, taken",
    [
        (True, [(None, 1), (None, 0)], [PAIR]),
        (True, [(None, 2), (None, 1), (None, 0)], [PAIR] * 2),
        (True, [(None, 1), ("V", 0), (None, 0)], [PAIR, MODES]),
        (True, [(None, 9), (None, 5), (None, 0)], [("random", 9), ("random", 5)]),
        (True, [(None, 40), (None, 1)], [("random", 16)] + [PAIR] * 42),  # to the limit
        (False, [(None, 0)] * 9, [PAIR] * 2),
        (False, [(None, 0)] * 2 + [("V", 0)] + [(None, 0)] * 3, [PAIR, PAIR, MODES] + [PAIR] * 2),
        (False, [("V", 0)] * 99, [PAIR] + [MODES] * (UNCOUNTED // 2 - 1)),
    ],
)
def test_rounds_of_columns(monkeypatch, counts, answers, taken):
    assert rounds(monkeypatch, counts, answers, room=100) == taken


@pytest.mark.parametrize(("multigrid", "passes"), [(False, PASSES - 1), (True, 0)])
def test_what_seems_to_be_no_mode_is_improved_some_times(monkeypatch, multigrid, passes):
    """By factors, which show by how little soft modes move."""
    taken = rounds(monkeypatch, True, [(None, 1)] + [(None, 0)] * 9, 100, "V", multigrid)
    assert taken == [PAIR] + [MODES] * passes


@pytest.mark.mpi
def test_filled_blocks_have_modes_that_no_load_moves(comm, monkeypatch):
    """Two chains of which one is loaded: the modes of the other are found by the columns that fill blocks,
    without a pass of their own."""
    n, f = 150, 1.2
    modes = 2 * np.sin(np.arange(1, n + 1) * np.pi / (2 * n + 2))  # of a chain of unit masses, in rad/s
    spring = scipy.sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(n, n))
    K = scipy.sparse.block_diag([spring, f**2 * spring], format="csr")
    B, band = np.zeros((2 * n, 1)), (0.0, float(modes[7] + modes[8]) / (4 * np.pi))
    B[40] = 1.0
    below = int((modes < 2 * np.pi * band[1]).sum() + (f * modes < 2 * np.pi * band[1]).sum())
    passes = []
    for rows in (point_solver.ROWS, 0):
        monkeypatch.setattr(point_solver, "ROWS", rows)
        with (
            hpcred.SecondOrderModel(scipy.sparse.eye(2 * n, format="csr"), K=K, B=B, comm=comm) as model,
            hpcred.reduce(model, tolerance=1e-3, band=band) as rom,
        ):
            accuracy = rom.record.accuracy
            assert accuracy.reached and not accuracy.missing_modes
            if accuracy.counted is not None:
                assert accuracy.counted.modes == below
            passes.append([part.where for part in rom.record.components if "no load moves" in part.where])
            passes.append(rom.size)
    (before, size), (after, filled) = passes[:2], passes[2:]
    assert before and not after and filled <= size


@pytest.mark.mpi
def test_counted_modes_are_told_from_pseudo_modes_once(comm, monkeypatch):
    """Before the verification, whose columns bring no modes; without a count after it as well."""
    found, look = [], searches.doubtful_modes
    monkeypatch.setattr(searches, "doubtful_modes", lambda *given: found.append(look(*given)) or found[-1])
    with hpcred.solid((12, 3, 3), inputs=2, comm=comm) as model:
        with hpcred.reduce(model, tolerance=1e-4, band=(0.0, 4000.0), damping=hpcred.Rayleigh(20.0, 1e-7)) as rom:
            accuracy = rom.record.accuracy
        assert accuracy.reached and len(accuracy.points) > 1 and set(found) == {None}
        assert len(found) == 1 if accuracy.counted is not None else len(found) > 1
