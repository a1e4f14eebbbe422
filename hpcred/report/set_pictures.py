"""Draw sets of nodes in colours on the grey surface of a body, from two opposite sides."""

import numpy as np

from .figures import INK, new_figure, save_as
from .mode_pictures import (
    DOTS,
    EDGE,
    FINE,
    GAP,
    OUTLINE,
    WIDTH,
    View,
    axes_of_view,
    coarse,
    mean_length,
    paint,
    scale_bar,
    shades,
)
from .rasteriser import Canvas
from .surface import DrawnSurface

GREY = np.array([0.80, 0.80, 0.80])
# told apart with any colour vision (Okabe and Ito), and between each other
PALETTE = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#882255", "#117733", "#332288", "#aa4499")
MOST = 30  # sets of a legend
LINE, FOOT = 0.22, 0.5  # inches: of the legend, of the scale
HIDDEN = 0.3  # how much of its colour a node shows through the body


def draw_sets(path, surface: DrawnSurface, nodes: np.ndarray, sets: list, marks=(), kind: str = "png"):
    """Draw sets, (name, places in `nodes` (k,)) each, on the surface of a body whose nodes lie at `nodes` (v, 3) in m,
    and `marks` (name, point in m) of reference nodes; call it on one rank."""
    # two views, from the front and from behind, on one scale
    points = np.concatenate([surface.points, nodes, *(np.reshape(place, (1, 3)) for _, place in marks)])
    views = [axes_of_view(points, behind) for behind in (False, True)]
    extents = [np.ptp(points @ axes.T, axis=0)[:2].clip(1e-3 * max(np.ptp(points, axis=0).max(), 1e-12)) * 1.08
               for axes in views]  # fmt: skip
    room = np.max(extents, axis=0)
    # side by side where the body is tall, else one above the other
    beside = room[0] < 1.9 * room[1]
    wide = (WIDTH - 3 * GAP) / 2 if beside else WIDTH - 2 * GAP
    high = min(wide * room[1] / room[0], 5.0)
    # the foot has the names of the sets
    columns = 3 if max((len(name) for name, _ in sets), default=0) <= 34 else 1
    shown = min(len(sets), MOST) + (len(sets) > MOST)
    legend = LINE * -(-shown // columns) + 0.1
    tall = (high + GAP) * (1 if beside else 2) + FOOT + legend
    figure, colours = new_figure(figsize=(WIDTH, tall), dpi=DOTS), _colours(len(sets))
    # pixels are computed for each panel at a multiple of its size, and made coarse
    for k, axes in enumerate(views):
        width, height = (int(DOTS * FINE * length) // FINE * FINE for length in (wide, high))
        flat = points @ axes.T
        view = View(axes, min(width / room[0], height / room[1]), (flat.min(axis=0) + flat.max(axis=0)) / 2 @ axes,
                    width, height)  # fmt: skip
        left = GAP + (wide + GAP) * (k if beside else 0)
        bottom = FOOT + legend + (high + GAP) * (0 if beside else 1 - k)
        panel = figure.add_axes([left / WIDTH, bottom / tall, wide / WIDTH, high / tall])
        panel.set_axis_off()
        image = _render(surface, nodes, [members for _, members in sets], colours, view)
        panel.imshow(coarse(image), interpolation="nearest", aspect="auto")
        for name, place in marks:
            x, y, _ = view.screen(np.reshape(place, (1, 3)))[0] / FINE
            panel.plot([x], [y], "o", color=INK, markersize=5, markeredgecolor="white", markeredgewidth=1)
            panel.annotate(name, (x, y), xytext=(5, 5), textcoords="offset points", fontsize=9, color=INK,
                           parse_math=False, bbox={"facecolor": "white", "alpha": 0.7, "lw": 0, "pad": 1})  # fmt: skip
    # names, the scale, and the mark of reference nodes
    foot = figure.add_axes([0, 0, 1, (FOOT + legend) / tall], xlim=(0, WIDTH), ylim=(0, FOOT + legend))
    foot.set_axis_off()
    _legend(foot, sets, colours, columns, legend)
    scale_bar(foot, view.scale / (DOTS * FINE), GAP + 0.3, 0.2)
    if marks:
        foot.plot([4.0], [0.25], "o", color=INK, markersize=5)
        foot.text(4.12, 0.25, "reference node", fontsize=9, color=INK, va="center")
    save_as(figure, path, kind, DOTS)


def _legend(foot, sets, colours, columns, legend):
    """Draw names and numbers of nodes beside their colours, line by line."""
    rows = [(f"{name}: {len(members)} nodes", colour) for (name, members), colour in zip(sets, colours, strict=True)]
    if len(rows) > MOST:
        rows = [*rows[:MOST], (f"and {len(rows) - MOST} more", None)]
    for k, (text, colour) in enumerate(rows):
        x = 0.3 + (k % columns) * (WIDTH - 0.4) / columns
        y = FOOT + legend - LINE * (k // columns + 0.5)
        if colour is not None:
            foot.plot([x], [y], "s", color=colour, markersize=7, markeredgewidth=0)
        foot.text(x + 0.14, y, text, fontsize=9, color=INK, va="center", parse_math=False)


def _colours(count):
    """Return colours (count, 3) that differ as far as they can."""
    if count <= len(PALETTE):
        return [tuple(int(word[k : k + 2], 16) / 255 for k in (1, 3, 5)) for word in PALETTE[:count]]
    from matplotlib import colormaps

    hues = colormaps["hsv"](np.arange(count) * 0.618034 % 1.0)[:, :3]  # neighbours far from each other
    return [tuple(hue * (0.9 if k % 2 else 0.65)) for k, hue in enumerate(hues)]


def _render(surface, nodes, sets, colours, view):
    """Return the pixels (h, w, 3): faces with all corners in a set have its colour, the smaller set before the larger
    one."""
    canvas = Canvas(view.width, view.height)
    image = np.ones((view.height, view.width, 3))
    screen = view.screen(surface.points)
    near = 0.004 * max(view.width, view.height)
    # larger sets first, so that smaller ones are painted over them
    order = sorted(range(len(sets)), key=lambda k: -len(sets[k]))
    inside = {k: np.isin(surface.nodes, sets[k]) for k in order}
    if len(surface.triangles):
        canvas.fill(screen, surface.triangles)
        (y, x), number, _ = canvas.weights(screen, surface.triangles)
        colour = np.tile(GREY, (len(surface.triangles), 1))
        # faces with all corners in a set have its colour
        for k in order:
            colour[inside[k][surface.triangles].all(axis=1)] = colours[k]
        image[y, x] = colour[number] * shades(screen, surface.triangles)[number][:, None]
        if len(surface.edges) and mean_length(screen, surface.edges) > 7 * FINE:
            paint(image, canvas.strokes(screen, surface.edges, 1, near), EDGE, 0.4)
        paint(image, canvas.strokes(screen, surface.outline, FINE, near), OUTLINE, 0.75)
    else:
        paint(image, canvas.discs(screen, 3 * FINE, np.inf), GREY, 1.0)
    # nodes as discs, large where no face shows the set, pale where they are hidden
    for k in order:
        place = view.screen(nodes[sets[k]])
        faceless = not inside[k][surface.triangles].all(axis=1).any()
        size = (7 if faceless else 4) * FINE
        seen = canvas.discs(place, size, near)
        paint(image, canvas.discs(place, size, np.inf) & ~seen, colours[k], HIDDEN)
        if faceless:
            paint(image, seen, colours[k], 1.0)
    return image
