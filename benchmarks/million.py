"""A clamped cube of hexahedra to a tolerance by multigrid: columns, processor seconds and memory of all ranks.

usage: python benchmarks/million.py [--cells 24 33] [--ranks 2] [--tolerance 1e-4]

The bands end where 38 modes of the cube lie below, whatever its cells an edge are; 69 of them make 1,014,300 dofs (up
to 5655 Hz), which take 8 GB and minutes. Another version of hpcred is measured with its folder as
PYTHONPATH.
"""

import argparse
import json
import resource
from pathlib import Path

from common import finish, hpcred, solid, workspace

CELLS, HIGH = 69, 5655.0  # Hz: cells of 10 mm


def processor_seconds():
    """Of all programs that were run so far and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured(cells, ranks, tolerance):
    """A row of the table."""
    with workspace() as folder:
        folder = Path(folder)
        solid(folder, (cells,) * 3)
        (folder / "job.toml").write_text(
            f'model = "model.h5"\noutput = "result.h5"\ntolerance = {tolerance}\nband = [0.0, {HIGH * CELLS / cells}]\n'
            '[solver]\nkind = "multigrid"\n'
        )
        before = processor_seconds()
        hpcred("reduce", "job.toml", "--json", "ours.json", ranks=ranks, folder=folder)
        used, record = processor_seconds() - before, json.loads((folder / "ours.json").read_text())
    accuracy, factors, timing = record["accuracy"], record["factorisations"], record["timing"]
    return {
        "cells": cells, "dofs": record["size"], "ranks": ranks, "asked": tolerance, "estimated": accuracy["largest"],
        "reached": accuracy["reached"], "proofs": len(accuracy["proofs"]), "coordinates": record["reduced_size"],
        "columns": accuracy["uncompressed_size"], "columns solved for": sum(f["columns_solved"] for f in factors),
        "iterations at most": max(f["iterations"] for f in factors), "processor seconds": used,
        "us a dof": 1e6 * used / record["size"], "share of solves": timing["seconds"]["solve"] / timing["elapsed"],
        "GB of all ranks": sum(timing["memory_mb_per_rank"]) / 1024,
    }  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[24, 33])
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--tolerance", type=float, default=1e-4)
    given = parser.parse_args()
    finish("million", [measured(cells, given.ranks, given.tolerance) for cells in given.cells])


if __name__ == "__main__":
    main()
