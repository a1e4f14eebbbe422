"""Files of ParaView read by xml.etree and base64 alone."""

import base64
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

NUMBERS = {"Float64": "<f8", "Float32": "<f4", "Int64": "<i8", "Int32": "<i4", "UInt8": "u1"}


@dataclass
class Mesh:
    """`cells` are pairs of a type of VTK and the points (elements, k) of the elements of this type."""

    points: np.ndarray
    cells: list
    point_data: dict


def read(path) -> Mesh:
    text, _, appended = Path(path).read_bytes().partition(b'<AppendedData encoding="raw">\n_')
    root = ElementTree.fromstring(text + b"</VTKFile>" * bool(appended))
    assert root.attrib == {
        "type": "UnstructuredGrid", "version": "1.0", "byte_order": "LittleEndian", "header_type": "UInt64"
    }  # fmt: skip
    piece = root.find("UnstructuredGrid/Piece")
    points, cells, data = (_arrays(piece.find(group), appended) for group in ("Points", "Cells", "PointData"))
    types, ends = cells["types"], cells["offsets"]
    assert len(points["points"]) == int(piece.get("NumberOfPoints")) and len(types) == int(piece.get("NumberOfCells"))
    parts = np.split(cells["connectivity"], ends)
    assert len(parts.pop()) == 0
    grouped = [(int(code), np.array([part for part, type_ in zip(parts, types, strict=True) if type_ == code]))
               for code in dict.fromkeys(types)]  # fmt: skip
    return Mesh(points["points"], grouped, data)


def _arrays(group, appended):
    return {item.get("Name"): _numbers(item, appended) for item in group}


def _numbers(item, appended):
    if item.get("format") == "appended":
        content = appended[int(item.get("offset")) :]
        content = content[: 8 + int.from_bytes(content[:8], "little")]
    else:
        content = base64.b64decode(item.text)
    values = np.frombuffer(content[8:], NUMBERS[item.get("type")])
    assert int.from_bytes(content[:8], "little") == values.nbytes
    columns = int(item.get("NumberOfComponents"))
    return values.reshape(-1, columns) if columns > 1 else values
