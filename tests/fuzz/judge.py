"""A case enters, is run in this process or in one of its own, and leaves with its verdict."""

import contextlib
import functools
import os
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer
from launch import mpi_environment

RIGHT, REFUSED, INTERNAL, WRONG = VERDICTS = "right", "refused", "internal error", "wrong"
LIMIT = 180  # seconds of a process of its own, of which a busy machine may take most for its start


@dataclass
class Case:
    """One run: `files` by name, the `command` in their folder, and what it should come to.

    `expected`: arrays by name that `read` finds in the folder afterwards, or None where the command must refuse; of
    more that `read` finds nothing is asked. `good`: it must not refuse. `renewed`: the file that the command may write
    again. `note`: what was done.
    """

    note: str
    files: dict[str, bytes]
    command: list[str]
    expected: dict[str, np.ndarray] | None
    read: Callable[[Path], dict[str, np.ndarray]]
    good: bool = False
    renewed: str = ""


def run_case(case: Case, ranks: int = 0) -> tuple[str, str]:
    """The verdict of a case and the reason for it; `ranks` = 0: in this process."""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as name:
        folder = Path(name)
        write(case, folder)
        before = snapshot(folder)
        with inside(folder):
            status, text = _in_own_process(case.command, ranks) if ranks else _in_this_process(case.command)
        return _verdict(case, folder, before, status, text, ranks)


def write(case: Case, folder: Path):
    """The files of a case into a folder."""
    for name, content in case.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def snapshot(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def same(found: dict, expected: dict, ranks: int = 0) -> str:
    """The name of an array that differs by more than round-off, or nothing.

    On one rank each entry is that of the same sums. On several, modes are those of another run of the eigensolver, to
    its tolerance: what is zero by symmetry is a small part of the largest entry.
    """
    off, share = (1e-8, 1.0) if ranks > 1 else (1e-12, 0.01)
    for name, wanted in expected.items():
        other, wanted = np.asarray(found.get(name, np.nan)), np.asarray(wanted)
        if other.shape != wanted.shape:
            return f"{name}: shape {other.shape} for {wanted.shape}"
        if wanted.dtype.kind in "fc":
            if ranks > 1:  # a shape whose extremes are equal takes its sign from round-off
                other, wanted = np.abs(other), np.abs(wanted)
            size = max(np.abs(wanted).max(initial=0.0), 1e-5 * (ranks > 1))
            near = np.abs(other - wanted) <= off * (np.abs(wanted) + share * size)
            if not near.all():
                place = tuple(int(k) for k in np.argwhere(~near)[0])
                return f"{name}{list(place)}: {other[place]} for {wanted[place]}"
        elif not (other == wanted).all():
            return name
    return ""


def _verdict(case, folder, before, status, text, ranks):
    after = snapshot(folder)
    changed = [name for name, content in before.items() if after.get(name) != content and name != case.renewed]
    if changed:
        return WRONG, f"{changed[0]}, which is read, was changed; {text}"
    lines = [line for line in text.splitlines() if line.strip()]
    if status == 0:
        if [line for line in lines if not line.startswith("warning: ")]:
            return INTERNAL, text
        if case.expected is None:
            return WRONG, "taken, where a second reading finds no sense"
        try:
            difference = same(case.read(folder), case.expected, ranks)
        except Exception as error:
            difference = f"what was written cannot be read: {error!r}"
        return (WRONG, difference) if difference else (RIGHT, "")
    told = [line for line in lines if not line.startswith("warning: ")]
    if status == 1 and len(told) == 1 and told[0].startswith("NOT REACHED: "):
        return RIGHT, ""  # as limits may have it; the result says the same
    if status not in (1, 2) or len(told) != 1 or not told[0].startswith("hpcred: error: "):
        return INTERNAL, f"exit {status}: {text}"
    if after.keys() - before.keys():
        return INTERNAL, f"left behind {sorted(after.keys() - before.keys())[0]}; {text}"
    if case.good:
        return WRONG, f"a good file is refused: {told[0]}"
    return REFUSED, told[0]


def run_good(command):
    """A command that must succeed, in the working folder, for what a damaged one is compared with."""
    status, text = _in_this_process(command)
    assert status == 0, (command, text)


def _in_this_process(command):
    """Exit status and what was printed to stderr, by Python and by libraries."""
    from hpcred.cli.main import run

    if not hasattr(typer.main.get_command, "cache_info"):  # the parser of all commands is made once, not in each case
        typer.main.get_command = functools.cache(typer.main.get_command)
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        kept = os.dup(1), os.dup(2)
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        try:
            with open(1, "w", closefd=False) as stdout, open(2, "w", closefd=False) as stderr, \
                    contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):  # fmt: skip
                try:
                    status = run(["--quiet", *command])
                except BaseException:
                    status = None
                    traceback.print_exc()
        finally:
            for fd, copy in enumerate(kept, 1):
                os.dup2(copy, fd)
                os.close(copy)
        err.seek(0)
        return status, err.read().decode("utf-8", "replace")


def _in_own_process(command, ranks, again=False):
    launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
    line = [*launcher, sys.executable, "-m", "hpcred", "--quiet", *command]
    try:
        done = subprocess.run(
            line, stdin=subprocess.DEVNULL, capture_output=True, timeout=LIMIT, env=mpi_environment()
        )
    except subprocess.TimeoutExpired:
        return None, f"hung for {LIMIT} s"
    text = done.stderr.decode("utf-8", "replace")
    if "error (rank " in text and not again:  # as where the system does not let the other rank run for seconds
        return _in_own_process(command, ranks, again=True)
    if ranks > 1:  # what mpiexec says of ranks that end with a status
        text = "\n".join(line for line in text.split("-" * 20)[0].splitlines() if line.strip("-"))
    return done.returncode, text


@contextlib.contextmanager
def inside(folder):
    """The folder as working folder."""
    before = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
