"""Compute sums over chunks of the rows of an array, which any part of the rows is checked by, and digests of files.

The sum of a chunk is the hash XXH3 (64 bits; Y. Collet's xxHash) of its bytes, exclusive or a number for the type and
the shape of the whole. Damage goes unseen once in 2^64 times.
"""

from math import prod

import numpy as np
from xxhash import xxh3_64_intdigest as hashed
from xxhash import xxh3_128, xxh3_128_digest

from ..parallel.failures import agreed
from .system_errors import open_input

ROWS_OF_SUM = 8192  # files keep sums of so many. Fewer cost more, a call each; more are read for a single row
BYTES_OF_A_PIECE = 2**25  # bytes of a file of any kind; each rank reads every size-th piece
MESSAGE = 2**28  # bytes that ranks send of a chunk at a time


def sums_of(array: np.ndarray, axis: int, tag: int, low: int = 0, high: int | None = None) -> np.ndarray:
    """Sums (leading, chunks) of the rows low..high of an array along `axis`, the first of them beginning a chunk.

    `leading`: what the axes before `axis` make up. `tag`: see tag_of. Raises TypeError for an array of objects.
    """
    leading, rows = prod(array.shape[:axis]), array.shape[axis]
    content = memoryview(np.ascontiguousarray(array).reshape(-1).view(np.uint8))
    width = len(content) // max(leading * rows, 1)  # bytes of a row
    high = rows if high is None else high
    starts = range(low, high, ROWS_OF_SUM)
    sums = [
        hashed(content[(line + start) * width : (line + min(start + ROWS_OF_SUM, high)) * width])
        for line in range(0, leading * rows, max(rows, 1))
        for start in starts
    ]
    return np.array(sums, np.uint64).reshape(leading, len(starts)) ^ np.uint64(tag)


def tag_of(dtype, shape, axis: int) -> int:
    """A number for the type and the shape of a whole array, and for the axis of its rows."""
    return hashed(f"{np.dtype(dtype).str} {tuple(map(int, shape))} {axis}".encode())


def sums_of_parts(comm, local: np.ndarray, axis: int, first: int, tag: int) -> np.ndarray:
    """Sums (leading, chunks) of the chunks that begin on this rank; `local`: its rows, `first` the number of the first.

    Ranks with later rows of a chunk send them to the rank where it begins. Collective.
    """
    local, leading, rows = np.ascontiguousarray(local), prod(local.shape[:axis]), local.shape[axis]
    head = min(-first % ROWS_OF_SUM, rows)  # rows of a chunk that begins on an earlier rank
    last = head + (rows - head) // ROWS_OF_SUM * ROWS_OF_SUM
    beginner = np.searchsorted(comm.allgather(first), first // ROWS_OF_SUM * ROWS_OF_SUM, side="right") - 1
    lines = local.reshape(leading, rows, prod(local.shape[axis + 1 :]))
    step = max(MESSAGE // max(ROWS_OF_SUM * lines.shape[2] * lines.itemsize, 1), 1)
    tails = []
    for low in range(0, max(leading, 1), step):
        columns = lines[low : low + step]
        heads = comm.alltoall([columns[:, :head] if head and rank == beginner else None for rank in range(comm.size)])
        tail = np.concatenate([columns[:, last:], *(block for block in heads if block is not None)], axis=1)
        tails.append(sums_of(tail, 1, tag))
    return np.hstack([sums_of(local, axis, tag, head, last), np.vstack(tails)])


def content_of(path, comm) -> str:
    """The hash XXH3 of the hashes of the chunks of a file, 32 hexadecimal digits. Collective. Raises InputError."""
    own = []
    with agreed(comm), open_input(path) as file:
        end = file.seek(0, 2)
        for start in range(comm.rank * BYTES_OF_A_PIECE, end, comm.size * BYTES_OF_A_PIECE):
            file.seek(start)
            own.append((start, xxh3_128_digest(file.read(BYTES_OF_A_PIECE))))
    chunks = sorted(sum(comm.allgather(own), []))
    return xxh3_128(b"".join(digest for _, digest in chunks)).hexdigest()
