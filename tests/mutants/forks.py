"""Run functions in forks of this process, which has loaded what is slow to load: neither MPI, nor hpcred."""

import os
import signal
import sys
import time
import traceback
from contextlib import suppress


def run_forked(tasks, jobs):
    """Run each (key, seconds, function) of the tasks, and yield (key, exit status, seconds) as they end.

    A function returns an exit status; what does not end in its time is killed, with all that it started.
    """
    tasks, running = iter(tasks), {}
    try:
        while True:
            while len(running) < jobs and (task := next(tasks, None)):
                key, limit, function = task
                running[_fork(function, limit)] = key, time.monotonic()
            if not running:
                return
            for number in list(running):
                ended, status = os.waitpid(number, os.WNOHANG)
                if ended:
                    _end(number)
                    key, since = running.pop(number)
                    yield key, status, time.monotonic() - since
            time.sleep(0.02)
    finally:
        for number in running:
            _end(number)


def _end(number):
    with suppress(ProcessLookupError):
        os.killpg(number, signal.SIGKILL)


def _fork(function, limit):
    sys.stdout.flush()
    if number := os.fork():
        return number
    status = 1
    try:
        os.setsid()
        signal.alarm(max(int(limit), 1))  # kills
        null = os.open(os.devnull, os.O_RDWR)
        for standard in range(3):
            os.dup2(null, standard)
        status = function()
    except BaseException:
        traceback.print_exc()
    os._exit(status)
