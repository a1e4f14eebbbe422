"""Draw what is in memory for notebooks: responses of a reduced model, Campbell diagrams, the lowest modes of a model.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import PurePath
from typing import TYPE_CHECKING

from ..analysis.campbell_diagram import Campbell
from ..analysis.frequency_response import frequencies_to_draw, frequency_response, resonances_of
from ..analysis.natural_modes import natural_modes
from ..files.temporary import folder_of_all
from ..linalg.solvers.settings import Factoring
from ..model.frames import Frame
from ..model.second_order_model import SecondOrderModel, require_model
from ..parallel.declared import declared, spelled
from ..parallel.failures import InputError, agreed
from ..parallel.ranges import require_band
from ..reduction.interface_coordinates import elastic_part
from ..reduction.result.reduced_model import ReducedModel, as_measured
from ..report.campbell_figure import draw_campbell
from ..report.figures import MOST, draw_responses, new_figure
from ..report.mode_pictures import figure_of_shapes
from .evaluate import band_of
from .modes import shapes_of_modes
from .pair_figures import pairs_by_name, pairs_to_show

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RIGID = 6  # rigid-body modes that a free body may have


@spelled
def plot_response(
    reduced: ReducedModel, pairs: str | Sequence[str] | None = None, *, band: Sequence[float] | None = None
) -> Figure:
    """Draw the frequency response of a reduced model, and its estimated error where that is known. Collective.

    Parameters
    ----------
    reduced : ReducedModel
    pairs : str or list of str, optional
        Responses by name, such as "20:z/1:x" for the output 20:z under the input 1:x; by default those of all drive
        points, or the largest ones where no output is at an input. The 16 largest are drawn.
    band : (float, float), optional
        Hz; by default that of the reduction, or up to between the two highest pseudo-frequencies.

    Returns
    -------
    matplotlib.figure.Figure
        Notebooks show it; `savefig` writes it. No window of pyplot has it.

    Raises
    ------
    InputError
        If matplotlib is missing, a pair is unknown, or the band is none.

    Notes
    -----
    Interface coordinates of a free body are drawn without the rigid-body motion, and undamped models with the loss
    factor that the error was measured with.
    """
    reduced = elastic_part(declared("reduced", reduced, ReducedModel))
    figure = new_figure(figsize=(9.0, 7.0), layout="constrained")
    band = tuple(declared("band", band_of(reduced) if band is None else band, tuple[float, float]))
    require_band("band", band)
    pairs = declared("pairs", [pairs] if isinstance(pairs, str) else () if pairs is None else pairs, tuple[str, ...])
    for name in pairs:
        if "/" not in name and PurePath(name).suffix:
            raise InputError(f"pairs: found '{name}', which looks like a file; expected output/input such as 20:z/1:x. "
                             f"The figure is written by plot(...).savefig('{name}')")  # fmt: skip
    accuracy = reduced.record.accuracy if reduced.record is not None else None
    measured = reduced if accuracy is None else as_measured(reduced, accuracy)
    frequencies = frequencies_to_draw(band, resonances_of(measured))
    H, names = frequency_response(measured, frequencies), (reduced.output_names, reduced.input_names)
    drive = [(i, names[1].index(name)) for i, name in enumerate(names[0]) if name in names[1]]
    chosen = pairs_by_name(pairs, *names, "the model") or drive or pairs_to_show(H, *names, MOST)
    title = reduced.size_in_words if reduced.record is None else f"{reduced.record.model}: {reduced.size_in_words}"
    if accuracy is not None:
        title += f", {accuracy.measured}"
    curves = [(names[0][i], names[1][j], H[:, i, j]) for i, j in chosen]
    known = None if accuracy is None else (accuracy.frequencies, accuracy.eps)
    loads = reduced.record.loads if reduced.record is not None else ()
    draw_responses(figure, frequencies, curves, title, known, accuracy and accuracy.tolerance, loads)
    return figure


@spelled
def plot_campbell(found: Campbell, title: str | None = None) -> Figure:
    """Draw a Campbell diagram: frequencies, and damping ratios where there is damping, over the parameter.

    Parameters
    ----------
    found : Campbell
    title : str, optional
        By default what is known of stability.

    Returns
    -------
    matplotlib.figure.Figure
        Notebooks show it; `savefig` writes it. No window of pyplot has it.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    found = declared("found", found, Campbell)
    figure = new_figure(figsize=(9.0, 7.0), layout="constrained")
    draw_campbell(figure, found, found.sentence if title is None else declared("title", title, str))
    return figure


@spelled
def plot_modes(
    model: SecondOrderModel, count: int = 6, *, frame: Frame | None = None, factoring: Factoring | None = None
) -> Figure | None:
    """Draw the lowest elastic modes of a model with nodes, on the surface of its elements. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        With nodes; without elements every node is a dot.
    count : int, default 6
        How many elastic modes.
    frame : Frame, optional
        Reference frame of a free body; by default it is free, and its rigid-body modes are left out.
    factoring : Factoring, optional
        How to factor.

    Returns
    -------
    matplotlib.figure.Figure or None
        On rank 0; None on the others. Colour is the size of the displacement; the undeformed outline is grey.

    Raises
    ------
    InputError
        If matplotlib is missing, or the model has no nodes or no elastic mode.

    Notes
    -----
    Shapes go through a temporary file, in the working folder where ranks are on several nodes, so that one rank holds
    one of them at a time.
    """
    require_model(model)
    with agreed(model.comm):
        new_figure()  # refused early where there is none
    if declared("count", count, int) < 1:
        raise InputError(f"count: found {count}, expected at least 1")
    if model.dofs is None:
        raise InputError(f"{model.name} has no nodes to draw; convert it with --nodes, or give dofs in Python")
    wanted = min(count + RIGID, max(count, model.size - RIGID))
    figure = None
    with closing(natural_modes(model, wanted, frame, factoring=factoring)) as modes:
        elastic = len(modes.frequencies) - modes.rigid
        with folder_of_all(model.comm) as folder, shapes_of_modes(folder / "shapes.h5", model, modes) as shapes:
            if shapes is not None:
                figure = figure_of_shapes(shapes, range(1, min(count, elastic) + 1))
    return figure
