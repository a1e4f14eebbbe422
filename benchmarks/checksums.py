"""What checksums cost while model.h5 is read: the same file with and without them, in turn, the best of several.

Seconds of the processor, of the slowest rank: those on the wall say little where other programs run.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
from common import ENVIRONMENT, finish, solid, workspace

TIMES = 9
READER = f"""
import json, sys, time
import hpcred
hpcred.start("real")
from hpcred.parallel.petsc import MPI
comm, best = MPI.COMM_WORLD, {{}}
for _ in range({TIMES}):
    for name in sys.argv[1:]:
        comm.Barrier()
        start = time.process_time()
        hpcred.read_model(name, comm).close()
        best[name] = min(best.get(name, 1e9), max(comm.allgather(time.process_time() - start)))
if comm.rank == 0:
    print(json.dumps(best))
"""


def main():
    rows = []
    with workspace() as folder:
        folder = Path(folder)
        for cells in ((30, 20, 20), (60, 30, 30)):
            solid(folder, cells)
            shutil.copy(folder / "model.h5", folder / "plain.h5")
            with h5py.File(folder / "plain.h5", "a") as file:
                del file.attrs["checksum"], file["checksums"]
                size = int(file.attrs["size"])
            for ranks in (1, 2):
                command = ["mpiexec", "-n", str(ranks), sys.executable, "-c", READER, "model.h5", "plain.h5"]
                done = subprocess.run(command, check=True, env=ENVIRONMENT, stdout=subprocess.PIPE, cwd=folder)
                found = json.loads(done.stdout.strip().splitlines()[-1])
                rows.append({"dofs": size, "MB": (folder / "model.h5").stat().st_size / 1e6, "ranks": ranks,
                             "with (s)": found["model.h5"], "without (s)": found["plain.h5"],
                             "cost (%)": 100 * (found["model.h5"] / found["plain.h5"] - 1)})  # fmt: skip
    finish("checksums", rows)


main()
