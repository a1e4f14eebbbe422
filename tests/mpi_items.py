"""Tests marked mpi, once for each number of ranks and each PETSc build: items of their own, with a line each.

In: items marked `mpi`, or `mpi(ranks=(1, 2))` where not all numbers of ranks make sense, `mpi(build="real")` where the
build of PETSc makes no difference, as to readers of text. Out: the same items with the
suffixes [1-rank] (run here), [2-ranks], [3-ranks] and, where there are two builds, [1-rank-complex], [2-ranks-complex].

Quick are [1-rank] and one more, as the name of the test decides: of eight tests about four run on two ranks, three on
two ranks of the complex build, and one on three ranks. Of the cases of one test the first and about every third of the
others have this one more. All else is marked slow. Of tests, and cases of tests, that are marked `costly` [1-rank]
alone is quick.

The items of one suffix run together in one `mpiexec ... pytest`, the inner session, which starts with the first of
them. Its ranks append what happens, a line of JSON each time, to a file; the session outside reads its reports there
while the inner one goes on. A failure on one rank ends the inner session, as does an item that takes longer than
HPCRED_TEST_TIMEOUT seconds, or a crash; the items after it go to a new one. `mpiexec -n 4 python -m pytest -m mpi` runs
the items on the ranks that it was given.

With `--beside` inner sessions on ranks go on beside the items of one rank, where the machine has cores for all their
ranks but AWAIT. On each further core a helper, an inner session without mpiexec, takes items of one rank too: blocks of
them (a file, or a part of a large one), beginning with the last, while this session takes them beginning with the
first, until they meet. Who has taken a block is the target of a link of its number, in a folder for all. If a helper
crashes, the items that it has not begun run here. What is shown, and in which order, does not change.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from functools import cache
from itertools import chain, groupby, pairwise
from pathlib import Path
from zlib import crc32

import pytest
from launch import TWO_BUILDS, make_ranks_patient, mpi_environment

from hpcred.parallel import startup

TIMEOUT = float(os.environ.get("HPCRED_TEST_TIMEOUT", "300"))
INNER = os.environ.get("HPCRED_TEST_SESSION")  # in an inner session: its folder
ITS_SUFFIX = os.environ.get("HPCRED_TEST_SUFFIX")  # and that of its items
OUTSIDE = "outside"
NAME = os.environ.get("HPCRED_TEST_HELPER", OUTSIDE)  # of this session among those that share blocks of items

HERE = "1-rank"
LAUNCHED = {HERE: (1, ""), "1-rank-complex": (1, "complex"), "2-ranks": (2, ""), "3-ranks": (3, ""),
            "2-ranks-complex": (2, "complex")}  # fmt: skip  # suffix: ranks, build
MORE = ["2-ranks"] * 4 + ["2-ranks-complex"] * 3 + ["3-ranks"]
AWAIT = 5  # of the processes of sessions beside each other, those that wait for others at any time
BLOCK = 30  # so many items in a block, or more where they are of one function
CASES = 3  # of so many cases of a test, but for the first, one runs on more ranks
if not (TWO_BUILDS or INNER):
    LAUNCHED = {suffix: job for suffix, job in LAUNCHED.items() if not job[1]}


def world():
    from mpi4py import MPI

    return MPI.COMM_WORLD


def pytest_addoption(parser):
    parser.addoption("--beside", action="store_true", help="run items on several ranks beside those on one")


def pytest_configure():
    if not INNER:
        signal.signal(signal.SIGTERM, lambda *_: pytest.exit("terminated", 143))  # ends the job as well
        make_ranks_patient()


# collection


@cache
def asked():
    """File and name of the functions and classes of the items of this inner session."""
    names = (name.partition("[")[0].split("::") for name in json.loads(Path(INNER, "items.json").read_text()))
    return {(file, first) for file, first, *_ in names}


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(collector, name):
    """Of the thousands of items of its files an inner session makes those of the functions that it was asked for."""
    left_out = INNER and isinstance(collector, pytest.Module) and (collector.nodeid, name) not in asked()
    return [] if left_out else None


@pytest.hookimpl(trylast=True)
def pytest_generate_tests(metafunc):
    if (mark := metafunc.definition.get_closest_marker("mpi")) is None:
        return
    suffixes = [ITS_SUFFIX] if INNER else [f"{world().size}-ranks"] if world().size > 1 else launched(mark)
    metafunc.fixturenames.append("job")
    metafunc.parametrize("job", suffixes)


def launched(mark):
    """The suffixes that a mark asks for."""
    ranks = mark.kwargs.get("ranks", (1, 2, 3))
    builds = ("",) if mark.kwargs.get("build") == "real" else ("", "complex")
    return [name for name, (count, build) in LAUNCHED.items() if count in ranks and build in builds]


def pytest_itemcollected(item):
    """Mark slow what the quick tests do without."""
    if (mark := item.get_closest_marker("mpi")) is None or world().size > 1:
        return
    job, suffixes = item.callspec.params["job"], launched(mark)
    number = crc32(item.nodeid.replace(job, "").encode())
    turn = MORE[number % len(MORE)]
    more = next((name for name in (turn, *MORE, "1-rank-complex") if name in suffixes), HERE)
    later = max(item.callspec.indices.values()) >= len(suffixes)  # no first case: pytest counts the suffixes as well
    alone = item.get_closest_marker("costly") or (later and number % CASES)
    if job not in (HERE, more) or (alone and job != suffixes[0]):
        item.add_marker("slow")


def suffix_of(item):
    """The suffix of an item that is to run in an inner session, else None."""
    # a test on one rank may have a `job` of its own
    suffix = item.callspec.params["job"] if item.get_closest_marker("mpi") else HERE
    return None if suffix == HERE or world().size > 1 else suffix


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items, config):
    if INNER:
        by_name = {item.nodeid: item for item in items}
        items[:] = [by_name[name] for name in json.loads(Path(INNER, "items.json").read_text())]
        private()
        startup.start()  # as the first items do for all behind them, wherever a block begins
    else:
        order = [None, *LAUNCHED]
        items.sort(key=lambda item: order.index(suffix_of(item)))
        waiting.extend(dict.fromkeys(filter(None, map(suffix_of, items))))
    if NAME != OUTSIDE or (not INNER and config.getoption("beside") and world().size == 1):
        blocks.extend(blocks_of([item for item in items if suffix_of(item) is None]))
        shared.update({item.nodeid: number for number, block in enumerate(blocks) for item in block})


# blocks of items that the session outside and its helpers share


blocks = []
shared = {}  # nodeid: the number of its block


def blocks_of(items):
    """The items in runs of one file, of whole functions."""
    for _, in_file in groupby(items, lambda item: item.path):
        block = []
        for _, of_function in groupby(in_file, lambda item: item.nodeid.partition("[")[0]):
            block += of_function
            if len(block) >= BLOCK:
                yield block
                block = []
        if block:
            yield block


@cache
def claims():
    """The folder of the links, which the session outside makes."""
    return Path(os.environ["HPCRED_TEST_CLAIMS"] if INNER else tempfile.mkdtemp(prefix="hpcred-tests-"))


def owner(number):
    """The name of the session that has taken a block: this one where none has."""
    link = claims() / str(number)
    with suppress(FileExistsError):
        os.symlink(NAME, link)
    return os.readlink(link)


def taken():
    """The items of the blocks that this session gets, until it meets the others."""
    numbers, parent = range(len(blocks)), os.getppid()
    for number in numbers if NAME == OUTSIDE else reversed(numbers):
        if owner(number) != NAME or (NAME != OUTSIDE and os.getppid() != parent):  # which was killed
            return
        yield from blocks[number]


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session):
    if not blocks or session.testsfailed or session.config.option.collectonly:
        return None  # pytest's own loop says what could not be collected

    def run(item, following):
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if session.shouldfail:
            raise session.Failed(session.shouldfail)
        if session.shouldstop:
            raise session.Interrupted(session.shouldstop)

    here = set()
    for item, following in pairwise(chain(taken(), [None])):
        here.add(item.nodeid)
        run(item, following)
    if NAME == OUTSIDE:
        for item in session.items:
            if item.nodeid not in here:
                run(item, None)
    return True


# inside: every rank tells what happens


@cache
def private():
    """A communicator of our own: a test in which one rank is left behind must not pair with the barrier here."""
    return world().Dup()


def tell(**event):
    with open(Path(INNER, "events"), "a") as file:  # one write a line, so that ranks do not mix
        file.write(json.dumps(event) + "\n")


def pytest_runtest_logstart(nodeid):
    if INNER and world().rank == 0:
        tell(start=nodeid)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if INNER and (report.failed or world().rank == 0):
        data = item.config.hook.pytest_report_to_serializable(config=item.config, report=report)
        tell(report=data, rank=world().rank)
    if report.failed and world().size > 1:
        # the other ranks may wait for this one for ever
        print(f"\nrank {world().rank}: {item.nodeid}\n{report.longreprtext}", file=sys.stderr, flush=True)
        world().Abort(1)
    return report


def pytest_runtest_logfinish(nodeid):
    if INNER:
        private().Barrier()  # no rank may still fail in an item that is called finished
        if world().rank == 0:
            tell(finish=nodeid)


# outside: the reports of inner sessions


class Session:
    """One inner session for items of one suffix: its process, and what it has told so far."""

    def __init__(self, items, suffix, helper=""):
        self.started, self.finished, self.reports = set(), set(), {}
        self._read = 0
        self._folder = Path(tempfile.mkdtemp(prefix="hpcred-tests-"))
        (self._folder / "items.json").write_text(json.dumps([item.nodeid for item in items]))
        (self._folder / "events").touch()
        self.ranks, build = LAUNCHED[suffix]
        options = ["-q", "--color=no", "-p", "no:cacheprovider", "-o", f"faulthandler_timeout={TIMEOUT:g}"]
        files = dict.fromkeys(str(item.path) for item in items)
        more = {"HPCRED_TEST_SESSION": str(self._folder), "HPCRED_TEST_SUFFIX": suffix,
                **({"HPCRED_SCALAR": build} if build else {})}  # fmt: skip
        more["OMPI_MCA_hwloc_base_binding_policy"] = "none"  # several sessions would take the same cores
        if helper:
            more |= {"HPCRED_TEST_HELPER": helper, "HPCRED_TEST_CLAIMS": str(claims())}
        launcher = [] if helper else ["mpiexec", "-n", str(self.ranks)]
        with open(self._folder / "output", "w") as output:
            self.process = subprocess.Popen(
                [*launcher, sys.executable, "-m", "pytest", *options, *files],
                cwd=items[0].config.rootpath,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=mpi_environment(**more),
            )

    def _listen(self):
        """Take in the lines that are new and complete; returns whether there were any."""
        with open(self._folder / "events", "rb") as file:
            file.seek(self._read)
            new = file.read()
        new = new[: new.rfind(b"\n") + 1]
        self._read += len(new)
        for event in map(json.loads, new.splitlines()):
            self.started.add(event.get("start"))
            self.finished.add(event.get("finish"))
            if "report" in event:
                self.reports.setdefault(event["report"]["nodeid"], []).append(event)
        return bool(new)

    def wait_for(self, nodeid):
        """Returns "finished", or "ended" or "hangs" where that will not come."""
        since = time.monotonic()
        while nodeid not in self.finished:
            ended = self.ended()
            if self._listen():
                since = time.monotonic()
            elif ended:
                return "ended"
            elif time.monotonic() - since > TIMEOUT + 15:  # after faulthandler has shown where
                self._stop()
                return "hangs"
            else:
                time.sleep(0.01)
        return "finished"

    def _stop(self):
        """End a job that has not come to its end by itself: mpiexec ends its ranks."""
        for end in (self.process.terminate, self.process.kill):
            if self.process.poll() is None:
                end()
                with suppress(subprocess.TimeoutExpired):
                    self.process.wait(10)

    def ended(self):
        return self.process.poll() is not None

    def output(self):
        return (self._folder / "output").read_text(errors="replace")[-8000:]

    def close(self, at_its_end=False):
        if at_its_end:
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(30)
        self._stop()
        shutil.rmtree(self._folder)


waiting = []  # suffixes of items whose inner session has not started
sessions = {}  # suffix or name of a helper: its latest inner session
broken = {}  # suffix: what a session told that ended before its first item


def start_session(suffix, items):
    """The inner session for those of the items that have the suffix, started."""
    if suffix in waiting:
        waiting.remove(suffix)
    sessions[suffix] = Session([item for item in items if suffix_of(item) == suffix], suffix)
    return sessions[suffix]


def start_beside(items):
    """Start the inner sessions for which there are cores beside this session and what runs."""
    cores = len(os.sched_getaffinity(0))
    if not sessions:
        for number in range(1, min(cores, len(blocks))):
            sessions[f"helper {number}"] = Session(list(chain(*blocks)), HERE, f"helper {number}")
    busy = 1 + sum(session.ranks for session in sessions.values() if not session.ended())
    for suffix in list(waiting):
        ranks = LAUNCHED[suffix][0]
        if busy + ranks <= cores + AWAIT:
            busy += start_session(suffix, items).ranks


def helper_of(item):
    """The helper that has run an item of one rank, None where it runs here."""
    name = owner(shared[item.nodeid])
    if name == OUTSIDE:
        return None
    sessions[name].wait_for(item.nodeid)
    return name if item.nodeid in sessions[name].started else None


def reports_of(item, suffix):
    """The reports of one item, from an inner session that is started where needed."""
    items = item.session.items
    session = sessions.get(suffix) or start_session(suffix, items)
    how = session.wait_for(item.nodeid)
    if how != "finished" and item.nodeid not in session.started and session.started:
        session.close()
        session = start_session(suffix, items[items.index(item) :])
        how = session.wait_for(item.nodeid)
    if suffix in broken:
        return [failure(item, broken[suffix])]
    told = session.reports.get(item.nodeid, [])
    if how != "finished":
        told = [event for event in told if event["report"]["outcome"] == "failed"][:1]
    if told:
        return [report_from(item, event, suffix) for event in told]
    text = f"the job {how} with exit status {session.process.poll()}; the end of its output:\n{session.output()}"
    if not session.started:
        broken[suffix] = text
    return [failure(item, text)]


def report_from(item, event, suffix):
    report = item.config.hook.pytest_report_from_serializable(config=item.config, data=event["report"])
    if isinstance(report.longrepr, list):  # the place and reason of a skip
        report.longrepr = tuple(report.longrepr)
    if report.failed:
        report.sections.append((suffix, f"on rank {event['rank']}"))
    return report


def failure(item, text):
    return pytest.TestReport(item.nodeid, item.location, dict.fromkeys(item.keywords, 1), "failed", text, "call")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item):
    if INNER:
        return None
    if item.config.getoption("beside"):
        start_beside(item.session.items)
    suffix = helper_of(item) if item.nodeid in shared else suffix_of(item)
    if suffix is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for report in reports_of(item, suffix):
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_sessionfinish(session, exitstatus):
    whole = exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED)
    for inner in sessions.values():
        inner.close(at_its_end=whole and not (session.shouldstop or session.shouldfail))
    sessions.clear()
    if blocks and not INNER:
        shutil.rmtree(claims())
