"""A result file enters; a file for another program leaves: SID, MATLAB, NumPy, Exudyn, ParaView, or a picture."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..formats import result_file
from ..formats.exudyn import write_exudyn
from ..formats.hdf5 import atomic_output, reading
from ..formats.matlab import write_matlab
from ..formats.body_npz import write_npz
from ..formats.sid import write_sid
from ..formats.vtk import write_vtk
from ..multibody.body import Body
from ..multibody.floating_frame import FloatingFrame
from ..multibody.node_shapes import NodeShape, shapes_of_rows
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI
from ..reduction.reduced_model import ReducedModel
from ..report.mode_pictures import draw_shapes

# until formats/result_file.py has it: read_result, Result, Shapes
CHUNK = 2**22  # rows of a result file looked through at a time


@dataclass
class Result:
    """A result file with its reduced model; bodies and shapes are read when asked for, on one rank."""

    path: Path
    reduced: ReducedModel

    def body(self, nodes=None) -> Body:
        """The body with chosen interface nodes, by default those of the inputs and outputs. Raises InputError."""
        with reading(self.path, result_file.FORMAT) as file:
            if "floating_frame" not in file:
                raise InputError(
                    f"{self.path}: no floating-frame quantities; the model had no node coordinates, or the projection "
                    "was two-sided"
                )
            group = file["floating_frame"]
            arrays = {key: group[key][()] for key in ("masses", "mc", "J", "Ct", "Cr", "N", "S", "Me", "origin")}
            quantities = FloatingFrame(**arrays, integrals=group["integrals"][()].decode())
            if nodes is None:
                nodes = [int(node) for node in file["interface/node"][...]] if "interface" in file else []
            return Body(self.reduced, quantities, _shapes_in_file(file, list(nodes), str(self.path)))

    @contextmanager
    def shapes(self):
        """The shapes of all columns of the basis, while the file is open. Raises InputError."""
        with reading(self.path, result_file.FORMAT) as file:
            yield Shapes(file, self.path)


def read_result(path, comm) -> Result:
    return Result(Path(path), result_file.read_result(path, comm))


def _shapes_in_file(file, nodes, name) -> list[NodeShape]:
    """The shapes of nodes from an open result file: those kept for the interface, others from the basis."""
    kept = {}
    if "interface" in file:
        group = file["interface"]
        for i, node in enumerate(group["node"][...]):
            kept[int(node)] = NodeShape(
                int(node), group["position"][i], group["phi"][i], group["psi"][i], bool(group["rotates"][i])
            )
    missing = [node for node in nodes if node not in kept]
    if missing:
        if "basis/V" not in file or "dofs" not in file:
            raise InputError(f"{name}: node {missing[0]} is no interface node, and the file was written without basis")
        columns, dofs = file["basis/V"], file["dofs"]
        rows = []
        for low in range(0, columns.shape[1], CHUNK):
            rows.append(low + np.flatnonzero(np.isin(dofs["node"][low : low + CHUNK], missing)))
        rows = np.concatenate(rows)
        parts = [dofs[key][rows] for key in ("node", "direction", "position")] if len(rows) else [np.zeros(0)] * 3
        basis = np.array([columns[:, row] for row in rows]).reshape(len(rows), columns.shape[0])
        kept |= {shape.node: shape for shape in shapes_of_rows(missing, *parts, basis, name)}
    return [kept[node] for node in nodes]


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


@dataclass(frozen=True)
class Export:
    """A format for other programs: its name there, how to write it, and what its writer takes."""

    write: Callable  # (path, Body) -> remarks; or, with all nodes, (path, shapes) -> names of the shapes
    suffix: str
    all_nodes: bool = False


EXPORTS = {
    "sid": Export(write_sid, ".SID_FEM"),
    "matlab": Export(write_matlab, ".mat"),
    "npz": Export(write_npz, ".npz"),
    "exudyn": Export(write_exudyn, "_exudyn.npz"),
    "vtk": Export(write_vtk, ".vtu", all_nodes=True),
    "png": Export(draw_shapes, ".png", all_nodes=True),
}


def export_result(result, kind, path=None, *, nodes=None, comm=None, progress=None) -> dict:
    """Write the result file `result` in another format, by rank 0. Collective. Raises InputError.

    `kind`: one of EXPORTS; `path`: by default the name of the result with the suffix of the format. `nodes`: numbers of
    the interface nodes, by default those of the inputs and outputs. Returns what was written: output, format, and
    shapes (their names), or coordinates (their number), nodes and remarks on what the format does not hold.
    """
    comm = comm or MPI.COMM_WORLD
    if kind not in EXPORTS:
        raise InputError(f"--format: found '{kind}', expected one of {', '.join(EXPORTS)}")
    export = EXPORTS[kind]
    if export.all_nodes and nodes is not None:
        raise InputError(f"--nodes: '{kind}' shows all nodes; leave it out")
    if nodes is not None and (not len(nodes) or len(set(nodes)) < len(nodes)):
        raise InputError(f"--nodes: found {list(nodes)}, expected at least one node, and each once")
    path = Path(path) if path else Path(result).with_name(Path(result).stem + export.suffix)
    if path.resolve() == Path(result).resolve():
        raise InputError(f"output {path}: this is the result itself; choose another name")
    if progress is not None:
        progress.say(f"export: {path}")
    report = None
    with atomic_output(path, comm) as temporary, agreed(comm):
        if comm.rank == 0:
            report = {"output": str(path), "format": kind, **_write(export, result, temporary, nodes)}
    return comm.bcast(report)


def _write(export, path, target, nodes) -> dict:
    """Write one format on one rank."""
    result = read_result(path, MPI.COMM_SELF)
    if export.all_nodes:
        with result.shapes() as shapes, _naming(path):
            return {"shapes": export.write(target, shapes)}
    body = result.body(nodes)
    with _naming(path):
        if not body.nodes:
            raise InputError("no interface nodes, since no input or output belongs to a node; name some by --nodes")
        remarks = export.write(target, body)
    return {"coordinates": body.reduced.size, "nodes": [shape.node for shape in body.nodes], "remarks": remarks}


@contextmanager
def _naming(path):
    """Put the name of the file before what a writer refuses."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
