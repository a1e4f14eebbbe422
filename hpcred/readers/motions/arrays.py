"""Read coordinates over time from an HDF5 file with the arrays t (nt), q (nt, m), and qdot, qddot (nt, m) perhaps."""

from ...body.coordinates import Coordinates
from ...files.opened_hdf5 import guarded, opened_hdf5, real_numbers
from ...parallel.failures import InputError

NAMES = {"t": "t", "q": "q", "velocity": "qdot", "acceleration": "qddot"}


def read(path) -> Coordinates:
    """Read the arrays. On one rank. Raises InputError."""
    with opened_hdf5(path) as file, guarded(path, "its contents"):
        arrays = {key: real_numbers(file, name, path) for key, name in NAMES.items()}
        missing = [name for name in ("t", "q") if arrays[name] is None]
        if missing:
            raise InputError(f"{path}: found the arrays {', '.join(sorted(file)) or 'none'}, and no "
                             f"{' and no '.join(missing)}; expected t (nt) and q (nt, m)")  # fmt: skip
    arrays = {key: array for key, array in arrays.items() if array is not None}
    if arrays["t"].ndim != 1:
        raise InputError(f"{path}: t has the shape {arrays['t'].shape}, expected (nt)")
    for key, array in arrays.items():
        expected = (len(arrays["t"]), arrays["q"].shape[-1] if arrays["q"].ndim else 0)
        if key != "t" and array.shape != expected:
            raise InputError(f"{path}: {NAMES[key]} has the shape {array.shape}, expected (nt, m) = {expected}")
    return Coordinates(**arrays)
