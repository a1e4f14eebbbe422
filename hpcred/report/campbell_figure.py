"""Draw Campbell diagrams: frequencies and damping ratios over a parameter, coloured by the direction of whirl."""

import numpy as np

from ..analysis.campbell_diagram import SPEEDS, Campbell
from ..analysis.whirl import in_words
from .figures import COLOURS, INK, add_grid, legend_beside, new_figure, save_as

STYLES = {"forward": (COLOURS[0], "-"), "backward": (COLOURS[1], "--"), "none": (INK, "-."), "unknown": (INK, "-")}
UNDAMPED = 1e-7  # per cent, below which it is round-off
RPM = np.pi / 30


def campbell_figure(path, diagram: Campbell, title, kind="png"):
    """Write the figure of draw_campbell as a file. `kind`: png, svg or pdf."""
    figure = new_figure(figsize=(9.0, 7.0), layout="constrained")
    draw_campbell(figure, diagram, title)
    save_as(figure, path, kind)


def draw_campbell(figure, diagram: Campbell, title):
    """Draw frequencies over the parameter on an empty figure, with the lines of the orders of its critical speeds and
    dots of the full model, and below the damping ratios where there is damping."""
    # what does not vibrate has a ratio of 100 or -100 %
    shown = (diagram.frequencies > 0) & (diagram.frequencies <= diagram.highest)
    ratios = np.where(shown, 100 * diagram.damping_ratios, np.nan)
    damped = np.nanmax(np.abs(ratios), initial=0.0) > UNDAMPED
    panels = figure.subplots(1 + damped, sharex=True, squeeze=False, height_ratios=(3, 2)[: 1 + damped])[:, 0]
    values, top = diagram.values, np.nanmax(diagram.frequencies, initial=0.0) or 1.0
    top = 1.05 * min(top, diagram.highest)
    # frequencies above, damping ratios below
    _curves(panels[0], diagram, diagram.frequencies)
    panels[0].set(ylabel="frequency (Hz)", xlim=(values[0], values[-1]), ylim=(0.0, top))
    if damped:
        _curves(panels[1], diagram, ratios)
        panels[1].set_ylabel("damping ratio (%)")
        panels[1].axhline(0.0, color=INK, linewidth=0.8)
    panels[0].set_title(title, fontsize=10)
    panels[-1].set_xlabel(f"{diagram.parameter} ({diagram.unit})" if diagram.unit else diagram.parameter)
    _orders(panels[0], diagram, top)
    # dots of the full model, and what is unstable
    for full, label in zip(diagram.full, ["full model"] + [None] * len(diagram.full), strict=False):
        style = {"marker": "o", "fillstyle": "none", "color": INK, "linestyle": "none", "markersize": 5}
        inside = full.frequencies <= diagram.highest
        at, moves = np.full(inside.sum(), full.value), full.frequencies[inside] > 0
        panels[0].plot(at, full.frequencies[inside], label=label, **style)
        if damped:
            panels[1].plot(at[moves], 100 * full.damping_ratios[inside][moves], **style)
    if diagram.stability_limit is not None:
        for axes in panels:
            axes.axvspan(diagram.stability_limit, values[-1], color=COLOURS[1], alpha=0.12, zorder=0, linewidth=0)
            axes.axvline(diagram.stability_limit, color=COLOURS[1], linewidth=1.0)
        panels[0].annotate("unstable", (diagram.stability_limit, 0.99 * top), (3, 0), textcoords="offset points",
                           va="top", fontsize=8, color=COLOURS[1])  # fmt: skip
    for axes in panels:
        add_grid(axes)
    if diagram.unit == "rad/s":
        above = panels[0].secondary_xaxis("top", functions=(lambda omega: omega / RPM, lambda rpm: rpm * RPM))
        above.set_xlabel("rpm", fontsize=8)
        above.tick_params(labelsize=8)
    legend_beside(panels[0])


def _curves(axes, diagram, heights):
    """Draw each mode in pieces of one direction of whirl."""
    labelled = set(axes.get_legend_handles_labels()[1])
    for k in range(heights.shape[1]):
        words = [in_words(orbit) for orbit in diagram.orbits[:, k]]
        start = 0
        for stop in range(1, len(words) + 1):
            if stop < len(words) and (words[stop] == words[start] or stop == 1):
                continue  # at the first value, of standstill, whirl begins
            word = words[stop - 1]
            colour, dash = STYLES[word]
            label = {"forward": "forward whirl", "backward": "backward whirl", "none": "no whirl"}.get(word, "mode")
            new = label not in labelled and np.isfinite(heights[start : stop + 1, k]).sum() > 1
            axes.plot(diagram.values[start : stop + 1], heights[start : stop + 1, k], dash, color=colour, linewidth=1.2,
                      label=label if new else None)  # fmt: skip
            labelled |= {label} if new else set()
            start = stop


def _orders(axes, diagram, top):
    """Draw the lines of multiples of the speed, and circles where modes cross them."""
    factor = SPEEDS.get(diagram.unit)
    for order in diagram.orders if factor is not None else ():
        line = np.abs(order * factor * diagram.values) / (2 * np.pi)
        axes.plot(diagram.values, line, ":", color="#777777", linewidth=1.0)
        out = diagram.values[-1] if line[-1] <= top else 2 * np.pi * top / (order * factor)
        if diagram.values[0] <= out:
            inside = line[-1] <= top
            axes.annotate(f"{order:g}x", (out, min(line[-1], top)), (-4, 3 if inside else -3), fontsize=8, ha="right",
                          textcoords="offset points", color="#777777", va="bottom" if inside else "top")  # fmt: skip
    critical = [speed for speed in diagram.critical_speeds if speed.frequency <= top]
    if critical:
        axes.plot([speed.value for speed in critical], [speed.frequency for speed in critical], "s", color=COLOURS[3],
                  markersize=5, label="critical speed")  # fmt: skip
