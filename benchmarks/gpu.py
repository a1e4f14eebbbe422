"""A clamped cube of hexahedra to a tolerance with factors on a GPU, beside MUMPS on the ranks that are there.

usage: python benchmarks/gpu.py [--cells 33 69] [--ranks 16] [--tolerance 1e-4] [--packages cudss mumps]
                                [--mumps-cells 33] [--precision double] [--widths]

The bands end where 38 modes of the cube lie below, whatever its cells an edge are; 33, 69 and 100 make 114,444,
1,014,300 and 3,060,300 dofs. MUMPS takes the cubes of --mumps-cells. With --widths one factor is solved with for blocks
of several widths, by which linalg/solvers/cudss.py chose its own. Needs a GPU of NVIDIA and nvmath-python.
"""

import argparse
import json
import sys
import time

from common import job

CELLS, HIGH = 69, 5655.0  # Hz: cells of 10 mm
WIDTHS = (1, 6, 12, 24, 48)


def reduced(cells, package, tolerance, precision):
    """Print a row of one reduction, as a program on some ranks."""
    from mpi4py import MPI

    import hpcred
    from hpcred import Factoring, LinearSolver

    comm = MPI.COMM_WORLD
    start = time.perf_counter()
    with hpcred.solid((cells,) * 3, comm=comm) as model:
        comm.barrier()
        assembled, start = time.perf_counter() - start, time.perf_counter()
        factoring = Factoring(solver=LinearSolver(package=package, precision=precision))
        with hpcred.reduce(model, tolerance=tolerance, band=(0.0, HIGH * CELLS / cells), factoring=factoring) as rom:
            seconds, record, size = time.perf_counter() - start, rom.record, rom.size
    factors, accuracy = record.factorisations, record.accuracy
    stages = dict(record.timing.seconds)
    solving = sum(item.solve_seconds for item in factors)
    analysed, factored = (sum(getattr(item, f"{key}_seconds") for item in factors) for key in ("analysis", "factor"))
    row = {
        "package": factors[0].package, "dofs": record.size, "ranks": comm.size, "assemble (s)": assembled,
        "reduce (s)": seconds, "analysis (s)": analysed, "factors (s)": factored, "solves (s)": solving,
        "rest (s)": seconds - analysed - factored - solving, "factors": len(factors),
        "columns solved for": sum(item.columns_solved for item in factors), "coordinates": size,
        "estimated": accuracy.largest, "reached": accuracy.reached, "proofs": len(accuracy.proofs),
        "MB of the factor": max(item.memory_mb_used_total for item in factors),
        "entries": max(item.factor_entries for item in factors), "residual": max(item.residual for item in factors),
        "modes below": [item.negative_pivots for item in factors], "stages (s)": stages,
    }  # fmt: skip
    if comm.rank == 0:
        print(json.dumps(row))


def widths(cells):
    """Print seconds of a column by the width of a solve, as a program on some ranks."""
    from mpi4py import MPI

    import hpcred
    from hpcred import Factoring, LinearSolver

    hpcred.start()
    from hpcred.linalg.blocks import create_block, random_block
    from hpcred.linalg.solvers import cudss
    from hpcred.linalg.solvers.shifted import ShiftedSolver

    comm, row = MPI.COMM_WORLD, {}
    with hpcred.solid((cells,) * 3, comm=comm) as model:
        solver = ShiftedSolver(model, factoring=Factoring(solver=LinearSolver(package="cudss")))
        solver.factor(0.0)
        load, solution = random_block(model.K, 48), create_block(model.K, 48)
        for width in WIDTHS:
            cudss.WIDTH = width
            for _ in range(2):
                start = time.perf_counter()
                solver.factors.back_substitute(load, solution)
                row[f"width {width} (s for 48 columns)"] = time.perf_counter() - start
        solver.close()
    if comm.rank == 0:
        print(json.dumps({"dofs": model.size, "ranks": comm.size, **row}))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[33, CELLS])
    parser.add_argument("--mumps-cells", type=int, nargs="*", default=[33])
    parser.add_argument("--ranks", type=int, default=16)
    parser.add_argument("--tolerance", type=float, default=1e-4)
    parser.add_argument("--packages", nargs="+", default=["cudss", "mumps"])
    parser.add_argument("--precision", default="double")
    parser.add_argument("--widths", action="store_true")
    parser.add_argument("--row", nargs="+", help=argparse.SUPPRESS)  # what the programs on several ranks are told
    given = parser.parse_args()
    if given.row:
        cells, *more = given.row
        return widths(int(cells)) if not more else reduced(int(cells), more[0], float(more[1]), more[2])
    for cells in given.cells:
        rows = [[cells, package, given.tolerance, given.precision] for package in given.packages]
        for row in [[cells]] if given.widths else rows:
            if "mumps" in row and cells not in given.mumps_cells:
                continue
            print(json.dumps(job(given.ranks, ".", "--row", *row)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
