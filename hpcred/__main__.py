"""`python -m hpcred` and the console script."""

import os
import sys

from .parallel import signals


def main():
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


if __name__ == "__main__":
    main()
