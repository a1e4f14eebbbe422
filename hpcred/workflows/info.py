"""A model file enters; what there is to know of it before it is reduced leaves."""

from __future__ import annotations

from ..analysis.summary import inspect
from ..formats.model_file import read_model
from ..parallel import startup
from ..parallel.failures import InputError
from ..parallel.progress import Progress


def inspect_file(path, *, frequencies=(), band_top=None, comm=None, progress: Progress | None = None) -> dict:
    """What analysis.summary.inspect says of a model file. Collective. Raises InputError."""
    comm = comm or startup.start_mpi()
    progress = progress or Progress(comm, show=False)
    if (band_top is not None and band_top <= 0) or any(f <= 0 for f in frequencies):
        raise InputError("info: frequencies must be positive")
    with progress.stage("read", str(path)):
        model = read_model(path, comm)
    with model, progress.stage("inspect"):
        return inspect(model, frequencies, band_top, progress=progress)
