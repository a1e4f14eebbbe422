"""A clamped cube of hexahedra to a tolerance by multigrid: columns, processor seconds and memory of all ranks.

usage: python benchmarks/million.py [--cells 24 33] [--ranks 2] [--tolerance 1e-4] [--cycle] [-- OPTIONS]

The bands end where 38 modes of the cube lie below, whatever its cells an edge are; 69 of them make 1,014,300 dofs (up
to 5655 Hz), which take 6 GB and minutes. Another version of hpcred is measured with its folder as
PYTHONPATH. OPTIONS are those of PETSc. With --cycle one cycle over all columns is compared with PCMatApply of PETSc's
own cycle, over the same levels with the same smoother.
"""

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np
from common import finish, hpcred, job, solid, workspace

CELLS, HIGH = 69, 5655.0  # Hz: cells of 10 mm
COLUMNS, TIMES = 12, 3  # of a block; cycles that are measured, of which the quickest counts


def processor_seconds():
    """Of all programs that were run so far and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured(cells, ranks, tolerance, options):
    """A row of the table."""
    with workspace() as folder:
        folder = Path(folder)
        solid(folder, (cells,) * 3)
        (folder / "job.toml").write_text(
            f'model = "model.h5"\noutput = "result.h5"\ntolerance = {tolerance}\nband = [0.0, {HIGH * CELLS / cells}]\n'
            '[solver]\nkind = "multigrid"\n'
        )
        before = processor_seconds()
        hpcred("reduce", "job.toml", "--json", "ours.json", *options, ranks=ranks, folder=folder)
        used, record = processor_seconds() - before, json.loads((folder / "ours.json").read_text())
    accuracy, factors, timing = record["accuracy"], record["factorisations"], record["timing"]
    return {
        "cells": cells, "dofs": record["size"], "ranks": ranks, "asked": tolerance, "estimated": accuracy["largest"],
        "reached": accuracy["reached"], "proofs": len(accuracy["proofs"]), "coordinates": record["reduced_size"],
        "columns": accuracy["uncompressed_size"], "columns solved for": sum(f["columns_solved"] for f in factors),
        "iterations at most": max(f["iterations"] for f in factors), "processor seconds": used,
        "us a dof": 1e6 * used / record["size"], "share of solves": timing["seconds"]["solve"] / timing["elapsed"],
        "GB of all ranks": sum(timing["memory_mb_per_rank"]) / 1024,
    }  # fmt: skip


def cycles(cells):
    """Print a row of both cycles over the cube, as a program on some ranks."""
    from hpcred import LinearSolver, start
    from hpcred import solid as cube

    start()
    from hpcred.linalg.blocks import create_dense
    from hpcred.linalg.multigrid import Multigrid
    from hpcred.model.node_blocks import NodeBlocks
    from hpcred.parallel.petsc import MPI

    comm, settings = MPI.COMM_WORLD, LinearSolver()
    with cube((cells,) * 3, comm=comm) as model:
        blocks = NodeBlocks(model)
        matrix = blocks.expanded(model.K, model.mean_diagonal_of_k)
        ours = Multigrid(matrix, blocks.motions, "multigrid_", settings.threshold, settings.sweeps)
        theirs = petsc_cycle(ours._levels, settings.sweeps)
        load, solution = create_dense(matrix, COLUMNS), create_dense(matrix, COLUMNS)
        load.getDenseArray()[...] = np.random.default_rng(comm.rank).standard_normal(load.getDenseArray().shape)
        load.assemble()
        found = np.empty_like(load.getDenseArray())
        row = {"cells": cells, "dofs": model.size, "ranks": comm.size, "columns": COLUMNS}
        row["ours (s)"] = quickest(comm, lambda: ours.apply(load.getDenseArray(), found))
        row["PETSc (s)"] = quickest(comm, lambda: theirs.matApply(load, solution))
        apart = np.array([np.linalg.norm(found - solution.getDenseArray()) ** 2, np.linalg.norm(found) ** 2])
        one, other = comm.allreduce(apart)
        row |= {"ratio": row["PETSc (s)"] / row["ours (s)"], "difference": float((one / other) ** 0.5)}
    if comm.rank == 0:
        print(json.dumps(row))


def petsc_cycle(levels, sweeps):
    """The V-cycle of PETSc over levels that are made, from fine to coarse."""
    from petsc4py import PETSc

    from hpcred.linalg.multigrid import LOW

    options, count = PETSc.Options(), len(levels)
    pc = PETSc.PC().create(levels[0].matrix.comm)
    pc.setOptionsPrefix("theirs_")
    pc.setOperators(levels[0].matrix)
    pc.setType("mg")
    pc.setMGLevels(count)
    for k, level in enumerate(reversed(levels[:-1]), start=1):
        pc.setMGInterpolation(k, level.interpolation)
        for key, value in {"ksp_type": "chebyshev", "ksp_norm_type": "none", "ksp_max_it": sweeps,
                           "ksp_chebyshev_eigenvalues": f"{LOW * level.top},{level.top}",
                           "pc_type": "mat"}.items():  # fmt: skip
            options[f"theirs_mg_levels_{k}_{key}"] = value
    options["theirs_mg_coarse_ksp_type"] = "preonly"
    options["theirs_mg_coarse_pc_type"] = "redundant"
    options["theirs_mg_coarse_redundant_pc_type"] = "svd"  # which may be singular
    pc.setFromOptions()
    for k, level in enumerate(reversed(levels)):
        pc.getMGSmoother(k).setOperators(level.matrix, level.inverses if k else level.matrix)
    pc.setUp()
    return pc


def quickest(comm, cycle):
    """Processor seconds of all ranks of the quickest call, after one that makes room."""
    cycle()
    found = []
    for _ in range(TIMES):
        comm.barrier()
        start = time.process_time()
        cycle()
        found.append(comm.allreduce(time.process_time() - start))
    return min(found)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[24, 33])
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--tolerance", type=float, default=1e-4)
    parser.add_argument("--cycle", action="store_true")
    parser.add_argument("options", nargs="*")
    parser.add_argument("--on", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.on:
        cycles(given.on)
        return
    if given.cycle:
        finish("cycle", [job(given.ranks, ".", "--on", cells) for cells in given.cells])
        return
    options = ["--", *given.options] if given.options else []
    finish("million", [measured(cells, given.ranks, given.tolerance, options) for cells in given.cells])


if __name__ == "__main__":
    main()
