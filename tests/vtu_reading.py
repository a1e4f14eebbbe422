"""Files of ParaView read by xml.etree and base64 alone."""

import base64
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

NUMBERS = {"Float64": "<f8", "Int64": "<i8", "UInt8": "u1"}


@dataclass
class Mesh:
    """`cells` are pairs of a type of VTK and the points (elements, k) of the elements of this type."""

    points: np.ndarray
    cells: list
    point_data: dict


def read(path) -> Mesh:
    root = ElementTree.parse(path).getroot()
    assert root.attrib == {
        "type": "UnstructuredGrid", "version": "1.0", "byte_order": "LittleEndian", "header_type": "UInt64"
    }  # fmt: skip
    piece = root.find("UnstructuredGrid/Piece")
    points, cells, data = (_arrays(piece.find(group)) for group in ("Points", "Cells", "PointData"))
    types, ends = cells["types"], cells["offsets"]
    assert len(points["points"]) == int(piece.get("NumberOfPoints")) and len(types) == int(piece.get("NumberOfCells"))
    parts = np.split(cells["connectivity"], ends)
    assert len(parts.pop()) == 0
    grouped = [(int(code), np.array([part for part, type_ in zip(parts, types, strict=True) if type_ == code]))
               for code in dict.fromkeys(types)]  # fmt: skip
    return Mesh(points["points"], grouped, data)


def _arrays(group):
    return {item.get("Name"): _numbers(item) for item in group}


def _numbers(item):
    content = base64.b64decode(item.text)
    values = np.frombuffer(content[8:], NUMBERS[item.get("type")])
    assert int.from_bytes(content[:8], "little") == values.nbytes
    columns = int(item.get("NumberOfComponents"))
    return values.reshape(-1, columns) if columns > 1 else values
