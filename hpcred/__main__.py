"""`python -m hpcred` and the console script."""

import os
import sys

from .parallel import signals


def main():
    _open_what_is_closed()
    try:
        signals.hear()
        # a process that no mpiexec started: Open MPI need not start a daemon, by which others could join it
        os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")
        from .cli import run

        status = run(sys.argv[1:])
    except (KeyboardInterrupt, Exception) as error:  # while modules are loaded
        signals.end(error)
    signals.no_longer()
    sys.exit(status)


def _open_what_is_closed():
    """Have the standard streams that the caller closed lead nowhere.

    Else the next files to be opened, such as results, take their numbers, and what libraries print goes into them.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            stream = open(number, "w" if number else "r", encoding="utf-8", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)
    sys.stdout.reconfigure(errors="backslashreplace")  # for names that the locale has no letters for


if __name__ == "__main__":
    main()
