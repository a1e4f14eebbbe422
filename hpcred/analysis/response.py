"""Frequency responses H(i 2 pi f): of a reduced model densely, of a full model by one factorisation a frequency."""

import numpy as np

from ..errors import InputError
from ..linalg.block import create_block, from_dense, inner
from ..linalg.mumps import SingularMatrix
from ..linalg.real_form import solver_for
from ..model.frame import apply_frame
from ..petsc import MPI
from ..rom import ReducedModel


def frequency_response(model, frequencies, frame=None, damping=None, progress=None) -> np.ndarray:
    """H (frequencies, r, p) of a ReducedModel, or of a SecondOrderModel in a frame with a damping law.

    `frequencies` in Hz. In the Buckens frame the response is that of the elastic part. Collective; the result is
    the same on all ranks. Raises InputError at an undamped pole.
    """
    frequencies = np.atleast_1d(np.asarray(frequencies, dtype=float))
    if isinstance(model, ReducedModel):
        return _reduced(model, frequencies)
    framed = apply_frame(model, frame, damping)
    try:
        return _full(framed, frequencies, progress)
    finally:
        framed.close()


def _reduced(rom, frequencies, comm=MPI.COMM_WORLD):
    """Frequencies are dealt out to the ranks."""
    mine = [rom.transfer_function(2j * np.pi * f) for f in frequencies[comm.rank :: comm.size]]
    response = np.zeros((len(frequencies), len(rom.C), rom.B.shape[1]), dtype=complex)
    for rank, part in enumerate(comm.allgather(mine)):
        if part:
            response[rank :: comm.size] = part
    return response


def _full(framed, frequencies, progress):
    model = framed.model
    loads = from_dense(model.B)
    sensors = from_dense(model.B if model.Ct is None else model.Ct)
    columns = loads.getSizes()[1]
    solver = solver_for(model, framed.rigid, damped=model.D is not None)
    response = np.zeros((len(frequencies), sensors.getSizes()[1], columns), dtype=complex)
    real, imaginary = create_block(model.K, columns), create_block(model.K, columns)
    try:
        for i, frequency in enumerate(frequencies):
            s = 2j * np.pi * frequency
            try:
                solver.solve_at(s, loads, real, imaginary)
            except SingularMatrix as error:
                raise InputError(
                    f"frequency {frequency:.10g} Hz is a pole of the full model (relative distance of its "
                    f"square {error.distance:.1e}); leave it out or add damping"
                ) from error
            response[i] = inner(sensors, real) + 1j * inner(sensors, imaginary)
            if progress is not None:
                progress.say(f"full model, {frequency:g} Hz ({i + 1} of {len(frequencies)})")
    finally:
        for item in (loads, sensors, real, imaginary):
            item.destroy()
        solver.close()
    return response
