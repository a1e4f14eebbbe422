"""(g) Reading 10^7 nonzeros of a binary OP4 (bigmat) on 1 and 2 ranks, against pyYeti.

A stiffness of 27 entries in three strings a column, symmetric, as a block of bricks with one dof a node has it.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from common import ENVIRONMENT, finish, peer, workspace

COLUMNS = 381_000
READER = """
import json, resource, sys, time
from hpcred.parallel.petsc import MPI
from hpcred.readers.nastran.op4 import contents, read_matrix
comm = MPI.COMM_WORLD
peak_mb = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
comm.Barrier()
before, start = comm.allreduce(peak_mb()), time.perf_counter()
(matrix,) = contents(sys.argv[1], comm)
entries = read_matrix(sys.argv[1], comm, matrix)
comm.Barrier()
seconds, total = time.perf_counter() - start, comm.allreduce(entries.values.sum())
count, peak = comm.allreduce(len(entries.values)), comm.allreduce(peak_mb())
if comm.rank == 0:
    print(json.dumps({"seconds": seconds, "bytes": (peak - before) * 2**20 / count, "sum": total, "nonzeros": count}))
"""


def write(path):
    """Columns of three strings of nine values about the diagonal and a band on each side."""
    rng = np.random.default_rng(0)
    offsets = np.array([-5000, -4, 4996])  # first rows of the strings, from the diagonal
    words = 3 * (2 + 18)
    record = np.dtype([("open", "<i4"), ("head", "<i4", 3), ("string", [("head", "<i4", 2), ("value", "<f8", 9)], 3),
                       ("close", "<i4")])  # fmt: skip
    head = np.dtype([("open", "<i4"), ("head", "<i4", 4), ("name", "S8"), ("close", "<i4")])
    inner = np.arange(5000, COLUMNS - 5010)
    with open(path, "wb") as file:
        np.array([(24, (COLUMNS, -COLUMNS, 1, 2), b"KAA     ", 24)], head).tofile(file)
        for low in range(0, len(inner), 10_000):
            column = inner[low : low + 10_000]
            part = np.zeros(len(column), record)
            part["open"] = part["close"] = 4 * (3 + words)
            part["head"] = np.stack([column + 1, 0 * column, 0 * column + words], axis=1)
            part["string"]["head"][:, :, 0] = 19
            part["string"]["head"][:, :, 1] = column[:, None] + 1 + offsets
            part["string"]["value"] = rng.standard_normal((len(column), 3, 9))
            part.tofile(file)
        np.array([20, COLUMNS + 1, 1, 2], "<i4").tofile(file)
        np.array([1.0]).tofile(file)
        np.array([20], "<i4").tofile(file)


def ours(path, ranks):
    command = ["mpiexec", "-n", str(ranks), sys.executable, "-c", READER, str(path)]
    run = subprocess.run(command, check=True, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True)
    return json.loads(run.stdout.strip().splitlines()[-1])


def main():
    rows = []
    with workspace() as folder:
        path = Path(folder) / "K.op4"
        write(path)
        size = path.stat().st_size / 1e6
        for ranks in (1, 2):
            found = ours(path, ranks)
            rows.append({"reader": f"hpcred, {ranks} rank(s)", "nonzeros": found["nonzeros"], "size (MB)": size,
                         "seconds": found["seconds"], "bytes a nonzero": found["bytes"], "sum": found["sum"]})
        try:
            other = peer("op4_read.py", path)
        except (OSError, subprocess.CalledProcessError):
            print("pyYeti is not in the environment of the peers (HPCRED_PEER_PYTHON): left out", file=sys.stderr)
        else:
            rows.append({"reader": f"pyYeti {other['version']}", "nonzeros": other["nonzeros"], "size (MB)": size,
                         "seconds": other["seconds"], "bytes a nonzero": other["bytes"], "sum": other["sum"],
                         "pyYeti / hpcred": other["seconds"] / rows[0]["seconds"]})  # fmt: skip
    finish("op4", rows)


main()
