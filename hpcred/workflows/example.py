"""Write an example model to try things on."""

from __future__ import annotations

from ..examples.crank import crank
from ..examples.linkage import linkage
from ..examples.solid import solid
from ..files.locks import locks_given_back
from ..files.model_file import FORMAT, write_model
from ..files.outputs import check_outputs, hdf5_kind
from ..parallel import startup
from ..parallel.progress import Progress


@locks_given_back()
def write_example(name, output="model.h5", *, comm=None, progress=None, **keywords) -> dict:
    """Write an example as a model file. Collective.

    Parameters
    ----------
    name : {"linkage", "solid", "crank"}
    output : str or PathLike
    **keywords
        Those of the example.

    Returns
    -------
    dict
        `output`, `size`, `inputs` and `sets`.

    Raises
    ------
    InputError
        For keywords that do not fit.
    """
    comm = comm or startup.start_mpi()
    progress = progress or Progress(comm)
    check_outputs({output: hdf5_kind(FORMAT)}, comm, progress=progress)
    with {"linkage": linkage, "solid": solid, "crank": crank}[name](comm=comm, **keywords) as model:
        write_model(output, model)
        made = {"size": model.size, "inputs": list(model.input_names), "sets": sorted(model.sets)}
        return progress.found({"output": str(output), **made})
