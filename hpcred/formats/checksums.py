"""Arrays enter; sums over chunks of their rows leave, which any part of the rows can be checked by, on any ranks.

The sum of a chunk is that of its 64-bit words (or shorter ones, where the type is shorter), each times an odd weight
that belongs to its place, modulo 2^64. Ranks add up what they have of a chunk; a word that was changed always changes
the sum, since an odd number has an inverse modulo 2^64. Of a 64-bit word the upper half is first folded onto the lower
one (exclusive or), as the highest bit times any odd weight is the same: all damage then changes bits below the 32nd,
and that of several words goes unseen once in 2^32 times, or less often. Sums of earlier files, without the fold, do not
see the signs of two numbers change.
"""

from __future__ import annotations

import sys
import zlib
from functools import lru_cache
from math import prod

import numpy as np

CHUNK = 1024  # rows under one sum; files keep such sums
HAND = 2**18  # bytes that the processor keeps at hand while they are folded and summed


def sums_of(array: np.ndarray, axis: int, first: int, tag: int, *, folded: bool = True) -> np.ndarray:
    """Sums (leading, chunks) of the rows that an array has along `axis`, the first of them being row `first` of all.

    `leading`: what the axes before `axis` make up; chunks: those that have any of the rows. `tag`: see tag_of.
    `folded`: False for sums of earlier files.
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
    weights = _weights(2 ** max(int(used * width - 1), 1).bit_length(), unit == 4 and not folded)
    head = min(-first % CHUNK, rows)
    last = head + (rows - head) // CHUNK * CHUNK
    step = max(HAND // max(leading * CHUNK * width * unit, 1), 1) * CHUNK

    def add(low, high):
        """Rows of one chunk, or some whole chunks."""
        place, chunk = (first + low) % CHUNK * width, (first + low) // CHUNK - begin
        part = words[:, low * width : high * width].reshape(leading, max((high - low) // CHUNK, 1), -1)
        found = _weighed(part, weights[place : place + part.shape[2]], folded)
        sums[:, chunk : chunk + found.shape[1]] += found

    for low, high in [(0, head), *((at, min(at + step, last)) for at in range(head, last, step)), (last, rows)]:
        if low < high:
            add(low, high)
    starts = np.arange(begin, end) * CHUNK
    sums[:, starts >= first] += np.uint64(tag)  # by the rank that has the first row
    return sums


def _weighed(words, weights, folded):
    """Sums (leading, chunks) of words (leading, chunks, count) times their weights."""
    half = np.uint64(32)
    if words.itemsize == 4 and words.shape[2] % 2 == 0 and sys.byteorder == "little":  # two at a time
        pairs, low, high = words.view("u8"), weights[::2], weights[1::2]
        found = _dot(pairs, low)
        return found + _dot(pairs >> half, high - (low << half)) if folded else found
    if words.itemsize == 8 and folded:
        upper = words >> half
        words = np.bitwise_xor(upper, words, out=upper)
    return _dot(words, weights)


def _dot(words, weights):
    return np.einsum("lcw,w->lc", words, weights, dtype=np.uint64, casting="safe")


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
