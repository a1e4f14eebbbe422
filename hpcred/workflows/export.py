"""A result file enters; a file for another program leaves: SID, MATLAB, NumPy, Exudyn, ParaView, UFF, or a picture."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..formats import outputs
from ..formats.body_npz import write_npz
from ..formats.exudyn import write_exudyn
from ..formats.hdf5 import atomic_output
from ..formats.matlab import write_matlab
from ..formats.result_file import Result, read_result
from ..formats.sid import write_sid
from ..formats.uff import write_uff
from ..formats.vtk import write_vtk
from ..model.units import SI, units_of
from ..multibody.body_units import in_units
from ..parallel import startup
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI
from ..report.mode_pictures import draw_shapes


@dataclass(frozen=True)
class Export:
    """A format for other programs: its name there, how to write it, and what its writer takes."""

    write: Callable  # (path, Body) -> remarks; or, with all nodes, (path, shapes) -> names of the shapes
    suffix: str
    kind: str  # see formats.outputs
    all_nodes: bool = False


EXPORTS = {
    "sid": Export(write_sid, ".SID_FEM", outputs.SID),
    "matlab": Export(write_matlab, ".mat", outputs.MATLAB),
    "npz": Export(write_npz, ".npz", outputs.NPZ),
    "exudyn": Export(write_exudyn, "_exudyn.npz", outputs.NPZ),
    "vtk": Export(write_vtk, ".vtu", outputs.VTK, all_nodes=True),
    "uff": Export(write_uff, ".uff", outputs.UFF, all_nodes=True),
    "png": Export(draw_shapes, ".png", outputs.PNG, all_nodes=True),
}


def export_result(result, kind, path=None, *, nodes=None, units: str = "SI", comm=None, progress=None) -> dict:
    """Write a result, a Result or the name of its file, in another format, by rank 0. Collective. Raises InputError.

    `kind`: one of EXPORTS; `path`: by default the name of the result with the suffix of the format. `nodes`: numbers of
    the interface nodes, by default those of the inputs and outputs. `units`: of the
    file, see model.units.units_of; pictures and shapes are in SI. Returns what was written: output, format, and
    shapes (their names), or coordinates (their number), nodes and remarks on what the format does not hold.
    """
    comm = comm or startup.start_mpi()
    if isinstance(result, Result):
        result = result.path
    if kind not in EXPORTS:
        raise InputError(f"--format: found '{kind}', expected one of {', '.join(EXPORTS)}")
    export = EXPORTS[kind]
    if export.all_nodes and nodes is not None:
        raise InputError(f"--nodes: '{kind}' shows all nodes; leave it out")
    if nodes is not None and (not len(nodes) or len(set(nodes)) < len(nodes)):
        raise InputError(f"--nodes: found {list(nodes)}, expected at least one node, and each once")
    system = units_of(units)
    if export.all_nodes and system != SI:
        raise InputError(f"--units: '{kind}' is in SI, found '{units}'; leave it out")
    path = Path(path) if path else Path(result).with_name(Path(result).stem + export.suffix)
    outputs.check_outputs({path: export.kind}, comm, [result], progress=progress)
    if progress is not None:
        progress.say(f"export: {path}")
    report = None
    with atomic_output(path, comm) as temporary, agreed(comm):
        if comm.rank == 0:
            report = {"output": str(path), "format": kind, **_write(export, result, temporary, nodes, system)}
    return comm.bcast(report)


def _write(export, path, target, nodes, system) -> dict:
    """Write one format on one rank."""
    result = read_result(path, MPI.COMM_SELF)
    if export.all_nodes:
        with result.shapes() as shapes, _naming(path):
            return {"shapes": export.write(target, shapes)}
    body = result.body(nodes)
    with _naming(path):
        if not body.nodes:
            raise InputError("no interface nodes, since no input or output belongs to a node; name some by --nodes")
        if system == SI:
            remarks = export.write(target, body)
        else:
            remarks = export.write(target, in_units(body, system)) + [f"in {system.name}; frequencies in Hz"]
    return {"coordinates": body.reduced.size, "nodes": [shape.node for shape in body.nodes], "remarks": remarks}


@contextmanager
def _naming(path):
    """Put the name of the file before what a writer refuses."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
