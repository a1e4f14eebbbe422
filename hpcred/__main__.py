"""`python -m hpcred` and the console script."""

import sys

from .parallel import signals


def main():
    signals.hear()
    try:
        from .cli import run

        status = run(sys.argv[1:])
    except (KeyboardInterrupt, Exception) as error:  # while modules are loaded
        signals.end(error)
    signals.no_longer()
    sys.exit(status)


if __name__ == "__main__":
    main()
