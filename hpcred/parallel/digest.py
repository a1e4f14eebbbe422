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


def digest(comm, first: int, rows: int, between) -> str:
    """XXH3 (128 bits) over the digests of ROWS_OF_DIGEST rows each (hexadecimal), the same on all ranks. Collective.

    The ranks hold the rows in order, this one `rows` of them from row `first` on. `between(low, high)` gives pairs of
    arrays for its rows low to high: how many values each row has (high - low,), and these values in one line. Both
    count as bytes.
    """
    held = comm.allgather((int(first), rows))
    # rows of a chunk that begins on an earlier rank go there
    head = min(-first % ROWS_OF_DIGEST, rows)
    begin = first - first % ROWS_OF_DIGEST
    owner = next((rank for rank, (low, count) in enumerate(held) if low <= begin < low + count), 0)
    tail = [exchange(comm, np.full(len(sent), owner), [sent])[0] for sent in _arrays(between, 0, head)]
    digests = []
    for low in range(head, rows, ROWS_OF_DIGEST):
        high = min(low + ROWS_OF_DIGEST, rows)
        chunk = xxh3_128()
        for sent, following in zip(_arrays(between, low, high), tail, strict=True):
            chunk.update(sent.data)
            if high == rows:
                chunk.update(following.data)
        digests.append(chunk.digest())
    digests = comm.gather(b"".join(digests))
    return comm.bcast(xxh3_128(b"".join(digests)).hexdigest() if comm.rank == 0 else None)


def _arrays(between, low, high):
    for lengths, values in between(low, high):
        yield np.ascontiguousarray(lengths, "<i8")
        yield np.ascontiguousarray(values)


def digest_of_block(comm, first: int, values: np.ndarray) -> str:
    """The digest of an array (rows, columns), as digest() has it. Collective."""
    rows, columns = values.shape
    return digest(comm, first, rows, lambda low, high: [(np.full(high - low, columns), values[low:high].reshape(-1))])


def digest_of_plain(value) -> str:
    """Return the digest of plain data."""
    return xxh3_128(_plain(value)).hexdigest()


def name_of_plain(value, digits: int) -> str:
    """Return so many hexadecimal digits that stand for plain data in the name of a file."""
    return sha256(_plain(value)).hexdigest()[:digits]


def _plain(value) -> bytes:
    return json.dumps(value, sort_keys=True).encode()
