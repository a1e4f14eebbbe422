"""Send rows of arrays to the ranks that are named for them."""

import numpy as np
from mpi4py import MPI

ENTRIES_OF_MESSAGE = 2**27  # entries sent to one rank in one message, below MPI's 32-bit counts


def exchange(comm, owner: np.ndarray, arrays: list[np.ndarray]) -> list[np.ndarray]:
    """Send entry i of each array to rank owner[i]; order is kept by sending rank. Collective."""
    if comm.size == 1:
        return arrays
    order = np.argsort(owner, kind="stable")
    counts = np.bincount(owner, minlength=comm.size)
    incoming = np.array(comm.alltoall(list(counts)))
    results = []
    for array in arrays:
        send = np.ascontiguousarray(array[order])
        receive = np.empty(incoming.sum(), dtype=array.dtype)
        start_out = np.concatenate([[0], np.cumsum(counts)])
        start_in = np.concatenate([[0], np.cumsum(incoming)])
        requests = []
        for rank in range(comm.size):
            for low in range(0, incoming[rank], ENTRIES_OF_MESSAGE):
                piece = receive[start_in[rank] + low : start_in[rank] + min(low + ENTRIES_OF_MESSAGE, incoming[rank])]
                requests.append(comm.Irecv(piece, source=rank))
        for rank in range(comm.size):
            for low in range(0, counts[rank], ENTRIES_OF_MESSAGE):
                piece = send[start_out[rank] + low : start_out[rank] + min(low + ENTRIES_OF_MESSAGE, counts[rank])]
                requests.append(comm.Isend(piece, dest=rank))
        MPI.Request.Waitall(requests)
        results.append(receive)
    return results
