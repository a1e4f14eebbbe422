"""Arrays enter; sums over chunks of their rows leave, which any part of the rows can be checked by, on any ranks.

The sum of a chunk is that of its 64-bit words (or shorter ones, where the type is shorter), each times an odd weight
that belongs to its place, modulo 2^64. Ranks add up what they have of a chunk; a word that was changed always changes
the sum, since an odd number has an inverse modulo 2^64, and other damage goes unseen once in about 2^64 times.
"""

from __future__ import annotations

import sys
import zlib
from functools import lru_cache
from math import prod

import numpy as np

CHUNK = 1024  # rows under one sum; files keep such sums


def sums_of(array: np.ndarray, axis: int, first: int, tag: int) -> np.ndarray:
    """Sums (leading, chunks) of the rows that an array has along `axis`, the first of them being row `first` of all.

    `leading`: what the axes before `axis` make up; chunks: those that have any of the rows. `tag`: see tag_of.
    """
    leading, rows = prod(array.shape[:axis]), array.shape[axis]
    begin, end = first // CHUNK, -(-(first + rows) // CHUNK)
    sums = np.zeros((leading, end - begin if rows else 0), np.uint64)
    if not sums.size or not array.size:
        return sums
    unit = next(size for size in (8, 4, 1) if array.dtype.itemsize % size == 0)
    words = np.ascontiguousarray(array).reshape(leading, -1).view(f"u{unit}")
    width = words.shape[1] // rows
    used = CHUNK if first % CHUNK + rows > CHUNK else first % CHUNK + rows  # a text may be one row of many words
    weights = _weights(2 ** max(int(used * width - 1), 1).bit_length(), unit == 4)
    head = min(-first % CHUNK, rows)
    whole = (rows - head) // CHUNK

    def add(low, high):
        place = (first + low) % CHUNK * width
        part = words[:, low * width : high * width]
        sums[:, (first + low) // CHUNK - begin] += np.einsum(
            "lw,w->l", part, weights[place : place + part.shape[1]], dtype=np.uint64, casting="safe"
        )

    if head:
        add(0, head)
    if whole:
        part = words[:, head * width : (head + whole * CHUNK) * width].reshape(leading, whole, CHUNK * width)
        low, factors = (first + head) // CHUNK - begin, weights[: CHUNK * width]
        if unit == 4 and sys.byteorder == "little" and part.flags.c_contiguous:
            part, factors = part.view("u8"), factors[::2]
        sums[:, low : low + whole] = np.einsum("lcw,w->lc", part, factors, dtype=np.uint64, casting="safe")
    if head + whole * CHUNK < rows:
        add(head + whole * CHUNK, rows)
    starts = np.arange(begin, end) * CHUNK
    sums[:, starts >= first] += np.uint64(tag)  # by the rank that has the first row
    return sums


def tag_of(dtype, shape, axis: int) -> int:
    """A number for the type and the shape of a whole array, and for the axis of its rows."""
    return zlib.crc32(f"{np.dtype(dtype).str} {tuple(map(int, shape))} {axis}".encode())


def whole_chunks(comm, sums: np.ndarray, first: int, rows: int) -> np.ndarray:
    """The sums (leading, chunks) of the chunks that begin on this rank, from those of all ranks' rows. Collective."""
    begun = rows > 0 and first % CHUNK != 0  # the first chunk begins on an earlier rank
    heads = comm.allgather((first // CHUNK, sums[:, 0]) if begun else None)
    begin = first // CHUNK
    if begun:
        sums, begin = sums[:, 1:], begin + 1
    for head in heads:
        if head is not None and begin <= head[0] < begin + sums.shape[1]:
            sums[:, head[0] - begin] += head[1]
    return sums


@lru_cache(maxsize=8)
def _weights(count, in_halves) -> np.ndarray:
    """Odd numbers without pattern: the generator splitmix64 (Steele, Lea & Flood, OOPSLA 2014) at 1, 2, ..., count.

    `in_halves`: of words of 32 bits, two of which count as one of 64 (on machines with the lower half first).
    """
    if in_halves and sys.byteorder == "little":
        return np.column_stack([_weights(count // 2, False), _weights(count // 2, False) << np.uint64(32)]).reshape(-1)
    z = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (z ^ (z >> np.uint64(31))) | np.uint64(1)
