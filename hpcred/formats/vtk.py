"""A .vtu file for ParaView: the shapes of a result with their points and elements enter, one file leaves.

Shapes are those of the basis, whatever damping, inputs and outputs the reduced model has.
"""

import numpy as np


def write_vtk(path, shapes) -> list[str]:
    """Write all columns as point data, and the node numbers; call it on one rank. Returns the names of the columns.

    `shapes` has nodes (k,), points (k, 3), cells by kind (indices of points), names, and displacement(column) (k, 3).
    """
    import meshio  # slow to import

    data = {name: shapes.displacement(k) for k, name in enumerate(shapes.names)}
    cells = shapes.cells or {"vertex": np.arange(len(shapes.nodes))[:, None]}
    mesh = meshio.Mesh(shapes.points, list(cells.items()), {**data, "node": shapes.nodes})
    mesh.write(path, file_format="vtu")
    return list(shapes.names)
