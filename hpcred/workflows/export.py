"""A result file enters; files for another program leave.

Bodies: SID, MATLAB, NumPy, Exudyn. Shapes: ParaView, UFF, a picture. Superelements: Nastran, ANSYS, Abaqus, Simscape.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..formats.abaqus_superelement import abaqus_superelement
from ..formats.ansys_superelement import ansys_superelement
from ..formats.body_npz import write_npz
from ..formats.exudyn import write_exudyn
from ..formats.hdf5 import atomic_output
from ..formats.matlab import write_matlab
from ..formats.nastran_superelement import nastran_dmig, nastran_op4
from ..formats.result_file import Result, read_result
from ..formats.sid import write_sid
from ..formats.simscape import simscape_solid
from ..formats.superelement import superelement
from ..formats.uff import write_uff
from ..formats.vtk import write_vtk
from ..parallel import startup
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI
from ..report.mode_pictures import draw_shapes


@dataclass(frozen=True)
class Export:
    """A format for other programs: its name there, how to write it, and what its writer takes."""

    write: Callable  # (path, Body) -> remarks; or, with all nodes, (path, shapes) -> names of the shapes; or, of a
    # superelement, (Superelement, stem of the file) -> its content, those beside it by what follows the stem, remarks
    suffix: str
    all_nodes: bool = False
    superelement: bool = False


EXPORTS = {
    "sid": Export(write_sid, ".SID_FEM"),
    "matlab": Export(write_matlab, ".mat"),
    "npz": Export(write_npz, ".npz"),
    "exudyn": Export(write_exudyn, "_exudyn.npz"),
    "vtk": Export(write_vtk, ".vtu", all_nodes=True),
    "uff": Export(write_uff, ".uff", all_nodes=True),
    "png": Export(draw_shapes, ".png", all_nodes=True),
    "nastran": Export(nastran_dmig, ".pch", superelement=True),
    "nastran-op4": Export(nastran_op4, "_external.op4", superelement=True),
    "ansys": Export(ansys_superelement, "_ansys.inp", superelement=True),
    "abaqus": Export(abaqus_superelement, "_abaqus.inp", superelement=True),
    "simscape": Export(simscape_solid, "_simscape.mat", superelement=True),
}


def export_result(result, kind, path=None, *, nodes=None, comm=None, progress=None) -> dict:
    """Write a result, a Result or the name of its file, in another format, by rank 0. Collective. Raises InputError.

    `kind`: one of EXPORTS; `path`: by default the name of the result with the suffix of the format. `nodes`: numbers of
    the interface nodes, by default those of the inputs and outputs; a superelement has those of its coordinates.
    Returns what was written: output, format, and shapes (their names), or coordinates (their number), nodes and remarks
    on what the format does not hold, and, of a superelement, the files beside the output.
    """
    comm = comm or startup.start_mpi()
    if isinstance(result, Result):
        result = result.path
    if kind not in EXPORTS:
        raise InputError(f"--format: found '{kind}', expected one of {', '.join(EXPORTS)}")
    export = EXPORTS[kind]
    if export.all_nodes and nodes is not None:
        raise InputError(f"--nodes: '{kind}' shows all nodes; leave it out")
    if export.superelement and nodes is not None:
        raise InputError(f"--nodes: '{kind}' has the interface nodes of the job; leave it out")
    if nodes is not None and (not len(nodes) or len(set(nodes)) < len(nodes)):
        raise InputError(f"--nodes: found {list(nodes)}, expected at least one node, and each once")
    path = Path(path) if path else Path(result).with_name(Path(result).stem + export.suffix)
    if path.resolve() == Path(result).resolve():
        raise InputError(f"output {path}: this is the result itself; choose another name")
    if progress is not None:
        progress.say(f"export: {path}")
    if export.superelement:
        return _export_superelement(export, kind, result, path, comm)
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


def _export_superelement(export, kind, result, path, comm) -> dict:
    """Write the files of a superelement, the one that takes the others at the end. Collective."""
    report, content, beside = None, None, {}
    with agreed(comm), _naming(result):
        if comm.rank == 0:
            element = superelement(read_result(result, MPI.COMM_SELF).reduced)
            content, others, remarks = export.write(element, path.stem)
            beside = {path.with_name(path.stem + suffix): text for suffix, text in others.items()}
            if path in beside:
                raise InputError(f"output {path}: this name is that of a file beside it; choose another")
            report = {
                "output": str(path), "format": kind, "coordinates": element.size,
                "nodes": [item.node for item in element.interfaces], "remarks": remarks,
                "files": [str(name) for name in beside],
            }  # fmt: skip
    report = comm.bcast(report)
    for name in [*map(Path, report["files"]), path]:
        with atomic_output(name, comm) as temporary, agreed(comm):
            if comm.rank == 0:
                data = beside.get(name, content)
                temporary.write_bytes(data if isinstance(data, bytes) else data.encode())
    return report


@contextmanager
def _naming(path):
    """Put the name of the file before what a writer refuses."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
