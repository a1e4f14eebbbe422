"""A result file enters; files for another program leave.

Bodies: SID, MATLAB, NumPy, Exudyn, MBDyn. Inputs and outputs: state space, FMU. Shapes: ParaView, UFF, a picture.
Superelements: Nastran, ANSYS, Abaqus, Simscape.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePath

from ..body.units import fields_in, in_units
from ..files import outputs
from ..files.hdf5 import atomic_output, require_name
from ..files.locks import locks_given_back
from ..files.result_file import Result, read_result
from ..files.text import absent
from ..model.units import SI, units_of
from ..parallel import startup
from ..parallel.declared import nearest, spelled
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI
from ..report.mode_pictures import picture_of
from ..writers.abaqus import abaqus_superelement
from ..writers.ansys import ansys_superelement
from ..writers.body_npz import write_npz
from ..writers.exudyn import write_exudyn
from ..writers.fmu import write_fmu
from ..writers.matlab import write_matlab
from ..writers.mbdyn import write_mbdyn
from ..writers.nastran import nastran_dmig, nastran_op4
from ..writers.sid import write_sid
from ..writers.simscape import simscape_solid
from ..writers.state_space import write_state_space_mat, write_state_space_npz
from ..writers.superelement import superelement
from ..writers.uff import write_uff
from ..writers.vtk import write_vtk


@dataclass(frozen=True)
class Export:
    """A format for other programs: how to write it, the end of its name, and what its writer takes.

    `takes` "body": (path, Body) -> remarks; "reduced": (path, ReducedModel) -> remarks, for programs that know inputs
    and outputs and no nodes; "shapes": (path, shapes of all nodes) -> names of the shapes; "superelement":
    (Superelement, stem of the file) -> its content, those beside it by what follows the stem, remarks. `surface`:
    whether the body has the surface that is drawn. `named`: whether the writer takes a `name` of the body. `si`:
    whether the program that reads it wants SI.
    """

    write: Callable
    suffix: str
    kind: str | None  # see files.outputs
    takes: str = "body"
    surface: bool = False
    picture: bool = False  # of chosen shapes
    named: bool = False
    si: bool = False

    @property
    def any_units(self) -> bool:
        """Whether it can be written in other units than SI."""
        return self.takes in ("body", "superelement") and not self.si


EXPORTS = {
    "sid": Export(write_sid, ".SID_FEM", outputs.SID),
    "matlab": Export(write_matlab, ".mat", outputs.MATLAB),
    "npz": Export(write_npz, ".npz", outputs.ZIP),
    "exudyn": Export(write_exudyn, "_exudyn.npz", outputs.ZIP, surface=True),
    "mbdyn": Export(write_mbdyn, ".fem", outputs.MBDYN),
    "statespace-mat": Export(write_state_space_mat, "_statespace.mat", outputs.MATLAB, takes="reduced"),
    "statespace-npz": Export(write_state_space_npz, "_statespace.npz", outputs.ZIP, takes="reduced"),
    "fmu": Export(write_fmu, ".fmu", outputs.ZIP, takes="reduced", named=True),
    "vtk": Export(write_vtk, ".vtu", outputs.VTK, takes="shapes"),
    "uff": Export(write_uff, ".uff", outputs.UFF, takes="shapes"),
    **{suffix[1:]: Export(picture_of(suffix[1:]), suffix, kind, takes="shapes", picture=True)
       for suffix, kind in outputs.PICTURES.items()},
    "nastran": Export(nastran_dmig, ".pch", outputs.SUPERELEMENT, takes="superelement"),
    "nastran-op4": Export(nastran_op4, "_external.op4", None, takes="superelement"),
    "ansys": Export(ansys_superelement, "_ansys.inp", outputs.SUPERELEMENT, takes="superelement"),
    "abaqus": Export(abaqus_superelement, "_abaqus.inp", outputs.SUPERELEMENT, takes="superelement"),
    "simscape": Export(simscape_solid, "_simscape.mat", outputs.MATLAB, takes="superelement", si=True),
}
PROGRAMS = {"simpack": "sid", "simulink": "simscape", "dymola": "fmu", "paraview": "vtk"}  # words for a format
WITHOUT_NODES = {
    "shapes": "shows all nodes",
    "reduced": "has inputs and outputs, and no nodes",
    "superelement": "has the interface nodes of the job",
}


@spelled
@locks_given_back()
def export_result(
    result, kind=None, path=None, *, nodes=None, units: str = "SI", modes=None, comm=None, progress=None
) -> dict:
    """Write a result, a Result or the name of its file, in another format, by rank 0. Collective. Raises InputError.

    `kind`: one of EXPORTS, by default what the name of `path` ends in, or else "sid"; `path`: by default the name of
    the result with the suffix of the format. `nodes`: numbers of the interface nodes, or names of interfaces or node
    sets, by default those of the inputs and outputs; a superelement has those of its coordinates. `units`: of the file,
    see model.units.units_of; bodies and superelements have others than SI.
    `modes`: numbers from 1 of the shapes of a picture, by default the first six elastic ones, of a moving one (gif,
    webp) the first. Returns what was written: output, format, and shapes (their names), or coordinates (their number),
    remarks on what the format does not hold, and nodes, or inputs and outputs by name; of a superelement, the files
    beside the output.
    """
    comm = comm or startup.start_mpi()
    if isinstance(result, Result):
        result = result.path
    require_name(result)
    kind = _chosen(kind, path)
    export = EXPORTS[kind]
    if export.takes in WITHOUT_NODES and nodes is not None:
        raise InputError(f"--nodes: '{kind}' {WITHOUT_NODES[export.takes]}; leave it out")
    if modes is not None and not export.picture:
        raise InputError(f"--modes: '{kind}' shows all shapes or none; leave it out")
    if nodes is not None and (not len(nodes) or len(set(nodes)) < len(nodes)):
        raise InputError(f"--nodes: found {list(nodes)}, expected at least one node, and each once")
    system = units_of(units)
    if not export.any_units and system != SI:
        raise InputError(f"--units: '{kind}' is in SI, found '{units}'; leave it out")
    if not Path(result).name:
        raise absent(result)
    path = Path(path) if path else Path(result).with_name(Path(result).stem + export.suffix)
    outputs.check_outputs({path: export.kind}, comm, [result])
    existed = comm.bcast(path.exists())
    if progress is not None:
        progress.say(f"export: {path}")
    if export.takes == "superelement":
        report = _export_superelement(export, result, path, system, comm, progress)
    else:
        report = None
        with atomic_output(path, comm) as temporary, agreed(comm):
            if comm.rank == 0:
                report = _write(export, result, temporary, nodes, system, modes)
        report = comm.bcast(report)
    if existed and progress is not None:  # said at the end: what cannot be written replaces nothing
        progress.tell(f"{path} existed and was replaced")
    return {"output": str(path), "format": kind, **report}


def _chosen(kind, path) -> str:
    """The format that is asked for by its name, or by the ending of a path. Raises InputError where they differ."""
    endings = {name: PurePath(f"x{item.suffix}").suffix.lower() for name, item in EXPORTS.items()}
    ending = PurePath(path).suffix.lower() if path else ""
    if kind is None:
        kind = next((name for name in EXPORTS if endings[name] == ending), "sid")
    if kind not in EXPORTS:
        meant = PROGRAMS.get(str(kind).lower())
        such = f" (did you mean '{meant}'?)" if meant else nearest(kind, EXPORTS)
        raise InputError(f"--format: found '{kind}', expected one of {', '.join(EXPORTS)}{such}")
    if path and ending != endings[kind] and (EXPORTS[kind].picture or ending in endings.values()):
        raise InputError(f"output {path}: found a name that ends in {ending or 'nothing'}, expected {endings[kind]} of "
                         f"--format {kind}")  # fmt: skip
    return kind


def _write(export, path, target, nodes, system, modes) -> dict:
    """Write one format on one rank."""
    result = read_result(path, MPI.COMM_SELF)
    if export.takes == "shapes":
        with result.shapes() as shapes, _naming(path):
            return {"shapes": export.write(target, shapes, modes) if export.picture else export.write(target, shapes)}
    if export.takes == "reduced":
        reduced = result.reduced
        with _naming(path):
            remarks = export.write(target, reduced, **({"name": Path(path).stem} if export.named else {}))
        named = {"inputs": list(reduced.input_names), "outputs": list(reduced.output_names)}
        return {"coordinates": reduced.size, **named, "remarks": remarks}
    body = result.body(nodes)
    with _naming(path):
        if not body.nodes:
            raise InputError("no interface nodes, since no input or output belongs to a node; name some by --nodes")
        body.surface = result.surface() if export.surface else None
        if system == SI:
            remarks = export.write(target, body)
        else:
            remarks = [*export.write(target, in_units(body, system)), f"{_in(system)}; frequencies in Hz"]
    return {"coordinates": body.reduced.size, "nodes": [shape.node for shape in body.nodes], "remarks": remarks}


def _export_superelement(export, result, path, system, comm, progress) -> dict:
    """Write the files of a superelement, the one that takes the others at the end. Collective."""
    report, content, beside = None, None, {}
    with agreed(comm), _naming(result):
        if comm.rank == 0:
            element = superelement(read_result(result, MPI.COMM_SELF).reduced)
            if system != SI:
                element = replace(element, **fields_in(element, system), remarks=(*element.remarks, _in(system)))
            content, others, remarks = export.write(element, path.stem)
            beside = {path.with_name(path.stem + suffix): text for suffix, text in others.items()}
            report = {
                "coordinates": element.size, "nodes": [item.node for item in element.interfaces], "remarks": remarks,
                "files": [str(name) for name in beside],
            }  # fmt: skip
    report = comm.bcast(report)
    besides = {Path(name): outputs.DENSE if name.endswith(".mtx") else outputs.SUPERELEMENT for name in report["files"]}
    outputs.check_outputs(besides, comm, [result], progress=progress)
    for name in [*besides, path]:
        with atomic_output(name, comm) as temporary, agreed(comm):
            if comm.rank == 0:
                data = beside.get(name, content)
                temporary.write_bytes(data if isinstance(data, bytes) else data.encode())
    return report


def _in(system) -> str:
    return f"in {system.name}"


@contextmanager
def _naming(path):
    """Put the name of the file before what a writer refuses."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
