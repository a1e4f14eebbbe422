"""Describe any file that hpcred reads or writes, and what a model needs to be reduced."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..analysis.summary import inspect
from ..fe.dofs import target_name
from ..fe.materials import properties_in_words
from ..files.checked import CHECKSUM, CheckedFile
from ..files.hdf5 import opened
from ..files.model_file import FORMAT as MODEL
from ..files.model_file import read_model
from ..files.opened_hdf5 import guarded, opened_hdf5
from ..files.outputs import HDF5, hdf5_kind
from ..files.system_errors import reading_from
from ..files.text import first_bytes, first_line
from ..linalg.solvers.cudss import gpus_in_words
from ..linalg.solvers.settings import PACKAGES
from ..model.interfaces.motion import members
from ..model.interfaces.nodes import warnings_of_interfaces
from ..model.parameters.definitions import rows_of_parameters
from ..parallel.declared import nearest
from ..parallel.failures import HpcredError, InputError, agreed
from ..parallel.petsc import is_complex
from ..parallel.plugins import OWN, blamed
from ..parallel.progress import Progress
from ..parallel.ranges import FREQUENCY, positive, within
from ..readers.abaqus import input_file as abaqus_input
from ..readers.abaqus.matrices import Triplets
from ..readers.calculix import matrix_storage as calculix
from ..readers.entries import LabelledEntries
from ..readers.matrix_formats import read_entries
from ..readers.model_source import read_export
from ..readers.nodes import table as node_table
from ..readers.registry import reader_of
from ..readers.unread import refuse_unread
from ..reduction.result.record import versions
from ..settings.job_file import read_job
from ..writers.registry import WRITERS
from .info_of_output import OUTPUTS, by_writers, damaged, described, read_whole
from .model_of_job import with_interfaces_of_job
from .pair_figures import check_figure
from .set_figure import MOST, draw_sets_of
from .workflow import workflow


def installation() -> dict[str, str]:
    """Return what is installed. Collective where PETSc has not been started.

    Returns
    -------
    dict of str
        The versions of hpcred and what it stands on, the scalars of PETSc, and the GPUs that factors can be made on.
    """
    return versions() | {
        "scalars": "complex" if is_complex() else "real", "packages_of_factors": ", ".join(PACKAGES),
        "gpus": gpus_in_words(),
    }  # fmt: skip


@workflow
def describe_file(
    path, *, frequencies=(), band_top=None, modes=None, variables=None, figure=None, sets=None, comm=None,
    progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Describe a file: a model file as inspect does, a job file by its model, interfaces and loads, others by their
    format and contents. Collective.

    Parameters
    ----------
    path : str or PathLike
    frequencies : sequence of float
        Hz, below which modes of a model are counted.
    band_top : float, optional
        Upper end of a band in Hz, for which the size is estimated.
    modes : int, optional
        So many lowest frequencies are computed.
    variables : dict of str, optional
        Names of matrices by K, M, D in a file that holds several.
    figure : str or PathLike, optional
        A .png, .svg or .pdf of the node sets of a model, or of the interfaces of a job.
    sets : sequence of str, optional
        Only these sets.

    Returns
    -------
    dict
        Plain numbers and words for a table or JSON.

    Raises
    ------
    InputError
        For a file of no known format.
    """
    job = None
    with agreed(comm):
        if Path(path).suffix == ".toml":
            job = read_job(path)
            if frequencies or band_top or modes or sets is not None:
                raise InputError(f"{path}: a job is shown and drawn with its interfaces; modes, sizes and sets are "
                                 "those of a model file")  # fmt: skip
            if figure is not None and not job.interface:
                raise InputError(f"--figure: {path} has no [[interface]] to draw; `hpcred bores` prints some")
    check_figure(figure, comm, [path, *(job.files if job else ())], progress)
    if job:
        return _job(path, job, figure, comm, progress)
    with agreed(comm):
        kind = _kind_of(path)
    export = None if kind else reader_of(path, comm, "model")
    written = None
    if not kind and not (export and export.package != OWN):  # files of Nastran may begin with words between commas
        written = _on_one_rank(path, comm, described, tables=not export)
    single = None if kind or export or written else reader_of(path, comm, "matrix")
    with agreed(comm):
        if not (kind or export or written or (single and single.package != OWN)):
            refuse_unread(path)
        if kind != MODEL and (frequencies or band_top or modes):
            raise InputError(f"{path}: modes can be found in a model file only; convert it first")
        if kind != MODEL and figure is not None:
            raise InputError(f"--figure: {path} is no model file and no job, whose sets can be drawn; convert it first")
    if kind == MODEL:
        for key, given in (("--below", frequencies), ("--band-top", () if band_top is None else (band_top,))):
            for frequency in given:
                positive(key, frequency)
            within(key, tuple(given), FREQUENCY)
        if modes is not None and modes < 1:
            raise InputError(f"--modes: found {modes}, expected at least 1")
        with progress.stage("read", str(path)):
            model = read_model(path, comm)
        with model:
            if figure is not None:
                with progress.stage("figure"):
                    _draw(figure, model, sets)
            with progress.stage("inspect"):
                return inspect(model, frequencies, band_top, modes=modes, progress=progress)
    with progress.stage("read", str(path)):
        if kind in OUTPUTS:
            return read_whole(OUTPUTS[kind], path, comm)
        if written:
            return written
        if kind:
            with agreed(comm), opened(path, kind) as file:
                if CHECKSUM in file.attrs:  # hpcred wrote it, perhaps under another name of the format
                    CheckedFile(file, path)
            return {"format": hdf5_kind(kind), "warnings": []}
        if export:
            return _export(path, export, comm, variables)
        if (single is None or single.vague) and (found := _on_one_rank(path, comm, by_writers, WRITERS.others)):
            return found
        if single:
            return _matrix(path, single, comm)
    if not first_bytes(path):
        raise InputError(f"{path}: found an empty file")
    raise InputError(
        f"{path}: found a file that begins with {first_bytes(path)[:12]!r}, which is none of the formats of "
        "`hpcred convert --list-formats`"
    )


def _draw(figure, model, names):
    """Draw the node sets of a model, or of those of some names. Collective. Raises InputError."""
    known = model.set_sizes
    for name in names or ():
        if name not in known:
            raise InputError(f"--sets: {model.name} has no set '{name}'{nearest(name, known)}; it has "
                             f"{', '.join(known) or 'none'}")  # fmt: skip
    if not known:
        raise InputError(f"--figure: {model.name} has no node sets to draw; `hpcred bores` finds holes and pins, and "
                         "`hpcred info job.toml --figure` draws the interfaces of a job")  # fmt: skip
    chosen = names or [name for name, size in known.items() if size <= MOST] or known
    draw_sets_of(figure, model, {name: model.sets.get(name, np.zeros(0, np.int64)) for name in chosen})


def _job(path, job, figure, comm, progress):
    """Return the model, the loads and the interfaces of a job, which are drawn. Collective. Raises InputError."""
    with progress.stage("read", str(path)):
        model = with_interfaces_of_job(job, comm)
    with model:
        with model.with_loads(job.load) as loaded:
            loads = loaded.loads
        nodes = model.interfaces
        if figure is not None:
            sets = {node.name: np.unique(model.dofs.node[members(model, node.definition)]) for node in nodes}
            with progress.stage("figure"):
                draw_sets_of(figure, model, sets, [(node.name, node.position) for node in nodes])
        rows = [
            {"interface": node.name, "node": node.node, "kind": node.definition.kind, "nodes": node.count}
            | {axis: round(value, 12) + 0.0 for axis, value in zip("xyz", node.position, strict=True)} for node in nodes
        ]  # fmt: skip
        varied = model.declared | ({
            "parameters": rows_of_parameters(job.parameter),
            "terms": [{"of": term.with_matrix(None).of, "factor": term.factor, "matrix": term.matrix_in_words}
                      for term in job.term],
        } if job.term else {})  # fmt: skip
        return {
            "format": "job file", "model": model.name, "dofs": model.size, "output": job.output,
            "interfaces": rows, **({"bases": [_base_row(base) for base in job.base]} if job.base else {}),
            "loads": [load.row for load in loads], **varied,
            "warnings": [*model.remarks, *warnings_of_interfaces(model), *sum((load.notes for load in loads), [])],
        }  # fmt: skip


def _base_row(base) -> dict:
    """What a base of a job is, without the solution that its column may take."""
    places = (name if isinstance(name, str) else target_name(name) for name in base.absolute)
    return {"base": base.name, "inputs": ", ".join(base.input_names),
            "on": "all that is held" if base.on is None else str(base.on), "absolute": ", ".join(places)}  # fmt: skip


def _on_one_rank(path, comm, describe, *arguments, **keywords):
    """Call a function on a file on one rank; refuse a damaged file. Collective. Raises InputError."""
    report = None
    with agreed(comm):
        if comm.rank == 0:
            try:
                with reading_from(path):
                    report = describe(path, *arguments, **keywords)
            except HpcredError:
                raise
            except Exception as error:  # whatever a damaged file makes its reader raise
                raise damaged(path, error) from error
    report = comm.bcast(report)
    return report and {**report, "warnings": []}


def _kind_of(path) -> str | None:
    """Return the format that an HDF5 file of hpcred names, or None."""
    if not first_bytes(path).startswith(HDF5):
        return None
    with opened_hdf5(path) as file, guarded(path, "its attributes"):
        return str(file.attrs.get("format", "")) or None


def _export(path, export, comm, variables):
    report = {"format": export.name}
    with agreed(comm), blamed(export):
        contents = export.contents(path)
    if contents is not None:
        return report | {"matrices": contents, "warnings": []}
    try:
        parts = read_export(path, comm, variables)
    except InputError as error:
        if not abaqus_input.begins(first_bytes(path)):
            raise
        mesh = abaqus_input.read(path, comm, calculix="K" in calculix.files_of(path))
        report["format"] = "Abaqus or CalculiX input file"
        return report | _mesh(comm, mesh.nodes, mesh.elements, mesh.sets, mesh.properties) | {"warnings": [str(error)]}
    report |= {key: f"{parts.files[key]}: {_size(comm, matrix)}" for key, matrix in parts.matrices.items()}
    report |= _mesh(comm, parts.nodes, parts.elements, parts.sets, parts.properties)
    if held := len(set().union(*comm.allgather(set(parts.removed.tolist())))):
        report["held_dofs"] = held
    return report | {"warnings": list(dict.fromkeys(sum(comm.allgather(parts.warnings), [])))}


def _mesh(comm, nodes, elements, sets, properties=None):
    if nodes is None:
        return {"nodes": "none"}
    counts = {"nodes": comm.allreduce(len(nodes.label))}
    if elements:
        counts["elements"] = {kind: comm.allreduce(len(members)) for kind, members in elements.items()}
    if properties is not None:
        counts |= properties_in_words(properties, comm, units=False)
    if sets:
        counts["sets"] = {name: comm.allreduce(len(members)) for name, members in sets.items()}
    return counts


def _matrix(path, single, comm):
    with agreed(comm):
        numbers = first_line(first_bytes(path)).replace(b",", b" ").split()
    if isinstance(single, Triplets) and len(numbers) in (2, 4):
        if len(numbers) == 4:
            return {"format": "lines of node, x, y, z"} | _mesh(comm, node_table.read(path, comm), {}, {}) | {
                "warnings": []}  # fmt: skip
        labels, _ = node_table.read_row_labels(path, comm)
        return {"format": "lines of node, direction", "rows": comm.allreduce(len(labels)), "warnings": []}
    return {"format": single.name, "matrix": _size(comm, read_entries(path, comm)), "warnings": []}


def _size(comm, matrix):
    """Return rows, columns and entries of a matrix in words."""
    entries = comm.allreduce(len(matrix.values))
    largest = max(comm.allgather(float(np.abs(matrix.values).max(initial=0.0))))
    if isinstance(matrix, LabelledEntries):
        return f"{entries} entries between named dofs, the largest {largest:.6g}"
    return f"{matrix.shape[0]} x {matrix.shape[1]}, {entries} entries, the largest {largest:.6g}"

