"""Read coordinates over time from an HDF5 file with the arrays t (nt), q (nt, m), and qdot, qddot (nt, m) perhaps."""

from __future__ import annotations

import h5py
import numpy as np

from ...body.coordinates import Coordinates
from ...files.hdf5 import require_whole
from ...parallel.failures import InputError

NAMES = {"t": "t", "q": "q", "velocity": "qdot", "acceleration": "qddot"}


def read(path) -> Coordinates:
    """Read the arrays. On one rank. Raises InputError."""
    require_whole(path)
    try:
        with h5py.File(path, "r") as file:
            missing = [name for name in ("t", "q") if not isinstance(file.get(name), h5py.Dataset)]
            if missing:
                raise InputError(f"{path}: found the arrays {', '.join(sorted(file)) or 'none'}, and no "
                                 f"{' and no '.join(missing)}; expected t (nt) and q (nt, m)")  # fmt: skip
            found = {key: np.asarray(file[name][()], float) for key, name in NAMES.items() if name in file}
    except (OSError, RuntimeError, ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: cannot be read ({error})") from error
    if found["t"].ndim != 1:
        raise InputError(f"{path}: t has the shape {found['t'].shape}, expected (nt)")
    for key, array in found.items():
        expected = (len(found["t"]), found["q"].shape[-1] if found["q"].ndim else 0)
        if key != "t" and array.shape != expected:
            raise InputError(f"{path}: {NAMES[key]} has the shape {array.shape}, expected (nt, m) = {expected}")
    return Coordinates(**found)
