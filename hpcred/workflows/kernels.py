"""Measure the kernels that OpenBLAS has for this processor, and keep the quickest for later runs.

Each is measured by a process of its own, since OpenBLAS chooses once, and since a process ends if its processor
lacks the instructions.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from ..examples.solid import solid
from ..linalg.solvers.shifted import ShiftedSolver
from ..parallel import kernels, processor, startup
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI, PETSc
from ..report.tables import write_json
from .children import SAFELY
from .workflow import workflow

SIZE, REPEATS = 1000, 3  # of the dense product; the best of so many counts
PATIENCE = 600.0  # seconds that a process may take
WORTH = 0.95  # of the time of OpenBLAS's own choice, below which another is worth it
LAUNCHERS = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "SLURM_", "I_MPI_", "MPI_", "HYDRA_")  # what ranks have of them
PROGRAM = ("import sys; sys.path[:] = [{root!r}, *filter(None, sys.path)]; "
           "from hpcred.workflows.kernels import measure; measure({cells})")  # fmt: skip


@workflow
def bench_kernels(cells=(40, 16, 16), *, save=False, comm=None) -> dict:
    """Compare the kernels that OpenBLAS has for this processor, in processor time of one rank.

    `table` has a row for each: GFlop/s of a dense product, seconds of a factor of a block of so many hexahedra, and
    their ratio to those of `own`, the kernels that OpenBLAS takes by itself. `quickest`: its own, unless others take
    less than 0.95 of the time. `save` keeps them for later runs of this user on this kind of processor; `kept` is what
    is kept. Collective. Raises InputError.
    """
    startup.start()
    choices, blas, kind = comm.bcast((processor.choices(), processor.blas() or "unknown", kernels.processor()))
    report = {"processor": kind, "blas": blas.partition(",")[0], "table": [], "why_none": None, "hints": []}
    if choices is None:
        report["why_none"] = why_none(blas)
        if save:
            raise InputError(f"--save: {report['why_none']}")
        return report
    with agreed(comm):
        if comm.rank == 0:
            report |= compared(choices, [_measured(cells, name) for name in (None, *choices)])
    report = comm.bcast(report)
    own, best = report["own"], report["quickest"]
    if save and best in kernels.NEEDS:  # not of a processor for which OpenBLAS has kernels of its own
        _keep(kernels.saved() | {kind: best}, comm)
    report["kept"] = kept = comm.bcast(kernels.saved().get(kind))
    if best not in (own, kept):
        report["hints"].append(
            f"the kernels {best} are quicker than {own}, which OpenBLAS takes by itself: `hpcred bench --save` keeps "
            "them for later runs"
        )
    return report


@workflow
def forget_kernels(*, comm=None) -> str | None:
    """Remove what is saved for this processor, and return its name; None: nothing was. A damaged file is removed.
    Collective. Raises InputError."""
    kind, known, damage = comm.bcast((kernels.processor(), kernels.saved(), kernels.damage()))
    name = known.pop(kind, None)
    if known and (name or damage):
        _keep(known, comm)
    elif name or damage:
        with agreed(comm):
            if comm.rank == 0:
                _remove(kernels.place())
    return name


def _remove(path):
    try:
        path.unlink()
    except OSError as error:
        raise InputError(f"{path}: cannot be removed ({error.strerror}); remove it by hand") from error


def why_none(blas) -> str:
    """Say why kernels cannot be chosen."""
    made = blas.partition(",")[0]
    built = f"{made} was built for one kind of processor" if made.startswith("OpenBLAS") else f"the BLAS is {made}"
    return f"{built}, not an OpenBLAS with DYNAMIC_ARCH: there are no kernels to choose"


def compared(choices, found) -> dict:
    """Make the table of measurements, the first with OpenBLAS's own choice; a text is how its process ended early."""
    own, *others = found
    if isinstance(own, str):
        raise InputError(f"the kernels cannot be measured: a process that factors ended with '{own}'")
    table = [
        {"kernels": name, "dgemm_gflops": item["dgemm_gflops"], "factor_seconds": item["factor_seconds"]}
        for name, item in zip(choices, others, strict=True)
        if not isinstance(item, str) and item["kernels"].lower() == name.lower()
    ]  # fmt: skip
    mine = next((row for row in table if row["kernels"].lower() == own["kernels"].lower()), own)
    for row in table:
        row["ratio"] = row["factor_seconds"] / mine["factor_seconds"]
    best = min((mine, *table), key=lambda row: row["factor_seconds"])
    return {
        "table": table, "own": mine["kernels"],
        "quickest": (best if best["factor_seconds"] < WORTH * mine["factor_seconds"] else mine)["kernels"],
        "not_here": [name for name in choices if name not in [row["kernels"] for row in table]],
    }  # fmt: skip


def _measured(cells, name):
    """What a process with these kernels measures, or how it ended, as by an instruction that is not there."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(LAUNCHERS)}
    environment |= {"OPENBLAS_NUM_THREADS": "1", "OMPI_MCA_ess_singleton_isolated": "1", "OMPI_MCA_pml": "ob1",
                    "OMPI_MCA_btl": "^tcp", "PYTHONSAFEPATH": "1"}  # fmt: skip
    environment.pop(kernels.TAKEN, None)
    environment[kernels.CORETYPE] = name or ""  # empty: OpenBLAS finds none of this name, and chooses
    program = PROGRAM.format(root=str(Path(__file__).parents[2]), cells=tuple(map(int, cells)))
    try:
        run = subprocess.run([sys.executable, *SAFELY, "-c", program], env=environment, stdin=subprocess.DEVNULL,
                             capture_output=True, text=True, timeout=PATIENCE)  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"no result after {PATIENCE:.0f} s"
    try:
        return json.loads(run.stdout.splitlines()[-1])
    except (ValueError, IndexError):
        return (run.stderr.splitlines() or [f"status {run.returncode}"])[-1]


def measure(cells):
    """Print what one process measures: its kernels, the rate of a dense product, and the time of a factor."""
    startup.start()
    entries = np.random.default_rng(0).standard_normal((SIZE, SIZE)).astype(PETSc.ScalarType)
    square = PETSc.Mat().createDense([SIZE, SIZE], array=entries, comm=MPI.COMM_SELF)
    product = square.matMult(square)
    seconds = min(_seconds(lambda: square.matMult(square, product)) for _ in range(REPEATS))
    found = {"kernels": processor.blas().rpartition(", ")[2], "dgemm_gflops": 2e-9 * SIZE**3 / seconds}
    with solid(cells, comm=MPI.COMM_SELF) as model:
        solver = ShiftedSolver(model)
        shifts = [-((2 * np.pi * frequency) ** 2) for frequency in (100.0, 200.0, 300.0, 400.0)]
        solver.factor(shifts[0])  # with the analysis, which is the same for all
        found["factor_seconds"] = min(_seconds(lambda shift=shift: solver.factor(shift)) for shift in shifts[1:])
        solver.release()
    print(json.dumps(found))


def _seconds(call):
    start = time.process_time()
    call()
    return time.process_time() - start


def _keep(known, comm):
    """Write the file of saved kernels anew. Collective."""
    path = kernels.place()
    with agreed(comm):
        if comm.rank == 0:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"{path.parent}: no folder for settings that can be made ({error.strerror}); "
                                 "set XDG_CONFIG_HOME") from error  # fmt: skip
            if kernels.damage():  # what is not of this program is not written over
                _remove(path)
    write_json(path, known, comm)
