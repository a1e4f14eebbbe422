"""Shapes to look at: those of a result with their points and elements enter, a picture of the first ones leaves."""

import numpy as np

from ..model.elements import edges
from ..parallel.failures import InputError
from .figures import COLOURS, pyplot

LINES = 20_000  # segments that a picture takes


def draw_shapes(path, shapes) -> list[str]:
    """A picture (PNG) of the first six shapes over the undeformed body; call it on one rank. Returns their names.

    `shapes` as for formats.vtk.write_vtk, with `frequencies` in Hz. Raises InputError without elements, and where they
    are too many for a picture.
    """
    plt = pyplot()
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    pairs = [cells[:, list(pair)] for kind, cells in shapes.cells.items() for pair in edges(kind)]
    if not pairs:
        raise InputError("no elements to draw; take format 'vtk', which shows the nodes as points")
    pairs = np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)
    if len(pairs) > LINES:
        raise InputError(f"{len(pairs)} edges are too many for a picture; take format 'vtk' and ParaView")
    extent = np.ptp(shapes.points, axis=0)
    count = min(6, len(shapes.names))
    figure = plt.figure(figsize=(10.0, 2.9 * -(-count // 3)), layout="constrained")
    for k in range(count):
        field = shapes.displacement(k)
        scale = 0.12 * np.linalg.norm(extent) / max(np.linalg.norm(field, axis=1).max(), 1e-300)
        moved = shapes.points + scale * field
        axes = figure.add_subplot(-(-count // 3), 3, k + 1, projection="3d")
        width = 0.6 if len(pairs) > 100 else 1.8
        axes.add_collection3d(Line3DCollection(shapes.points[pairs], colors="#bbbbbb", linewidths=width / 2))
        axes.add_collection3d(Line3DCollection(moved[pairs], colors=COLOURS[0], linewidths=width))
        room = np.stack(
            [np.minimum(shapes.points, moved).min(axis=0), np.maximum(shapes.points, moved).max(axis=0)]
        )
        middle, half = room.mean(axis=0), max(np.ptp(room, axis=0).max() / 2, 1e-12)
        lengths = np.maximum(np.ptp(room, axis=0) / 2, 0.15 * half)
        for limit, centre, length in zip(
            (axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, lengths, strict=True
        ):
            limit(centre - length, centre + length)
        axes.set_box_aspect(lengths, zoom=1.0)
        axes.set_axis_off()
        f = shapes.frequencies[k]
        axes.set_title(f"{f:.0f} Hz" if f >= 1000 else f"{f:.4g} Hz", fontsize=10)
    figure.savefig(path, dpi=120, format="png")
    plt.close(figure)
    return shapes.names[:count]
