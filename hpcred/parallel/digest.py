"""Compute digests of distributed arrays that do not depend on how many ranks share the rows, and of plain data.

XXH3 tells contents from others, fast; names of files, which stand for all that they depend on, are of SHA-256.
"""

from __future__ import annotations

import json
from hashlib import sha256

import numpy as np
from xxhash import xxh3_128

from .exchange import exchange

ROWS_OF_DIGEST = 4096  # records of results keep digests over so many: with another number they are others


def digest(comm, first: int, parts) -> str:
    """XXH3 (128 bits) over the digests of ROWS_OF_DIGEST rows each (hexadecimal), the same on all ranks. Collective.

    The ranks hold the rows in order, this one from row `first` on. `parts`: arrays as pairs (starts (rows + 1,),
    values): row i of this rank has values[starts[i] : starts[i + 1]]. Values count as bytes, and so does their type.
    """
    rows = len(parts[0][0]) - 1
    held = comm.allgather((int(first), rows))
    # rows of a chunk that begins on an earlier rank go there
    head = min(-first % ROWS_OF_DIGEST, rows)
    begin = first - first % ROWS_OF_DIGEST
    owner = next((rank for rank, (low, count) in enumerate(held) if low <= begin < low + count), 0)
    lengths = [np.diff(starts).astype("<i8") for starts, _ in parts]
    tail = []
    for length, (starts, values) in zip(lengths, parts, strict=True):
        for sent in (length[:head], values[starts[0] : starts[head]]):
            tail += exchange(comm, np.full(len(sent), owner), [sent])
    digests = []
    for low in range(head, rows, ROWS_OF_DIGEST):
        high = min(low + ROWS_OF_DIGEST, rows)
        chunk = xxh3_128()
        for i, (length, (starts, values)) in enumerate(zip(lengths, parts, strict=True)):
            chunk.update(length[low:high].data)
            if high == rows:
                chunk.update(tail[2 * i].data)
            chunk.update(np.ascontiguousarray(values[starts[low] : starts[high]]).data)
            if high == rows:
                chunk.update(tail[2 * i + 1].data)
        digests.append(chunk.digest())
    digests = comm.gather(b"".join(digests))
    return comm.bcast(xxh3_128(b"".join(digests)).hexdigest() if comm.rank == 0 else None)


def digest_of_block(comm, first: int, values: np.ndarray) -> str:
    """The digest of an array (rows, columns), C-contiguous, as digest() has it. Collective."""
    rows, columns = values.shape
    return digest(comm, first, [(np.arange(rows + 1) * columns, values.reshape(-1))])


def digest_of_plain(value) -> str:
    """Return the digest of plain data."""
    return xxh3_128(_plain(value)).hexdigest()


def name_of_plain(value, digits: int) -> str:
    """Return so many hexadecimal digits that stand for plain data in the name of a file."""
    return sha256(_plain(value)).hexdigest()[:digits]


def _plain(value) -> bytes:
    return json.dumps(value, sort_keys=True).encode()
