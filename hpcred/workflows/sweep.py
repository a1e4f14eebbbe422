"""Run the jobs of a sweep file, here or as an array of a batch system, to one result each."""

from __future__ import annotations

import os
import shlex
import shutil
import time
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from mpi4py import MPI

from ..files.checksums import content_of
from ..files.folders import folder_for
from ..files.hdf5 import atomic_output, check_writable, reading
from ..files.locks import Taken, lock, locks_given_back, unlock
from ..files.outputs import check_kept
from ..files.result_file import FORMAT, VERSION
from ..parallel.declared import spelled
from ..parallel.digest import name_of_plain
from ..parallel.failures import InputError
from ..parallel.progress import MINUTE, Progress, in_time
from ..parallel.stopping import Stopped
from ..settings.job_file import TERMS_OF_MODEL, plain
from ..settings.sweep_file import Sweep, SweepRun, read_sweep
from .children import HPCRED, Child, check_log, run_all
from .shared_basis import job_of_ranges

SELF = MPI.COMM_SELF
BETWEEN = 0.5  # seconds between two looks at a run of another sweep


@dataclass(frozen=True)
class State:
    """What there is of a run: "finished", "not reached" (its tolerance), "missing", "of another job" or "damaged";
    the file and its record as plain types, where there is one."""

    word: str
    file: Path | None = None
    record: dict | None = None

    @property
    def done(self) -> bool:
        return self.word in ("finished", "not reached")


def states_of(sweep: Sweep) -> dict[str, State]:
    """Return the State of each run, by name. A result counts as that of a run if its record says the same job and the
    files that it was made from have the same contents; times of files do not matter."""
    content = _contents()
    return {run.name: _state(run, content) for run in sweep.runs}


def _contents():
    """Return a function that tells the contents of files by name, read once; None if missing."""
    return cache(lambda name: content_of(name, SELF) if os.path.isfile(name) else None)


def _state(run, content):
    states = [State("missing")]
    for path, word in ((run.output, "finished"), (run.beside(".not-reached.h5"), "not reached")):
        if not path.is_file():
            continue
        try:
            with reading(path, FORMAT, VERSION) as file:
                record = file.table("record")
        except (InputError, OSError):
            states.append(State("damaged", path))
            continue
        same = run.same_job(record.get("job"), record.get("contents"), content)
        states.append(State(word if same else "of another job", path, record))
    return next((state for state in states if state.done), states[-1])


@spelled
@locks_given_back()
def run_sweep(
    path, *, parallel: int | None = None, index: int | None = None, of: int | None = None, store=None,
    dry_run: bool = False, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Run the jobs of a sweep file on this machine.

    Finished runs are skipped, failed ones do not keep the others from running. SIGINT and SIGTERM end all runs; SIGUSR1
    asks them to end after the current point.

    Parameters
    ----------
    path : str or PathLike
        The sweep file.
    parallel : int, optional
        Runs at a time; by default as its [launch] says.
    index, of : int, optional
        Only that share of the runs, as a task of an array does.
    store : str or PathLike, optional
        A folder of expansion points that the runs share.
    dry_run : bool
        Only say what there is.

    Returns
    -------
    dict
        folder, `runs` (rows with name, status, size, seconds, and the sentence of one that failed), how many finished,
        were skipped and failed, and the numbers of factorisations made and saved.

    Raises
    ------
    InputError
        For a sweep file that does not fit.
    Interrupted, Stopped
        After a signal.
    """
    refuse_ranks(comm, "sweep")
    sweep = read_sweep(path, store)
    chosen = share(sweep, index, of)
    at_once = parallel if parallel is not None else sweep.launch.parallel
    if at_once < 1:
        raise InputError(f"--parallel: found {at_once}, expected at least 1")
    progress = progress or Progress(SELF, show=False)
    before = states_of(sweep)
    skipped = {run.name for run in chosen if before[run.name].done}
    if dry_run:
        return _report(sweep, chosen, before, skipped, {})
    _launcher(sweep)  # refused early
    left = [run for run in chosen if run.name not in skipped]
    with folder_of(sweep) if left else nullcontext():  # what is finished may be read-only
        return _run(sweep, chosen, left, before, skipped, at_once, progress)


def _run(sweep, chosen, left, before, skipped, at_once, progress) -> dict:
    """Run what is `left` of the `chosen` runs; see run_sweep."""
    # what stands in the way is refused before a run begins
    for run in left:
        for path in (run.output, run.beside(".not-reached.h5")):
            check_kept(path)
        check_log(run.beside(".log"))
    for run in left:
        if before[run.name].file is not None:
            progress.say(f"{before[run.name].file}: {before[run.name].word}, made again")
    # bases over ranges of parameters that several runs share
    shared, content = _shared_bases(sweep), _contents()
    bases = {basis.name: basis for run in left if (basis := shared.get(run.name))}
    known = {name: _state(basis, content) for name, basis in bases.items()}
    wanted = [basis for name, basis in bases.items() if not known[name].done]
    _, by_others = _reduced(sweep, wanted, {}, at_once, progress)
    known |= {basis.name: _state(basis, content) for basis in wanted}
    mine = [known[basis.name] for basis in wanted if basis.name not in by_others]
    # the runs, with such a basis where it has reached its tolerance
    proven = {run.name: known[shared[run.name].name] for run in left if run.name in shared}
    from_bases = {name: ["--basis", str(state.file.absolute())] for name, state in proven.items()
             if state.word == "finished"}  # fmt: skip
    children, by_others = _reduced(sweep, left, from_bases, at_once, progress)
    skipped |= by_others
    # the responses of the full model that they are compared with
    after = states_of(sweep)
    ended = {child.name: child for child in children}
    if not any(child.met_full_disk for child in children):
        ended |= _full_responses(sweep, chosen, after, at_once, progress)
    return _report(sweep, chosen, after, skipped, ended, mine)


def _reduced(sweep, runs, bases, at_once, progress) -> tuple[list[Child], set[str]]:
    """Run `hpcred reduce` for each of these runs, with options by name, `bases`; returns the children, and the
    names of those that another sweep in this folder has done meanwhile. Raises Stopped."""
    children = [
        _child(sweep, run.name, "reduce", str(run.beside(".toml").absolute()), *bases.get(run.name, ()),
               log=run.beside(".log")) for run in runs
    ]  # fmt: skip
    by_name, content, skipped = {run.name: run for run in runs}, _contents(), set()

    def done(child):
        if _state(by_name[child.name], content).done:
            skipped.add(child.name)
        return child.name in skipped

    def write_job(child):
        run = by_name[child.name]
        with atomic_output(run.beside(".toml"), SELF) as temporary:
            temporary.write_text(f"# hpcred sweep: one job of it\n{run.job_text()}", encoding="utf-8")

    others = _beside_others(progress, done, write_job)
    run_all(children, at_once, sweep.launch.environment, **others, **_told(progress, len(children)))
    if any(child.status == Stopped.exit_status for child in children):
        raise Stopped("a run was stopped as asked; the same command goes on with what is left")
    return children, skipped


def _shared_bases(sweep) -> dict[str, SweepRun]:
    """Return the reduction over the ranges of parameters that a run shares with others, by the name of the run; none
    for runs that differ from all others in more than the values `at`."""
    content, users = cache(lambda name: content_of(name, SELF)), {}
    for run in sweep.runs:
        if run.job.parameter and run.job.search is not None and any(key.split(".")[0] == "at" for key in run.values):
            with suppress(InputError):  # a job that needs its values
                basis = SweepRun("ranges", {}, {}, job_of_ranges(run.job, sweep.folder / "ranges.h5"))
                name = f"ranges-{name_of_plain(basis.known_by(content), 12)}"
                users.setdefault(name, (basis, []))[1].append(run.name)
    return {
        run: SweepRun(name, {}, {}, replace(basis.job, output=str(sweep.folder / f"{name}.h5")))
        for name, (basis, runs) in users.items() if len(runs) > 1 for run in runs
    }  # fmt: skip


def refuse_ranks(comm, command):
    """Raise InputError where there is more than one rank."""
    if (comm or MPI.COMM_WORLD).size > 1:
        raise InputError(f"{command}: run it without mpiexec; [launch] of the sweep says on how many ranks each run is")


def share(sweep, index, of) -> list[SweepRun]:
    """Return the runs of a task of an array: every `of`-th from the `index`-th on, which counts from 1. Raises
    InputError."""
    if index is None and of is None:
        return list(sweep.runs)
    if index is None or of is None:
        raise InputError("--index: belongs together with --of, such as --index 3 --of 8")
    if of < 1 or not 1 <= index <= of:
        raise InputError(f"--index: found {index} of {of}, expected 1 to the number of shares")
    return list(sweep.runs[index - 1 :: of])


@contextmanager
def folder_of(sweep):
    """The folder of the results, which is made, and goes again where the block fails and nothing is in it. Raises
    InputError."""
    with folder_for(sweep.folder, SELF, "output "):
        check_writable(sweep.folder / "x.h5", SELF)
        yield


def _launcher(sweep) -> list[str]:
    """Return the words of the launcher. Raises InputError where there is no such command."""
    text = sweep.launch.launcher.replace("{ranks}", str(sweep.launch.ranks))
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise InputError(f"launch.launcher: found '{text}', which no shell reads ({error})") from error
    if words and shutil.which(words[0]) is None:
        raise InputError(f"launch.launcher: found '{text}', but there is no command {words[0]} here")
    return words


def _child(sweep, name, *arguments, log):
    """Return a command of hpcred on the ranks of the sweep."""
    return Child(name, [*_launcher(sweep), *HPCRED, *arguments], log)


def _beside_others(progress, done, begin=lambda child: None):
    """Keep this sweep from computing a run of another sweep in its folder at the same time: a run has the lock of its
    log from before it begins to its end, and those of others come last. `done(child)`: whether another has finished it
    meanwhile; `begin(child)`: what is to be done before it."""
    # runs that another sweep computes, and when each is looked at again
    later = {}

    def waits(child, who):
        if child.name not in later:
            progress.say(f"{child.name}: is being computed by another sweep ({who}), which is waited for")
        later[child.name] = time.monotonic() + BETWEEN

    def wanted(child):
        if time.monotonic() < later.get(child.name, 0.0):
            return None
        try:
            lock(child.log)
        except Taken as taken:
            return waits(child, taken.holder)
        if done(child):
            unlock(child.log)
            return False
        begin(child)
        return True

    def again(child):
        unlock(child.log)
        if child.status != Taken.exit_status:
            return False
        if done(child):
            child.status = 0
            return False
        waits(child, "another process")
        return True

    return {"wanted": wanted, "again": again}


def _told(progress, total):
    """Return functions that report the progress: when a run has ended, and once a minute."""
    begun = said = time.monotonic()
    count = 0

    def left():
        if not count or count == total:
            return ""
        return f", about {in_time((time.monotonic() - begun) / count * (total - count))} left"

    def ended(child):
        nonlocal count, said
        count, said = count + 1, time.monotonic()
        word = "done" if child.status == 0 else f"ended with {child.status}"
        why = f": {child.last_line}" if child.status else ""
        progress.say(f"{child.name}: {word} in {in_time(child.seconds)}; {count} of {total}{left()}{why}")
        if child.met_full_disk:  # as it is for those that come
            progress.say(f"the disk is full, so that no other run is begun; {total - count} have not ended")
            return True
        return False

    def waiting(running):
        nonlocal said
        if time.monotonic() - said >= MINUTE:
            said = time.monotonic()
            for child in running:
                progress.say(f"{child.name}: {child.last_line}")
            progress.say(f"{count} of {total} runs ended, {len(running)} under way{left()}")

    return {"ended": ended, "waiting": waiting}


def _report(sweep, chosen, states, skipped, ended, bases=()):
    """`bases`: states of reductions over ranges that were made for the runs."""
    rows, records = [], [state.record for state in bases if state.done]
    for run in chosen:
        state, child = states[run.name], ended.get(run.name)
        record = state.record or {}
        status, sentence = state.word, ""
        bad = child is not None and child.status not in (0, None)
        if bad and state.word != "finished":  # else another sweep made it
            status = "not reached" if state.word == "not reached" else "failed"
            sentence = child.last_line.removeprefix("hpcred: ") or f"ended with status {child.status}"
        if state.word == "not reached":
            sentence = f"tolerance not reached; see {state.file}"
        if state.done and run.name not in skipped:
            records.append(record)
        rows.append({
            "run": run.name, "status": "skipped" if status == "finished" and run.name in skipped else status,
            "sentence": sentence, **run.labels, "output": str(state.file or run.output),
        })  # fmt: skip
    for name, child in ended.items():
        if name not in states and child.status not in (0, None):
            rows.append({"run": name, "status": "failed", "sentence": child.last_line.removeprefix("hpcred: ")})
    return {
        "folder": str(sweep.folder),
        "runs": rows,
        "finished": sum(row["status"] == "finished" for row in rows),
        "skipped": sum(row["status"] == "skipped" for row in rows),
        "failed": [{"run": row["run"], "sentence": row["sentence"]} for row in rows
                   if row["status"] in ("failed", "not reached")],
        "factorisations": sum(len(record.get("factorisations", ())) for record in records),
        "factorisations_saved": sum(record.get("factorisations_saved", 0) for record in records),
    }  # fmt: skip


# the full response, once for all runs that share it


def response_of(sweep, run, content) -> Path:
    """Return the file of the full response that a run is compared with; its name stands for all that it depends on."""
    job, asked = plain(run.job), sweep.evaluate
    full = os.path.abspath(asked.full or run.job.model)
    settings = [job[key] for key in ("inputs", "outputs", "interface", "frame", "damping")]
    settings += [job[key] for key in TERMS_OF_MODEL if job[key]]
    grid = asked.frequencies or [asked.band or run.job.band, asked.points]
    inputs = [content(full), [content(name) for name in run.job.files[1:]], *settings, grid]
    return sweep.folder / f"full-{name_of_plain(inputs, 12)}.h5"


def responses_of(sweep) -> dict[str, Path]:
    """Return the file of the full response by name of the run; empty where nothing is compared."""
    if sweep.evaluate is None:
        return {}
    content = cache(lambda name: content_of(name, SELF))
    return {run.name: response_of(sweep, run, content) for run in sweep.runs}


def _full_responses(sweep, chosen, states, at_once, progress):
    """Compute the full responses that are not there yet; of several shares the one with the first run that needs it."""
    wanted, children, outputs = {}, [], {}
    names = {run.name for run in chosen}
    for name, file in responses_of(sweep).items():
        wanted.setdefault(file, []).append(name)
    for file, users in wanted.items():
        result = next((states[name].file for name in users if states[name].done), None)
        if file.exists() or result is None or users[0] not in names:
            continue
        run = next(run for run in sweep.runs if run.name == users[0])
        asked = sweep.evaluate
        if asked.frequencies:
            grid = ["--frequencies", ",".join(map(repr, asked.frequencies))]
        else:
            band = asked.band or run.job.band
            grid = ["--band", f"{band[0]!r},{band[1]!r}", "--points", str(asked.points)]
        full = os.path.abspath(asked.full or run.job.model)
        arguments = [str(result.absolute()), "--full", full, "-o", str(file.absolute()), *grid]
        outputs[file.stem] = file
        children.append(_child(sweep, file.stem, "evaluate", *arguments, log=file.with_suffix(".log")))
    others = _beside_others(progress, lambda child: outputs[child.name].exists())
    run_all(children, at_once, sweep.launch.environment, **others, **_told(progress, len(children)))
    return {child.name: child for child in children}
