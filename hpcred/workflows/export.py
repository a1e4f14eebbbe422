"""Write a result file in the format of another program.

Bodies: SID, MATLAB, NumPy, Exudyn, MBDyn, MBSim. Inputs and outputs: state space, FMU. Shapes: ParaView, UFF, a
picture. Superelements: Nastran, ANSYS, Abaqus, Simscape, OpenFAST. Other packages add formats (see writers.base).
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import contextmanager
from pathlib import Path, PurePath

from ..body.preload import warning_of_basis
from ..files import outputs
from ..files.hdf5 import atomic_output, require_name
from ..files.result_file import LARGE, Result, read_result, write_result
from ..files.temporary import folder_of_all
from ..files.text import absent
from ..files.together import together
from ..model.units import SI, units_of
from ..parallel.declared import as_declared, declared, nearest, spelled, types_of
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI
from ..parallel.plugins import blamed
from ..reduction.result.parameter_accuracy import in_words
from ..reduction.result.reduced_model import ReducedModel
from ..settings.toml_file import override
from ..writers.base import OF_NAMES, ExportSource
from ..writers.registry import PROGRAMS, WRITERS
from .workflow import workflow

WITHOUT_NODES = {
    "shapes": "shows all nodes",
    "reduced": "has inputs and outputs, and no nodes",
    "superelement": "has the interface nodes of the job",
}


@workflow
def export_result(
    result, kind=None, path=None, *, nodes=None, units: str = "SI", modes=None, options=None, preload=None, at=None,
    base: str | None = None, comm=None, progress=None,
) -> dict:  # fmt: skip
    """Write a result in another format, by rank 0. Collective.

    Parameters
    ----------
    result : Result or path
    kind : str, optional
        A format (see `hpcred export --help`), or the name of a program; by default what the name of `path` ends in, or
        else "sid".
    path : str or PathLike, optional
        By default the name of the result with the suffix of the format.
    nodes : sequence of int or str, optional
        Numbers of the interface nodes, or names of interfaces or node sets; by default those of the inputs and outputs.
        A superelement has those of its coordinates.
    units : str
        Of the file (see units_of); bodies and superelements have others than SI.
    modes : sequence of int, optional
        Numbers from 1 of the shapes of a picture; by default the first six elastic ones, of a moving one (gif, webp)
        the first.
    options : dict or sequence of str, optional
        Settings of the format by name, such as {"ge_order": "coordinate"} of "sid", or texts such as
        "sid.ge_order=coordinate".
    preload : Preload, optional
        Whose stiffness K then has.
    at : dict of float, optional
        Values of the parameters by name; without them formats that hold parameters keep them, and others have the
        reference values.
    base : {"displacement", "velocity", "acceleration"}, optional
        What the inputs of bases are, of formats of inputs and outputs: see ReducedModel.driven_by. By default
        accelerations; a file with others keeps no parameters.

    Returns
    -------
    dict
        What was written: output, format, and shapes (their names), or coordinates (their number), remarks on what the
        format does not hold, and nodes, or inputs and outputs by name; of a superelement, the files beside the output.

    Raises
    ------
    InputError
        For what the format cannot hold.
    """
    if isinstance(result, Result):
        result, preload, at = result.path, preload or result.preload, at or result.values
    require_name(result)
    writer, guessed = _chosen(kind, path, comm), kind is None and path
    kind = writer.name
    if writer.needs in WITHOUT_NODES and nodes is not None:
        raise InputError(f"--nodes: '{kind}' {WITHOUT_NODES[writer.needs]}; leave it out")
    if modes is not None and not writer.picture:
        raise InputError(f"--modes: '{kind}' shows all shapes or none; leave it out")
    if nodes is not None and (not len(nodes) or len(set(nodes)) < len(nodes)):
        raise InputError(f"--nodes: found {list(nodes)}, expected at least one node, and each once")
    if base is not None and writer.needs != "reduced":
        raise InputError(f"--base: '{kind}' has no inputs for the motion of a base; leave it out")
    settings = _options_of(writer, options)
    system = units_of(units)
    if not writer.any_units and system != SI:
        raise InputError(f"--units: '{kind}' is in SI, found '{units}'; leave it out")
    if not Path(result).name:
        raise absent(result)
    path = Path(path) if path else Path(result).with_name(Path(result).stem + writer.suffix)
    told = None if writer.kind else outputs.OtherKind(f"file of format '{kind}'", writer.begins)
    outputs.check_outputs({path: told or writer.kind}, comm, [result])
    if guessed and path.suffix.lower() != _ending(writer):
        known = ", ".join(dict.fromkeys(_ending(WRITERS.load(entry)) for entry in WRITERS.own))
        raise InputError(f"output {path}: found a name that ends in {path.suffix or 'nothing'}, expected one of "
                         f"{known}, or a --format")  # fmt: skip
    existed = comm.bcast(path.exists())
    if progress is not None:
        progress.say(f"export: {path}")
    with together(comm), atomic_output(path, comm, told) as temporary:
        report = beside = None
        with agreed(comm), _naming(result):
            if comm.rank == 0:
                taken = read_result(result, MPI.COMM_SELF)
                parametric = taken.reduced if hasattr(taken.reduced, "parameters") and not at else None
                keeps = writer.keeps_parameters and preload is None and base is None
                taken = taken.at(**at) if at else taken.at_reference()
                far = preload is not None and warning_of_basis(taken.body(), preload)
                taken = taken if preload is None else taken.at_preload(preload)
                surface = writer.surface or getattr(settings, "surface", False)
                source = ExportSource(taken, path.stem, nodes, system, modes, surface, writer.stress, settings,
                                      parametric=parametric if keeps else None, base=base)  # fmt: skip
                report = _write(writer, source, temporary)
                remarks = report.get("remarks", [])
                if parametric is not None and not keeps:
                    remarks.append(f"at {in_words(parametric.reference)}, the reference values; --at takes others")
                if writer.needs == "body" and _rotates(taken.reduced.record):
                    remarks.append("D and K have terms of rotation, whose forces programs that rotate the body add too")
                if preload is not None and preload.values and not any("preload" in remark for remark in remarks):
                    remarks.append(f"K has the stress of the preload {preload.words}")
                if far:
                    remarks.append(far)
                remarks.extend(WRITERS.broken)
                beside = {path.with_name(path.stem + suffix): content for suffix, content in source.beside.items()}
        report, names = comm.bcast((report, beside and list(beside)))
        if names or writer.needs == "superelement":
            report["files"] = [str(name) for name in names]
        known = {".mtx": outputs.DENSE, ".obj": outputs.SURFACE}
        kinds = {name: known.get(name.suffix, told or outputs.SUPERELEMENT) for name in names or ()}
        outputs.check_outputs(kinds, comm, [result, path], progress=progress)
        for name in kinds:  # before the file that takes them
            with atomic_output(name, comm, told) as other, agreed(comm):
                if comm.rank == 0:
                    text = beside[name]
                    other.write_bytes(text if isinstance(text, bytes) else text.encode(errors=OF_NAMES))
    if existed and progress is not None:  # said at the end: what cannot be written replaces nothing
        progress.tell(f"{path} existed and was replaced")
    return {"output": str(path), "format": kind, **report}


@spelled
def export_reduced(
    reduced, path, format=None, *, nodes=None, units: str = "SI", modes=None, options=None, preload=None, at=None,
    base=None, stress=None, geometric_stiffness=None, progress=None,
) -> dict:  # fmt: skip
    """Write a ReducedModel, with the model that it was made from, for another program. Collective.

    Parameters
    ----------
    reduced : ReducedModel
        One that was read from a file is exported by `export_result`.
    path : str or PathLike
    format, nodes, units, modes, options, preload, at, base : optional
        See export_result.
    stress : StressModes, optional
        Of its basis (see stress_modes).
    geometric_stiffness : GeometricStiffness, optional
        Of its basis, whose origin the body frame then has.

    Returns
    -------
    dict
        As of export_result.

    Raises
    ------
    InputError
        For what the format cannot hold.
    """
    declared("reduced", reduced, ReducedModel)
    if reduced.model is None:
        raise InputError("export: found a reduced model without its full model, as one that was read from a file or "
                         "closed; export the file by hpcred.export")  # fmt: skip
    with folder_of_all(reduced.model.comm) as folder:
        result = folder / f"{Path(path).stem or 'result'}.h5"
        origin = (0.0, 0.0, 0.0) if geometric_stiffness is None else geometric_stiffness.origin
        write_result(
            result, reduced, reduced.model, origin=origin, geometric_stiffness=geometric_stiffness, stress=stress
        )
        try:
            return export_result(
                result, format, path, nodes=nodes, units=units, modes=modes, options=options, preload=preload, at=at,
                base=base, comm=reduced.model.comm, progress=progress,
            )
        except InputError as error:  # names a file that the caller has never seen
            raise InputError(str(error).replace(str(result), reduced.model.name)) from error


def _rotates(record):
    """Test whether the job of a record has terms that are made for a rotation."""
    return any(term["kind"] != "matrix" for term in (record and record.job or {}).get("term", ()))


def _chosen(kind, path, comm):
    """Return the Writer that is asked for by its name, or by the ending of a path. Collective.

    Raises InputError where the two differ.
    """
    entry = None
    with agreed(comm):
        if comm.rank == 0:
            entry = _entry(kind, path)
    entry = comm.bcast(entry)
    with agreed(comm):
        return WRITERS.load(entry)


def _entry(kind, path):
    own = {entry.name: entry for entry in WRITERS.own}
    writers = {name: WRITERS.load(entry) for name, entry in own.items()}
    endings = {name: _ending(writer) for name, writer in writers.items()}
    ending = PurePath(path).suffix.lower() if path else ""
    if kind is None:
        like = next((name for name in own if endings[name] == ending), None)
        named = [name for name in own if str(path).endswith(writers[name].suffix)]  # rod_statespace.mat is no rod.mat
        kind = max(named, key=lambda name: len(writers[name].suffix), default=like)
    if kind is None:
        fits = ending and WRITERS.first(lambda item: _ending(item) == ending, WRITERS.others)
        return fits or own["sid"]
    kind = PROGRAMS.get(str(kind).lower(), kind)
    known = own if kind in own else dict(own)
    for entry in WRITERS.others if kind not in own else ():
        known.setdefault(entry.name, entry)
    if kind not in known:
        names = [*known, *PROGRAMS]
        raise InputError(f"--format: found '{kind}', expected one of {', '.join(names)}{nearest(kind, names)}")
    writer = WRITERS.load(known[kind])
    expected = _ending(writer)
    if path and ending != expected and (writer.picture or ending in endings.values()):
        raise InputError(f"output {path}: found a name that ends in {ending or 'nothing'}, expected {expected} of "
                         f"--format {kind}")  # fmt: skip
    return known[kind]


def _options_of(writer, wanted):
    """The settings of a format, checked, or None where it has none. Raises InputError."""
    if not isinstance(wanted or {}, Mapping):
        table = {}
        for text in wanted:
            override(table, text)
        if others := [name for name in table if name != writer.name]:
            raise InputError(f"--set: found '{others[0]}', expected {writer.name}.key=value, of --format {writer.name}")
        wanted = table.get(writer.name, {})
    if writer.options is None:
        if wanted:
            raise InputError(f"--set: '{writer.name}' has no settings of its own; leave it out")
        return None
    known = types_of(writer.options)
    for key in wanted or {}:
        if key not in known:
            raise InputError(f"--set: {writer.name}: unknown key{nearest(key, known)}; known are {', '.join(known)}")
    settings = writer.options(**(wanted or {}))
    as_declared(settings, f"--set: {writer.name}.")
    return settings


def _ending(writer) -> str:
    return PurePath(f"x{writer.suffix}").suffix.lower()


def _write(writer, source, target) -> dict:
    """Write one format, and say what was written; on one rank."""
    needs = writer.needs
    if needs == "body":
        _require_nodes(source)
    with blamed(writer):
        remarks = list(writer.write(target, source))
    if needs == "shapes":
        return {"shapes": remarks}
    if writer.stress and source.result.stress_nodes and source.body.stress is None:
        remarks.append(
            f"the stresses of {source.result.stress_nodes} nodes are left out, more than {LARGE // 3}: keep those of "
            "some in result.h5, stress = [...] in the job"
        )
    if needs == "body" and source.units != SI:
        remarks.append(f"in {source.units.name}; frequencies in Hz")
    if needs == "reduced":
        if lost := len(source.result.reduced.output_names) - len(source.reduced.output_names):
            remarks.append(f"{lost} outputs are left out, which would need derivatives of the {source.base} of the "
                           "base")  # fmt: skip
        named = {"inputs": list(source.reduced.input_names), "outputs": list(source.reduced.output_names)}
    else:
        points = source.body.nodes if needs == "body" else source.superelement.interfaces
        named = {"nodes": [node.node for node in points]}
    return {"coordinates": source.reduced.size, **named, "remarks": remarks}


def _require_nodes(source):
    """Raise InputError for a body without interface nodes; it names the formats that need none."""
    others = ", ".join(writer.name for writer in map(WRITERS.load, WRITERS.own) if writer.needs == "reduced")
    try:
        nodes = source.body.nodes
    except InputError as error:
        if source.result.floating_frame is not None:
            raise
        raise InputError(f"{error}; formats without nodes: {others}") from error
    if not nodes:
        raise InputError("no interface nodes, since no input or output belongs to a node; name some by --nodes, or "
                         f"choose a --format without nodes: {others}")  # fmt: skip


@contextmanager
def _naming(path):
    """Put the name of the file before what a writer refuses."""
    try:
        yield
    except InputError as error:
        if str(error).startswith(f"{path}:"):
            raise
        raise InputError(f"{path}: {error}") from error
