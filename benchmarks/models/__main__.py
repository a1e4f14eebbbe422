"""List the published models, or write one as model.h5: python -m benchmarks.models list | make NAME OUTPUT."""

from __future__ import annotations

import argparse
import sys

import hpcred

from . import MODELS
from .published import all_ranks


def make(name, output, folder=None) -> str:
    """Write model.h5, and return the text of a job that reduces it. Collective."""
    published = MODELS[name]
    with published.model(folder=folder) as model:
        hpcred.write_model(output, model)
    return published.job(str(output))


def listed() -> str:
    rows = [(each.name, f"{each.n:,}", each.file, each.licence, each.where, each.what) for each in MODELS.values()]
    rows.insert(0, ("name", "n", "file", "licence", "download", "what"))
    widths = [max(map(len, column)) for column in list(zip(*rows, strict=True))[:-1]]
    return "\n".join("  ".join([*map(str.ljust, row, widths), row[-1]]) for row in rows)


def main(arguments=None):
    parser = argparse.ArgumentParser(prog="python -m benchmarks.models", description=__doc__.partition(":")[0] + ".")
    commands = parser.add_subparsers(required=True, dest="command")
    commands.add_parser("list", help="print what there is, and where to download it")
    making = commands.add_parser("make", help="write model.h5, and print the job that reduces it")
    making.add_argument("name", choices=MODELS)
    making.add_argument("--data", metavar="FOLDER", help="folder of the downloaded file")
    making.add_argument("output", metavar="OUTPUT.h5")
    given = parser.parse_args(arguments)
    if given.command == "list":
        print(listed())
        return 0
    first = all_ranks(None).rank == 0
    try:
        job = make(given.name, given.output, given.data)
    except hpcred.InputError as error:
        if first:
            print(error, file=sys.stderr)
        return 2
    if first:
        print(job, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
