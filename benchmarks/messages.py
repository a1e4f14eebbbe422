"""Messages that a block of columns costs on 1 to 16 ranks, which may be more than there are cores.

From reductions at one point with 4, 8 and 12 blocks: differences are those of blocks 5 to 8 and of 9 to 12, which have
twice the columns before them. "Reductions" are the collective operations in PETSc's -log_view, most of which only make
objects; hpcred's own are counted apart: sums (projections and norms) and decisions, which rank 0 sends. Messages and
MB are all that goes from rank to rank, MUMPS's included, as Open MPI's component `monitoring` counts them.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

from common import ENVIRONMENT, finish, krylov, solid, workspace

CELLS, INPUTS = (24, 10, 9), 6
RANKS = (1, 2, 4, 8, 16)
SENT = re.compile(r"^E\t\d+\t\d+\t(\d+) bytes\t(\d+) msgs sent", re.MULTILINE)
COUNTED = """
import collections, runpy, sys
from hpcred.linalg import basis, blocks, refinement, solvers
from hpcred.parallel import decisions
counts = collections.Counter()

def counting(module, name, kind):
    function = getattr(module, name)
    def counted(*arguments):
        counts[kind] += 1
        return function(*arguments)
    setattr(module, name, counted)

OF = ((basis, "inner"), (basis, "stacked_inner"), (refinement, "column_norms"), (solvers, "column_norms"))
for module, name in OF:
    counting(module, name, "sums")
counting(basis, "decided", "decisions")
sys.argv = ["hpcred", "reduce", "job.toml"]
try:
    runpy.run_module("hpcred", run_name="__main__")
except SystemExit:
    pass
import json
from mpi4py import MPI
if MPI.COMM_WORLD.rank == 0:
    open("counts.json", "w").write(json.dumps(counts))
"""


def counts(folder, ranks, blocks):
    """What a run with so many blocks has of each."""
    (folder / "job.toml").write_text(
        'model = "model.h5"\noutput = "result.h5"\nwrite_basis = false\n' + krylov([3000.0], order=blocks - 1)
    )
    (folder / "run.py").write_text(COUNTED)
    monitoring = {"enable": 2, "enable_output": 3, "filename": folder / "count"}
    settings = [word for key, value in monitoring.items() for word in ("--mca", f"pml_monitoring_{key}", str(value))]
    environment = {**ENVIRONMENT, "OPENBLAS_NUM_THREADS": "1", "PETSC_OPTIONS": "-log_view :log.txt"}
    command = ["mpiexec", "-n", str(ranks), *settings, sys.executable, "run.py"]
    subprocess.run(command, check=True, cwd=folder, env=environment, stdout=subprocess.DEVNULL)
    found = json.loads((folder / "counts.json").read_text())
    found["reductions"] = float(re.search(r"^MPI Reductions: +(\S+)", (folder / "log.txt").read_text(), re.M)[1])
    found |= {"messages": 0, "MB": 0.0}
    for rank in range(ranks):
        path = folder / f"count.{rank}.prof"
        for size, messages in SENT.findall(path.read_text()):
            found["messages"] += int(messages)
            found["MB"] += int(size) / 1e6
        os.remove(path)
    return found


def main():
    rows = []
    with workspace() as folder:
        folder = Path(folder)
        solid(folder, CELLS, INPUTS)
        for ranks in RANKS:
            some, more, most = (counts(folder, ranks, blocks) for blocks in (4, 8, 12))
            rows.append({"ranks": ranks} | {
                f"{key}, blocks {which}": (after[key] - before[key]) / 4
                for key in most for which, before, after in (("5 to 8", some, more), ("9 to 12", more, most))
            })  # fmt: skip
    finish("messages", rows)


main()
