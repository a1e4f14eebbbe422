"""Processes that tests start as forks of the test process, which has loaded what they load.

To start Python and to load hpcred, PETSc and matplotlib takes a process most of its time. A fork has a pid, pipes, a
working folder and an exit status of its own, as any process has. The program that looks at HDF5 files is forked in all
tests, commands of hpcred on one rank in those with the fixture `forked_commands`; what happens before
`hpcred.cli.main.run` is looked at in others.
"""

import os
import shlex
import stat
import subprocess
import sys
import traceback
from contextlib import suppress

from hpcred.cli.main import run
from hpcred.files import hdf5_probe
from hpcred.files.opened_hdf5 import PROBE

SHELL = ["bash", "-o", "pipefail", "-c"]  # as docs/tutorial/run.py starts a line of a page
NO_WORDS = set("|&;<>()$`\\\"'*?[]#~=%\n")  # a line with one of these is for a shell


def function_of(command, commands):
    """What a fork does instead of the command, None where the command has to be started."""
    if isinstance(command, str):
        return None
    words = list(map(str, command))
    if words[:2] == [sys.executable, str(PROBE)]:
        return lambda: hdf5_probe.main(*words[2:])
    if commands and words[:-1] == SHELL and words[-1].startswith("hpcred ") and not NO_WORDS & set(words[-1]):
        return lambda: run(shlex.split(words[-1])[1:])
    if commands and words[0] == sys.executable and "hpcred" in words and words[words.index("hpcred") - 1] == "-m":
        return None if "--scalar" in words else lambda: run(words[words.index("hpcred") + 1 :])
    return None


def of_this_build(environment):
    """Whether a process with this environment takes the build of PETSc that this one has."""
    return environment.get("HPCRED_SCALAR", "") == os.environ.get("HPCRED_SCALAR", "")


def end_with(function, environment):
    """Run the function in this new process, whose standard streams are in place, and end with what it returns."""
    status = 1
    try:
        for number in map(int, os.listdir("/proc/self/fd")):  # also the pipe on which Popen waits for an exec
            with suppress(OSError):
                if number > 2 and stat.S_ISFIFO(os.fstat(number).st_mode):
                    os.close(number)
        os.environ.clear()
        os.environ.update(environment)
        sys.stdout = sys.__stdout__ = open(1, "w", closefd=False)  # noqa: SIM115
        sys.stderr = sys.__stderr__ = open(2, "w", buffering=1, closefd=False)  # noqa: SIM115
        status = function() or 0
        sys.stdout.flush()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


class Forked(subprocess.Popen):
    """A Popen that forks where it can: its child comes to `preexec_fn` with all streams in place, and stays there."""

    commands = False  # whether those of hpcred are forked as well

    def __init__(self, args, *more, env=None, **how):
        environment = dict(os.environ if env is None else env)
        if (function := function_of(args, self.commands and of_this_build(environment))) is not None:
            how["preexec_fn"] = lambda: end_with(function, environment)
        super().__init__(args, *more, env=env, **how)
