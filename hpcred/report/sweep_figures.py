"""Draw figures of a sweep: error over size, over each key, and eps(f)."""

import re

from .figures import COLOURS, DASHES, FEW, INK, add_grid, legend_beside, new_figure, save

MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
MOST = 16  # curves that a legend can tell apart


def size_figure(stem, rows, series, error):
    """Draw `error` over the size, logarithmic, one colour for each `series(row)`, as stem.png and stem.svg.

    A line joins the best results of each size; the lowest one shows its worst direction.
    """
    figure, axes = _axes("coordinates", error, "Error over size")
    for i, (label, group) in enumerate(_grouped(rows, series)):
        best = {}
        for row in sorted(group, key=lambda row: -row[error]):
            best[row["size"]] = row
        sizes = sorted(best)
        style = _style(i)
        axes.plot([row["size"] for row in group], [_positive(row[error]) for row in group], style["marker"],
                  color=style["color"], markersize=4, alpha=0.5)  # fmt: skip
        axes.plot(sizes, [_positive(best[size][error]) for size in sizes], label=label, **style)
        for size in sizes:
            worst = (best[size].get("worst_direction") or "").rpartition(": ")[0]
            axes.annotate(worst, (size, _positive(best[size][error])), (3, 3), textcoords="offset points", fontsize=6,
                          color=style["color"])  # fmt: skip
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.margins(x=0.12, y=0.08)  # for the names of directions
    _finish(figure, axes, stem)


def key_figure(stem, rows, key, series, error):
    """Draw `error` over the values of a swept key, one line for each `series(row)`, as stem.png and stem.svg."""
    figure, axes = _axes(key, error, f"Error over {key}")
    groups = _grouped(rows, series)
    for i, (label, group) in enumerate(groups):
        group = sorted(group, key=lambda row: row[key])
        axes.plot([row[key] for row in group], [_positive(row[error]) for row in group], label=label, **_style(i))
    values = sorted({row[key] for row in rows})
    if values[0] > 0 and values[-1] > 30 * values[0]:
        axes.set_xscale("log")
    elif all(isinstance(value, int) for value in values) and len(values) <= MOST:
        axes.set_xticks(values)
    _finish(figure, axes, stem)


def curves_figure(stem, curves):
    """Draw eps over frequency of all runs, {label: (frequencies, eps)}, as stem.png and stem.svg."""
    figure, axes = _axes("frequency (Hz)", "relative error", f"Relative error of {len(curves)} reduced models")
    for i, (label, (frequencies, eps)) in enumerate(curves.items()):
        style = _style(i) | {"marker": "." if len(frequencies) <= FEW else None}  # of what was solved
        axes.plot(frequencies, [_positive(value) for value in eps], label=label, **style)
    _finish(figure, axes, stem)


def stem_of(key):
    """Return a key of a job in the name of a file."""
    return re.sub(r"[^\w.-]+", "_", key)


def _grouped(rows, series):
    groups = {}
    for row in rows:
        groups.setdefault(series(row), []).append(row)
    return list(groups.items())


def _positive(error):
    return max(error, 1e-18)


def _style(i):
    return {"color": (*COLOURS, INK)[i % 5], "linestyle": DASHES[i // 5 % len(DASHES)], "linewidth": 1.2,
            "marker": MARKS[i % len(MARKS)], "markersize": 4}  # fmt: skip


def _axes(x, y, title):
    figure = new_figure(figsize=(8.0, 5.0), layout="constrained")
    axes = figure.subplots()
    axes.set_yscale("log")
    axes.set(xlabel=x, ylabel={"eps": "largest relative error", "estimate": "estimated relative error"}.get(y, y),
             title=title)  # fmt: skip
    add_grid(axes)
    return figure, axes


def _finish(figure, axes, stem):
    handles, labels = axes.get_legend_handles_labels()
    if len(handles) > MOST:
        handles, labels = handles[:MOST], [*labels[: MOST - 1], f"{labels[MOST - 1]}, and {len(handles) - MOST} more"]
    if len(handles) > 1 or (handles and labels[0]):
        legend_beside(axes, handles, labels)
    save(figure, stem)
