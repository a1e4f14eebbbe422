"""sim.toml enters, with the result.h5 that it names; simulation.h5, a .csv and a picture leave."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..formats.hdf5 import atomic_output
from ..formats.outputs import CSV_OF_MOTION, PNG, check_outputs, hdf5_kind
from ..formats.result_file import read_result
from ..formats.simulation_file import FORMAT, read_simulation, write_motion, write_motion_csv
from ..multibody.simulation import simulate
from ..parallel import startup
from ..parallel.failures import agreed
from ..parallel.petsc import MPI
from ..parallel.progress import Progress
from ..reduction.record import versions
from ..report.figures import has_matplotlib, motion_figure


def simulate_file(path, *, overrides=(), comm=None, progress=None) -> dict:
    """Simulate a reduced body in time as a file says. Collective. Raises InputError, ComputationError.

    `overrides`: texts "key.path=value" that replace keys of the file. Rank 0 computes. Returns a summary: the files
    written, the largest errors and displacements, and notes on what was changed or approximated.
    """
    comm = comm or startup.start_mpi()
    progress = progress or Progress(comm, show=False)
    with agreed(comm):
        setup = read_simulation(path, overrides)
    output = Path(setup.output)
    written = {output: hdf5_kind(FORMAT), output.with_suffix(".csv"): CSV_OF_MOTION}
    if has_matplotlib():
        written[output.with_suffix(".png")] = PNG
    check_outputs(written, comm, [path, setup.body], progress=progress)
    motion = None
    with progress.stage("simulate", setup.body), agreed(comm):  # a stage loads PETSc, on all ranks together
        if comm.rank == 0:
            body = read_result(setup.body, MPI.COMM_SELF).body(setup.nodes)
            motion = simulate(body, setup, progress)
    motion = comm.bcast(motion)
    files = [(output.with_suffix(".csv"), write_motion_csv)]
    notes = list(motion.notes)
    if comm.bcast(has_matplotlib()):
        files.append((output.with_suffix(".png"), motion_figure))
    else:
        notes.append("no picture was drawn, which needs matplotlib: pip install 'hpcred[plots]'")
    report = {"output": [str(output), *(str(name) for name, _ in files)], **_figures(motion), "notes": notes}
    with progress.stage("write", str(output)):
        record = {"versions": versions(), "setup": asdict(setup), **report, "timing": asdict(progress.timing())}
        write_motion(output, motion, record, comm)
        for target, write in files:
            with atomic_output(target, comm) as temporary, agreed(comm):
                if comm.rank == 0:
                    write(temporary, motion)
    return report


def _figures(motion):
    return {
        "constraint_drift_m": motion.drift,
        "energy_defect": motion.balance,
        "factorisations": motion.factorisations,
        "largest_displacement_m": {
            str(node): float(np.linalg.norm(motion.node_displacement[:, i], axis=-1).max())
            for i, node in enumerate(motion.nodes)
        },
    }
