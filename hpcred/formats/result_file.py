"""result.h5: a ReducedModel, its basis, and the record of the run that made it.

reduced/M, D, K (m, m), B (m, p), C (r, m), frequencies (m) in Hz, input_names, output_names
basis/V (m, n), one row a basis vector in the dofs of the full model; dofs/ and elements/ as in model.h5
floating_frame/ and interface/: for multibody programs, see multibody.floating_frame and multibody.shapes
provenance: JSON
"""

import json

import numpy as np

from ..linalg.blocks import local_rows
from ..parallel.failures import agreed
from ..parallel.petsc import MPI
from ..reduction.reduced_model import ReducedModel
from .hdf5 import reading, texts, writing
from .model_file import write_elements

FORMAT = "hpcred-result"
ARRAYS = ("M", "D", "K", "B", "C", "frequencies")
NAMES = ("input_names", "output_names")


def write_result(path, rom: ReducedModel, dofs=None, basis=True, comm=MPI.COMM_WORLD, body=None, elements=None):
    """Write a reduced model; with `basis` also V, by all ranks. Collective. Raises InputError.

    `body`: (FloatingFrame, list of NodeShape) of the same reduction, for multibody programs. `elements`: of the model.
    """
    with writing(path, comm) as file:
        file.attribute("format", FORMAT)
        file.attribute("version", 1)
        for key in ARRAYS:
            file.small(f"reduced/{key}", getattr(rom, key))
        for key in NAMES:
            file.small(f"reduced/{key}", list(getattr(rom, key)))
        if basis and rom.columns is not None:
            with local_rows(rom.columns) as rows:
                file.rows("basis/V", np.ascontiguousarray(rows.real.T), axis=1)
            if rom.left_columns is not None:
                with local_rows(rom.left_columns) as rows:
                    file.rows("basis/W", np.ascontiguousarray(rows.real.T), axis=1)
            if dofs is not None:
                for key in ("node", "direction", "position"):
                    file.rows(f"dofs/{key}", getattr(dofs, key))
            write_elements(file, elements or {})
        if body is not None:
            frame, shapes = body
            for key, value in frame.arrays().items():
                file.small(f"floating_frame/{key}", value)
            file.small("floating_frame/integrals", frame.integrals)
            if shapes:
                file.small("interface/node", np.array([shape.node for shape in shapes]))
                for key in ("position", "phi", "psi", "rotates"):
                    file.small(f"interface/{key}", np.array([getattr(shape, key) for shape in shapes]))
        file.attribute("loss_factor", rom.loss_factor)
        file.small("provenance", rom.provenance)


def read_result(path, comm=MPI.COMM_WORLD) -> ReducedModel:
    """Read a reduced model on every rank, without its basis. Collective. Raises InputError."""
    with agreed(comm), reading(path, FORMAT) as file:
        reduced = file["reduced"]
        return ReducedModel(
            **{key: reduced[key][...] for key in ARRAYS},
            **{key: texts(reduced[key]) for key in NAMES},
            loss_factor=float(file.attrs.get("loss_factor", 0.0)),
            provenance=json.loads(file["provenance"][()].decode()),
        )
