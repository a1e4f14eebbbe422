"""Find the holes and pins of a model file, as a table, as lines of a job, and as a picture."""

from __future__ import annotations

import numpy as np

from ..analysis.bores import TURN, Bore, bores_and_warnings
from ..files.model_file import read_model
from ..parallel.progress import Progress
from .pair_figures import check_figure
from .set_figure import draw_sets_of
from .workflow import workflow


@workflow
def bores_of_file(
    model, *, turn: float = TURN, figure=None, comm=None, progress: Progress | None = None
) -> dict:  # fmt: skip
    """Return the holes and pins of a model file, see find_bores. Collective.

    Parameters
    ----------
    model : str or PathLike
        A model file.
    turn : float
        Degrees of a cylinder that a hole or pin has at least.
    figure : str or PathLike, optional
        A .png, .svg or .pdf of the model with them in colours.

    Returns
    -------
    dict
        Plain numbers for a table or JSON: `bores`, a list of name, kind, centre, axis, start, end, radius and length in
        m, turn in degrees and nodes (how many), `job`, their lines for a job file, and `warnings`.

    Raises
    ------
    InputError
        For a model without the faces that they are found by.
    """
    check_figure(figure, comm, [model], progress)
    with progress.stage("read", str(model)):
        loaded = read_model(model, comm)
    with loaded:
        with progress.stage("bores"):
            bores, warnings = bores_and_warnings(loaded, turn)
        if figure is not None:
            with progress.stage("figure"):
                draw_sets_of(figure, loaded, {bore.name: np.array(bore.nodes) for bore in bores})
    rows = [
        {key: getattr(bore, key) for key in ("name", "kind", "centre", "axis", "start", "end", "radius", "length",
                                             "turn")} | {"nodes": len(bore.nodes)}
        for bore in bores
    ]  # fmt: skip
    return {"model": str(model), "bores": rows, "job": "\n".join(map(lines_of_job, bores)), "warnings": warnings}


def lines_of_job(bore: Bore) -> str:
    """Return the table [[interface]] of a bore, in TOML."""
    interface = bore.interface()
    key = "pin" if interface.nodes.pin is not None else "bore"
    start, end, radius = interface.nodes.surface
    at = [float(f"{coordinate:.9g}") for coordinate in interface.at]
    return (
        f'[[interface]]\nname  = "{interface.name}"\n'
        "# ends of the axis, radius; m\n"
        f"nodes = {{{key} = [{list(start)}, {list(end)}, {radius}]}}\n"
        f"at    = {at}\n"
    )
