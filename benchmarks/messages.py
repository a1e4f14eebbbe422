"""Messages that a block of columns costs, on 1 to 16 ranks: all of MUMPS, PETSc and hpcred.

Open MPI counts them (its component `monitoring`) in reductions at one point with 4, 8 and 12 blocks: the differences are
those of blocks 5 to 8 and of blocks 9 to 12, with twice the columns before them. Ranks may be more than cores: the
counts are the same. A collective operation counts once, on rank 0; nearly all are those by which PETSc makes objects.
"""

import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

from common import ENVIRONMENT, finish, krylov, solid, workspace

CELLS, INPUTS = (36, 15, 15), 6
RANKS = (1, 2, 4, 8, 16)
SENT = re.compile(r"^E\t\d+\t\d+\t(\d+) bytes\t(\d+) msgs sent", re.MULTILINE)
TOGETHER = re.compile(r"^(?:O2A|A2O|A2A)\t\d+\t\d+ bytes\t(\d+) msgs sent", re.MULTILINE)


def counts(folder, ranks, blocks):
    """Messages of a run by kind: point to point of all ranks with their MB, collectives of rank 0."""
    (folder / "job.toml").write_text(
        'model = "model.h5"\noutput = "result.h5"\nwrite_basis = false\n' + krylov([3000.0], order=blocks - 1)
    )
    monitoring = {"enable": 2, "enable_output": 3, "filename": folder / "count"}
    settings = [word for key, value in monitoring.items() for word in ("--mca", f"pml_monitoring_{key}", str(value))]
    command = ["mpiexec", "-n", str(ranks), *settings, sys.executable, "-m", "hpcred", "reduce", "job.toml"]
    environment = {**ENVIRONMENT, "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(command, check=True, cwd=folder, env=environment, stdout=subprocess.DEVNULL)
    found = Counter()
    for rank in range(ranks):
        path = folder / f"count.{rank}.prof"
        text = path.read_text()
        for size, messages in SENT.findall(text):
            found["messages"] += int(messages)
            found["MB"] += int(size) / 1e6
        for communicator in text.split("\nD\t")[1:]:
            if rank == 0 and "," in communicator.partition("\n")[0]:  # not those of one rank
                found["collectives"] += sum(map(int, TOGETHER.findall(communicator)))
        os.remove(path)
    return found


def main():
    rows = []
    with workspace() as folder:
        folder = Path(folder)
        solid(folder, CELLS, INPUTS)
        for ranks in RANKS:
            some, more, most = (counts(folder, ranks, blocks) for blocks in (4, 8, 12))
            row = {"ranks": ranks}
            for key in ("collectives", "messages", "MB"):
                row |= {f"{key} a block": (more[key] - some[key]) / 4, f"{key}, later": (most[key] - more[key]) / 4}
            rows.append(row)
    finish("messages", rows)


main()
