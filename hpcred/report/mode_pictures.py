"""Shapes to look at: a result file with its basis enters, a file for ParaView or a picture of the first shapes leaves.

The stored basis is the diagonalised one (54), so its columns are the pseudo-modes; those of a two-sided projection are
called basis vectors. Both functions run on one rank and read one column at a time.
"""

import numpy as np

from ..formats.hdf5 import reading
from ..formats.result_file import FORMAT
from ..model.elements import edges
from ..parallel.failures import InputError

LINES = 20_000  # segments that a picture takes


class Shapes:
    """Points (nodes, 3), cells by kind as indices of points, and displacements of the columns, from an open file."""

    def __init__(self, file, name):
        if "basis/V" not in file or "dofs" not in file:
            raise InputError(
                f"{name}: no basis with node coordinates; reduce a model with nodes, and with write_basis = true"
            )
        node, self._direction = file["dofs/node"][...], file["dofs/direction"][...]
        self.nodes, first, self._place = np.unique(node, return_index=True, return_inverse=True)
        self.points = file["dofs/position"][...][first]
        self._basis = file["basis/V"]
        kind = "basis vector" if "basis/W" in file else "pseudo-mode"
        frequencies = file["reduced/frequencies"][...]
        width = len(str(len(frequencies)))
        self.names = [f"{kind} {k + 1:0{width}d}: {f:.6g} Hz" for k, f in enumerate(frequencies)]
        self.frequencies = frequencies
        self.cells = {}
        for key, cells in file.get("elements", {}).items():
            cells = cells[...]
            index = np.searchsorted(self.nodes, cells).clip(max=len(self.nodes) - 1)
            there = (self.nodes[index] == cells).all(axis=1)  # a frame may hold all dofs of a node
            self.cells[key] = index[there]

    def displacement(self, column) -> np.ndarray:
        """(nodes, 3); the translational dofs of a column."""
        values, moved = self._basis[column], self._direction < 3
        field = np.zeros((len(self.nodes), 3))
        field[self._place[moved], self._direction[moved]] = values[moved]
        return field


def write_vtk(result, path) -> list[str]:
    """A .vtu file with all columns as point data, and node numbers; returns the names. Raises InputError."""
    try:
        import meshio
    except ImportError as error:
        raise InputError("--format vtk needs meshio: pip install 'hpcred[vtk]'") from error
    with reading(result, FORMAT) as file:
        shapes = Shapes(file, result)
        data = {name: shapes.displacement(k) for k, name in enumerate(shapes.names)}
        cells = shapes.cells or {"vertex": np.arange(len(shapes.nodes))[:, None]}
        mesh = meshio.Mesh(shapes.points, list(cells.items()), {**data, "node": shapes.nodes})
        mesh.write(path, file_format="vtu")
    return shapes.names


def draw_shapes(result, path) -> list[str]:
    """A picture of the first six shapes over the undeformed body; returns their names. Raises InputError."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    from .figures import COLOURS, pyplot

    plt = pyplot()
    with reading(result, FORMAT) as file:
        shapes = Shapes(file, result)
        pairs = [cells[:, list(pair)] for kind, cells in shapes.cells.items() for pair in edges(kind)]
        if not pairs:
            raise InputError(f"{result}: no elements to draw; use --format vtk, which shows the nodes as points")
        pairs = np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)
        if len(pairs) > LINES:
            raise InputError(f"{result}: {len(pairs)} edges are too many for a picture; use --format vtk and ParaView")
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
