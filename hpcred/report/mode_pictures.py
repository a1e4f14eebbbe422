"""Draw pictures and animations of the shapes of a result, in colours of displacements or of stresses.

The surface is drawn with a depth buffer, which removes hidden surfaces and draws 10^5 nodes in seconds; titles, colour
bar, axes and scale bar are matplotlib's.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..body.stress import von_mises
from ..files.outputs import PDF, PICTURES, SVG
from ..parallel.failures import InputError
from ..writers.base import Writer
from .figures import COLOURS, INK, new_figure, save_as
from .rasteriser import Canvas
from .surface import DrawnSurface, surface_of

RIGID = 1e-6  # of the highest pseudo-frequency, below which a shape is a rigid-body motion
FIRST = 6  # shapes that a picture shows unless others are named
SWING = 0.10  # largest displacement in a picture, relative to the diagonal of the body
FRAMES = 24  # of an animation
DOTS, MOVING_DOTS = 150, 80  # per inch
FINE = 2  # pixels are drawn in each direction for one that is shown
WIDTH, TALLEST = 10.0, 3.4  # inches: of the figure, and of a panel at most
TITLE, FOOT, GAP = 0.32, 0.75, 0.12  # inches
ISOMETRIC = (0.5, -0.75, 0.45)
# from where bodies are seen, flat ones by the direction in which they are thin
FLAT = {0: (0.85, -0.4, 0.4), 1: (0.35, -0.85, 0.42), 2: (0.35, -0.6, 0.72)}
LIGHT = np.array([-0.35, -0.45, -0.82])  # direction towards the light in right, down, away from the viewer
ARROW = {"arrowstyle": "-|>", "color": INK, "lw": 1.0, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
OUTLINE, UNDEFORMED, EDGE = (0.13, 0.13, 0.13), (0.62, 0.62, 0.62), (0.25, 0.25, 0.25)
MARK = tuple(int(COLOURS[1][k : k + 2], 16) / 255 for k in (1, 3, 5))


# Blue over yellow to red of ColorBrewer: light and told apart by hue, so that shadow leaves it readable, where the dark
# end of viridis gets black; no grey in it, which stands for no value. The page has it without matplotlib.
COLOUR_MAP, NO_VALUE = "RdYlBu_r", (0.4, 0.4, 0.4)
COLOUR_STOPS = ("#313695", "#4575b4", "#74add1", "#abd9e9", "#e0f3f8", "#ffffbf", "#fee090", "#fdae61", "#f46d43",
                "#d73027", "#a50026")  # fmt: skip
COLOUR_BARS = {"displacement": "displacement / its largest", "stress": "von Mises stress / its largest"}
MEGAPASCAL = 1e6


@dataclass(frozen=True, kw_only=True)
class PictureOptions:
    """`colour`: of the surface, by the size of the displacement, or by von Mises' stress ("stress")."""

    colour: Literal["displacement", "stress"] = "displacement"


@dataclass(frozen=True)
class Panel:
    """A picture: displacements `field` (k, 3) of the nodes and `marks` (j, 3) of the interface nodes, and `values` (k,)
    of the colour, not below 0, NaN where there are none."""

    title: str
    field: np.ndarray
    marks: np.ndarray
    values: np.ndarray


class Picture(Writer):
    """Pictures of chosen shapes of the kind that is their name: png, svg, pdf, or moving ones: gif, webp."""

    needs, picture, options = "shapes", True, PictureOptions
    suffix = property(lambda self: f".{self.name}")
    kind = property(lambda self: PICTURES[self.suffix])

    def write(self, target, source):
        draw = animate_shapes if self.name in ("gif", "webp") else draw_shapes
        with source.shapes() as shapes:
            return draw(target, shapes, source.modes, self.name, source.options.colour)

    def describe(self, path):
        if self.kind in (SVG, PDF):
            return {"format": self.kind}
        from PIL import Image

        with Image.open(path) as image:
            size = f"{image.width} x {image.height} pixels"
            frames = getattr(image, "n_frames", 1)
            return {"format": f"{image.format} picture", "size": size, **({"frames": frames} if frames > 1 else {})}


def draw_shapes(path, shapes, modes=None, kind="png", colour="displacement") -> list[str]:
    """Draw shapes on the surface of the body; call it on one rank. Returns their names.

    `shapes`: see files.result_file.Shapes. `modes`: numbers from 1, by default the first six elastic ones. `colour`:
    see PictureOptions; the undeformed outline is grey. Raises InputError where there is no such shape, or no stress.
    """
    chosen = _chosen(shapes, modes, FIRST)
    save_as(_figure(shapes, _panels(shapes, chosen, colour), (COLOUR_BARS[colour], 1.0)), path, kind, DOTS)
    return [shapes.names[k] for k in chosen]


def figure_of_shapes(shapes, modes=None):
    """Return the picture of draw_shapes as a matplotlib Figure. Raises InputError."""
    return _figure(shapes, _panels(shapes, _chosen(shapes, modes, FIRST), "displacement"),
                   (COLOUR_BARS["displacement"], 1.0))  # fmt: skip


def draw_state(path, shapes, q, title: str, kind="png"):
    """Draw the body at coordinates q (m,) in colours of von Mises' stress; call it on one rank. Raises InputError."""
    field, marks = shapes.moved(q)
    stress = von_mises(shapes.stress(q))
    bar = "von Mises stress (MPa)", float(np.nanmax(stress, initial=0.0)) / MEGAPASCAL
    save_as(_figure(shapes, [Panel(title, field, marks, stress)], bar), path, kind, DOTS)


def _panels(shapes, chosen, colour) -> list[Panel]:
    """Return the pictures of shapes. Raises InputError where the result has no stress modes."""
    panels, start = [], first_elastic(shapes.frequencies)
    for k in chosen:
        field = shapes.displacement(k)
        values = np.linalg.norm(field, axis=1)
        if colour == "stress":  # that of a rigid-body motion is round-off
            values = von_mises(shapes.stress(shapes.coordinates_of(k))) * (k >= start)
        title = f"{k + shapes.first}:  {in_hertz(shapes.frequencies[k])}"
        panels.append(Panel(title, field, shapes.mark_displacement(k), values))
    return panels


def _figure(shapes, panels, bar):
    stage = _Stage(shapes, panels, bar, DOTS)
    figure, images = stage.figure()
    for k, image in enumerate(images):
        image.set_data(stage.picture(k, 1.0))
    return figure


def animate_shapes(path, shapes, modes=None, kind="gif", colour="displacement") -> list[str]:
    """Draw animations like draw_shapes: one period of each shape, repeated; by default of the first shape only."""
    new_figure()  # refused where there is no matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    chosen = _chosen(shapes, modes, 1)
    stage = _Stage(shapes, _panels(shapes, chosen, colour), (COLOUR_BARS[colour], 1.0), MOVING_DOTS)
    figure, images = stage.figure()
    canvas, frames = FigureCanvasAgg(figure), {}
    amplitudes = np.sin(2 * np.pi * np.arange(FRAMES) / FRAMES).round(12)
    for amplitude in amplitudes:
        if amplitude not in frames:  # most are passed twice
            for k, image in enumerate(images):
                image.set_data(stage.picture(k, amplitude))
            canvas.draw()
            frames[amplitude] = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    if kind == "gif":
        palette = frames[1.0].quantize(256, method=Image.Quantize.MEDIANCUT)
        frames = {key: frame.quantize(palette=palette, dither=Image.Dither.NONE) for key, frame in frames.items()}
    frames = [frames[amplitude] for amplitude in amplitudes]
    frames[0].save(path, format=kind, save_all=True, append_images=frames[1:], duration=60, loop=0)
    return [shapes.names[k] for k in chosen]


def _chosen(shapes, modes, first):
    """Return Columns, counted from 0."""
    count = len(shapes.names)
    if modes is None:
        start = first_elastic(shapes.frequencies)
        return list(range(start, min(start + first, count)))
    wrong = [k for k in modes if not 1 <= k <= count]
    if wrong or not modes:
        raise InputError(f"modes: found {', '.join(map(str, wrong)) or 'none'}, expected numbers from 1 to {count}")
    return [k - 1 for k in modes]


def first_elastic(frequencies) -> int:
    """Return the place of the first elastic shape: rigid-body motions come first in interface coordinates of a free
    body."""
    elastic = np.flatnonzero(frequencies > RIGID * frequencies.max(initial=0.0))
    return int(elastic[0]) if elastic.size else 0


@dataclass(frozen=True)
class View:
    """Seen from afar: `axes` (3, 3), rows right, down and away from the viewer; `scale` in pixels a metre; the point
    that is in the `middle` (3,) of width x height pixels."""

    axes: np.ndarray
    scale: float
    middle: np.ndarray
    width: int
    height: int

    def screen(self, points):
        """Return pixels right and down, and depth in pixels (v, 3)."""
        return (points - self.middle) @ self.axes.T * self.scale + [self.width / 2, self.height / 2, 0.0]


def axes_of_view(points, behind=False) -> np.ndarray:
    """Return Right, down and away (3, 3) for a body, z upwards; a flat body is seen from its broad side. `behind`: from
    the opposite side."""
    extent = np.ptp(points, axis=0)
    thin = int(extent.argmin())
    flat = extent[thin] < 0.2 * np.sort(extent)[1]
    towards = np.array(FLAT[thin] if flat else ISOMETRIC) * (-1.0 if behind else 1.0)
    away = -towards / np.linalg.norm(towards)
    right = np.cross(away, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(away, right), away])


class _Stage:
    """The body, the chosen shapes on its surface, and how they are laid out in one figure. `bar`: what the colours
    are, and the number at the end of their bar."""

    def __init__(self, shapes, panels, bar, dots):
        self.shapes, self.panels, self.bar, self.dots = shapes, panels, bar, dots
        self.surface = surface_of(shapes.points, shapes.cells)
        points = self.surface.points
        diagonal = max(np.linalg.norm(np.ptp(shapes.points, axis=0)), 1e-12)
        self.fields, self.values, self.marks = [], [], []
        for panel in panels:
            swing = SWING * diagonal / max(np.linalg.norm(panel.field, axis=1).max(initial=0.0), 1e-300)
            self.fields.append(swing * panel.field)
            self.marks.append(swing * panel.marks)
            self.values.append(panel.values / max(np.nanmax(panel.values, initial=0.0), 1e-300))
        axes = axes_of_view(points)
        seen = [(points + sign * field[self.surface.nodes]) @ axes.T for field in self.fields for sign in (-1, 0, 1)]
        low, high = np.min([s.min(axis=0) for s in seen], axis=0), np.max([s.max(axis=0) for s in seen], axis=0)
        room = np.maximum((high - low)[:2], 1e-3 * diagonal) * 1.06
        self.columns = self._columns(room[0] / room[1])
        self.rows = -(-len(panels) // self.columns)
        wide = (WIDTH - GAP * (self.columns + 1)) / self.columns
        self.panel = wide, min(wide * room[1] / room[0], TALLEST if self.columns > 1 else 1.6 * TALLEST)
        width, height = (int(dots * FINE * length) // FINE * FINE for length in self.panel)
        self.view = View(axes, min(width / room[0], height / room[1]), (low + high) / 2 @ axes, width, height)

    def _columns(self, aspect):
        """Return the number of panels per row that makes the figure nearly square."""
        if len(self.panels) == 1:
            return 1
        heights = {c: -(-len(self.panels) // c) * (TITLE + WIDTH / c / aspect) for c in (1, 2, 3)}
        fitting = [c for c in heights if heights[c] <= 0.95 * WIDTH]
        return min(fitting or [3])

    def figure(self):
        """Return an empty matplotlib figure with titles, axes, scale bar and colour bar, and its images, one a
        shape."""
        tall = self.rows * (self.panel[1] + TITLE) + FOOT
        figure = new_figure(figsize=(WIDTH, tall), dpi=self.dots)
        images = []
        for place, panel in enumerate(self.panels):
            row, column = divmod(place, self.columns)
            left = GAP + column * (self.panel[0] + GAP)
            bottom = FOOT + (self.rows - 1 - row) * (self.panel[1] + TITLE)
            axes = figure.add_axes([left / WIDTH, bottom / tall, self.panel[0] / WIDTH, self.panel[1] / tall])
            axes.set_axis_off()
            size = self.view.height // FINE, self.view.width // FINE
            images.append(axes.imshow(np.ones((*size, 3)), interpolation="nearest", aspect="auto"))
            axes.set_title(panel.title, fontsize=11, color=INK, pad=3)
        self._legend(figure, tall)
        return figure, images

    def _legend(self, figure, tall):
        axes = figure.add_axes([0, 0, 1, FOOT / tall], xlim=(0, WIDTH), ylim=(0, FOOT))
        axes.set_axis_off()
        # axes and a bar of length
        tip = self.view.axes[:2] * [[1], [-1]] * 0.24  # inches, of the unit vectors, up positive
        origin = np.array([0.42, 0.30])
        for name, end in zip("xyz", tip.T, strict=True):
            if np.linalg.norm(end) > 0.02:
                axes.annotate("", origin + end, origin, arrowprops=ARROW)
                axes.text(*(origin + end * (1 + 0.09 / np.linalg.norm(end))), name, fontsize=9, color=INK, ha="center",
                          va="center")  # fmt: skip
        scale_bar(axes, self.view.scale / (self.dots * FINE), 1.1, 0.28)
        # marks and lines
        left = 3.6
        if len(self.shapes.mark_points):
            axes.plot([left], [0.30], "o", color=MARK, markersize=5, markeredgewidth=0)
            axes.text(left + 0.12, 0.30, "interface node", fontsize=9, color=INK, va="center")
        if len(self.surface.outline):  # none of nodes without elements
            axes.plot([left + 1.3, left + 1.65], [0.30, 0.30], color=UNDEFORMED, linewidth=1.2)
            axes.text(left + 1.75, 0.30, "undeformed", fontsize=9, color=INK, va="center")
        # the bar of colours
        bar = figure.add_axes([(WIDTH - 3.0) / WIDTH, 0.27 / tall, 2.6 / WIDTH, 0.12 / tall])
        label, largest = self.bar
        bar.imshow(np.linspace(0, 1, 256)[None], cmap=COLOUR_MAP, aspect="auto", extent=(0, largest or 1.0, 0, 1))
        ticks = round_ticks(largest)
        bar.set(yticks=[], xticks=ticks, xticklabels=[f"{tick:g}" for tick in ticks])
        bar.tick_params(labelsize=8, length=2, pad=2, color=INK, labelcolor=INK)
        bar.set_title(label, fontsize=9, color=INK, pad=3)
        for spine in bar.spines.values():
            spine.set_linewidth(0.4)

    def picture(self, place, amplitude) -> np.ndarray:
        """Return pixels (h, w, 3) of a shape that is deflected by `amplitude` from -1 to 1."""
        field, size = self.fields[place], self.values[place] * abs(amplitude)
        moved = self.surface.points + amplitude * field[self.surface.nodes]
        marks = self.shapes.mark_points + amplitude * self.marks[place]
        return coarse(render(self.surface, moved, size[self.surface.nodes], self.view, marks))


def coarse(fine) -> np.ndarray:
    """Return the mean colours (h, w, 3) of FINE x FINE pixels each."""
    return fine.reshape(fine.shape[0] // FINE, FINE, fine.shape[1] // FINE, FINE, 3).mean(axis=(1, 3))


def render(surface: DrawnSurface, moved, values, view: View, marks=()) -> np.ndarray:
    """Return the pixels (h, w, 3), 0 to 1, of a surface whose points have moved to `moved` (v, 3).

    `values` (v,), 0 to 1, are its colour, grey where they are NaN; `marks` (k, 3): points that are marked, hidden
    or not.
    """
    from matplotlib import colormaps

    colours = colormaps[COLOUR_MAP].with_extremes(bad=NO_VALUE)
    canvas = Canvas(view.width, view.height)
    image = np.ones((view.height, view.width, 3))
    # the deflected surface: colours by value, shaded by its slope, hidden behind what is nearer
    screen = view.screen(moved)
    near = 0.004 * max(view.width, view.height)
    if len(surface.triangles):
        canvas.fill(screen, surface.triangles)
        (y, x), number, weights = canvas.weights(screen, surface.triangles)
        corners = surface.triangles[number].T
        shade = shades(screen, surface.triangles)
        image[y, x] = colours((weights * values[corners]).sum(axis=0))[:, :3] * shade[number][:, None]
        if len(surface.edges) and mean_length(screen, surface.edges) > 7 * FINE:
            paint(image, canvas.strokes(screen, surface.edges, 1, near), EDGE, 0.5)
    else:
        # without faces, the points, those behind first
        size = int(np.clip(np.sqrt(0.15 * view.width * view.height / len(screen)), 3 * FINE, 9 * FINE))
        order = np.argsort(-screen[:, 2], kind="stable")
        _splats(image, screen[order], colours(values[order])[:, :3], size)
    # the outline at rest, that of the deflected body, and the marks
    rest = view.screen(surface.points)
    paint(image, canvas.strokes(rest, surface.outline, FINE, near), UNDEFORMED, 0.9)
    if len(surface.edges):
        paint(image, canvas.strokes(screen, surface.outline, FINE, near), OUTLINE, 0.75)
    if len(marks):
        place = view.screen(np.asarray(marks))
        for width, colour in ((9 * FINE, (1.0, 1.0, 1.0)), (7 * FINE, MARK)):
            paint(image, canvas.discs(place, width, np.inf), colour, 1.0)
    return image


def shades(screen, triangles):
    """Return how bright triangles (t,) are, 0.5 to 1, by their normals towards the viewer."""
    a, b, c = (screen[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals *= np.where(normals[:, 2:] > 0, -1.0, 1.0)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    return 0.5 + 0.5 * np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)


def mean_length(screen, pairs):
    return np.linalg.norm(screen[pairs[:, 0], :2] - screen[pairs[:, 1], :2], axis=1).mean()


def paint(image, pixels, colour, cover):
    image[pixels] = (1 - cover) * image[pixels] + cover * np.array(colour)


def _splats(image, screen, colours, size):
    """Draw round dots from back to front, with a darker rim."""
    half = (size - 1) / 2
    height, width = image.shape[:2]
    dots = [(dx - half, dy - half) for dy in range(size) for dx in range(size)]
    dots = np.array([dot for dot in dots if np.hypot(*dot) <= size / 2])
    light = 1.0 - 0.45 * (np.hypot(*dots.T) / (size / 2)) ** 4
    for first in range(0, len(screen), max(1, 2**21 // len(dots))):  # the later ones lie in front
        chunk = slice(first, first + max(1, 2**21 // len(dots)))
        x = np.rint(screen[chunk, :1] + dots[:, 0]).astype(int)
        y = np.rint(screen[chunk, 1:2] + dots[:, 1]).astype(int)
        fits = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        image[y[fits], x[fits]] = (colours[chunk][:, None] * light[:, None])[fits]


def in_hertz(frequency) -> str:
    """Return a frequency in four digits."""
    return f"{frequency:.0f} Hz" if frequency >= 1000 else f"{frequency:.4g} Hz"


def scale_bar(axes, inch, left, height):
    """Draw a bar of a round length, with `inch` inches a metre, on axes in inches."""
    length = round_length(1.6 / inch)
    axes.plot([left, left + length * inch], [height] * 2, color=INK, linewidth=2.5, solid_capstyle="butt")
    axes.text(left + length * inch / 2, height + 0.07, in_metres(length), fontsize=9, color=INK, ha="center",
              va="bottom")  # fmt: skip


def round_length(length) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above a length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-12)) * power)


def round_ticks(largest) -> list[float]:
    """Return 0 and multiples of a round step up to `largest`, three to six in all; 0 alone where that is 0."""
    if not largest > 0:
        return [0.0]
    step = round_length(largest / 2)
    return [float(f"{k * step:.6g}") for k in range(int(largest / step * (1 + 1e-9)) + 1)]


def in_metres(length) -> str:
    """Return a round length with its unit."""
    for size, unit in ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm")):
        if length >= size * (1 - 1e-9):
            return f"{length / size:g} {unit}"
    return f"{length:g} m"
