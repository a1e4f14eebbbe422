"""Which changes are made, and that those listed as none still are among them."""

import ast
import os
import signal
import subprocess

from .__main__ import ROOMS, ROOT, SAME, key_of
from .changes import changes
from .forks import run_forked

SOURCE = '''
"""A module."""
LIMIT, STEPS = 1e-12, 9

def f(x, k=2):
    """A function."""
    if len(x) < 3:
        raise ValueError(f"found {len(x) + 1}")
    say("done", k - 1)
    return -x[:k].T * 2.0
'''


def test_one_place_is_changed_at_a_time():
    found = list(changes(SOURCE))
    lines = ast.unparse(ast.parse(SOURCE)).splitlines()
    made = []
    for change in found:
        others = change.source().splitlines()
        assert len(others) == len(lines)
        (pair,) = [(a, b) for a, b in zip(lines, others, strict=True) if a != b]
        made.append(pair[1].strip())
    assert "return x[:k].T * 2.0" in made and "return -x[:k] * 2.0" in made and "return -x[:k - 1].T * 2.0" in made
    assert "return -x[:k].T / 2.0" in made and "return -x[:k].T" in made and "return -x[:k].T * 4.0" in made
    assert {"if len(x) >= 3:", "if len(x) <= 3:", "if len(x) < 2:", "if len(x) < 4:"} <= set(made)
    assert "def f(x, k=3):" in made and "LIMIT, STEPS = (0.0, 9)" in made
    assert not [line for line in made if "raise" in line or "say" in line or '"""' in line]
    assert [change.imported for change in found] == [change.first < 6 for change in found]


def test_forks_end_with_a_status_and_in_their_time():
    tasks = {
        "good": lambda: 0, "fails": lambda: 3, "raises": lambda: 1 / 0,
        "hangs": lambda: subprocess.run(["sleep", "60"]),
        "crashes": lambda: os.kill(os.getpid(), signal.SIGKILL),
    }  # fmt: skip
    limited = [(key, 1 if key == "hangs" else 9, task) for key, task in tasks.items()]
    ended = {key: status for key, status, _ in run_forked(limited, 2)}
    assert ended.keys() == tasks.keys() and [key for key in ended if not ended[key]] == ["good"]


def test_changes_that_are_none_are_among_those_that_are_made():
    listed = [tuple(line.rpartition(" | ")[0].split(" | ", 2)) for line in SAME.read_text().splitlines()]
    paths = [path for room in ROOMS.split(",") for path in (ROOT / "hpcred" / room).rglob("*.py")]
    named = [path for path in paths if str(path.relative_to(ROOT / "hpcred")) in {module for module, *_ in listed}]
    keys = {key_of(path, change) for path in named for change in changes(path.read_text())}
    assert not set(listed) - keys and len(set(listed)) == len(listed)
