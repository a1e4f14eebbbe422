"""When the search for modes that no load moves ends: by a count of modes, or after pairs of columns without news."""

from types import SimpleNamespace

import pytest

from hpcred.reduction.tolerance import hidden_modes
from hpcred.reduction.tolerance.hidden_modes import HIDDEN, find_hidden


def rounds(monkeypatch, counts, answers):
    """How many times columns were added, and how many of these were random; `answers`: (moving, missing) a time."""
    basis, taken = SimpleNamespace(size=0), []

    def extend(kind):
        def add(*_):
            taken.append(kind)
            basis.size += 2
            return 2

        return add

    answers = iter(answers)
    monkeypatch.setattr(hidden_modes, "extend_by_random", extend("random"))
    monkeypatch.setattr(hidden_modes, "_extend_by_modes", extend("modes"))
    monkeypatch.setattr(hidden_modes, "_moving", lambda *_: next(answers, (None, 1)))
    monkeypatch.setattr(hidden_modes, "_change", lambda *_: (0, 0.0))
    run = SimpleNamespace(note=lambda *_: None, model=SimpleNamespace(comm=SimpleNamespace(size=1)))
    solver = SimpleNamespace(projections=SimpleNamespace(basis=basis), run=run, counts=counts)
    find_hidden(solver, None, [(10.0, 3)])
    return taken


@pytest.mark.parametrize(
    "counts, answers, taken",
    [
        (True, [(None, 0)], ["random"]),
        (True, [(None, 1), (None, 0)], ["random"] * 2),
        (True, [("V", 0), (None, 0)], ["random", "modes"]),
        (False, [(None, 0)] * 9, ["random"] * 2),
        (False, [(None, 0), ("V", 0), (None, 0), (None, 0), (None, 0)], ["random", "random", "modes"] + ["random"] * 2),
        (False, [], ["random"] * (HIDDEN // 2)),
    ],
)
def test_rounds_of_columns(monkeypatch, counts, answers, taken):
    assert rounds(monkeypatch, counts, answers) == taken
