"""Write the shapes of a result for ParaView as one .vtu.

Shapes are those of the basis, whatever damping, inputs and outputs the reduced model has. Names of arrays have only
letters, digits, dots and underscores, which every part of ParaView takes.
"""

import re
import struct
from base64 import b64decode, b64encode
from collections import Counter
from xml.etree import ElementTree

import numpy as np

from ..files.outputs import VTK
from ..parallel.failures import InputError
from .base import Writer

TYPES = {  # of cells in VTK, whose nodes have the order of model.elements
    "vertex": 1, "line": 3, "triangle": 5, "quad": 9, "tetra": 10, "hexahedron": 12, "wedge": 13, "pyramid": 14,
    "line3": 21, "triangle6": 22, "quad8": 23, "tetra10": 24, "hexahedron20": 25, "wedge15": 26,
}  # fmt: skip
GROUPS = ("PointData", "CellData", "Points", "Cells")
NUMBERS = {"f": ("Float64", "<f8"), "i": ("Int64", "<i8"), "u": ("UInt8", "u1")}  # by the letter of NumPy


def array_name(name: str) -> str:
    """A name without blanks, colons and hyphens: pseudo_mode_07_123.4_Hz."""
    return re.sub(r"[^A-Za-z0-9.]+", "_", name)


def _write_mesh(path, points, cells, data):
    """Write a .vtu whose arrays are in base64, each behind its length in bytes."""
    counts, sizes = zip(*(nodes.shape for nodes in cells.values()), strict=True)
    groups = {
        "PointData": data,
        "Points": {"points": points},
        "Cells": {
            "connectivity": np.concatenate([nodes.ravel() for nodes in cells.values()]),
            "offsets": np.cumsum(np.repeat(sizes, counts)),
            "types": np.repeat(np.array([TYPES[kind] for kind in cells], np.uint8), counts),
        },
    }
    with open(path, "w", encoding="ascii") as file:
        file.write('<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
                   'header_type="UInt64">\n<UnstructuredGrid>\n'
                   f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{sum(counts)}">\n')  # fmt: skip
        for group, arrays in groups.items():
            file.write(f"<{group}>\n")
            for name, values in arrays.items():
                _write_array(file, name, values)
            file.write(f"</{group}>\n")
        file.write("</Piece>\n</UnstructuredGrid>\n</VTKFile>\n")


def _write_array(file, name, values):
    kind, number = NUMBERS[values.dtype.kind]
    columns = values.shape[1] if values.ndim > 1 else 1
    content = np.ascontiguousarray(values, number).tobytes()
    file.write(f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{columns}" format="binary">\n')
    file.write(b64encode(struct.pack("<Q", len(content)) + content).decode())
    file.write("\n</DataArray>\n")


def describe(path) -> dict:
    """Return the numbers of points and cells of a .vtu, and the names of its point data.

    Cells are by kind where their types stand in the XML as text or as bytes that are not packed, as ours do. Raises
    InputError for other files of VTK, ValueError for arrays that are not whole.
    """
    points, cells, kinds, names = 0, 0, Counter(), []
    root, group = {}, None
    # the file piece by piece, since it may be large
    for event, item in ElementTree.iterparse(path, ("start", "end")):
        if item.tag == "AppendedData":  # bytes that are no XML
            break
        if event == "start":
            group = item.tag if item.tag in GROUPS else group
            if item.tag == "VTKFile":
                root = item.attrib
                if root.get("type") != "UnstructuredGrid":
                    raise InputError(
                        f"{path}: found a VTK file of the type {root.get('type')}, expected UnstructuredGrid"
                    )
            elif item.tag == "Piece":
                points, cells = points + int(item.get("NumberOfPoints")), cells + int(item.get("NumberOfCells"))
        elif item.tag == "DataArray":
            name = item.get("Name")
            if group == "PointData" and name not in names:
                names.append(name)
            types = _types(item, root)
            if group == "Cells" and name == "types" and types is not None:
                kinds.update(types)
            item.clear()
    if kinds and kinds.total() != cells:
        raise ValueError(f"types: found {kinds.total()}, expected {cells}")
    # cells by kind where their types are known
    known = {code: kind for kind, code in TYPES.items()}
    by_kind = {known.get(code, f"of type {code}"): count for code, count in kinds.items()}
    return {"points": points, "cells": by_kind or cells, "point_data": names}


def _types(item, root):
    """The types of cells, or None of other arrays, and where they are packed or elsewhere. Raises ValueError."""
    types = item.get("Name") == "types"
    if item.get("format") == "ascii":
        return [int(word) for word in item.text.split()] if types else None
    if item.get("format") != "binary" or root.get("compressor"):
        return None
    content = b64decode((item.text or "").strip(), validate=True)
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    head = struct.Struct(order + ("Q" if root.get("header_type") == "UInt64" else "I"))
    (length,) = head.unpack_from(content)
    if length != len(content) - head.size:
        raise ValueError(f"{item.get('Name')}: found {len(content) - head.size} bytes, expected {length}")
    if not types:
        return None
    letters, bits = re.fullmatch(r"(U?Int)(\d+)", item.get("type")).groups()
    return np.frombuffer(content[head.size :], f"{order}{letters[0].lower()}{int(bits) // 8}").tolist()


class VtkFile(Writer):
    """Shapes for ParaView: all columns as point data, and the node numbers."""

    suffix, needs, kind = ".vtu", "shapes", VTK

    def write(self, target, source):
        with source.shapes() as shapes:
            data = {array_name(name): shapes.displacement(k) for k, name in enumerate(shapes.names)}
            cells = shapes.cells or {"vertex": np.arange(len(shapes.nodes))[:, None]}
            _write_mesh(target, shapes.points, cells, {**data, "node": shapes.nodes})
        return list(data)

    def describe(self, path):
        with open(path, "rb") as file:
            collection = b'type="Collection"' in file.read(500)
        if collection:
            times = [float(item.get("timestep")) for item in ElementTree.parse(path).iter("DataSet")]
            return {"format": "ParaView collection (.pvd)", "times": len(times), "end_s": times[-1] if times else None}
        return {"format": "VTK file (.vtu)", **describe(path)}
