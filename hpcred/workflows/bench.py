"""Measure the expensive steps of a reduction on this machine, on a block of hexahedra."""

from __future__ import annotations

import os
import time

import numpy as np

from ..examples.solid import solid
from ..files.model_file import read_model, write_model
from ..files.temporary import folder_of_all
from ..linalg.basis import Basis
from ..linalg.blocks import apply, create_block, local_rows, random_block
from ..linalg.solvers.mumps import ORDERINGS, PORD, SOLVE_WIDTH, WIDTH_OPTION, orderings
from ..linalg.solvers.shifted import ShiftedSolver
from ..parallel import processor, startup
from ..parallel.failures import InputError, Owned, agreed
from ..parallel.memory import available_mb
from ..parallel.progress import Progress
from .workflow import workflow

NESTED = ("METIS", "SCOTCH")
COLUMNS = 32
WIDTHS = (16, 32, 64, 96, 128)  # columns that MUMPS may solve for at a time, of MANY
MANY = 128
WORTH = 0.9  # of the time, below which another width is worth a hint


@workflow
def bench(cells=(40, 16, 16), *, folder=None, comm=None, progress: Progress | None = None) -> dict:
    """Measure rates of factorisation, solves, products, orthogonalisation, writing and reading, on a block of
    hexahedra. Collective.

    Parameters
    ----------
    cells : sequence of 3 ints
        Hexahedra of the block along x, y and z.
    folder : str or PathLike, optional
        Where to try writing and reading; by default that of temporary files.

    Returns
    -------
    dict
        Rates and hints, plain numbers for a table or JSON.

    Raises
    ------
    InputError
        For a block that is too large, or a folder that cannot be written.
    """
    with agreed(comm):
        if folder is not None and not os.path.isdir(folder):
            raise InputError(f"--folder: found '{folder}', expected a folder that exists")
    with folder_of_all(comm, folder) as place:
        report = comm.bcast(_measure(cells, place, comm, progress))
    return report | {"hints": [*processor.hints(comm), *_hints(report)]}


def _measure(cells, folder, comm, progress):
    report = {"ranks": comm.size, "ranks_on_node": startup.ranks_on_node, "memory_mb_per_rank": available_mb(comm)}
    with solid(cells, comm=comm) as model, Owned(comm) as owned:
        report |= {"blas": processor.blas() or "unknown", "dofs": model.size, "nonzeros": model.nonzeros}
        # one factor, as a search makes it
        with progress.stage("factor"):
            solver = owned.owns(ShiftedSolver(model))
            solver.factor(-((2 * np.pi * 100.0) ** 2))
        record = solver.records[-1]
        report |= {
            "ordering": record.ordering,
            "analysis_seconds": record.analysis_seconds,
            "factor_seconds": record.factor_seconds,
            "factor_gflops": record.flops / record.factor_seconds / 1e9,
            "factor_entries_per_dof": record.factor_entries / model.size,
            "bytes_per_entry": record.memory_mb_used_total * 2**20 / record.factor_entries,
        }
        # solves by the number of columns; the first of each kind also sets up memory
        for columns in (1, COLUMNS):
            load, solution = random_block(model.K, columns), create_block(model.K, columns)
            with progress.stage("solve"):
                solver.solve(load, solution)
                before = record.solve_seconds, record.columns_solved
                solver.solve(load, solution)
            seconds = (record.solve_seconds - before[0]) / (record.columns_solved - before[1])
            report[f"solve_ms_per_column_of_{columns}"] = 1e3 * seconds
            report[f"solve_gflops_of_{columns}"] = 4 * record.factor_entries / seconds / 1e9
        report["residual"] = record.residual
        with progress.stage("solve"):
            load, solution = random_block(model.K, MANY), create_block(model.K, MANY)
            # many columns, by how many go at once
            report[f"solve_ms_per_column_of_{MANY}_by_width"] = {
                width: 1e3 * _solve_seconds(solver, load, solution, width) / MANY for width in WIDTHS
            }
        # what other orderings would take, then products and files
        solver.release()
        with progress.stage("orderings"):
            expected = solver.factors.expected((*orderings(), PORD))
        report["gflop_by_ordering"] = {ORDERINGS[number]: factor["flops"] / 1e9 for number, factor in expected.items()}
        solver.release()
        return report | _products(model, comm, progress) | _files(model, folder, comm, progress)


def _solve_seconds(solver, load, solution, width):
    """Return the better of two solves with so many columns at a time."""
    solver.factors.set_solve_width(width)
    record, seconds = solver.records[-1], []
    for _ in range(2):
        before = record.solve_seconds
        solver.solve(load, solution)
        seconds.append(record.solve_seconds - before)
    return min(seconds)


def _hints(report) -> list[str]:
    """Return advice that would make this machine faster."""
    hints = []
    if report["ordering"] not in NESTED:
        hints.append(
            f"MUMPS ordered by {report['ordering']}: large solids need about half the operations with METIS or Scotch; "
            "on Debian `apt-get install 'libmumps-ptscotch-[0-9]*'`, elsewhere build MUMPS with METIS"
        )
    widths = report[f"solve_ms_per_column_of_{MANY}_by_width"]
    best = min(widths, key=widths.get)
    if widths[best] < WORTH * widths[SOLVE_WIDTH]:
        hints.append(
            f"many columns are solved for fastest {best} at a time here, {widths[best]:.3g} ms each instead of "
            f"{widths[SOLVE_WIDTH]:.3g}: PETSC_OPTIONS='-shift_{WIDTH_OPTION} {best}'"
        )
    if report["ranks"] < (os.cpu_count() or 1):
        hints.append(
            f"{report['ranks']} ranks on a machine with {os.cpu_count()} cores: try mpiexec -n {os.cpu_count()}"
        )
    if pages := processor.small_pages():
        hints.append(pages)
    return hints


def _products(model, comm, progress):
    """Measure sparse times block, and the orthonormalisation of columns that are close to dependent."""
    block, product = random_block(model.K, COLUMNS), create_block(model.K, COLUMNS)
    with progress.stage("multiply"):
        apply(model.K, block, product)
        comm.Barrier()
        start = time.perf_counter()
        for _ in range(5):
            apply(model.K, block, product)
        comm.Barrier()
        seconds = (time.perf_counter() - start) / 5
    basis = Basis(model.M, room=COLUMNS)
    with local_rows(block) as rows:
        rows[:, 1::2] = rows[:, 0::2] + 1e-7 * rows[:, 1::2]
    with progress.stage("orthogonalise"):
        start = time.perf_counter()
        basis.extend(block)
        comm.Barrier()
        spent = time.perf_counter() - start
    return {
        "multiply_ms_per_column": 1e3 * seconds / COLUMNS,
        "multiply_gflops": 2 * model.nonzeros * COLUMNS / seconds / 1e9,
        "orthogonalise_ms_per_column": 1e3 * spent / COLUMNS,
        "orthogonality_loss": basis.defect(),
    }


def _files(model, folder, comm, progress):
    path = folder / "model.h5"
    with progress.stage("write"):
        start = time.perf_counter()
        write_model(path, model)
        written = time.perf_counter() - start
    with progress.stage("read"):
        start = time.perf_counter()
        read_model(path, comm).close()
        read = time.perf_counter() - start
    size = comm.bcast(path.stat().st_size if comm.rank == 0 else None) / 1e6
    return {"file_mb": size, "write_mb_per_second": size / written, "read_mb_per_second": size / read}
