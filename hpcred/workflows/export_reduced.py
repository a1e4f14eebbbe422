"""Export a reduced model that is in memory."""

from __future__ import annotations

from pathlib import Path

from ..files.result_file import write_result
from ..files.temporary import folder_of_all
from ..parallel.declared import declared, spelled
from ..parallel.failures import InputError
from ..reduction.reduced_model import ReducedModel
from .export import export_result


@spelled
def export_reduced(
    reduced, path, format=None, *, nodes=None, units: str = "SI", modes=None, options=None, progress=None
) -> dict:
    """Write a ReducedModel, with the model that it was made from, for another program: see export_result.

    Collective. Raises InputError; one that was read from a file is exported by `export_result`.
    """
    declared("reduced", reduced, ReducedModel)
    if reduced.model is None:
        raise InputError("export: found a reduced model without its full model, as one that was read from a file or "
                         "closed; export the file by hpcred.export_result")  # fmt: skip
    with folder_of_all(reduced.model.comm) as folder:
        result = folder / f"{Path(path).stem or 'result'}.h5"
        write_result(result, reduced, reduced.model)
        try:
            return export_result(
                result, format, path, nodes=nodes, units=units, modes=modes, options=options, comm=reduced.model.comm,
                progress=progress,
            )
        except InputError as error:  # names a file that the caller has never seen
            raise InputError(str(error).replace(str(result), reduced.model.name)) from error
