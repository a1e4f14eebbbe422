"""What `python -m hpcred` shows: the linkage as SISO system in the chord frame, three rows of the paper's Table 1."""

import numpy as np

from ..analysis.error import error_integral, relative_error
from ..analysis.response import frequency_response
from ..formats.result_file import write_result
from ..reduction.krylov import Krylov, StaticCorrection
from ..reduction.modes import Modes
from ..reduction.reduce import reduce
from ..report.tables import show_table, show_timings, write_json
from .linkage import BAND, DAMPING, FRAME, LOAD, linkage

POINTS = 3001
ROUND_OFF = 1e-13  # deflation tolerance: all 14 vectors of row 1, the last of which are close to dependent
MODELS = {
    1: ("Krylov", "10 Hz (1), 150 Hz (5), 240 Hz (3), 300 Hz (1)",
        (Krylov(10, 1), Krylov(150, 5), Krylov(240, 3), Krylov(300, 1))),
    3: ("modal + frm", "modes 1-13, 0 Hz (0)", (Modes(count=13), StaticCorrection())),
    4: ("modal", "modes 1-14", (Modes(count=14),)),
}  # fmt: skip


def run_demo(comm, output, progress, json=None):
    """Reduce the linkage in three ways, print the table, write the first model to `output`. Collective."""
    frequencies = np.linspace(0.1, BAND[1], POINTS)
    rows = []
    with linkage(comm) as model:
        with progress.stage("full response", f"{POINTS} frequencies"):
            full = frequency_response(model, frequencies, FRAME, DAMPING)
        for number, (method, points, basis) in MODELS.items():
            with reduce(model, basis, FRAME, DAMPING, ROUND_OFF, progress=progress) as rom:
                errors = relative_error(full, frequency_response(rom, frequencies))
                rows.append(
                    [number, method, points, rom.size, error_integral(frequencies, errors), float(errors.max())]
                )
                if number == 1:
                    write_result(output, rom, model.dofs, comm=comm)
    columns = ["row of Table 1", "method", "modes, points (order)", "size", "Q", "largest eps"]
    show_table(
        comm,
        f"Stabilisation linkage, chord frame, force and displacement at node {LOAD[0]} in {LOAD[1]}, "
        f"{BAND[0]:g} to {BAND[1]:g} Hz",
        columns,
        rows,
    )
    write_json(comm, json, [dict(zip(columns, row, strict=True)) for row in rows])
    print(f"model of row 1 written to {output}")
    show_timings(comm, progress.summary())
