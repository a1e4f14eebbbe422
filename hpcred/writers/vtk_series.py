"""Write a motion for ParaView: a .pvd and one .vtu an instant in a folder beside it, or a .vtu of one instant.

All ranks write: rank 0 the XML, each rank its rows of the arrays, which are appended as they are in memory.
"""

import re
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ..files.folders import atomic_folder, check_folder
from ..files.hdf5 import atomic_output
from ..files.result_points import Points
from ..files.system_errors import open_input, writing_to
from ..parallel.failures import InputError, agreed

TYPES = {  # of cells in VTK, whose nodes have the order of model.elements
    "vertex": 1, "line": 3, "triangle": 5, "quad": 9, "tetra": 10, "hexahedron": 12, "wedge": 13, "pyramid": 14,
    "line3": 21, "triangle6": 22, "quad8": 23, "tetra10": 24, "hexahedron20": 25, "wedge15": 26,
}  # fmt: skip
KINDS = {"<f8": "Float64", "<f4": "Float32", "<i8": "Int64", "<i4": "Int32", "|u1": "UInt8"}
BEGIN = (b'<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
         b'header_type="UInt64">\n<UnstructuredGrid>\n')  # fmt: skip
NOT_IN_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
LENGTH = 8  # bytes of the number of bytes in front of an array


@dataclass(eq=False)
class Rows:
    """An array (total, components) of a file; `local` are the rows of this rank, from `first` on."""

    name: str
    group: str
    local: np.ndarray
    first: int
    total: int


def folder_of(path) -> Path:
    """The folder of the .vtu of a .pvd."""
    return Path(path).with_name(f"{Path(path).stem}_vtu")


def is_of_series(path: Path) -> bool:
    """Whether a file is a .vtu of a series in its folder: by its name, and by its beginning unless it is empty."""
    begin, folder = path.name.rpartition("_")[0], path.parent.name.partition(".tmp-")[0]
    if not re.fullmatch(r".*_\d+\.vtu", path.name, re.DOTALL) or begin not in (path.parent.name, folder):
        return False
    with open_input(path) as file:
        return file.read(len(BEGIN)) in (b"", BEGIN)


def check_series(path, comm, progress=None):
    """Raise InputError where the folder of a .pvd has other files than those of a series, or where XML has no letters
    for its name. Collective."""
    folder = folder_of(path)
    if NOT_IN_XML.search(folder.name):
        raise InputError(f"output {path}: found a name with signs that XML does not have, by which the .pvd would name "
                         "its files; choose another name")  # fmt: skip
    with agreed(comm):
        if comm.rank == 0:
            check_folder(folder, is_of_series)
            if progress is not None and folder.exists():
                progress.tell_later(f"{folder} exists and will be replaced")


@contextmanager
def series(path, points: Points, t, comm, dtype):
    """Write a .pvd. The block gets a function that takes the fields of the next instants (b, k, ...); collective."""
    path, folder = Path(path), folder_of(path)
    check_series(path, comm)
    digits, done = len(str(len(t))), 0
    names = [f"{folder.name}_{i:0{digits}d}.vtu" for i in range(len(t))]
    with atomic_folder(folder, comm, is_of_series) as made, atomic_output(path, comm) as temporary:
        mesh = mesh_rows(points, comm)

        def put(fields):
            nonlocal done
            count = len(next(iter(fields.values())))
            write_instants([made / name for name in names[done : done + count]], mesh, points, fields, comm, dtype)
            done += count

        yield put
        with agreed(comm), writing_to(path, temporary):
            if comm.rank == 0:
                _write_collection(temporary, t, [f"{folder.name}/{name}" for name in names])


@contextmanager
def single(path, points: Points, comm, dtype):
    """Write a .vtu of one instant. The block gets a function that takes its fields (1, k, ...); collective."""
    with atomic_output(path, comm) as temporary:
        mesh = mesh_rows(points, comm)
        yield lambda fields: write_instants([temporary], mesh, points, fields, comm, dtype)


def _write_collection(path, t, names):
    file = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(file, "Collection")
    for time, name in zip(t, names, strict=True):
        ElementTree.SubElement(collection, "DataSet", timestep=repr(float(time)), part="0", file=name)
    ElementTree.ElementTree(file).write(path, encoding="utf-8", xml_declaration=True)


def mesh_rows(points: Points, comm) -> list[Rows]:
    """Return what is the same in all files: cells, and numbers of nodes. Collective."""
    cells = {kind: nodes for kind, nodes in points.cells.items() if comm.allreduce(len(nodes))}
    if not cells:
        cells = {"vertex": points.first + np.arange(len(points.node))[:, None]}
    index = np.int32 if comm.allreduce(sum(corners.size for corners in cells.values())) < 2**31 else np.int64
    sizes = np.repeat([nodes.shape[1] for nodes in cells.values()], [len(nodes) for nodes in cells.values()])
    types = np.repeat([TYPES[kind] for kind in cells], [len(nodes) for nodes in cells.values()])
    ends = np.cumsum(sizes) + (comm.exscan(int(sizes.sum())) or 0)
    arrays = {"connectivity": np.concatenate([nodes.ravel() for nodes in cells.values()]).astype(index),
              "offsets": ends.astype(index), "types": types.astype(np.uint8)}  # fmt: skip
    rows = [_rows(name, "Cells", local, comm) for name, local in arrays.items()]
    return [*rows, _rows("node", "PointData", points.node.astype(np.int64), comm)]


def _rows(name, group, local, comm):
    return Rows(name, group, local, comm.exscan(len(local)) or 0, comm.allreduce(len(local)))


def write_instants(paths, mesh, points: Points, fields, comm, dtype):
    """Write one file an instant, all ranks their rows of the fields (instants, k, ...). Collective."""
    places = fields.get("place")
    for i, path in enumerate(paths):
        arrays = {name: ("PointData", values[i]) for name, values in fields.items() if name != "place"}
        arrays["points"] = "Points", points.position if places is None else places[i]
        rows = [*(Rows(name, group, np.ascontiguousarray(values, dtype), points.first, points.total)
                  for name, (group, values) in arrays.items()), *mesh]  # fmt: skip
        head, starts, end = _head(rows)
        with agreed(comm):
            if comm.rank == 0:
                with open(path, "wb") as file:
                    file.write(head)
                    for array, start in zip(rows, starts, strict=True):
                        file.seek(start - LENGTH)
                        file.write((array.total * _row_bytes(array)).to_bytes(LENGTH, "little"))
                    file.seek(end)
                    file.write(b"\n</AppendedData>\n</VTKFile>\n")
        with agreed(comm), open(path, "r+b") as file:
            for array, start in zip(rows, starts, strict=True):
                if array.local.size:
                    file.seek(start + array.first * _row_bytes(array))
                    file.write(array.local.data)


def _row_bytes(array) -> int:
    return array.local.dtype.itemsize * int(np.prod(array.local.shape[1:]))


def _head(rows) -> tuple[bytes, list[int], int]:
    """Return the XML in front of the numbers, the byte where each array begins, and that behind the last one."""
    counts = {array.name: array.total for array in rows}
    text = BEGIN.decode() + f'<Piece NumberOfPoints="{counts["points"]}" NumberOfCells="{counts["types"]}">\n'
    offsets = np.cumsum([0, *(LENGTH + array.total * _row_bytes(array) for array in rows)])
    for group in ("PointData", "Points", "Cells"):
        text += f"<{group}>\n"
        for array, offset in zip(rows, offsets, strict=False):
            if array.group == group:
                components = int(np.prod(array.local.shape[1:]))
                text += (f'<DataArray type="{KINDS[array.local.dtype.str]}" Name="{array.name}" '
                         f'NumberOfComponents="{components}" format="appended" offset="{offset}"/>\n')  # fmt: skip
        text += f"</{group}>\n"
    head = (text + '</Piece>\n</UnstructuredGrid>\n<AppendedData encoding="raw">\n_').encode()
    return head, [len(head) + int(offset) + LENGTH for offset in offsets[:-1]], len(head) + int(offsets[-1])
