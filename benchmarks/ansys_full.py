"""(g) Reading K and M of 10^7 stored nonzeros each from ANSYS' .full on 2 ranks, against ansys-mapdl-reader.

Without the peer in its environment (HPCRED_PEER_PYTHON) only our own times are printed.
"""

import json
import subprocess
import sys
from pathlib import Path

from common import ENVIRONMENT, HERE, PEER_PYTHON, finish, workspace

sys.path.insert(0, str(HERE.parent / "tests"))
from ansys_files import write_large  # noqa: E402

NODES, WIDTH = 84_000, 40
READER = """
import json, sys, time
from resource import RUSAGE_SELF, getrusage
import hpcred
hpcred.start("real")
from hpcred.parallel.petsc import MPI
from hpcred.readers.ansys.full import read_parts
from hpcred.parallel.progress import memory_mb
comm = MPI.COMM_WORLD
comm.Barrier()
before, cpu, start = memory_mb(), getrusage(RUSAGE_SELF), time.perf_counter()
parts = read_parts(sys.argv[1], comm)
comm.Barrier()
seconds = time.perf_counter() - start
now = getrusage(RUSAGE_SELF)
cpu = comm.allreduce(now.ru_utime + now.ru_stime - cpu.ru_utime - cpu.ru_stime)
sums = [comm.allreduce(parts.matrices[key].values.sum()) for key in "KM"]
count = comm.allreduce(sum(len(item.values) for item in parts.matrices.values()))
memory = comm.allreduce(memory_mb() - before)
if comm.rank == 0:
    print(json.dumps({"seconds": seconds, "cpu": cpu, "memory_mb": memory, "sums": sums, "count": count}))
"""
PEER = """
import json, resource, sys, time
from ansys.mapdl import reader
start = time.perf_counter()
before = resource.getrusage(resource.RUSAGE_SELF)
_, k, m = reader.read_binary(sys.argv[1]).load_km(sort=False)
sums = [float(2 * mat.sum() - mat.diagonal().sum()) for mat in (k, m)]
seconds = time.perf_counter() - start
now = resource.getrusage(resource.RUSAGE_SELF)
memory, cpu = (now.ru_maxrss - before.ru_maxrss) / 1024, now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime
print(json.dumps({"seconds": seconds, "memory_mb": memory, "cpu": cpu, "sums": sums, "version": reader.__version__}))
"""


def has_peer():
    command = [PEER_PYTHON, "-c", "import scipy, ansys.mapdl.reader"]
    return Path(PEER_PYTHON).is_file() and not subprocess.run(command, check=False, capture_output=True).returncode


def ours(path, ranks):
    command = ["mpiexec", "-n", str(ranks), sys.executable, "-c", READER, str(path)]
    run = subprocess.run(command, check=True, env={**ENVIRONMENT, "OPENBLAS_NUM_THREADS": "1"}, stdout=subprocess.PIPE,
                         text=True)  # fmt: skip
    return json.loads(run.stdout.strip().splitlines()[-1])


def main():
    rows = []
    with workspace() as folder:
        path = Path(folder) / "large.full"
        terms, *sums = write_large(path, NODES, WIDTH)
        about = {"stored nonzeros": 2 * terms, "size (MB)": path.stat().st_size / 1e6}

        def row(name, found):
            defect = max(abs(a - b) / (1 + abs(b)) for a, b in zip(found["sums"], sums, strict=True))
            memory = found["memory_mb"]
            rows.append({
                "reader": name, **about, "seconds": found["seconds"], "CPU seconds": found["cpu"], "MB": memory,
                "bytes a nonzero": memory * 2**20 / (4 * terms), "agreement": defect,
            })  # fmt: skip

        ours(path, 1)  # memory that the system has not given away before costs more than the reading
        for ranks in (1, 2):
            row(f"hpcred, {ranks} rank(s)", ours(path, ranks))
        if has_peer():
            run = subprocess.run([PEER_PYTHON, "-c", PEER, str(path)], check=True, stdout=subprocess.PIPE, text=True)
            found = json.loads(run.stdout.strip().splitlines()[-1])
            row(f"ansys-mapdl-reader {found['version']}", found)
            for item in rows[:2]:
                item["peer / hpcred"] = rows[2]["seconds"] / item["seconds"]
    finish("ansys_full", rows)


main()
