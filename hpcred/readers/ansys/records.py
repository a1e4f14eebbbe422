"""Read the records of ANSYS' binary files (.full, .rst), one by one, or many columns of a matrix at once.

A record is a word with its length n, a word of flags, n words, and its length again. Words have 4 bytes, positions in
the file count words. Integers take one word, floating-point numbers two. The flags tell which of them it is, and
whether zeros are omitted: by a bit mask, or as windows of nonzeros.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...files.system_errors import damaged_file, open_input, read_numbers, reading_from
from ...files.text import require_file
from ...parallel.failures import InputError

WORD = np.dtype("<i4")
INTEGER, SHORT, ZIPPED, WINDOWS, BITS = (1 << k for k in (31, 30, 29, 28, 27))
STANDARD = 100  # words of the first header
NUMBERS = {2: "element", 3: "element", 4: ".full", 8: "substructure", 9: "mode shape", 12: "result"}  # what a file is
FULL = 4
BLOCKS = [2**k for k in range(10, 23)]  # words; the end of a file is filled up to a multiple of one of them
PIECE = 2**21  # words of columns looked at in one step
FEW = 2**14
SHORT_FLAGS = [0, WINDOWS, BITS]
BEFORE = np.int32(-(2**31))  # the flags of plain integers, as a word


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is a binary file of ANSYS, in either order of bytes."""
    words = np.frombuffer(start[: 4 * (STANDARD + 3)], WORD) if len(start) >= 4 * (STANDARD + 3) else []
    return len(words) > 0 and any(
        head[0] == head[-1] == STANDARD and head[1] == BEFORE for head in (words, words.byteswap())
    )


def file_number(start: bytes) -> int:
    """Return the kind of the file, a key of NUMBERS."""
    return int(np.frombuffer(start[8:12], WORD)[0])


class RecordFile:
    """A binary file of ANSYS. Raises InputError when it is none, cut off, or of a machine with other bytes."""

    def __init__(self, path, number: int):
        self.path = Path(path)
        require_file(path)
        bytes_ = self.path.stat().st_size
        with open_input(path) as file:
            start = file.read(4 * (STANDARD + 3))
        if not begins(start):
            raise damaged_file(path, "no header of ANSYS' binary files")
        if np.frombuffer(start[:4], WORD)[0] != STANDARD:
            raise InputError(
                f"{path}: found bytes in the order of another machine (big-endian), expected little-endian; write the "
                "file on the machine that you use now"
            )
        found = file_number(start)
        if found != number:
            raise InputError(
                f"{path}: found a binary file of ANSYS of kind {found} ({NUMBERS.get(found, 'unknown')} file), "
                f"expected the {NUMBERS[number]} file"
                f"{' of a modal analysis (ANTYPE,MODAL with WRFULL,1), which may lie beside it' * (number == FULL)}"
            )
        if bytes_ % 4:
            raise damaged_file(path, f"{bytes_} bytes, expected words of 4 bytes")
        self.size = bytes_ // 4
        with reading_from(path):
            self._few = np.memmap(path, WORD, "r")  # for headers of records; opening the file for each takes too long

    def damaged(self, position, found: str) -> InputError:
        return damaged_file(self.path, f"{found} at word {position}")

    def words(self, position: int, count: int) -> np.ndarray:
        """Return some words (count,) as integers."""
        if not 0 <= position <= position + count <= self.size:
            raise self.damaged(position, f"a record that reaches beyond the end of the file ({self.size} words)")
        if count < FEW:
            return np.array(self._few[position : position + count])
        return read_numbers(self.path, WORD, count, offset=4 * position)

    def words_at(self, positions: np.ndarray, count: int) -> np.ndarray:
        """Return so many words from each of some positions (k,), as integers (k, count)."""
        if count < 0 or not ((positions >= 0) & (positions + count <= self.size)).all():
            raise self.damaged(int(positions.max()), f"records beyond the end of the file ({self.size} words)")
        return self._few[positions[:, None] + np.arange(count)]

    @staticmethod
    def is_plain(flags: int) -> bool:
        """Test whether a record has all of its numbers one after the other."""
        return not flags & (BITS | WINDOWS | ZIPPED)

    def frame(self, position: int) -> tuple[int, int]:
        """Return length and flags of a record, whose end is where it must be."""
        length, flags = (int(word) for word in self.words(position, 2))
        flags &= 0xFFFFFFFF
        if length < 0 or flags & 0x07FFFFFF:
            raise self.damaged(position, f"no record (length {length}, flags {flags:#x})")
        if int(self.words(position + 2 + length, 1)[0]) != length:
            raise self.damaged(position, f"a record of {length} words without its length at the end")
        return length, flags

    def record(self, position: int) -> tuple[np.ndarray, int]:
        """Return the numbers of a record, integers or floating-point, and where the next one begins."""
        length, flags = self.frame(position)
        return self.decoded(self.words(position + 2, length), flags, position), position + length + 3

    def part(self, position: int, low: int, high: int) -> np.ndarray:
        """Return the numbers low..high of a record; one with zeros squeezed out is small, and is unfolded whole."""
        length, flags = self.frame(position)
        if flags & (BITS | WINDOWS | ZIPPED | SHORT):
            return self.record(position)[0][low:high]
        width = 1 if flags & INTEGER else 2
        return self.decoded(self.words(position + 2 + width * low, width * (high - low)), flags, position)

    def count(self, position: int) -> int:
        """Return how many numbers a record holds."""
        length, flags = self.frame(position)
        if flags & (BITS | WINDOWS) and length:
            return int(self.words(position + 2, 1)[0])
        return length if flags & INTEGER else length // 2

    def integers(self, position: int, count: int, what: str) -> tuple[np.ndarray, int]:
        """Return a record of `count` integers, and where the next one begins."""
        numbers, after = self.record(position)
        if len(numbers) != count or numbers.dtype.kind != "i":
            kind = "integers" if numbers.dtype.kind == "i" else "floating-point numbers"
            raise self.damaged(position, f"{what} of {len(numbers)} {kind}, expected {count} integers,")
        return numbers, after

    def decoded(self, words, flags, position):
        """Return the numbers that the words of a record mean."""
        if flags & ZIPPED or (flags & SHORT and flags & (WINDOWS | BITS)):
            raise InputError(
                f"{self.path}: found a packed record at word {position}, expected plain ones or such without zeros; "
                "write a result file with /FCOMP,RST,0, or take HBMAT and CDWRITE"
            )
        kind = {0: "<f8", INTEGER: "<i4", SHORT: "<f4", INTEGER | SHORT: "<i2"}[flags & (INTEGER | SHORT)]
        if not flags & (WINDOWS | BITS):
            if kind == "<f8" and len(words) % 2:
                raise self.damaged(position, f"floating-point numbers in {len(words)} words")
            return words.view(kind)
        if len(words) < 2 or words[0] < 0:
            raise self.damaged(position, "a squeezed record without its size")
        unfold = _from_bits if flags & BITS else _from_windows
        numbers = unfold(words, kind, 1 if flags & INTEGER else 2)
        if numbers is None:
            raise self.damaged(position, "a squeezed record that does not fill its size")
        return numbers


def _from_bits(words, kind, width):
    """Return numbers of which only those are stored whose bit is set; None where that does not fit."""
    size, mask = int(words[0]), int(words[1]) & 0xFFFFFFFF
    set_ = np.array([k for k in range(32) if mask >> k & 1], dtype=np.int64)
    if size > 32 or (set_ >= size).any() or len(words) != 2 + width * len(set_):
        return None
    numbers = np.zeros(size, kind)
    numbers[set_] = words[2:].view(kind)
    return numbers


def _from_windows(words, kind, width):
    """Return numbers given where they are not zero: alone, or a window of several or of one value; or None."""
    size, windows = int(words[0]), int(words[1])
    numbers, at = np.zeros(size, kind), 2
    for _ in range(windows):
        if at >= len(words):
            return None
        place = int(words[at])
        if place > 0:  # a number alone
            length, stored, at = 1, 1, at + 1
        else:
            if at + 1 >= len(words):
                return None
            place, length, at = -place, int(words[at + 1]), at + 2
            stored, length = (1, -length) if length < 0 else (length, length)
        if place + length > size or at + width * stored > len(words):
            return None
        numbers[place : place + length] = words[at : at + width * stored].view(kind)
        at += width * stored
    return numbers if at == len(words) else None


@dataclass
class Columns:
    """Some columns of a lower triangle: `rows` (from 1) and `values` below the diagonal, `counts` of them a column.

    `column` (from 1) and `diagonal`: of each column what its records have last. `begin`, `end`: words of the file.
    """

    rows: np.ndarray
    values: np.ndarray
    column: np.ndarray
    diagonal: np.ndarray
    counts: np.ndarray
    begin: int
    end: int


def columns(file: RecordFile, start: int, count: int, terms: int, rank: int, ranks: int):
    """Yield Columns, the share of a rank of `count` with `terms` entries. Raises InputError where not all are plain
    records."""
    # a rank finds its first column by what a pair of records looks like; whether shares meet is for the caller to see
    stop = start + 6 * count + 3 * terms
    low, high = (start + (stop - start) * k // ranks for k in (rank, rank + 1))
    stop = min(stop, file.size)
    position, window, synchronised = low, PIECE, low == start
    while position < high:
        words = file.words(position, max(0, min(window, stop - position)))
        first, lengths = _plain_columns(words)
        if not len(first) or (synchronised and first[0] != 0):
            if position + len(words) < stop and window < PIECE * 64:
                window *= 4  # a long column
                continue
            if synchronised:
                raise _no_column(file, position)
            return  # the last column began before
        first, lengths, after = _chained(first, lengths, first + 3 * lengths + 6)
        broken = np.flatnonzero(first[1:] != after[:-1])
        if broken.size:
            raise _no_column(file, position + int(after[broken[0]]))
        mine = position + first < high
        first, lengths = first[mine], lengths[mine]
        if not len(first):
            return
        begin, end = int(first[0]), int(first[-1] + 3 * lengths[-1] + 6)
        # frame, rows, diagonal, frames, values, diagonal, frame
        runs = np.full((len(first), 7), [2, 0, 1, 3, 0, 2, 1])
        runs[:, 1], runs[:, 4] = lengths - 1, 2 * lengths - 2
        role = np.repeat(np.tile(np.array([0, 1, 2, 0, 3, 4, 0], np.int8), len(first)), runs.ravel())
        rows, column, values, diagonal = (words[begin:end][role == k] for k in (1, 2, 3, 4))
        yield Columns(rows, values.view("<f8"), column, diagonal.view("<f8"), lengths - 1, position + begin,
                      position + end)  # fmt: skip
        position, window, synchronised = position + end, PIECE, True


def _no_column(file, position):
    """Return why there is no plain column at a place."""
    try:
        length, flags = file.frame(position)
        flags |= file.frame(position + length + 3)[1]
    except InputError as error:
        return error
    if flags & (WINDOWS | BITS | SHORT):
        return InputError(f"{file.path}: found a matrix with zeros left out of its columns at word {position}, "
                          "expected plain columns; take HBMAT and CDWRITE")  # fmt: skip
    return file.damaged(position, "no column of a matrix")


def _plain_columns(words):
    """Return where columns begin that lie completely in the words, and their numbers of entries."""
    first = np.flatnonzero(words == BEFORE) - 1
    first = first[first >= 0]
    lengths = words[first].astype(np.int64)
    fits = (lengths > 0) & (first + 3 * lengths + 6 <= len(words))
    first, lengths = first[fits], lengths[fits]
    fits = (
        (words[first + lengths + 2] == lengths) & (words[first + lengths + 3] == 2 * lengths)
        & (words[first + lengths + 4] == 0) & (words[first + 3 * lengths + 5] == 2 * lengths)
    )  # fmt: skip
    return first[fits], lengths[fits]


def _chained(first, lengths, after):
    """Return where candidates begin, their lengths and ends, without those that lie inside of another record."""
    while (inside := np.flatnonzero(first[1:] < after[:-1])).size:
        first, lengths, after = (np.delete(array, inside[0] + 1) for array in (first, lengths, after))
    return first, lengths, after


def short_records(file: RecordFile, start: int, count: int, size: int, rank: int, ranks: int) -> np.ndarray:
    """Return numbers (share, size) of the share of one rank of `count` records in a row, of `size` each."""
    low, high = (count * k // ranks for k in (rank, rank + 1))
    position, number, shares = start, 0, [np.zeros((0, size))]
    while number < high:
        words = file.words(position, min(PIECE, file.size - position))
        first = np.flatnonzero(np.isin(words, SHORT_FLAGS)) - 1
        first = first[first >= 0]
        lengths = words[first].astype(np.int64)
        fits = (lengths > 1) & (lengths <= 2 * size + 4) & (first + lengths + 3 <= len(words))
        first, lengths = first[fits], lengths[fits]
        fits = words[first + lengths + 2] == lengths
        first, lengths, after = _chained(first[fits], lengths[fits], (first + lengths + 3)[fits])
        broken = np.flatnonzero(np.append(True, first[1:] != after[:-1])[: len(first)])
        whole = len(first) if len(broken) < 2 else broken[1]
        whole = min(whole, count - number)
        if not whole or first[0] != 0:
            raise file.damaged(position, f"no record of {size} numbers")
        inside = slice(max(low - number, 0), max(min(high - number, whole), 0))
        shares.append(_unfolded(file, words, first[inside], lengths[inside], size, position))
        position, number = position + int(after[whole - 1]), number + whole
    return np.concatenate(shares)


def _unfolded(file, words, first, lengths, size, position):
    """Return numbers (records, size) of short records; those with the same mask of bits in one step."""
    numbers = np.full((len(first), size), np.nan)
    flags = words[first + 1]
    plain = np.flatnonzero((flags == 0) & (lengths == 2 * size))
    numbers[plain] = words[first[plain, None] + np.arange(2, 2 + 2 * size)].view("<f8")
    squeezed = np.flatnonzero(flags == np.int32(BITS))
    masks = words[first[squeezed] + 3]
    for mask in np.unique(masks):
        some = squeezed[masks == mask]
        if (lengths[some] == lengths[some[0]]).all():
            block = words[first[some, None] + np.arange(2, 2 + lengths[some[0]])]
            sample = _from_bits(block[0], "<f8", 2)
            if sample is not None and len(sample) == size and (block[:, 0] == size).all():
                numbers[some] = 0.0
                numbers[some[:, None], [k for k in range(size) if int(mask) >> k & 1]] = block[:, 2:].copy().view("<f8")
    for k in np.flatnonzero(flags == np.int32(WINDOWS)):
        values = file.decoded(words[first[k] + 2 : first[k] + 2 + lengths[k]], WINDOWS, position + int(first[k]))
        numbers[k] = values if len(values) == size else np.nan
    wrong = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
    if wrong.size:
        raise file.damaged(position + int(first[wrong[0]]), f"no record of {size} finite numbers")
    return numbers
