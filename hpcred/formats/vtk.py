"""Files for ParaView: the shapes of a result with their points and elements enter, one .vtu leaves, or with a motion a
.pvd and one .vtu a time.

Shapes are those of the basis, whatever damping, inputs and outputs the reduced model has. Names of arrays have only
letters, digits, dots and underscores, which every part of ParaView takes.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

AT_ONCE = 2**25  # numbers of displacements that are held at a time


def write_vtk(path, shapes) -> list[str]:
    """Write all columns as point data, and the node numbers; call it on one rank. Returns the names of their arrays.

    `shapes` has nodes (k,), points (k, 3), cells by kind (indices of points), names, and displacement(column) (k, 3).
    """
    data = {array_name(name): shapes.displacement(k) for k, name in enumerate(shapes.names)}
    _write_mesh(path, shapes.points, _cells(shapes), {**data, "node": shapes.nodes})
    return list(data)


def array_name(name: str) -> str:
    """A name without blanks, colons and hyphens: pseudo_mode_07_123.4_Hz."""
    return re.sub(r"[^A-Za-z0-9.]+", "_", name)


def write_motion_vtk(path, folder, shapes, motion, origin):
    """Write a Motion as a .pvd and the .vtu of its times, which lie in `folder`; call it on one rank.

    Points are where the nodes are, in inertial axes; point data are the `displacement` since the start, the part of it
    that is `elastic`, and the numbers of the nodes. `origin` (3,) of the body frame in the axes of the model.
    """
    folder = Path(folder)
    cells, local = _cells(shapes), shapes.points - origin
    axes = Rotation.from_quat(np.roll(motion.quaternion, -1, axis=1)).as_matrix()  # scalar last there
    file = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(file, "Collection")
    start, digits = None, len(str(len(motion.t)))
    step = max(1, AT_ONCE // max(local.size, 1))
    for first in range(0, len(motion.t), step):
        q = motion.elastic[first : first + step]
        elastic = np.zeros((len(q), *local.shape))
        for k in range(q.shape[1]):
            elastic += q[:, k, None, None] * shapes.column(k)
        for i, u in enumerate(elastic, first):
            place = motion.position[i] + (local + u) @ axes[i].T
            start = motion.position[0] + local @ axes[0].T if start is None else start
            name = f"{folder.name}_{i:0{digits}d}.vtu"
            data = {"displacement": place - start, "elastic": u @ axes[i].T, "node": shapes.nodes}
            _write_mesh(folder / name, place, cells, data)
            ElementTree.SubElement(collection, "DataSet", timestep=repr(float(motion.t[i])), part="0",
                                   file=f"{folder.name}/{name}")  # fmt: skip
    ElementTree.ElementTree(file).write(path, encoding="utf-8", xml_declaration=True)


def _cells(shapes):
    return shapes.cells or {"vertex": np.arange(len(shapes.nodes))[:, None]}


def _write_mesh(path, points, cells, data):
    import meshio  # slow to import

    meshio.Mesh(points, list(cells.items()), data).write(path, file_format="vtu")
