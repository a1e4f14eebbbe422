"""Make mutants, run the tests that cover each, and print those that survive; exit status 1 where there are any."""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue

from coverage import CoverageData
from launch import mpi_environment

from .changes import changes

ROOT = Path(__file__).resolve().parents[2]
ROOMS = "linalg,fe,model,reduction,body,simulation"
TESTS = [ROOT / "tests" / room for room in (*ROOMS.split(","), "analysis")]
SAME = Path(__file__).with_name("same.txt")
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
    covered = Covered(given.folder, given.jobs)
    chosen = sample(given.rooms.split(","), given.count, given.seed, covered, given.only)
    print(f"{len(chosen)} mutants, seed {given.seed}", flush=True)
    with tempfile.TemporaryDirectory(prefix="hpcred-mutants-") as name, ThreadPoolExecutor(given.jobs) as pool:
        places = Queue()
        for job in range(given.jobs):
            places.put(scratch(Path(name) / str(job)))
        found = pool.map(lambda item: survives(item, covered, places, given.seconds, given.everywhere), chosen)
        survivors = list(filter(None, found))
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
    """Which tests run which lines, and how long they take; measured again where a file is newer."""

    def __init__(self, folder, jobs):
        folder.mkdir(parents=True, exist_ok=True)
        code = max(path.stat().st_mtime for path in (ROOT / "hpcred").rglob("*.py"))
        files = [path for room in TESTS for path in sorted(room.glob("test_*.py"))]
        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(lambda path: self._measure(path, folder, code), files))
        self._lines, self.seconds, self.every = {}, {}, set()
        for path in files:
            measured, watched = kept_in(folder, path)
            watched = json.loads(watched.read_text())
            self.seconds |= {test: time for test, time in watched["seconds"].items() if test not in watched["failed"]}
            self.every |= set(watched["every"])
            if watched["failed"]:
                print(f"left out, as they fail as it is: {' '.join(watched['failed'])}")
            data = CoverageData(str(measured))
            data.read()
            for file in data.measured_files():
                lines = self._lines.setdefault(Path(file), {})
                for line, tests in data.contexts_by_lineno(file).items():
                    lines.setdefault(line, set()).update(tests)

    def _measure(self, path, folder, code):
        data, watched = kept_in(folder, path)
        if watched.exists() and watched.stat().st_mtime > max(path.stat().st_mtime, code):
            return
        print(f"measure {path.relative_to(ROOT)}", flush=True)
        data.unlink(missing_ok=True)
        subprocess.run(
            [sys.executable, "-m", "coverage", "run", f"--data-file={data}", f"--rcfile={os.devnull}",
             "--source=hpcred", "-m", "pytest", "-q", "-p", "mutants.watching", "-m", QUICK,
             "-k", "not 2-ranks and not 3-ranks and not complex", str(path)],
            cwd=ROOT, stdout=subprocess.DEVNULL, env=environment(ROOT) | {"HPCRED_WATCHED": str(watched)},
        )  # fmt: skip

    def tests(self, path, change):
        """Tests that run a line of a change, else those that run its module; its own first, then the shortest."""
        lines = self._lines.get(path, {})
        found = set().union(*(lines.get(line, ()) for line in range(change.first, change.last + 1)))
        if change.imported and found:  # by whichever test comes first
            found = set().union(*lines.values())
        own = f"/test_{path.stem}.py::"
        return sorted(found & self.seconds.keys(), key=lambda test: (own not in test, self.seconds[test], test))


def kept_in(folder, path):
    """The files of what the tests of a module run, and of their times."""
    return (folder / f"{path.parent.name}-{path.stem}{suffix}" for suffix in (".sqlite", ".json"))


def environment(folder):
    return mpi_environment(PYTHONPATH=f"{folder}:{ROOT / 'tests'}", PYTHONDONTWRITEBYTECODE="1")


def scratch(folder):
    """A folder like the repository, with a copy of the package."""
    folder.mkdir()
    for path in ROOT.iterdir():
        if path.name == "hpcred":
            shutil.copytree(path, folder / "hpcred")
        elif path.name not in ("build", ".git"):
            (folder / path.name).symlink_to(path)
    return folder


def survives(item, covered, places, seconds, everywhere):
    """A line about a mutant for which no test fails, else None."""
    path, change = item
    tests, took = [], 0.0
    for test in covered.tests(path, change):
        took += covered.seconds[test]
        if tests and took > seconds:
            break
        tests.append(test)
    elsewhere = [test.replace("1-rank", suffix) for test in tests for suffix in ("3-ranks", "1-rank-complex")]
    elsewhere = [test for test in elsewhere if everywhere and test in covered.every and test not in tests]
    place, start = places.get(), time.monotonic()
    target = place / path.relative_to(ROOT)
    try:
        target.write_text(change.source())
        dead = run(tests, place, 60 + 4 * took) or (elsewhere and run(elsewhere, place, 120 + 12 * took))
    finally:
        shutil.copy2(path, target)
        places.put(place)
    line = line_of(path, change)
    print(f"{'killed  ' if dead else 'SURVIVED'} {time.monotonic() - start:4.0f} s {line}", flush=True)
    return None if dead else f"{line} | {len(tests)} tests"


def run(tests, place, limit):
    """Whether one of the tests fails, or they do not end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests], cwd=place,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment(place), start_new_session=True,
    )  # fmt: skip
    try:
        return process.wait(limit) != 0
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGTERM)
        return True
    finally:
        if process.poll() is None:
            process.wait()


if __name__ == "__main__":
    sys.exit(main())
