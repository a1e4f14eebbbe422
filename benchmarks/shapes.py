"""(n) Multigrid on bodies that are not cubes: iterations at 0 Hz and in the band, and the work beside factors of MUMPS.

usage: python benchmarks/shapes.py [size] [name ...]   (size: 16; of the shapes whose names contain one of these)

Processor seconds of one rank, 8 columns with random loads at a time. The shift in the band is in the widest gap of
eigenvalues after the second to fifth mode, beside the modes below.
"""

import sys
import time
from pathlib import Path

import numpy as np
from common import finish

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from shape_models import SHAPES

import hpcred
from hpcred.linalg.blocks import View, create_block, local_rows
from hpcred.linalg.solvers.multigrid import MultigridSolver
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.model.node_blocks import NodeBlocks
from hpcred.parallel.petsc import MPI

COLUMNS = 8


def seconds(function, *arguments):
    """Processor seconds of a call, and what it raised, in short."""
    start, failed = time.process_time(), ""
    try:
        function(*arguments)
    except hpcred.ComputationError as error:
        failed = str(error)
    return time.process_time() - start, failed


def measured(name, model):
    right, left = (create_block(model.K, COLUMNS) for _ in range(2))
    with local_rows(right) as rows:
        rows[...] = np.random.default_rng(1).standard_normal(rows.shape)
    row = {"shape": name, "dofs": model.size}
    direct = ShiftedSolver(model)
    row["MUMPS: factor (s)"], _ = seconds(direct.factor, 0.0)
    row["MUMPS: column (s)"] = seconds(direct.solve, right, left)[0] / COLUMNS
    row["MUMPS: MB"] = direct.records[-1].memory_mb_used_total
    direct.close()
    solver = MultigridSolver(model, None, NodeBlocks(model), hpcred.LinearSolver())
    row["levels (s)"], failed = seconds(solver.factor, 0.0)
    if failed:
        return {**row, "iterations": failed[:60]}
    spent, failed = seconds(solver.solve, right, left)
    record = solver.records[-1]
    row |= {"column (s)": spent / COLUMNS, "levels (MB)": record.memory_mb_used_total,
            "expected": record.expected_iterations, "iterations": record.iterations}  # fmt: skip
    if failed:
        return {**row, "iterations": failed[:60]}
    modes = hpcred.natural_modes(model, 6, hpcred.NoFrame())
    values = (2 * np.pi * modes.frequencies) ** 2
    below = 2 + int(np.diff(values[1:]).argmax())
    record.iterations = 0
    basis = View(modes.shapes, 0, below)
    spent, failed = seconds(solver.solve_below, -values[below - 1 : below + 1].mean(), right, left, basis,
                            np.diag(values[:below]))  # fmt: skip
    modes.close()
    solver.close()
    return row | {"iterations in the band": failed[:60] or record.iterations}


def main(size=16, *names):
    rows = []
    for name, make in SHAPES.items():
        if not names or any(part in name for part in names):
            with make(MPI.COMM_WORLD, int(size)) as model:
                rows.append(measured(name, model))
                print(rows[-1], file=sys.stderr)
    finish("shapes", rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
