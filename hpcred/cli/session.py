"""Run a command line on all ranks: global options, the Progress of the command, and where output goes.

Commands print through this module what --quiet and --json send to other places.
"""

from __future__ import annotations

import os
import sys
from contextlib import redirect_stdout

from ..files.locks import unlock_all
from ..files.outputs import JSON, check_outputs, keep_files
from ..parallel import startup
from ..parallel.failures import InputError, fail
from ..parallel.messages import LOGGER, printable
from ..parallel.progress import Progress
from ..report import tables
from ..report.profile import show_profile, start_profile
from ..report.tables import say


class Session:
    """The values of the global options, the Progress of the command, and the stream for --json -."""

    profile = quiet = verbose = keep = False
    progress: Progress
    out = sys.stdout


MOST_LOADS = 20  # that are listed
FLAGS = ("--traceback", "--profile", "--quiet", "--verbose", "--keep")  # global options, anywhere on the line


def _refuse_blank(arguments):
    """Raise InputError for an empty text, which a variable of a shell without value leaves."""
    for before, word in zip(["", *arguments], arguments, strict=False):
        name, equals, value = word.partition("=")
        if not word.strip() or (name.startswith("--") and equals and not value.strip()):
            where = name if word.strip() else before if before.startswith("-") else f"the word behind '{before}'"
            raise InputError(f"{where}: found an empty text, expected a value; leave it out where there is none")


def run(arguments: list[str], call) -> int:
    """Run one command line on all ranks and return the exit status, which `call(arguments)` may give."""
    LOGGER.propagate = False  # what a plug-in makes of the root logger changes nothing on the terminal
    try:
        comm = startup.start_mpi()
        arguments = list(arguments)
        cut = arguments.index("--") if "--" in arguments else len(arguments)
        arguments, petsc_args = arguments[:cut], arguments[cut + 1 :]
        startup.insist(_take(arguments, "--scalar"), petsc_args)
        for flag in FLAGS:
            setattr(Session, flag[2:], flag in arguments)
            arguments = [argument for argument in arguments if argument != flag]
        if (file := _take(arguments, "--json")) is not None:  # also before the command
            arguments += ["--json", file]
        _refuse_blank(arguments)
        keep_files(Session.keep)
        if Session.traceback:
            os.environ["HPCRED_TRACEBACK"] = "1"
        if Session.quiet and Session.verbose:
            raise InputError("--quiet: cannot be combined with --verbose")
        show = False if Session.quiet else Session.verbose or None
        Session.progress = Progress(comm, show=show, bars=True)
        with redirect_stdout(_stdout(comm, arguments)):
            try:
                status = call(arguments)
            finally:
                Session.progress.close()
            if Session.profile and startup.started():
                show_profile(comm, Session.progress)
            warn(_unused_options(petsc_args))
            sys.stdout.flush()
        return status if isinstance(status, int) else 0
    except BaseException as error:
        return fail(error)
    finally:
        LOGGER.propagate = True
        unlock_all()


def _stdout(comm, arguments):
    """Where tables go: nowhere but on rank 0, and to stderr where JSON is printed."""
    printed = "--json=-" in arguments or ("--json", "-") in zip(arguments, arguments[1:], strict=False)
    Session.out = sys.stdout
    if printed and sys.stdout is sys.__stdout__:
        sys.stdout.flush()
        Session.out = os.fdopen(os.dup(1), "w", errors="backslashreplace")
        os.dup2(2, 1)  # what PETSc and MUMPS print
    if comm.rank:
        Session.out = open(os.devnull, "w", errors="replace")  # noqa: SIM115
    if comm.rank or Session.quiet:
        return open(os.devnull, "w", errors="replace")  # noqa: SIM115
    return sys.stderr if printed else sys.stdout


def _unused_options(petsc_args):
    """A sentence on PETSc options that nothing asked for."""
    left = startup.unused_options() if startup.started() else [word for word in petsc_args if word.startswith("-")]
    if not left:
        return []
    return [f"nothing used the PETSc option{'s' * (len(left) > 1)} {', '.join(left)}; check the names and prefixes"]


def checked(path: str | None) -> str | None:
    """The name of a file for JSON, refused early where it cannot be written."""
    if path not in (None, "-"):
        check_outputs({path: JSON}, Session.progress.comm, progress=Session.progress)
    return path


def write_json(path, data):
    """Write the numbers of a command, or print them for '-'."""
    if path == "-":
        print(tables.as_json(data), file=Session.out, flush=True)
    else:
        tables.write_json(path, data)


def _take(arguments, option):
    """Remove an option with a value from the arguments, wherever it stands."""
    for i, word in enumerate(arguments):
        if word == option and i + 1 < len(arguments):
            del arguments[i]
            return arguments.pop(i)
        if word.startswith(option + "="):
            return arguments.pop(i).partition("=")[2]
    return None


def progress() -> Progress:
    """The Progress of the command."""
    if Session.profile:
        start_profile()
    return Session.progress


def warn(sentences):
    """Print warnings, also with --quiet, but for those that were printed while the run went on."""
    if Session.progress.comm.rank == 0:
        told = () if Session.quiet else tuple(Session.progress.warned)
        for sentence in sentences:
            if not sentence.startswith(told):  # at the end its largest value may follow
                say(f"warning: {printable(sentence)}", file=sys.stderr if Session.quiet else sys.stdout)


def list_all(word, entries):
    """Print each item behind a word."""
    for entry in entries:
        say(f"{word}: {entry}")


def written(*names):
    """Print the names of files that were asked for and are written now; None was not."""
    for name in names:
        if name is not None:
            say(f"written to {printable(str(name))}")


def show_loads(rows):
    """Print the sums of loads, of very many the first ones."""
    tables.show_table("Loads, and their sums; moments about the origin", rows[:MOST_LOADS])
    if len(rows) > MOST_LOADS:
        say(f"and {len(rows) - MOST_LOADS} more loads; --json - lists all")


def verdict(sentence, good):
    """Print the verdict; failures even with --quiet."""
    if not (Session.quiet and good) and Session.progress.comm.rank == 0:
        say(sentence, file=sys.stderr if Session.quiet else sys.stdout)
