"""Make mutants, run the tests that cover each, and print those that survive; exit status 1 where there are any."""

import argparse
import json
import os
import random
import sys
import tempfile
from pathlib import Path

import coverage
import numpy  # noqa: F401  with the others, for the forks
import pydantic  # noqa: F401
import pytest
import scipy.io  # noqa: F401
import scipy.linalg  # noqa: F401
import scipy.optimize  # noqa: F401
import scipy.sparse.linalg  # noqa: F401

from .changes import changes
from .forks import run_forked

ROOT = Path(__file__).resolve().parents[2]
ROOMS = "linalg,fe,model,reduction,body,simulation,analysis,assembly"
SAME = Path(__file__).with_name("same.txt")
LIMIT = 1200  # seconds of the tests of a module, measured
QUICK = "not slow and not ccx and not dolfinx and not chromium and not slurm and not docs and not wheel"


def main():
    parser = argparse.ArgumentParser(prog="python -m mutants", description=__doc__)
    parser.add_argument("--rooms", default=ROOMS, help="rooms or modules (linalg/basis.py), separated by commas")
    parser.add_argument("--count", type=int, default=100, help="mutants, taken evenly from the modules")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=60.0, help="of tests of a mutant, the shortest first")
    parser.add_argument("--only", action="append", help="mutants whose line in the table contains this text")
    parser.add_argument("--everywhere", action="store_true", help="the tests on 3 ranks and in the complex build, too")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "mutants", help="for what tests cover")
    given = parser.parse_args()
    os.chdir(ROOT)
    rooms = given.rooms.split(",")
    covered = Covered(given.folder, sorted({room.partition("/")[0] for room in rooms}), given.jobs)
    chosen = sample(rooms, given.count, given.seed, covered, given.only)
    print(f"{len(chosen)} mutants, seed {given.seed}", flush=True)
    survivors = []
    with tempfile.TemporaryDirectory(prefix="hpcred-mutants-") as folder:
        tasks = (task_of(*item, covered, Path(folder), given.seconds, given.everywhere) for item in chosen)
        for line, status, seconds in run_forked(tasks, given.jobs):
            print(f"{'killed  ' if status else 'SURVIVED'} {seconds:4.0f} s {line}", flush=True)
            survivors += [] if status else [line]
    print(f"{len(chosen)} mutants, {len(survivors)} survived")
    print(*survivors, sep="\n")
    return int(bool(survivors))


def sample(rooms, count, seed, covered, only=None):
    """(path, change) of mutants whose lines some test runs: of each module in turn one by chance."""
    paths = [path for room in rooms for path in (
        sorted((ROOT / "hpcred" / room).rglob("*.py")) or [ROOT / "hpcred" / room])]  # fmt: skip
    same = {tuple(line.rpartition(" | ")[0].split(" | ", 2)) for line in SAME.read_text().splitlines()}
    piles = []
    for path in paths:
        pile = [(path, change) for change in changes(path.read_text())
                if covered.tests(path, change) and key_of(path, change) not in same
                and (not only or any(text in line_of(path, change) for text in only))]  # fmt: skip
        random.Random(f"{seed} {path.relative_to(ROOT)}").shuffle(pile)
        piles.append(pile)
    chosen = []
    while any(piles) and len(chosen) < count:
        chosen += [pile.pop() for pile in piles if pile]
    return chosen[:count]


def key_of(path, change):
    """What stands in same.txt before the reason."""
    before, after = (" ".join(text.split()) for text in (change.before, change.after))
    return str(path.relative_to(ROOT / "hpcred")), change.inside, f"{before} -> {after}"


def line_of(path, change):
    """The line of a mutant in the table."""
    module, inside, what = key_of(path, change)
    return f"{module}:{change.first} | {inside} | {what}"


class Covered:
    """Which tests of rooms run which lines, and how long they take; measured again where what they run is newer."""

    def __init__(self, folder, rooms, jobs):
        folder.mkdir(parents=True, exist_ok=True)
        files = [path for room in rooms for path in sorted((ROOT / "tests" / room).glob("test_*.py"))]
        old = [path for path in files if self._is_old(path, *kept_in(folder, path))]
        tasks = [(path, LIMIT, lambda path=path: measure(path, *kept_in(folder, path))) for path in old]
        for path, _, seconds in run_forked(tasks, jobs):
            print(f"measured {path.relative_to(ROOT)} in {seconds:.0f} s", flush=True)
        self._lines, self.seconds, self.every = {}, {}, set()
        for path in files:
            data, watched = kept_in(folder, path)
            watched = json.loads(watched.read_text())
            self.seconds |= {test: time for test, time in watched["seconds"].items() if test not in watched["failed"]}
            self.every |= set(watched["every"])
            if watched["failed"]:
                print(f"left out, as they fail as it is: {' '.join(watched['failed'])}")
            for file, by_line in lines_of(data):
                lines = self._lines.setdefault(file, {})
                for line, tests in by_line.items():
                    lines.setdefault(line, set()).update(tests)

    @staticmethod
    def _is_old(path, data, watched):
        since = watched.stat().st_mtime if watched.exists() else 0.0
        return path.stat().st_mtime > since or any(
            not file.exists() or file.stat().st_mtime > since for file, _ in lines_of(data)
        )

    def tests(self, path, change):
        """Tests that run a line of a change, else those that run its module; its own first, then the shortest."""
        lines = self._lines.get(path, {})
        found = set().union(*(lines.get(line, ()) for line in range(change.first, change.last + 1)))
        own = f"/test_{path.stem}.py::"
        if change.imported and found:  # by whichever test comes first; tests of tables run no line
            found = set().union(*lines.values(), (test for test in self.seconds if own in test))
        return sorted(found & self.seconds.keys(), key=lambda test: (own not in test, self.seconds[test], test))


def kept_in(folder, path):
    """The files of what the tests of a module run, and of their times."""
    return (folder / f"{path.parent.name}-{path.stem}{suffix}" for suffix in (".sqlite", ".json"))


def measure(path, data, watched):
    """Run the tests of a module on one rank under coverage."""
    data.unlink(missing_ok=True)
    watched.unlink(missing_ok=True)
    os.environ["HPCRED_WATCHED"] = str(watched)
    measured = coverage.Coverage(data_file=str(data), config_file=False, source=["hpcred"])
    measured.start()
    status = pytest.main(["-q", "-p", "no:cacheprovider", "-p", "mutants.watching", "-m", QUICK,
                          "-k", "not 2-ranks and not 3-ranks and not rank-complex", str(path)])  # fmt: skip
    measured.stop()
    measured.save()
    return status


def lines_of(data):
    """The modules that tests run, each with the tests by line."""
    kept = coverage.CoverageData(str(data))
    kept.read()
    found = ((Path(file), kept.contexts_by_lineno(file)) for file in kept.measured_files())
    return [(file, by_line) for file, by_line in found if set().union(*by_line.values()) - {""}]


def task_of(path, change, covered, folder, seconds, everywhere):
    """The line of a mutant, the time (s) that its tests may take, and a function that runs them: its exit status is 0
    where no test fails."""
    tests, took = [], 0.0
    for test in covered.tests(path, change):
        took += covered.seconds[test]
        if tests and took > seconds:
            break
        tests.append(test)
    elsewhere = [test.replace("1-rank", suffix) for test in tests for suffix in ("3-ranks", "1-rank-complex")]
    elsewhere = [test for test in elsewhere if everywhere and test in covered.every and test not in tests]
    line = line_of(path, change)

    def run():
        source = folder / str(os.getpid())
        source.write_text(change.source())
        os.environ |= {"HPCRED_MUTANT": f"{path}={source}", "PYTEST_PLUGINS": "mutants.changed"}
        return pytest.main(["-x", "-q", "-p", "no:cacheprovider", *tests, *elsewhere])

    return f"{line} | {len(tests)} tests", 60 + 4 * took + 16 * took * bool(elsewhere), run


if __name__ == "__main__":
    sys.exit(main())
