"""Coordinates to rows: entries (row, column, value) from any rank enter, CSR rows of this rank leave."""

import numpy as np

from ..petsc import MPI

CHUNK = 2**27  # entries sent to one rank in one message, below MPI's 32-bit counts


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
            for low in range(0, incoming[rank], CHUNK):
                part = receive[start_in[rank] + low : start_in[rank] + min(low + CHUNK, incoming[rank])]
                requests.append(comm.Irecv(part, source=rank))
        for rank in range(comm.size):
            for low in range(0, counts[rank], CHUNK):
                part = send[start_out[rank] + low : start_out[rank] + min(low + CHUNK, counts[rank])]
                requests.append(comm.Isend(part, dest=rank))
        MPI.Request.Waitall(requests)
        results.append(receive)
    return results


def compress(entries: dict, first: int, last: int, columns: int):
    """CSR of the rows first..last-1 on the union pattern of square matrices, with duplicates summed.

    `entries`: name -> (rows, columns, values) with global numbers from 0. Returns indptr (rows + 1,), indices
    (nonzeros,) and a dict name -> values (nonzeros,).
    """
    keys = {name: (i - first) * columns + j for name, (i, j, _) in entries.items()}
    diagonal = np.arange(last - first) * (columns + 1) + first  # always present, as PETSc wants it
    pattern = np.unique(np.concatenate([diagonal, *(np.unique(key) for key in keys.values())]))
    rows, indices = np.divmod(pattern, columns)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows.astype(np.int64), minlength=last - first))])
    values = {}
    for name, (_, _, data) in entries.items():
        place = np.searchsorted(pattern, keys[name])
        values[name] = np.bincount(place, weights=data, minlength=pattern.size)
    return indptr, indices, values
