"""`python -m hpcred` and the console script."""

import sys


def main():
    from .cli import run

    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
