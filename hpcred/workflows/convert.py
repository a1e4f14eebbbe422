"""Files of other programs enter, model.h5 leaves."""

from __future__ import annotations

from pathlib import Path

from ..formats.hdf5 import check_writable
from ..formats.model_file import write_model
from ..formats.model_source import Source, load_export, load_source
from ..model.rigid_body_modes import doubts_of_nodes
from ..parallel import startup
from ..parallel.progress import Progress


def convert(
    source: Source | str | Path, output, *, inputs=None, outputs=None, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Write a model file from matrix files (a Source), or from the main file of a finite-element export. Collective.

    `inputs`, `outputs`: dofs as for SecondOrderModel.with_inputs. Returns plain numbers for a table or JSON, with
    `warnings` of what is doubtful. Raises InputError.
    """
    comm = comm or startup.start_mpi()
    progress = progress or Progress(comm, show=False)
    check_writable(output, comm)
    load = load_source if isinstance(source, Source) else load_export
    with progress.stage("read", str(source)):
        model = load(source, comm, Path(output).name)
    for key, targets in (("inputs", inputs), ("outputs", outputs)):
        if targets:
            with model:
                loaded = getattr(model, f"with_{key}")(targets)
            model = loaded
    with model:
        warnings = doubts_of_nodes(model) if model.dofs is not None else []
        with progress.stage("write", str(output)):
            write_model(output, model)
        return {
            "output": str(output), "size": model.size, "nonzeros": model.nonzeros, "matrices": sorted(model.matrices),
            "nodes": model.dofs is not None, "inputs": list(model.input_names), "warnings": warnings,
        }  # fmt: skip
