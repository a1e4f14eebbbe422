"""The fuzzer: seconds and a seed enter, a table of verdicts by kind of case leaves; exit status 1 where one is bad.

Cases run in children, one a core and each one case after the other, which are replaced where a case crashes or hangs
them; every so-manieth runs as a command of its own, on one rank or two. A failing case is kept as a folder with the
command that repeats it.
"""

import argparse
import json
import os
import resource
import select
import subprocess
import sys
import threading
import time
from collections import Counter
from itertools import count
from pathlib import Path

from launch import mpi_environment

from .judge import INTERNAL, LIMIT, VERDICTS, WRONG, run_case, write

APART = 51  # one in so many cases runs as a command of its own, on one rank and two in turn
MEMORY = 16 * 2**30  # bytes of address space of a case


class Worker:
    """A child that makes and judges cases one by one."""

    process = None

    def ask(self, kind, seed, number, ranks):
        """Verdict, reason and note of a case; a crash or a hang of the child is an internal error."""
        if self.process is None:
            command = [sys.executable, "-m", "fuzz", "--worker"]
            # the environment as Python found it: what Open MPI adds to that of this process would confuse an mpiexec
            self.process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=mpi_environment()
            )
        self.process.stdin.write(json.dumps([kind, seed, number, ranks]).encode() + b"\n")
        self.process.stdin.flush()
        if not select.select([self.process.stdout], [], [], 2 * LIMIT)[0]:
            self.close()
            return INTERNAL, f"hung for {2 * LIMIT} s", ""
        answer = self.process.stdout.readline()
        if answer:
            return json.loads(answer)
        status = self.process.wait()
        self.process = None
        return INTERNAL, f"the process ended with status {status}", ""

    def close(self):
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None


def work():
    """Answer the lines of stdin; whatever else prints goes to stderr."""
    from .generators import make

    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    for line in sys.stdin:
        kind, seed, number, ranks = json.loads(line)
        case = make(kind, seed, number)
        verdict, why = run_case(case, ranks)
        print(json.dumps([verdict, why, case.note]), file=answers, flush=True)


class Judging:
    """What all children find, by kind; the cases are numbered through."""

    def __init__(self, kinds, seed, end, folder):
        self.kinds, self.seed, self.end, self.folder = kinds, seed, end, folder
        self.counts, self.numbers, self.lock = {kind: Counter() for kind in kinds}, count(), threading.Lock()

    def work(self):
        """Ask a child for one case after the other until the end."""
        worker = Worker()
        try:
            while time.monotonic() < self.end:
                with self.lock:
                    number = next(self.numbers)
                kind, place = self.kinds[number % len(self.kinds)], number // len(self.kinds)
                ranks = 1 + number // APART % 2 if number % APART == APART - 1 else 0
                if kind == "sweep.toml":  # which starts its own ranks
                    ranks = min(ranks, 1)
                verdict, why, note = worker.ask(kind, self.seed, place, ranks)
                with self.lock:
                    self.take(kind, place, ranks, verdict, why, note)
        finally:
            worker.close()

    def take(self, kind, place, ranks, verdict, why, note):
        """Count a verdict; keep a case that is bad."""
        self.counts[kind][verdict] += 1
        if verdict in (INTERNAL, WRONG):
            on = f", {ranks} ranks" if ranks else ""
            print(f"{kind}, case {place}{on}: {verdict}: {note}\n    {why.strip()[:300]}", flush=True)
            keep(self.folder, kind, self.seed, place, f"{verdict}{on}: {note}\n{why}")


def main():
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600)
    parser.add_argument("--seed", type=int, default=None, help="of all cases; by default the time")
    parser.add_argument("--kinds", default="", help="only kinds that begin so, separated by commas")
    parser.add_argument("--case", type=int, help="only this case of the seed, of one kind; printed")
    parser.add_argument("--keep", default="fuzz-failures", help="folder for failing cases")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker:
        return work()
    from .generators import KINDS, make

    seed = int(time.time()) if given.seed is None else given.seed
    kinds = [kind for kind in KINDS if kind.startswith(tuple(given.kinds.split(",")))]
    if given.case is not None:
        case = make(kinds[0], seed, given.case)
        print(case.note, *run_case(case), sep="\n")
        keep(Path(given.keep), kinds[0], seed, given.case, "")
        return 0
    print(f"seed {seed}, {given.seconds:g} s, {len(kinds)} kinds of cases", flush=True)
    judging = Judging(kinds, seed, time.monotonic() + given.seconds, Path(given.keep))
    threads = [threading.Thread(target=judging.work) for _ in os.sched_getaffinity(0)]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    finally:
        judging.end = 0
    total = sum(judging.counts.values(), Counter())
    show({**judging.counts, "all": total})
    bad = total[INTERNAL] + total[WRONG]
    print(f"{total.total()} cases, seed {seed}; {bad} bad" + (f", kept in {given.keep}" if bad else ""))
    return int(bad > 0)


def keep(folder, kind, seed, number, why):
    """The files of a case, and how it is repeated."""
    from .generators import make

    target = folder / f"{kind.replace(' ', '-').replace('/', '-')}-{seed}-{number}"
    target.mkdir(parents=True, exist_ok=True)
    try:
        case = make(kind, seed, number)
    except Exception as error:
        (target / "case.txt").write_text(f"it cannot be made: {error!r}")
        return
    write(case, target)
    (target / "case.txt").write_text(
        f"{case.note}\n{why}\nhere: hpcred {' '.join(case.command)}\n"
        f"again: PYTHONPATH=tests python -m fuzz --seed {seed} --kinds '{kind}' --case {number}\n"
    )


def show(counts):
    """The table."""
    print(f"{'':<24}" + "".join(f"{verdict:>16}" for verdict in VERDICTS))
    for kind, found in counts.items():
        print(f"{kind:<24}" + "".join(f"{found[verdict]:>16}" for verdict in VERDICTS))


if __name__ == "__main__":
    sys.exit(main())
