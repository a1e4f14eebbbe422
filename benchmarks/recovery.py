"""Motion of all nodes from reduced coordinates against a plain write of the same bytes in the same run.

Arguments: nodes (1,000,000), coordinates (50), instants (1,000), ranks (2), `single` for single precision. The result
is made up, since only its size matters here. A plain write is that of blocks of 64 MB, one after the other, by as many
ranks to as many files, with an fsync as in hpcred; it is done before and after, and the mean is taken.
"""

import json
import os
import sys
import time
from pathlib import Path

import h5py
import numpy as np
from common import finish, job, workspace

BLOCK = 2**26


def write_result(path, nodes, count):
    """A result with random shapes."""
    import hpcred
    from hpcred.files.hdf5 import writing
    from hpcred.files.result_file import FORMAT, VERSION
    from hpcred.parallel.petsc import MPI

    rng, n, empty = np.random.default_rng(1), 3 * nodes, np.zeros((count, 0))
    numbers = np.repeat(np.arange(1, nodes + 1), 3)
    with writing(path, MPI.COMM_SELF) as file:
        for name, value in (("format", FORMAT), ("version", VERSION), ("loss_factor", 0.0)):
            file.attribute(name, value)
        for key, value in {"M": np.eye(count), "D": 0 * np.eye(count), "K": np.eye(count), "B": empty, "C": empty.T,
                           "frequencies": np.ones(count), "input_names": [], "output_names": []}.items():  # fmt: skip
            file.small(f"reduced/{key}", value)
        file.rows("basis/V", rng.standard_normal((count, n), dtype=np.float32).astype(float), axis=1)
        file.rows("dofs/node", numbers)
        file.rows("dofs/direction", np.tile(np.arange(3, dtype=np.int8), nodes))
        file.rows("dofs/position", np.zeros((n, 3)))
        file.small("record", "null")
    assert hpcred.read_result(path).reduced.size == count


def recover(folder, single):
    """Recover by all ranks; the last line is JSON."""
    import hpcred
    from hpcred.parallel.petsc import MPI
    from hpcred.parallel.progress import Progress

    comm, folder = MPI.COMM_WORLD, Path(folder)
    progress = Progress(comm, show=False)
    comm.Barrier()
    start = time.perf_counter()
    hpcred.recover(folder / "result.h5", folder / "q.h5", folder / "out.h5", single=single, progress=progress)
    seconds, timing = comm.allreduce(time.perf_counter() - start) / comm.size, progress.timing()
    if comm.rank == 0:
        print(json.dumps({"seconds": seconds, "stages": timing.seconds, "memory_mb": max(timing.memory_mb_per_rank)}))


def plain(folder, count):
    """Write so many bytes by all ranks; the last line is JSON."""
    from mpi4py import MPI

    comm, block = MPI.COMM_WORLD, memoryview(np.random.default_rng(1).bytes(BLOCK))
    mine, name = count // comm.size, Path(folder) / f"plain{comm.rank}"
    comm.Barrier()
    start = time.perf_counter()
    with open(name, "wb") as file:
        for low in range(0, mine, BLOCK):
            file.write(block[: min(BLOCK, mine - low)])
        file.flush()
        os.fsync(file.fileno())
    comm.Barrier()
    seconds = time.perf_counter() - start
    name.unlink()
    if comm.rank == 0:
        print(json.dumps({"seconds": seconds}))


def main(nodes=1_000_000, count=50, instants=1_000, ranks=2, single=False):
    with workspace() as folder:
        folder = Path(folder)
        write_result(folder / "result.h5", nodes, count)
        with h5py.File(folder / "q.h5", "w") as file:
            file["t"] = np.arange(instants) / instants
            file["q"] = np.random.default_rng(2).standard_normal((instants, count))
        size = nodes * 3 * instants * (4 if single else 8)
        before = job(ranks, folder, "plain", folder, size)["seconds"]
        ours = job(ranks, folder, "recover", folder, int(single))
        (folder / "out.h5").unlink()
        after = job(ranks, folder, "plain", folder, size)["seconds"]
    written = (before + after) / 2
    return {"nodes": nodes, "coordinates": count, "instants": instants, "ranks": ranks, "GB": size / 1e9,
            "plain write (s)": f"{before:.3g}, {after:.3g}", "recover (s)": ours["seconds"],
            "of it reading (s)": ours["stages"]["read"], "ratio": ours["seconds"] / written,
            "MB a rank": ours["memory_mb"]}  # fmt: skip


if __name__ == "__main__":
    if sys.argv[1:2] == ["plain"]:
        plain(sys.argv[2], int(sys.argv[3]))
    elif sys.argv[1:2] == ["recover"]:
        recover(sys.argv[2], sys.argv[3] == "1")
    else:
        given = [int(word) for word in sys.argv[1:] if word != "single"]
        finish("recovery", [main(*given, single="single" in sys.argv)])
