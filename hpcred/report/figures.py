"""Draw figures of responses, errors and simulations, on rank 0. Matplotlib is imported when the first one is drawn."""

import os
import sys
from contextlib import contextmanager, nullcontext
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

import numpy as np

from ..files.hdf5 import atomic_output
from ..model.units import unit_of_response
from ..parallel.failures import InputError
from ..parallel.petsc import MPI
from ..simulation.simulation import AXES

MISSING = "figures need matplotlib: pip install 'hpcred[plots]'"
INK = "#333333"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")  # told apart with any colour vision (Okabe and Ito)
DASHES = ("-", "--", "-.", ":")
UNKNOWN = "SI units"  # of a response, where the names of its output and input do not tell them
FEW = 100  # frequencies up to which each is a dot


def has_matplotlib() -> bool:
    """Test whether figures can be drawn."""
    return find_spec("matplotlib") is not None


def _matplotlib():
    """Return the package, without a matplotlibrc of the working folder, which may be another user's and can name
    programs, unless who uses hpcred has loaded it before. Raises InputError when it is not installed."""
    unread = "matplotlib" not in sys.modules and os.path.exists("matplotlibrc")
    with _outside_the_working_folder() if unread else nullcontext():
        try:
            import matplotlib
        except ImportError as error:
            raise InputError(MISSING) from error
    return matplotlib


@contextmanager
def _outside_the_working_folder():
    """For the block; paths in it are not those of the user."""
    here = os.open(".", os.O_RDONLY)
    try:
        os.chdir(os.path.dirname(__file__))
        yield
    finally:
        os.fchdir(here)
        os.close(here)


def new_figure(**keywords):
    """Return an empty matplotlib Figure of which pyplot knows nothing, and which notebooks show; it needs no display.
    Raises InputError when matplotlib is not installed."""
    _matplotlib()
    import matplotlib.figure

    class Figure(matplotlib.figure.Figure):
        def _repr_png_(self):
            picture = BytesIO()
            self.savefig(picture, format="png", dpi=80)
            return picture.getvalue()

    return Figure(**keywords)


def add_grid(axes):
    """Draw the lines of the large ticks."""
    axes.grid(True, which="major", color="#dddddd", linewidth=0.6)


def legend_beside(axes, *entries, **style):
    """Draw the legend to the right of axes."""
    axes.legend(*entries, loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False, **style)


def error_figure(stem, frequencies, curves, title):
    """Draw eps over frequency, logarithmic, as stem.png and stem.svg. `curves`: (label, errors) pairs."""
    figure = new_figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.subplots()
    for (label, errors), colour, dash in zip(curves, COLOURS, DASHES, strict=False):
        marker = "." if len(frequencies) <= FEW else None  # of the frequencies that were solved at
        axes.semilogy(frequencies, errors, dash, color=colour, linewidth=1.1, marker=marker, label=label)
    axes.set(xlabel="frequency (Hz)", ylabel="relative error", title=title)
    axes.set_xlim(0, frequencies[-1])
    add_grid(axes)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, fontsize=9, frameon=False)
    save(figure, stem)


def cut_figure(stem, t, curves, title):
    """Draw displacements in mm over time, and below a cut-out where they differ most: stem.png and stem.svg.

    `curves`: (label, values in m) pairs, the reference first.
    """
    figure = new_figure(figsize=(7.5, 7.5), layout="constrained")
    whole, cut = figure.subplots(2)
    reference = curves[0][1]
    worst = int(np.argmax(np.max([np.abs(values - reference) for _, values in curves[1:]], axis=0)))
    width = (t[-1] - t[0]) / 40
    near = np.abs(t - t[worst]) <= width
    styles = zip((INK, *COLOURS), ("-", *DASHES[1:], (0, (5, 1, 1, 1, 1, 1))), strict=True)
    for (label, values), (colour, dash) in zip(curves, styles, strict=False):
        for axes, shown in ((whole, slice(None)), (cut, near)):
            thick = 2.2 if values is reference else 1.3
            axes.plot(t[shown], 1e3 * values[shown], linestyle=dash, color=colour, linewidth=thick, label=label)
    whole.set(title=title, xlim=(t[0], t[-1]))
    whole.axvspan(t[worst] - width, t[worst] + width, color="#eeeeee", zorder=0)
    cut.set(xlabel="time (s)", xlim=(t[near][0], t[near][-1]))
    for axes in (whole, cut):
        axes.set_ylabel("displacement (mm)")
        add_grid(axes)
    cut.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=9, frameon=False)
    save(figure, stem)


def motion_figure(path, motion):
    """Draw displacements, rotations, forces and moments of constraints and springs, and energies over time, as PNG."""

    def curves(names, values, least=0.0):
        """Of values (nt, k, 3), but for those that change by no more than `least`."""
        return [(f"{name} {a}", values[:, j, i]) for j, name in enumerate(names) for i, a in enumerate(AXES)
                if np.nanmax(values[:, j, i]) - np.nanmin(values[:, j, i]) > least]  # fmt: skip

    rotating = np.flatnonzero(motion.node_rotates)
    names = [f"node {name}" for name in motion.node_names]
    springs = [f"spring {name}" for name in motion.spring_names]
    panels = [
        ("displacement (m)", curves(names, motion.node_displacement, least=1e-9)),
        ("rotation (rad)", curves([names[j] for j in rotating], _without_jumps(motion.node_rotation[:, rotating]),
                                  least=1e-9)),
        ("constraint force (N)", list(zip(motion.constraint_names, motion.constraint_force.T, strict=True))),
        ("constraint moment (N m)", list(zip(motion.moment_names, motion.constraint_moment.T, strict=True))),
        ("spring force (N)", curves(springs, motion.spring_force)),
        ("spring moment (N m)", curves(springs, motion.spring_moment)),
        ("energy (J)", [(name, value) for name, value in motion.energies.items() if value.any()]),
    ]
    at_rest = [("energy (J)", list(motion.energies.items()))]
    time_figure(path, motion.t, [panel for panel in panels if panel[1]] or at_rest)


def _without_jumps(vectors):
    """Return rotation vectors (nt, k, 3), NaN behind a jump, so that no line is drawn there."""
    jump = np.linalg.norm(np.diff(vectors, axis=0), axis=-1) > np.pi
    return np.concatenate([vectors[:1], np.where(jump[..., None], np.nan, vectors[1:])])


def time_figure(path, t, panels, kind="png"):
    """Draw curves over time, one panel below the other. `panels`: (label of the axis, [(label, values)])."""
    figure = new_figure(figsize=(9.0, 2.9 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), sharex=True, squeeze=False)
    for (name, curves), panel in zip(panels, axes[:, 0], strict=True):
        for i, (label, values) in enumerate(curves):
            panel.plot(t, values, DASHES[i // len(COLOURS) % len(DASHES)], color=COLOURS[i % len(COLOURS)],
                       linewidth=1.1, label=label)  # fmt: skip
        panel.set_ylabel(name)
        add_grid(panel)
        legend_beside(panel)
    axes[-1, 0].set(xlabel="time (s)", xlim=(t[0], t[-1]))
    save_as(figure, path, kind)


FIGURES = (".png", ".svg", ".pdf")
MOST = 16  # curves of a response that can be told apart
DOTS = 150  # per inch


def kind_of_figure(path, endings=FIGURES) -> str:
    """Return png, svg or pdf by the ending of a name, in any case of letters. Raises InputError for others."""
    ending = Path(path).suffix.lower()
    if ending not in endings:
        raise InputError(f"figure {path}: expected a name that ends in {', '.join(endings)}")
    return ending[1:]


def save_as(figure, path, kind, dpi=None):
    """Write a figure as png, svg or pdf, without a date, so that the same numbers give the same file."""
    with _matplotlib().rc_context({"svg.hashsalt": "hpcred"}):
        figure.savefig(path, dpi=dpi or DOTS, format=kind, metadata={"Date": None} if kind == "svg" else None)


def draw_responses(figure, frequencies, curves, title, errors=None, tolerance=None, loads=()):
    """Draw magnitude and phase of responses over frequency on an empty figure, and below their estimated error.

    `curves`: (output, input, complex (F,)), of which the largest MOST are drawn. `errors`: frequencies (S,) and eps
    (S,), or None where nothing is known. `loads`: see unit_of_response.
    """
    largest = sorted(range(len(curves)), key=lambda i: -np.abs(curves[i][2]).max())[:MOST]
    curves = [curves[i] for i in sorted(largest)]
    units = [unit_of_response(*names, loads) or UNKNOWN for *names, _ in curves]
    rows = 2 if errors is None else 3
    panels = figure.subplots(rows, sharex=True, height_ratios=(3, 2, 1.5)[:rows])
    for place, ((output, input_, values), unit) in enumerate(zip(curves, units, strict=True)):
        style = {"linestyle": DASHES[place // len(COLOURS)], "color": COLOURS[place % len(COLOURS)], "linewidth": 1.1}
        label = f"{output}/{input_}" + (f" ({unit})" if len(set(units)) > 1 else "")
        draw_response(*panels[:2], frequencies, values, label=label, **style)
    panels[0].set_title(title, fontsize=10)
    panels[0].set_ylabel(f"|H| ({', '.join(dict.fromkeys(units))})")
    if errors is not None:
        panels[2].semilogy(errors[0], np.maximum(errors[1], 1e-18), color=INK, linewidth=1.0)
        panels[2].set_ylabel("estimated\nrelative error")
    if tolerance is not None:
        panels[2].axhline(tolerance, color=COLOURS[1], linewidth=1.0, linestyle="--")
        panels[2].annotate("tolerance", (0.995, tolerance), xycoords=("axes fraction", "data"), ha="right", va="top",
                           fontsize=8, color=COLOURS[1])  # fmt: skip
    panels[-1].set_xlabel("frequency (Hz)")
    if len(frequencies) > 1:
        panels[-1].set_xlim(*_limits(frequencies))
    for axes in panels:
        add_grid(axes)
    legend_beside(panels[0], title="output/input", title_fontsize=8)


def response_figure(path, frequencies, curves, eps, tolerance, title, loads=(), kind="png"):
    """Write the figure of draw_responses as a file, with `eps` (F,). `kind`: png, svg or pdf."""
    figure = new_figure(figsize=(9.0, 8.0), layout="constrained")
    draw_responses(figure, frequencies, curves, title, (frequencies, eps), tolerance, loads)
    save_as(figure, path, kind)


def driven_figure(path, frequencies, curves, title, kind="png"):
    """Write a figure of levels over frequency, a panel for each unit, and of their phases where they are complex.

    `curves`: (label, unit, (F,)), of which the largest MOST of each unit are drawn. `kind`: png, svg or pdf.
    """
    by_unit: dict[str, list] = {}
    for label, unit, values in sorted(curves, key=lambda curve: -np.abs(curve[2]).max()):
        if len(by_unit.setdefault(unit, [])) < MOST:
            by_unit[unit].append((label, values))
    turned = any(np.iscomplexobj(values) for *_, values in curves)
    rows = len(by_unit) + turned
    figure, place = new_figure(figsize=(9.0, 1.2 + 2.8 * rows), layout="constrained"), 0
    panels = figure.subplots(rows, sharex=True, squeeze=False)[:, 0]
    for axes, (unit, mine) in zip(panels, by_unit.items(), strict=False):
        for label, values in mine:
            style = _style(place, label, len(frequencies)) | ({"marker": "o"} if len(frequencies) == 1 else {})
            if turned:
                draw_response(axes, panels[-1], frequencies, values, label, **style)
            else:
                axes.semilogy(frequencies, np.where(values != 0, values, np.nan), label=label, **style)
            place += 1
        axes.set_ylabel(unit)
    panels[0].set_title(title, fontsize=10)
    if frequencies[0] > 0:
        panels[-1].set_xscale("log")
    _finish(figure, panels, frequencies, path, kind)


def draw_response(size, phase, frequencies, values, label, **style):
    """Draw one curve: the magnitude on the axes `size`, the angle on the axes `phase`."""
    size.semilogy(frequencies, np.where(values != 0, np.abs(values), np.nan), label=label, **style)
    angle = np.angle(values, deg=True)
    jump = np.flatnonzero(np.abs(np.diff(angle)) > 180) + 1  # no line from one end of the circle to the other
    phase.plot(np.insert(frequencies, jump, frequencies[jump]), np.insert(angle, jump, np.nan), **style)
    phase.set(ylabel="phase (degrees)", ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))


def pair_figure(path, curves, output, given, errors=(), loads=(), kind="png"):
    """Magnitude and phase of the response of an output to an input, by name, by several models, and below the relative
    error where `errors` are given.

    `curves`: (label, frequencies (F,) in Hz, complex (F,)); `errors`: (label, frequencies, (F,)). Those whose label
    ends in "full model", and errors that end in "measured", are dots where there are few. `loads`: see
    unit_of_response. `kind`: png, svg or pdf.
    """
    rows = 3 if errors else 2
    figure = new_figure(figsize=(7.5, 2.2 + 1.9 * rows), layout="constrained")
    panels = figure.subplots(rows, sharex=True, height_ratios=(3, 2, 2)[:rows])
    for place, (label, frequencies, values) in enumerate(curves):
        draw_response(*panels[:2], frequencies, values, label=label, **_style(place, label, len(frequencies)))
    unit = unit_of_response(output, given, loads) or UNKNOWN
    panels[0].set(title=f"output {output}, input {given}", ylabel=f"|H| ({unit})")
    if errors:
        _error_panel(panels[2], errors)
    _finish(figure, panels, curves[0][1], path, kind)


def errors_figure(path, curves, title, tolerance=None, kind="png"):
    """Relative errors over frequency. `curves`: ("result, estimate" or "result, measured", frequencies in Hz, (F,)),
    as in pair_figure; what belongs to one result has one colour."""
    figure = new_figure(figsize=(7.5, 4.2), layout="constrained")
    axes = figure.subplots()
    results = list(dict.fromkeys(label.rpartition(", ")[0] for label, _, _ in curves))
    _error_panel(axes, curves, tolerance, [results.index(label.rpartition(", ")[0]) for label, _, _ in curves])
    axes.set_title(title)
    _finish(figure, [axes], curves[0][1], path, kind)


def _style(place, label, count):
    full = label.endswith("full model")
    colour = INK if full else COLOURS[place % len(COLOURS)]
    if full and count > FEW:  # under the others
        return {"color": "#bbbbbb", "linestyle": "-", "linewidth": 3.5, "zorder": 1}
    if label.endswith(("full model", "measured")) and count <= FEW:
        return {"color": colour, "linestyle": "none", "marker": "o", "markersize": 4.5, "fillstyle": "none"}
    return {"color": colour, "linestyle": DASHES[place // len(COLOURS) % len(DASHES)], "linewidth": 1.2}


def _error_panel(axes, curves, tolerance=None, places=None):
    for place, (label, frequencies, errors) in zip(places or range(len(curves)), curves, strict=True):
        axes.semilogy(frequencies, np.where(np.asarray(errors) > 0, errors, np.nan), label=label,
                      **_style(place, label, len(frequencies)))  # fmt: skip
    if tolerance is not None:
        axes.axhline(tolerance, color=INK, linewidth=1.0, linestyle="--", label="tolerance")
    axes.set_ylabel("relative error")


def _limits(frequencies, logarithmic=False):
    """Begin the axis at 0 Hz if the band begins close to it."""
    low, high = frequencies[0], frequencies[-1]
    return (low if logarithmic or low > 0.05 * high else 0.0), high


def _finish(figure, panels, frequencies, path, kind):
    for axes in panels:
        add_grid(axes)
        axes.spines[["top", "right"]].set_visible(False)
        if axes.get_legend_handles_labels()[0]:
            legend_beside(axes)
    panels[-1].set_xlabel("frequency (Hz)")
    if len(frequencies) > 1:
        panels[-1].set_xlim(*_limits(frequencies, panels[-1].get_xscale() == "log"))
    save_as(figure, path, kind)


def save(figure, stem):
    """Write PNG and SVG."""
    for kind in ("png", "svg"):
        with atomic_output(f"{stem}.{kind}", MPI.COMM_SELF) as path:
            save_as(figure, path, kind)
