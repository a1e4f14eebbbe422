"""Files of other programs enter, model.h5 leaves."""

from pathlib import Path

from ..formats.hdf5 import check_writable
from ..formats.model_file import write_model
from ..formats.model_source import Source, abaqus_source, column_names, load_export, load_source, read_columns
from ..parallel.petsc import MPI

# the names under which the other rooms still look for these
convert = load_source
__all__ = ["Source", "abaqus_source", "column_names", "convert", "convert_files", "read_columns"]


def convert_files(source, output, *, inputs=None, outputs=None, comm=MPI.COMM_WORLD) -> dict:
    """Write a model file from a Source, or from the main file of a finite-element export. Collective.

    `inputs`, `outputs`: dofs as for SecondOrderModel.set_inputs. Returns plain numbers for a table or JSON. Raises
    InputError.
    """
    check_writable(output, comm)
    load = load_source if isinstance(source, Source) else load_export
    with load(source, comm, Path(output).name) as model:
        if inputs:
            model.set_inputs(inputs)
        if outputs:
            model.set_outputs(outputs)
        write_model(output, model)
        return {
            "output": str(output), "size": model.size, "matrices": sorted(model.matrices), "nodes": bool(model.dofs),
            "inputs": model.input_names,
        }  # fmt: skip
