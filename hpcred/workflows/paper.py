"""Reproduce Section 5: Tables 1 and 2 beside the paper's figures, Figures 3 to 5, and the numbers as data."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from ..examples.linkage import linkage
from ..examples.section5 import FREQUENCIES, MIMO, SISO, compare, deviations, lateral, table, time_response
from ..files.folders import folder_for
from ..files.hdf5 import writing
from ..files.outputs import JSON, PICTURES, check_outputs, hdf5_kind
from ..files.together import together
from ..parallel import startup
from ..parallel.declared import declared
from ..parallel.failures import InputError, agreed
from ..parallel.progress import Progress
from ..report.figures import cut_figure, error_figure
from ..report.tables import write_json
from .workflow import workflow

FIGURES = (SISO.figure, MIMO.figure, 5)


@workflow
def reproduce(
    folder="paper", *, figures: Iterable[int] = FIGURES, show: Callable[[dict], None] | None = None, comm=None,
    progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Compute and write the tables and figures of the paper's Section 5. Collective.

    The tables are written first; the simulations of Figure 5 take minutes.

    Parameters
    ----------
    folder : str or PathLike
        Created where needed.
    figures : iterable of int
        Of 3, 4 and 5.
    show : callable, optional
        Called with the tables as soon as they are written.

    Returns
    -------
    dict
        The tables as lists of dicts: table_1, table_2 and, with Figure 5, figure_5, as in section5.json.

    Raises
    ------
    InputError
        For other figures, and a folder that cannot be written.
    """
    startup.start(preferred="complex")
    folder, figures = Path(folder), declared("figures", figures, tuple[int, ...])
    if wrong := sorted(set(figures) - set(FIGURES)):
        raise InputError(f"figures: found {wrong[0]}, expected some of {', '.join(map(str, FIGURES))}")
    with folder_for(folder, comm, "output "):
        return _reproduced(folder, figures, show, comm, progress)


def _reproduced(folder, figures, show, comm, progress):
    """Compute and write everything into a folder. Collective."""
    written = {folder / "section5.h5": hdf5_kind("hpcred-section5"), folder / "section5.json": JSON}
    written |= {folder / f"figure_{number}{suffix}": PICTURES[suffix] for suffix in (".png", ".svg")
                for number in figures}  # fmt: skip
    check_outputs(written, comm, progress=progress)
    data, results = {}, {}
    with linkage(comm) as model:
        # tables come first, since figure 5 takes a simulation
        for setting in (SISO, MIMO):
            with progress.stage(f"table {setting.table}"):
                results[setting] = compare(model, setting)
            columns, rows = table(results[setting])
            data[f"table_{setting.table}"] = [dict(zip(columns, row, strict=True)) for row in rows]
        with together(comm):
            _write(folder, data, results, None, comm)
        if show is not None:
            show(data)
        with progress.stage("figures"), agreed(comm):
            for setting, reproduced in results.items():
                if comm.rank == 0 and setting.figure in figures:
                    curves = [(f"{r['row'].method}, Q = {r['Q']:.2g}", r["eps"]) for r in reproduced]
                    error_figure(
                        folder / f"figure_{setting.figure}", FREQUENCIES, curves,
                        f"Relative error of the reduced models, {setting.title.partition(':')[0]} case",
                    )  # fmt: skip
        # figure 5: the motion of each reduced model against that of the full one
        if 5 not in figures:
            return data
        with progress.stage("figure 5"):
            motions = time_response(model, progress)
    moved = [0.0, *deviations(motions)]
    columns = ["row", "method", "size", "largest |u_y - reference| (m)", "constraint drift (m)", "energy defect"]
    rows = [
        [row.number, row.method, motion.elastic.shape[1], deviation, motion.drift, motion.balance]
        for (row, motion), deviation in zip(motions, moved, strict=True)
    ]
    data["figure_5"] = [dict(zip(columns, row, strict=True)) for row in rows]
    with progress.stage("figures"), agreed(comm):
        if comm.rank == 0:
            curves = [
                (row.method + (f", deviation {deviation:.1e} m" if row.number else ""), lateral(motion))
                for (row, motion), deviation in zip(motions, moved, strict=True)
            ]
            cut_figure(folder / "figure_5", motions[0][1].t, curves, "Displacement of node 20 in y")
    with together(comm):
        _write(folder, data, results, motions, comm)
    return data


def _write(folder, data, results, motions, comm):
    """Write section5.h5 and section5.json, with the motions of Figure 5 unless they are None. Collective."""
    with writing(folder / "section5.h5", comm, "hpcred-section5") as file:
        file.small("frequencies", FREQUENCIES)
        for setting, rows in results.items():
            file.small(f"table_{setting.table}/methods", [r["row"].method for r in rows])
            file.small(f"table_{setting.table}/Q", np.array([r["Q"] for r in rows]))
            file.small(f"table_{setting.table}/eps", np.array([r["eps"] for r in rows]))
        if motions is not None:
            file.small("figure_5/t", motions[0][1].t)
            file.small("figure_5/methods", [row.method for row, _ in motions])
            file.small("figure_5/u_y", np.array([lateral(motion) for _, motion in motions]))
    write_json(folder / "section5.json", data, comm)
