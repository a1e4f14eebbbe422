"""What checksums cost while model.h5 is read: the same file with and without them, in turn, the median of many turns.

Seconds of the processor, of all ranks: those on the wall say little where other programs run.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
from common import ENVIRONMENT, finish, solid, workspace

TIMES = 30
READER = f"""
import json, sys, time
import hpcred
hpcred.start("real")
from hpcred.parallel.petsc import MPI
comm, found = MPI.COMM_WORLD, {{name: [] for name in sys.argv[1:]}}
for _ in range({TIMES}):
    for name in sys.argv[1:]:
        comm.Barrier()
        start = time.process_time()
        hpcred.read_model(name, comm).close()
        found[name].append(comm.allreduce(time.process_time() - start))
if comm.rank == 0:
    print(json.dumps(found))
"""


def main():
    rows = []
    with workspace() as folder:
        folder = Path(folder)
        for cells in ((30, 20, 20), (60, 30, 30)):
            solid(folder, cells)
            for name in ("summed.h5", "plain.h5"):  # copies both: how the system holds a file depends on its writer
                shutil.copy(folder / "model.h5", folder / name)
            with h5py.File(folder / "plain.h5", "a") as file:
                del file.attrs["xxh3"], file["checksums"]
                size = int(file.attrs["size"])
            for ranks in (1, 2):
                command = ["mpiexec", "-n", str(ranks), sys.executable, "-c", READER, "summed.h5", "plain.h5"]
                done = subprocess.run(command, check=True, env=ENVIRONMENT, stdout=subprocess.PIPE, cwd=folder)
                found = json.loads(done.stdout.strip().splitlines()[-1])
                summed, plain = np.array(found["summed.h5"]), np.array(found["plain.h5"])
                rows.append({"dofs": size, "MB": (folder / "model.h5").stat().st_size / 1e6, "ranks": ranks,
                             "with (s)": np.median(summed), "without (s)": np.median(plain),
                             "cost (%)": 100 * (np.median(summed / plain) - 1)})  # fmt: skip
    finish("checksums", rows)


main()
