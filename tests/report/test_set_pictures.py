"""Pictures of sets: each has its colour where it is seen, from one side or the other, and its name."""

import numpy as np
import pytest
from bodies import block
from PIL import Image

from hpcred.report.set_pictures import PALETTE, draw_sets
from hpcred.report.surface import surface_of


def share(path, colour):
    """How much of a picture has about the hue of a colour."""
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(float)
    target = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)], float)
    size = np.linalg.norm(pixels, axis=2) * np.linalg.norm(target)
    return float(((pixels @ target > 0.995 * size) & (np.ptp(pixels, axis=2) > 40)).mean())


@pytest.mark.parametrize("elements", [True, False])
def test_sets_on_opposite_sides_are_both_seen(tmp_path, elements):
    points, cells = block(6, 3, 2, (1.0, 0.4, 0.3))
    surface = surface_of(points, {"hexahedron": cells} if elements else {})
    ends = [(name, np.flatnonzero(points[:, 0] == x)) for name, x in (("left_$end", 0.0), ("right", 1.0))]
    draw_sets(tmp_path / "a.png", surface, points, ends, [("left_$end", points[0])])
    draw_sets(tmp_path / "b.png", surface, points, ends[:1])
    least = 0.01 if elements else 0.001
    assert share(tmp_path / "a.png", PALETTE[0]) > least and share(tmp_path / "a.png", PALETTE[1]) > least
    assert share(tmp_path / "b.png", PALETTE[1]) < 1e-4


def test_a_set_inside_of_a_larger_one_and_one_without_faces_are_seen(tmp_path):
    points, cells = block(6, 6, 6)
    surface = surface_of(points, {"hexahedron": cells})
    face = np.flatnonzero(points[:, 2] == 1.0)
    middle = np.flatnonzero((points[:, 2] == 1.0) & (np.abs(points[:, :2] - 0.5) < 0.2).all(axis=1))
    corner = np.flatnonzero(points.sum(axis=1) == 3.0)
    draw_sets(tmp_path / "a.png", surface, points, [("middle", middle), ("face", face), ("corner", corner)])
    found = [share(tmp_path / "a.png", colour) for colour in PALETTE[:3]]
    assert found[1] > found[0] > 0.002 and found[2] > 1e-4


def test_many_sets_have_a_legend_that_ends(tmp_path):
    points, cells = block(5, 5, 1)
    surface = surface_of(points, {"hexahedron": cells})
    sets = [(f"set {k}", np.arange(k, k + 3)) for k in range(60)]
    draw_sets(tmp_path / "a.svg", surface, points, sets, kind="svg")
    text = (tmp_path / "a.svg").read_text()
    assert "<!-- set 0: 3 nodes -->" in text and "<!-- and 30 more -->" in text and "set 31:" not in text
