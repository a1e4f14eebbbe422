"""The kernels that OpenBLAS has for this processor: a dense product, and the factor of a block by MUMPS.

usage: python benchmarks/kernels.py [cells along each axis of the block]

Each is measured by a process of its own, since OpenBLAS chooses once, and since a process ends if its processor lacks
the instructions. Processor time of one rank; the first row is the choice of OpenBLAS itself.
"""

import json
import os
import subprocess
import sys
import time

import numpy as np
from common import finish

NAMES = (
    "Prescott", "Nehalem", "Sandybridge", "Zen", "Haswell", "SkylakeX", "Cooperlake", "SapphireRapids",
    "ARMV8", "CortexA57", "CortexA72", "ThunderX2T99", "NeoverseN1", "ARMV8SVE", "A64FX", "NeoverseV1", "NeoverseN2",
)  # fmt: skip
SIZE, REPEATS = 1000, 3  # of the dense product; the best of so many counts
FREQUENCIES = (200.0, 300.0, 400.0)  # Hz, of the factors


def main(cells="24"):
    rows = []
    for name in ("", *NAMES):  # empty: OpenBLAS finds none of this name, and chooses
        run = subprocess.run([sys.executable, __file__, "one", cells], capture_output=True, text=True,
                             env=os.environ | {"OPENBLAS_CORETYPE": name})  # fmt: skip
        row = json.loads(run.stdout.splitlines()[-1]) if run.returncode == 0 else {"kernels": None}
        if row["kernels"] and name.lower() in ("", row["kernels"].lower()):  # else not of this processor or OpenBLAS
            rows.append(row)
    for row in rows:
        row["ratio"] = row["factor (s)"] / rows[0]["factor (s)"]
    finish("kernels", rows)


def one(cells):
    """Print what one process measures."""
    import hpcred
    from hpcred.linalg.solvers.shifted import ShiftedSolver
    from hpcred.parallel import processor

    hpcred.start()
    square = np.random.default_rng(0).standard_normal((SIZE, SIZE))
    product = min(seconds(lambda: square @ square) for _ in range(REPEATS))
    with hpcred.solid((int(cells),) * 3) as model:
        solver = ShiftedSolver(model)
        solver.factor(-((2 * np.pi * 100.0) ** 2))  # with the analysis, which is the same for all
        factor = min(seconds(lambda f=f: solver.factor(-((2 * np.pi * f) ** 2))) for f in FREQUENCIES)
    print(json.dumps({"kernels": processor.blas().rpartition(", ")[2], "GFlop/s": 2e-9 * SIZE**3 / product,
                      "factor (s)": factor}))  # fmt: skip


def seconds(call):
    start = time.process_time()
    call()
    return time.process_time() - start


if __name__ == "__main__":
    one(*sys.argv[2:]) if sys.argv[1:2] == ["one"] else main(*sys.argv[1:])
