"""A clamped cube of hexahedra to a tolerance with factors on a GPU, beside MUMPS on the ranks that are there.

usage: python benchmarks/gpu.py [--cells 33 69 100] [--ranks 16] [--tolerance 1e-4] [--packages cudss mumps]
                                [--mumps-cells 33] [--precision double] [--widths]

The bands end where 38 modes of the cube lie below, whatever its cells an edge are; 33, 69 and 100 make 114,444,
1,014,300 and 3,060,300 dofs. MUMPS takes the cubes of --mumps-cells. Each run is a line of JSON; at the end a table
sets them beside what one H200 with 16 ranks is to reach, and the exit status is 1 where a row does not. Memory of the
GPU is that which nvidia-smi sees while a run goes on, or else what cuDSS estimates. With --widths one factor is solved
with for blocks of several widths, by which linalg/solvers/cudss.py chose its own. Needs a GPU of NVIDIA and
nvmath-python.
"""

import argparse
import json
import subprocess
import sys
import time
from contextlib import contextmanager

from common import finish, job

CELLS, HIGH = 69, 5655.0  # Hz: cells of 10 mm
WIDTHS = (1, 6, 12, 24, 48)
TARGETS = {33: (1e-4, 4.0, None), 69: (1e-4, 15.0, 24.0), 100: (1e-3, 60.0, None)}  # tolerance, seconds, GB of the GPU
OTHER_TOLERANCE = 1e-4  # of other cubes
SAMPLE = 100  # ms between looks at the memory of the GPU


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
        if package == "cudss":
            from hpcred.linalg.solvers.cudss import gpus_in_words

            row["GPU"] = gpus_in_words()
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


@contextmanager
def watched():
    """Give a list that has, after the block, how many GB of the fullest GPU came into use in it; empty where nvidia-smi
    is not there."""
    found, ask = [], ["nvidia-smi", "--query-gpu=index,memory.used", "--format=csv,noheader,nounits"]
    try:
        look = subprocess.Popen([*ask, f"--loop-ms={SAMPLE}"], stdout=subprocess.PIPE, text=True)
    except OSError:
        yield found
        return
    try:
        yield found
    finally:
        look.terminate()
        used = {}
        for line in look.communicate()[0].splitlines():
            gpu, _, mb = line.partition(",")
            if mb.strip().isdigit():
                used.setdefault(gpu, []).append(int(mb))
        found += [max((max(samples) - samples[0] for samples in used.values()), default=0) / 1024] if used else []


def judged(row, cells, tolerance):
    """What a row is to reach, and what of that it does not; None where nothing is asked of it."""
    target, seconds, gb = TARGETS.get(cells, (None, None, None))
    if row["package"] != "cudss" or target != tolerance:
        return None
    missed = [] if row["reached"] else ["the tolerance"]
    missed += [f"{seconds:g} s"] if row["reduce (s)"] > seconds else []
    missed += [f"{gb:g} GB"] if gb is not None and row["GB of the GPU"] > gb else []
    return ", ".join([f"{seconds:g} s", *([f"{gb:g} GB"] if gb is not None else [])]), ", ".join(missed)


def table(rows):
    """Print rows beside their targets and MUMPS; returns how many miss something."""
    keys = ("reduce (s)", "analysis (s)", "factors (s)", "solves (s)", "rest (s)")
    mumps = {row["cells"]: row["reduce (s)"] for row in rows if row["package"] == "mumps"}
    print(" | ".join(("dofs", "tolerance", "package", "ranks", *keys, "GB of the GPU", "MUMPS takes", "to reach")))
    misses = 0
    for row in rows:
        asked = judged(row, row["cells"], row["tolerance"])
        said, memory = "", "" if row["package"] != "cudss" else f"{row['GB of the GPU']:.1f}"
        if asked is not None:
            misses += bool(asked[1])
            said = f"{asked[0]}: " + (f"missed {asked[1]}" if asked[1] else "reached")
        slower = mumps.get(row["cells"], 0) / row["reduce (s)"] if row["package"] != "mumps" else 0
        print(" | ".join((
            f"{row['dofs']:,}", f"{row['tolerance']:g}", row["package"], str(row["ranks"]),
            *(f"{row[key]:.1f}" for key in keys), memory, f"{slower:.1f} times" if slower else "", said,
        )))  # fmt: skip
    return misses


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[*TARGETS])
    parser.add_argument("--mumps-cells", type=int, nargs="*", default=[33])
    parser.add_argument("--ranks", type=int, default=16)
    parser.add_argument("--tolerance", type=float, help="by default that of the target of a cube")
    parser.add_argument("--packages", nargs="+", default=["cudss", "mumps"])
    parser.add_argument("--precision", default="double")
    parser.add_argument("--widths", action="store_true")
    parser.add_argument("--row", nargs="+", help=argparse.SUPPRESS)  # what the programs on several ranks are told
    given = parser.parse_args()
    if given.row:
        cells, *more = given.row
        return widths(int(cells)) if not more else reduced(int(cells), more[0], float(more[1]), more[2])
    rows = []
    for cells in given.cells:
        if given.widths:
            print(json.dumps(job(given.ranks, ".", "--row", cells)), flush=True)
            continue
        tolerance = given.tolerance or TARGETS.get(cells, (OTHER_TOLERANCE,))[0]
        for package in given.packages:
            if package == "mumps" and cells not in given.mumps_cells:
                continue
            with watched() as memory:
                row = job(given.ranks, ".", "--row", cells, package, tolerance, given.precision)
            on_gpu = memory[0] if memory else row["MB of the factor"] / 1024
            row |= {"cells": cells, "tolerance": tolerance, "GB of the GPU": on_gpu if package == "cudss" else None}
            print(json.dumps(row), flush=True)
            rows.append(row)
    if rows:
        finish("gpu", rows)
    return 1 if rows and table(rows) else 0


if __name__ == "__main__":
    sys.exit(main())
