"""(f) Reading 28 million nonzeros on 2 ranks from model.h5, PETSc binary and Matrix Market, against scipy.io.mmread."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from common import ENVIRONMENT, finish, peer, solid, workspace

READER = """
import json, sys, time
import hpcred
hpcred.start("real")
from hpcred.parallel.petsc import MPI
from hpcred.readers.matrix_formats import read_entries
from hpcred.files.model_file import read_model
from hpcred.parallel.progress import memory_mb
comm = MPI.COMM_WORLD
comm.Barrier()
before, start = memory_mb(), time.perf_counter()
if sys.argv[1].endswith("h5"):
    model = read_model(sys.argv[1], comm)
    values = model.K.getValuesCSR()[2].real
else:
    values = read_entries(sys.argv[1], comm).values
comm.Barrier()
seconds, total = time.perf_counter() - start, comm.allreduce(values.sum())
if comm.rank == 0:
    print(json.dumps({"seconds": seconds, "memory_mb": memory_mb(), "sum": total}))
"""


def ours(path):
    command = ["mpiexec", "-n", "2", sys.executable, "-c", READER, str(path)]
    run = subprocess.run(command, check=True, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True)
    return json.loads(run.stdout.strip().splitlines()[-1])


def write_others(folder):
    """K of model.h5 as PETSc binary and as Matrix Market with 17 digits."""
    import h5py

    with h5py.File(folder / "model.h5") as file:
        group = file["matrices"]
        indptr, indices, values = group["indptr"][:], group["indices"][:], group["K"][:]
    lengths, size = np.diff(indptr), len(indptr) - 1
    with open(folder / "K.bin", "wb") as file:
        np.array([1211216, size, size, len(values)], dtype=">i4").tofile(file)
        for part, kind in ((lengths, ">i4"), (indices, ">i4"), (values, ">f8")):
            part.astype(kind).tofile(file)
    rows = np.repeat(np.arange(1, size + 1), lengths)
    with open(folder / "K.mtx", "w") as file:
        file.write(f"%%MatrixMarket matrix coordinate real general\n{size} {size} {len(values)}\n")
        for low in range(0, len(values), 500_000):
            part = slice(low, low + 500_000)
            triples = zip(rows[part].tolist(), (indices[part] + 1).tolist(), values[part].tolist(), strict=True)
            file.writelines(f"{i} {j} {v!r}\n" for i, j, v in triples)
    return len(values), float(values.sum()), float(np.abs(values).sum())


def main():
    rows = []
    with workspace() as folder:
        folder = Path(folder)
        solid(folder, (90, 37, 34))
        count, total, scale = write_others(folder)
        own = subprocess.run([sys.executable, "-W", "ignore", str(Path(__file__).parent / "peers/mmread.py"),
                              str(folder / "K.mtx")], check=True, stdout=subprocess.PIPE, text=True)  # fmt: skip
        peers = [json.loads(own.stdout), peer("mmread.py", folder / "K.mtx")]
        for name in ("model.h5", "K.bin", "K.mtx"):
            found = ours(folder / name)
            rows.append({"file": name, "nonzeros": count, "size (MB)": (folder / name).stat().st_size / 1e6,
                         "seconds": found["seconds"], "MB a rank": found["memory_mb"],
                         "agreement": abs(found["sum"] - total) / scale})  # fmt: skip
    for item in peers:
        rows.append({"file": f"K.mtx by scipy.io.mmread {item['scipy']}", "nonzeros": count, "seconds": item["seconds"],
                     "MB a rank": item["memory_mb"], "agreement": abs(item["sum"] - total) / scale,
                     "mmread / hpcred": item["seconds"] / rows[2]["seconds"]})  # fmt: skip
    finish("reading", rows)


main()
