"""Compute the lowest natural frequencies of a model file, what mass each mode moves, and a picture of them."""

from __future__ import annotations

from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..analysis.natural_modes import NaturalModes, natural_modes
from ..body.preload import Preload
from ..files.hdf5 import atomic_output, reading, writing
from ..files.model_file import read_model, write_nodes
from ..files.result_file import Shapes
from ..linalg.blocks import local_rows
from ..linalg.solvers.settings import Factoring
from ..model.order_of_matrices import questions_on_order
from ..model.rigid_body.modes import exchange_of_matrices
from ..parallel import startup
from ..parallel.failures import InputError, agreed
from ..parallel.progress import Progress
from ..report.mode_pictures import draw_shapes
from .model_of_job import at_preload
from .pair_figures import check_figure
from .workflow import workflow

MOTIONS = ("x", "y", "z", "rx", "ry", "rz")
ROUND_OFF = 1e-12  # of a mass


@workflow
def modes_of_file(
    model, count: int = 20, *, frame=None, figure=None, factoring: Factoring | None = None,
    preload: Preload | None = None, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Return the lowest undamped modes of a model file. Collective.

    Parameters
    ----------
    model : str or PathLike
        A model file.
    count : int
        Number of modes.
    frame, factoring : optional
        See natural_modes.
    figure : str or PathLike, optional
        A .png of the first six elastic modes.
    preload : Preload, optional
        A constant load on a body of solids, which the matrices or the frame hold.

    Returns
    -------
    dict
        Plain numbers for a table or JSON: frequencies_hz (m), the number of rigid_body_modes, which come first at 0 Hz,
        and with nodes participation_factors (m, 6), effective_masses (m, 6) and masses (6) along x, y, z and about the
        axes through the centre of mass.

    Raises
    ------
    InputError, ComputationError
        For a model without real modes, and where they are not found.
    """
    check_figure(figure, comm, [model], progress, endings=(".png",))
    startup.start(preferred="real", low_rank=factoring is not None and factoring.low_rank is not None)
    with progress.stage("read", str(model)):
        loaded = at_preload(read_model(model, comm), preload, frame, factoring)
    with loaded, closing(natural_modes(loaded, count, frame, factoring=factoring, progress=progress)) as modes:
        report = {"model": str(model), "size": loaded.size, **_numbers(modes)}
        exchanged = exchange_of_matrices(loaded)
        asked = [exchanged] if exchanged else questions_on_order(loaded)
        report["warnings"] = [*asked, *loaded.remarks, *modes.warnings]
        if figure is not None:
            with progress.stage("figure"):
                _draw(figure, loaded, modes)
            report["figure"] = str(figure)
    return report | {"timing": asdict(progress.timing())}


def _numbers(modes: NaturalModes) -> dict:
    report = {"frequencies_hz": modes.frequencies.tolist(), "rigid_body_modes": modes.rigid, "residual": modes.residual}
    if modes.masses is not None:
        report |= {
            "motions": list(MOTIONS),
            "masses": modes.masses.tolist(),
            "effective_masses": modes.effective_masses.tolist(),
            "participation_factors": modes.participation.tolist(),
        }
    return report


def tables_of_modes(report) -> tuple[list[dict], list[dict]]:
    """Return rows for tables of modes.

    Motions without mass or inertia have no column, such as those out of the plane of a plane body, and rigid-body
    modes no row.

    Parameters
    ----------
    report : dict
        What modes_of_file returned.

    Returns
    -------
    tuple of 2 lists of dict
        Effective masses in % of the whole, and participation factors.
    """
    masses, factors = np.array(report["masses"]), np.array(report["participation_factors"])
    there = _moving(masses)
    share = np.divide(report["effective_masses"], masses, out=np.zeros_like(factors), where=there)
    factors[np.abs(factors) < np.sqrt(ROUND_OFF * masses)] = 0.0
    named = [{"mode": i, "f (Hz)": f} for i, f in enumerate(report["frequencies_hz"], 1)]
    rigid = slice(report["rigid_body_modes"], None)
    rows = [row | _by_motion(100 * values, 2, there) for row, values in zip(named, share, strict=True)][rigid]
    rows.append({"mode": "sum", "f (Hz)": ""} | _by_motion(100 * share.sum(axis=0), 2, there))
    return rows, [row | _by_motion(values, 5, there) for row, values in zip(named, factors, strict=True)][rigid]


def mass_in_words(report) -> str:
    """Return the masses and the moments of inertia as text, where there are any.

    Parameters
    ----------
    report : dict
        What modes_of_file returned.
    """
    masses = np.array(report["masses"])
    there = _moving(masses)
    sentences = []
    for quantity, unit, place in (("mass", "kg", slice(0, 3)), ("inertia", "kg m^2", slice(3, 6))):
        named = [f"{mass:.6g}" + ("" if there.all() else f" ({name})")
                 for name, mass, moves in list(zip(MOTIONS, masses, there, strict=True))[place] if moves]  # fmt: skip
        sentences.append(f"{quantity} {', '.join(named)} {unit}" if named else f"no {quantity}")
    return "; ".join(sentences)


def _moving(masses):
    """Return which motions (6,) have mass: a straight beam along x has no inertia about x, but round-off."""
    return masses > ROUND_OFF * np.repeat([masses[:3].max(), masses[3:].max()], 3)


def _by_motion(values, digits, there):
    return {
        name: round(value, digits) for name, value, moves in zip(MOTIONS, values.tolist(), there, strict=True) if moves
    }


def _draw(figure, model, modes):
    with (
        atomic_output(figure, model.comm) as temporary,
        shapes_of_modes(Path(f"{temporary}.h5"), model, modes) as shapes,
    ):
        if shapes is not None:
            draw_shapes(temporary, shapes)


@contextmanager
def shapes_of_modes(store, model, modes):
    """Yield the Shapes of the elastic modes on rank 0, None on the others, by way of the file `store`, which is read
    mode by mode, as a result is, and removed. Collective. Raises InputError."""
    comm, elastic = model.comm, modes.frequencies[modes.rigid :]
    if model.dofs is None or modes.shapes is None or not len(elastic):
        raise InputError("figure: no elastic mode with nodes to draw; ask for more modes, or convert --nodes")
    try:
        with writing(store, comm, "hpcred-shapes") as file:
            file.attribute("first_number", modes.rigid + 1)  # as in the table
            with local_rows(modes.shapes) as rows:
                columns = rows.real[:, rows.shape[1] - len(elastic) :]
                file.rows("basis/V", np.ascontiguousarray(columns.T), axis=1)
            file.small("reduced/frequencies", elastic)
            write_nodes(file, model)
        with agreed(comm):
            if comm.rank == 0:
                with reading(store, "hpcred-shapes") as file:
                    yield Shapes(file, model.name)
            else:
                yield None
    finally:
        if comm.rank == 0:
            store.unlink(missing_ok=True)
