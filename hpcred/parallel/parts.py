"""Put rows of all ranks into one array on the first rank, and take them from there, again and again.

Ranks on the node of the first one write to memory that they share with it; others send messages.
"""

from __future__ import annotations

import os

import numpy as np
from mpi4py import MPI

SHARED = "/dev/shm"  # where MPI takes memory that processes share; more than there is ends a process
SPARE = 2.0  # times what is needed must be free there


class Parts:
    """An array on the first rank of a communicator with a place for the rows of each. Call close(). Collective.

    `rows`: of this rank; `columns`: at most. `whole`: the array on the first rank, and on all where they share its
    memory; empty on others else. The rows of rank r with k columns stand in it from starts[r] columns on, column by
    column.
    """

    def __init__(self, comm, rows: int, columns: int, dtype):
        self._comm, self.columns, self._dtype = comm, columns, np.dtype(dtype)
        self.starts = np.concatenate([[0], np.cumsum(comm.allgather(rows), dtype=np.int64)])
        size, self._window = int(self.starts[-1]) * columns, None
        if comm.size > 1 and self._may_share(size * self._dtype.itemsize):
            mine = size * self._dtype.itemsize if comm.rank == 0 else 0
            self._window = MPI.Win.Allocate_shared(mine, self._dtype.itemsize, comm=comm)
            self._window.Lock_all()
            self.whole = np.frombuffer(self._window.Shared_query(0)[0], self._dtype, size)
        else:
            self.whole = np.empty(size if comm.rank == 0 else 0, self._dtype)

    def _may_share(self, size):
        """Whether all ranks are on one node that has the memory."""
        node = self._comm.Split_type(MPI.COMM_TYPE_SHARED)
        fits = node.size == self._comm.size
        node.Free()
        try:
            disk = os.statvfs(SHARED)
            fits = fits and SPARE * size <= disk.f_bavail * disk.f_frsize
        except OSError:
            fits = False
        return self._comm.allreduce(fits, op=MPI.LAND)

    def place(self, rank: int, columns: int) -> np.ndarray:
        """The place (rows, columns) of the rows of a rank, on the first one, or where the memory is shared."""
        first, last = self.starts[rank], self.starts[rank + 1]
        start = first * self.columns
        return self.whole[start : start + (last - first) * columns].reshape((last - first, columns), order="F")

    def gather(self, rows: np.ndarray):
        """Put the rows (rows, columns) of each rank in their places."""
        columns, rank = rows.shape[1], self._comm.rank
        if self._window is not None or rank == 0:
            self.place(rank, columns)[...] = rows
        self._exchange(rows, columns, back=False)

    def scatter(self, rows: np.ndarray):
        """Take the rows (rows, columns) of each rank from their places."""
        columns, rank = rows.shape[1], self._comm.rank
        values = self._exchange(rows, columns, back=True)
        if values is None:
            values = self.place(rank, columns)
        rows[...] = values

    def _exchange(self, rows, columns, back):
        """Let ranks see what others have written; returns rows that came in a message."""
        comm = self._comm
        if self._window is not None:
            self._window.Sync()
            comm.Barrier()
            self._window.Sync()
        elif comm.rank == 0:
            move = comm.Isend if back else comm.Irecv
            MPI.Request.Waitall([move(self.place(rank, columns), rank) for rank in range(1, comm.size)])
        elif back:
            received = np.empty(rows.shape, self._dtype, order="F")
            comm.Recv(received, 0)
            return received
        else:
            comm.Send(np.asfortranarray(rows, self._dtype), 0)
        return None

    def close(self):
        self.whole = None
        if self._window is not None:
            self._window.Unlock_all()
            self._window.Free()
        self._window = None
