"""The state of an automatic reduction in HDF5: written after each point, read on any number of ranks.

attributes: format, version
basis/V (m, n), one row a column of the big basis, in the free dofs of the frame
state: JSON of what the search knows; job: JSON of what it was asked for, which must be the same when it goes on
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..linalg.blocks import create_block, local_rows
from ..parallel.failures import InputError, agreed
from ..reduction.record import signature_of
from .hdf5 import reading, writing

FORMAT, VERSION = "hpcred-restart", 1
ASKED = ("tolerance", "band", "frame", "damping", "basis", "adaptive")


class RestartFile:
    """A Checkpoint (see reduction.adaptive) on a file, for one job."""

    def __init__(self, path, comm, job):
        self._path, self._comm = Path(path), comm
        table = asdict(job)
        self._asked = json.loads(json.dumps({key: table[key] for key in ASKED}))
        self._model = None

    def load(self, model):
        """The state and the basis in the rows of `model`; None without a file. Collective.

        Raises InputError where the file is damaged or of another job or model.
        """
        self._model = {key: list(values) for key, values in signature_of(model).items()}
        if not self._comm.bcast(os.path.isfile(self._path)):
            return None
        first = model.first_row
        with agreed(self._comm), reading(self._path, FORMAT, VERSION) as file:
            try:
                state, job = (json.loads(file[key][()].decode()) for key in ("state", "job"))
                columns = file["basis/V"][:, first : first + model.local_rows].T
                size = file["basis/V"].shape[1]
            except (KeyError, ValueError, OSError) as error:
                raise InputError(f"--restart {self._path}: damaged ({error}); remove it to begin anew") from error
            if job["asked"] != self._asked:
                changed = [key for key in ASKED if job["asked"].get(key) != self._asked[key]]
                raise InputError(
                    f"--restart {self._path}: it belongs to a job with another {', '.join(changed)}; remove it to "
                    "begin anew"
                )
            same = size == model.size and job["model"].keys() == self._model.keys() and all(
                np.allclose(values, self._model[key], rtol=1e-8, atol=0) for key, values in job["model"].items()
            )  # fmt: skip
            if not same:
                raise InputError(f"--restart {self._path}: it belongs to another model; remove it to begin anew")
        block = create_block(model.K, columns.shape[1])
        with local_rows(block) as rows:
            rows[...] = columns
        return state, block

    def save(self, state: dict, columns):
        """Replace the file. Collective."""
        with writing(self._path, self._comm) as file:
            file.attribute("format", FORMAT)
            file.attribute("version", VERSION)
            with local_rows(columns) as rows:
                file.rows("basis/V", np.ascontiguousarray(rows.real.T), axis=1)
            file.small("state", json.dumps(state))
            file.small("job", json.dumps({"asked": self._asked, "model": self._model}))
