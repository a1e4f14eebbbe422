"""Convert files of other programs into a model.h5, and describe what it has."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..analysis.summary import inspect
from ..files.model_file import FORMAT, write_model
from ..files.outputs import check_outputs, hdf5_kind
from ..files.result_file import FORMAT as OF_RESULTS
from ..files.result_file import write_result
from ..files.together import rescued
from ..model.units import SI, in_si, units_of
from ..parallel.declared import flattened
from ..parallel.failures import InputError
from ..parallel.plugins import OWN
from ..parallel.progress import Progress
from ..readers.model_source import load_export, load_source
from ..readers.registry import READERS, readers_of
from ..readers.superelements import read_superelement
from ..settings.declared_terms import DeclaredTerms
from ..settings.source import Source
from .keywords import FileUnits, InputsAndOutputs, Variables
from .model_of_job import with_declared_terms, with_targets
from .workflow import workflow


@workflow
@flattened
def convert(
    source: Source | str | Path, output, *, ends: InputsAndOutputs, variables: Variables = None,
    units: FileUnits = "SI", terms: DeclaredTerms, superelement: bool = False, comm=None,
    progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Write a model file from matrix files, or from the main file of a finite-element export. Collective.

    Parameters
    ----------
    source : Source or path
    output : str or PathLike
        model.h5.
    inputs, outputs : optional
        Dofs as for SecondOrderModel.with_inputs, or a matrix file.
    variables : dict of str, optional
        Names of matrices by K, M, D, where the main file of an export holds several.
    units : str
        Those of the files (see units_of); the model file is in SI.
    viscoelastic : sequence
        Parts with their matrix files, as in a job.
    circulatory : bool
        Whether K may be unsymmetric.
    superelement : bool
        Whether the files are a body that is reduced already: the output is a result with all its coordinates, whose
        nodes are interfaces.

    Returns
    -------
    dict
        The report of inspect on the model: plain numbers for a table or JSON, with `sentences` on them and `warnings`
        of what looks wrong; of a superelement its nodes, coordinates and frequencies.

    Raises
    ------
    InputError
        For files that cannot be read completely, or do not fit each other.
    """
    system = units_of(units)
    # nothing that is read may be the output
    reads = source.files if isinstance(source, Source) else [source]
    reads = [*reads, *terms.files]
    check_outputs({output: hdf5_kind(OF_RESULTS if superelement else FORMAT)}, comm, reads, progress=progress)
    if superelement:
        columns = isinstance(source, Source) and any((source.B, source.C, source.Cv, source.Ca))
        if columns or any(ends.given.values()) or any(terms.given.values()):
            raise InputError("superelement: has all directions of its nodes as inputs and outputs, and symmetric "
                             "matrices K, M and D; leave out inputs, outputs, B, C, viscoelastic and "
                             "circulatory")  # fmt: skip
        return _superelement(source, output, variables, units, comm, progress)
    # the model in SI, with what the files do not say
    name = Path(output).name
    with progress.stage("read", source.K if isinstance(source, Source) else str(source)):
        if isinstance(source, Source):
            model = load_source(source, comm, name)
        else:
            model = load_export(source, comm, name, variables)
    model = with_declared_terms(model, terms)
    if system != SI:
        with model:
            converted = in_si(model, system)
        model = converted
    for key, targets in ends.given.items():  # they name nodes, so they come after the units
        model = with_targets(model, key.removesuffix("s"), targets or None)
    with model:
        with progress.stage("check"):
            # what looks wrong is said, and the model is written all the same
            report = inspect(model, progress=progress)
            report["warnings"] = [*report["warnings"], *comm.bcast(READERS.broken)]
        with progress.stage("write", str(output)):
            rescued(lambda place: write_model(place, model), output, comm)
        return {"output": str(output), **report}


def _superelement(source, output, variables, units, comm, progress) -> dict:
    """Write a superelement as a result. Collective."""
    with progress.stage("read", source.K if isinstance(source, Source) else str(source)):
        result = read_superelement(source, comm, variables=variables, units=units)
    reduced, record = result.reduced, result.reduced.record
    warnings = [*record.warnings, *comm.bcast(READERS.broken)]
    with progress.stage("write", str(output)):
        rescued(lambda place: write_result(place, reduced, nodes=result.nodes), output, comm)
    others = [node.label for node in result.nodes if node.label not in {own.name for own in reduced.interfaces}]
    placed, frequencies = len(reduced.input_names), np.sort(reduced.frequencies)
    known = frequencies.any() or not reduced.K.any()  # not of a spring, which has no mass
    return {
        "output": str(output), "size": reduced.size, "nodes_with_six_directions": [i.name for i in reduced.interfaces],
        "other_nodes": others, "coordinates_without_place": reduced.size - placed,
        "rigid_body_modes": int((frequencies == 0).sum()) if known else None,
        "lowest_frequencies_hz": frequencies[:10].tolist() if known else None,
        "warnings": warnings,
    }  # fmt: skip


def list_formats() -> list[dict]:
    """Return the formats that `convert` reads.

    Those of other installed packages name their package.

    Returns
    -------
    list of dict
        A row each: name, what it holds, what tells it, and the files beside it.
    """
    rows = []
    for holds, kind in (("model", "a whole model"), ("matrix", "a matrix")):
        for reader in readers_of(holds):
            beside = reader.companions if holds == "model" else "-K, -M, --nodes, --dofs"
            brought = "" if reader.package == OWN else f" (of the package {reader.package})"
            rows.append({"format": reader.name + brought, "holds": kind, "told by": reader.told_by, "with it": beside})
    return rows
