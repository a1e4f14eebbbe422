"""This checkout against an earlier commit, in turn in one run: seconds of the reduction in the table of
docs/benchmarks.md, and ratios.

usage: python benchmarks/against.py COMMIT [cells along x y z] [rounds]
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from common import ENVIRONMENT, finish, krylov

ROOT = Path(__file__).parent.parent


def reduce(source, folder):
    """Elapsed seconds of one reduction by the package in `source`, without the start of the interpreter."""
    command = ["mpiexec", "-n", "2", sys.executable, "-m", "hpcred", "reduce", "job.toml", "--json", "run.json"]
    environment = {**ENVIRONMENT, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(source)}
    subprocess.run(command, check=True, cwd=folder, env=environment, stdout=subprocess.DEVNULL)
    record = json.loads((Path(folder) / "run.json").read_text())
    return (record.get("timing") or record["run"])["elapsed"]


def main(commit, cells=("36", "15", "15"), rounds=5):
    with tempfile.TemporaryDirectory(prefix="hpcred-bench-") as folder:
        before = Path(folder) / "before"
        before.mkdir()
        archive = subprocess.run(["git", "archive", commit, "hpcred"], check=True, cwd=ROOT, stdout=subprocess.PIPE)
        subprocess.run(["tar", "-x", "-C", str(before)], check=True, input=archive.stdout)
        (Path(folder) / "job.toml").write_text('model = "model.h5"\n' + krylov())
        make = [sys.executable, "-m", "hpcred", "example", "solid", "--cells", *cells, "-o", "model.h5"]
        subprocess.run(make, check=True, cwd=folder, env={**os.environ, "PYTHONPATH": str(before)})
        pairs = [(reduce(ROOT, folder), reduce(before, folder)) for _ in range(rounds)]
    now, then = zip(*pairs, strict=True)
    finish("against", [{
        "cells": " x ".join(cells), "commit": commit, "this checkout (s)": statistics.median(now),
        "commit (s)": statistics.median(then), "this / commit": statistics.median(a / b for a, b in pairs),
    }])  # fmt: skip


main(sys.argv[1], tuple(sys.argv[2:5]) or ("36", "15", "15"), int(sys.argv[5]) if len(sys.argv) > 5 else 5)
