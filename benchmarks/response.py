"""Harmonic analysis to a tolerance beside direct factorisation at each frequency: seconds, their ratio, differences.

usage: python benchmarks/response.py [ranks] [small|medium ...]

Blocks of hexahedra, six inputs and outputs, Rayleigh damping 20, 1e-7. Direct solves are measured at DIRECT frequencies
of the band, by the same program on the same ranks, and their seconds per frequency give those of all POINTS.
"""

import json
import subprocess
import sys

from common import ENVIRONMENT, finish, workspace

CASES = {"small": ((14, 5, 4), 30000.0), "medium": ((40, 16, 8), 15000.0)}
POINTS, DIRECT, TOLERANCE = 2001, 51, 1e-6


def work(name):
    """Both ways in one job; a row of the table from rank 0."""
    import numpy as np
    from mpi4py import MPI

    import hpcred

    hpcred.start("complex")  # in the direct solves' favour: complex arithmetic instead of real of twice the size
    cells, top = CASES[name]
    grid, damping = np.linspace(0.0, top, POINTS), hpcred.Rayleigh(20.0, 1e-7)
    some = np.arange(DIRECT) * (POINTS - 1) // (DIRECT - 1)
    comm = MPI.COMM_WORLD
    with hpcred.solid(cells) as model:
        start = MPI.Wtime()
        found = hpcred.full_response(model, grid, damping=damping, tolerance=TOLERANCE)
        seconds = MPI.Wtime() - start
        start = MPI.Wtime()
        direct = hpcred.frequency_response(model, grid[some], damping=damping, groups=1)
        each = (MPI.Wtime() - start) / DIRECT
        size = model.size
    if comm.rank == 0:
        difference = hpcred.relative_error(direct, found.response[some]).max()
        print(json.dumps({
            "case": name, "dofs": size, "ranks": comm.size, "factorisations": len(found.factorisations),
            "columns": found.accuracy.uncompressed_size, "response (s)": seconds, "one direct solve (s)": each,
            f"{POINTS} direct (s)": each * POINTS, "ratio": each * POINTS / seconds,
            "as many direct solves": seconds / each, "estimated": float(found.eps.max()),
            "largest difference": float(difference),
        }))  # fmt: skip


def main(ranks, names):
    rows = []
    for name in names:
        with workspace() as folder:
            command = ["mpiexec", "-n", ranks, sys.executable, __file__, "--work", name]
            environment = {**ENVIRONMENT, "OPENBLAS_NUM_THREADS": "1"}
            run = subprocess.run(command, check=True, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
        rows.append(json.loads(run.stdout.strip().splitlines()[-1]))
    finish("response", rows)


if sys.argv[1:2] == ["--work"]:
    work(sys.argv[2])
else:
    main(sys.argv[1] if len(sys.argv) > 1 else "2", sys.argv[2:] or list(CASES))
