"""Pictures of shapes: what is hidden is hidden, colours are those of the displacement, and moving ones move."""

import numpy as np
import pytest
from bodies import block
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from PIL import Image

from hpcred.parallel.failures import InputError
from hpcred.report import mode_pictures
from hpcred.report.mode_pictures import (
    View,
    animate_shapes,
    axes_of_view,
    draw_shapes,
    draw_state,
    in_metres,
    render,
    round_length,
)
from hpcred.report.surface import surface_of


class Bending:
    """Two shapes of a block that is held at x = 0: its tip moves in z, and in y."""

    def __init__(self, cells=True):
        self.points, hexahedra = block(8, 2, 1, (1.0, 0.4, 0.2))
        self.nodes = np.arange(len(self.points)) + 1
        self.cells = {"hexahedron": hexahedra} if cells else {}
        self.names, self.frequencies, self.first = ["first", "second"], np.array([12.5, 2000.0]), 1
        self.mark_names, self.mark_points = ["tip"], np.array([[1.0, 0.2, 0.1]])

    def displacement(self, k):
        field = np.zeros_like(self.points)
        field[:, 2 - k] = 3.0 * self.points[:, 0] ** 2
        return field

    def mark_displacement(self, k):
        return 3.0 * np.eye(3)[[2 - k]]


def test_what_is_inside_a_body_is_not_seen():
    outer, cells = block(2, 2, 2)
    inner = 0.25 + 0.5 * outer
    body = surface_of(np.concatenate([outer, inner]), {"hexahedron": np.concatenate([cells, cells + len(outer)])})
    view = View(axes_of_view(outer), 110.0, np.full(3, 0.5), 200, 200)
    values = (body.nodes >= len(outer)).astype(float)  # 1 inside
    image = render(body, body.points, values, view)
    low, high = colormaps[mode_pictures.COLOUR_MAP]([0.0, 1.0])[:, :3]
    red_over_blue = image[..., 0] / image[..., 2]
    seen = image.min(axis=-1) < 0.99
    assert 0.3 < seen.mean() < 0.9
    assert (red_over_blue[seen] < 1.2).all() and high[0] / high[2] > 4 > low[0] / low[2]
    alone = surface_of(inner, {"hexahedron": cells})
    image = render(alone, inner, np.ones(len(alone.points)), view)
    assert (image[..., 0] / image[..., 2] > 3).mean() > 0.05  # and it would be seen


@pytest.mark.parametrize("cells", [True, False])
def test_a_picture(tmp_path, cells):
    shapes = Bending(cells)
    assert draw_shapes(tmp_path / "a.png", shapes) == ["first", "second"]
    first = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)
    assert first.shape[1] == 600 and (first.min(axis=2) < 250).mean() > 0.02
    assert draw_shapes(tmp_path / "b.png", shapes, [2]) == ["second"]
    assert draw_shapes(tmp_path / "c.svg", shapes, [1], "svg") == ["first"]
    drawn = (tmp_path / "c.svg").read_text()
    assert "<svg" in drawn and ("<!-- undeformed -->" in drawn) == cells  # points have no outline
    for wrong in ([3], [0], []):
        with pytest.raises(InputError, match="modes: found .*expected numbers from 1 to 2"):
            draw_shapes(tmp_path / "d.png", shapes, wrong)


@pytest.fixture
def eight_frames(monkeypatch):
    monkeypatch.setattr(mode_pictures, "FRAMES", 8)


@pytest.mark.usefixtures("eight_frames")
@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_a_moving_picture(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    assert animate_shapes(path, Bending(), None, kind) == ["first"]
    image, frames = Image.open(path), []
    for k in (0, 2, 4, 6):
        image.seek(k)
        frames.append(np.asarray(image.convert("RGB")).astype(int))
    assert image.n_frames == 8

    def differing(i, j):
        return (np.abs(frames[i] - frames[j]).max(axis=-1) > 40).mean()

    assert differing(0, 2) < 1e-3 < 0.01 < min(differing(0, 1), differing(1, 3))


def test_scale_bars_are_round():
    assert [round_length(x) for x in (0.99, 1.0, 4.9, 73.0)] == [0.5, 1.0, 2.0, 50.0]
    assert [in_metres(x) for x in (2.0, 0.05, 2e-5, 5e-8)] == ["2 m", "50 mm", "20 µm", "5e-08 m"]


def test_bodies_stand_upright():
    for thin in (None, 0, 1, 2):
        size = np.where(np.arange(3) == thin, 0.01, 1.0)
        axes = axes_of_view(np.array([[0, 0, 0], size]))
        assert axes @ axes.T == pytest.approx(np.eye(3)) and np.linalg.det(axes) == pytest.approx(1)
        assert axes[0, 2] == 0 and axes[1, 2] < -0.5 or thin == 2  # z is up
        assert axes[2, 2] < 0 and (thin is None or abs(axes[2, thin]) == np.abs(axes[2]).max())


class Stressed(Bending):
    """Uniaxial stress that grows with x, and is not known at x = 0."""

    def coordinates_of(self, k):
        return np.eye(2)[k]

    def stress(self, q):
        found = np.zeros((len(self.points), 6))
        found[:, 0] = 5e6 * q.sum() * self.points[:, 0]
        found[self.points[:, 0] == 0] = np.nan
        return found

    def moved(self, q):
        return self.displacement(0) * q[0], self.mark_displacement(0) * q[0]


def colours_of(path):
    """Shares of grey, and of the blue and the red end of the colours, among the pixels of the body."""
    image = np.asarray(Image.open(path).convert("RGB")).astype(int)[20:-60]  # without title and legend
    red, green, blue = np.moveaxis(image, -1, 0)
    grey = (np.ptp(image, axis=2) < 4) & (red > 50) & (red < 110)
    low, high = (blue > red + 40) & (green < 130), (red > green + 40) & (red > blue + 40)
    return grey.mean(), low.mean(), high.mean()


def test_the_page_has_the_colours_of_the_pictures():
    stops = [to_rgb(stop) for stop in mode_pictures.COLOUR_STOPS]
    known = colormaps[mode_pictures.COLOUR_MAP](np.linspace(0, 1, len(stops)))[:, :3]
    assert np.abs(known - stops).max() < 0.01


@pytest.mark.parametrize(("largest", "ticks"), [
    (166.5, [0, 50, 100, 150]), (1.0, [0, 0.5, 1]), (0.04, [0, 0.02, 0.04]), (99.0, [0, 20, 40, 60, 80]), (0.0, [0]),
])  # fmt: skip
def test_ticks_are_round(largest, ticks):
    assert mode_pictures.round_ticks(largest) == ticks


def test_stresses_are_drawn_grey_where_they_are_not_known(tmp_path):
    """Displacements are known everywhere; stresses of twice the coordinates have the same picture."""
    shapes = Stressed()
    draw_shapes(tmp_path / "moved.png", shapes, [1])
    draw_shapes(tmp_path / "stress.png", shapes, [1], colour="stress")
    draw_state(tmp_path / "state.png", shapes, np.array([0.5, 0.0]), "a title")
    names = ("moved", "stress", "state")
    (grey, *plain), (more, *stressed), state = (colours_of(tmp_path / f"{name}.png") for name in names)
    assert more > grey + 0.01 and min(*plain, *stressed) > 0.005
    assert state == pytest.approx((more, *stressed), abs=0.01)


def test_the_stress_of_a_rigid_shape_is_none(tmp_path):
    """Round-off is not drawn in the colours of its largest value."""
    shapes = Stressed()
    shapes.frequencies = np.array([1e-5, 2000.0])
    draw_shapes(tmp_path / "rigid.png", shapes, [1], colour="stress")
    _, low, high = colours_of(tmp_path / "rigid.png")
    assert low > 0.05 and high < 1e-3  # but for the mark


@pytest.mark.usefixtures("eight_frames")
def test_stresses_move(tmp_path):
    animate_shapes(tmp_path / "a.gif", Stressed(), None, "gif", "stress")
    assert Image.open(tmp_path / "a.gif").n_frames == 8
