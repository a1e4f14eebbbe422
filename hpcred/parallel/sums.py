"""Combine small values of the ranks: sums, lists, and whether something holds anywhere."""

import numpy as np
from mpi4py import MPI


def summed(comm, values) -> np.ndarray:
    """The sum of an array (or a number) over the ranks, the same on all of them. Collective."""
    total = np.array(values, order="C")
    if comm.size > 1:
        comm.Allreduce(MPI.IN_PLACE, total, MPI.SUM)
    return total


def anywhere(comm, flags) -> bool:
    """Whether a flag, or one of several, is true on any rank. Collective."""
    return comm.allreduce(bool(np.any(flags)), MPI.LOR)


def joined(comm, items: list) -> list:
    """The items that the ranks have, in the order of the ranks. Collective."""
    return sum(comm.allgather(items), [])
