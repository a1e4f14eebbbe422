"""Reproduce Section 5: Tables 1 and 2 beside the paper's figures, Figures 3 to 5, and the numbers as data."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..examples.linkage import linkage
from ..examples.section5 import FREQUENCIES, MIMO, SISO, compare, deviations, lateral, table, time_response
from ..files.folders import folder_for
from ..files.hdf5 import writing
from ..files.outputs import JSON, PICTURES, check_outputs, hdf5_kind
from ..files.together import together
from ..parallel import startup
from ..parallel.failures import agreed
from ..parallel.progress import Progress
from ..report.figures import cut_figure, error_figure
from ..report.tables import write_json
from .workflow import workflow


@workflow
def reproduce(folder="paper", *, comm=None, progress: Progress | None = None) -> dict:
    """Compute and write everything into `folder`, which is created. Collective. Raises InputError.

    Returns the tables as lists of dicts: table_1, table_2 and figure_5, as in section5.json.
    """
    startup.start(preferred="complex")
    folder = Path(folder)
    with folder_for(folder, comm, "output "), together(comm):
        return _reproduced(folder, comm, progress)


def _reproduced(folder, comm, progress):
    """Compute and write everything into a folder. Collective."""
    written = {folder / "section5.h5": hdf5_kind("hpcred-section5"), folder / "section5.json": JSON}
    written |= {folder / f"figure_{number}{suffix}": PICTURES[suffix] for suffix in (".png", ".svg")
                for number in (SISO.figure, MIMO.figure, 5)}  # fmt: skip
    check_outputs(written, comm, progress=progress)
    data, results = {}, {}
    with linkage(comm) as model:
        for setting in (SISO, MIMO):
            with progress.stage(f"table {setting.table}"):
                results[setting] = compare(model, setting)
            columns, rows = table(results[setting])
            data[f"table_{setting.table}"] = [dict(zip(columns, row, strict=True)) for row in rows]
        with progress.stage("figure 5"):
            motions = time_response(model, progress)
    moved = deviations(motions)
    columns = ["row", "method", "size", "largest |u_y - reference| (m)", "constraint drift (m)", "energy defect"]
    rows = [
        [row.number, row.method, motion.elastic.shape[1], deviation, motion.drift, motion.balance]
        for (row, motion), deviation in zip(motions, [0.0, *moved], strict=True)
    ]
    data["figure_5"] = [dict(zip(columns, row, strict=True)) for row in rows]
    with progress.stage("figures"), agreed(comm):
        if comm.rank == 0:
            for setting, found in results.items():
                curves = [(f"{r['row'].method}, Q = {r['Q']:.2g}", r["eps"]) for r in found]
                error_figure(
                    folder / f"figure_{setting.figure}", FREQUENCIES, curves,
                    f"Relative error of the reduced models, {setting.title.partition(':')[0]} case",
                )  # fmt: skip
            curves = [
                (row.method + (f", deviation {deviation:.1e} m" if row.number else ""), lateral(motion))
                for (row, motion), deviation in zip(motions, [0.0, *moved], strict=True)
            ]
            cut_figure(folder / "figure_5", motions[0][1].t, curves, "Displacement of node 20 in y")
    with writing(folder / "section5.h5", comm) as file:
        file.attribute("format", "hpcred-section5")
        file.small("frequencies", FREQUENCIES)
        for setting, found in results.items():
            file.small(f"table_{setting.table}/methods", [r["row"].method for r in found])
            file.small(f"table_{setting.table}/Q", np.array([r["Q"] for r in found]))
            file.small(f"table_{setting.table}/eps", np.array([r["eps"] for r in found]))
        file.small("figure_5/t", motions[0][1].t)
        file.small("figure_5/methods", [row.method for row, _ in motions])
        file.small("figure_5/u_y", np.array([lateral(motion) for _, motion in motions]))
    write_json(folder / "section5.json", data, comm)
    return data
