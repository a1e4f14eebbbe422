"""Pixels against a loop over all pixels and triangles."""

import numpy as np

from hpcred.report.rasteriser import NOTHING, Canvas


def brute_force(points, triangles, width, height):
    """Depth of the nearest triangle at each pixel, one by one."""
    depth = np.full((height, width), np.inf)
    for a, b, c in points[triangles]:
        matrix = np.array([[a[0], b[0], c[0]], [a[1], b[1], c[1]], [1, 1, 1]])
        for y in range(height):
            for x in range(width):
                weights = np.linalg.solve(matrix, [x, y, 1])
                if weights.min() >= 0:
                    depth[y, x] = min(depth[y, x], weights @ [a[2], b[2], c[2]])
    return depth


def test_random_triangles():
    random = np.random.default_rng(1)
    points = random.uniform(-5, 35, (30, 3))
    triangles = random.permutation(30).reshape(10, 3)
    canvas = Canvas(32, 24)
    canvas.fill(points, triangles)
    expected = brute_force(points, triangles, 32, 24)
    seen = np.isfinite(expected)
    assert 100 < seen.sum() < seen.size
    assert np.array_equal(canvas.triangle != NOTHING, seen)
    assert np.abs(canvas.depth[seen] - expected[seen]).max() < 1e-9
    (y, x), number, weights = canvas.weights(points, triangles)
    place = (weights[..., None] * points[triangles[number]].transpose(1, 0, 2)).sum(axis=0)
    assert np.abs(place - np.stack([x, y, canvas.depth[y, x]], axis=1)).max() < 1e-9


def test_lines_and_dots_behind_are_hidden():
    canvas = Canvas(40, 20)
    points = np.array([(10, -50, 5), (10, 70, 5), (200, 10, 5), (0, 5, 9), (39, 5, 9), (0, 15, 1), (39, 15, 1.0)])
    canvas.fill(points, np.array([[0, 1, 2]]))
    shown = canvas.strokes(points, np.array([[3, 4], [5, 6]]), 1, 0.0)
    assert np.flatnonzero(shown[5]).tolist() == list(range(10)) and shown[15].all() and shown.sum() == 50
    assert canvas.strokes(points, np.array([[3, 4]]), 1, 4.5)[5].all()  # put in front
    assert canvas.discs(points[[3, 4]], 1).sum() == 1
