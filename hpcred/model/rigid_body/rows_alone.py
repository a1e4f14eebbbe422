"""Warn of supports that a program wrote as rows with nothing but a diagonal entry. Collective."""

from __future__ import annotations

import numpy as np

from ...fe.dofs import SCALAR
from ...linalg.csr import diagonal_of
from ...parallel.petsc import MPI
from ..checked_arrays import row_name

FEWEST_NODES = 3  # of a mesh
SAME = 1e-9  # relative difference of frequencies that are one


def rows_alone(model) -> np.ndarray:
    """Return the rows of this rank (local, from 0) that no matrix couples with others; none where all are such."""
    alone = np.arange(model.local_rows)
    for key in model.matrices:
        alone = np.intersect1d(alone, model.rows_alone_in(key))
    return alone[: 0 if model.comm.allreduce(len(alone)) == model.size else None]


def warnings_of_rows_alone(model) -> list[str]:
    """Return a sentence where rows of a body have nothing beside the diagonal in any of its matrices: each is an
    oscillator of its own, with a frequency that the body does not have.

    Rows of modal coordinates and scalar points may be so, and those of models that are such oscillators altogether.
    """
    comm, alone = model.comm, rows_alone(model)
    stiffness, mass = diagonal_of(model.K), diagonal_of(model.M)
    alone = alone[(stiffness[alone] >= 0) & (mass[alone] > 0)]
    if model.dofs is not None:  # a rigid body at a node or two may have such rows
        alone = alone[(model.dofs.direction[alone] < SCALAR) & (model.node_count >= FEWEST_NODES)]
    frequencies = np.sqrt(stiffness[alone] / mass[alone]) / (2 * np.pi)
    low = comm.allreduce(frequencies.min(initial=np.inf), op=MPI.MIN)
    high = comm.allreduce(frequencies.max(initial=0.0), op=MPI.MAX)
    first = next((name for name in comm.allgather(
        row_name(alone[0], model.first_row, model.dofs) if len(alone) else None) if name), None)  # fmt: skip
    count = comm.allreduce(len(alone))
    if not count:
        return []
    place = f"at {high:.6g} Hz" if high - low <= SAME * high else f"from {low:.4g} to {high:.4g} Hz"
    false = f"{count} false modes" if count > 1 else "a false mode"
    return [
        f"{model.name}: found {count} row{'s' * (count > 1)} with nothing beside the diagonal, the first is {first}, "
        f"as programs write supports and dofs that follow others: {false} {place}; leave such rows and columns out of "
        "the matrices (SecondOrderModel.from_petsc does by `held`)"
    ]
