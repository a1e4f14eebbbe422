"""Bodies to draw: points and elements."""

import numpy as np


def block(n, m, l, size=(1.0, 1.0, 1.0)):
    """Points and hexahedra of a block."""
    axes = [np.linspace(0, edge, count + 1) for edge, count in zip(size, (n, m, l), strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    i = np.arange(len(points)).reshape(n + 1, m + 1, l + 1)
    a, b = slice(None, -1), slice(1, None)
    places = [(a, a, a), (b, a, a), (b, b, a), (a, b, a), (a, a, b), (b, a, b), (b, b, b), (a, b, b)]
    return points, np.stack([i[place].ravel() for place in places], axis=1)
