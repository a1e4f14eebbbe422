"""Read text files: whole lines of this rank, as bytes.

Each rank reads a range of bytes; of a gzip file, which has no way in from the middle, every size-th piece.
"""

import gzip
import os
import re
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..parallel.failures import InputError, agreed
from ..parallel.messages import printable
from .system_errors import open_input

PIECE = 2**19  # bytes of text parsed at a time: what is copied on the way stays in the cache
LONGEST_LINE = 2**26  # bytes; a small gzip file may hold one of any length
ENOUGH = 2**10  # bytes in front of a line that show how the line above ends
COMMENT = re.compile(rb"(?m)^[ \t]*(?:%|#|\*\*).*$")
COMMENTS = re.compile(rb"(?:[ \t]*(?:[$!#%]|\*\*)[^\n]*\n|\s*\n)*")  # of any program, above all else
BEGINNING, MOST_COMMENTS = 2**12, 2**20  # bytes by which a format is told, and of the comments above
CONTROL = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")  # characters that are neither signs nor blanks
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
LARGEST_LABEL = 2**31 - 1


@dataclass(frozen=True)
class Piece:
    """Whole lines of a file; `start` is the byte where they begin (in the unpacked text), `share` how much of what this
    rank reads of the file ends with them."""

    path: Path
    text: bytes
    start: int
    share: float = 1.0

    def refusal(self, line: int, expected: str) -> InputError:
        """An InputError for a line, counted from 0 in the piece."""
        words = shown(self.text.split(b"\n", line + 1)[line])
        number = line_number(self.path, self.start) + line
        return InputError(f"{self.path}, line {number}: found '{words}', expected {expected}")

    def require(self, fits: np.ndarray, lines: np.ndarray | None, expected: str):
        """Raise InputError for the first item that does not fit; `lines` of the items, None where each is one."""
        if not fits.all():
            wrong = int(fits.argmin())
            raise self.refusal(wrong if lines is None else int(lines[wrong]), expected)


def shown(line: bytes, most=80) -> str:
    """The beginning of a line of a file for a message, which nothing in it can break or colour."""
    return printable(line.decode("latin-1").strip()[:most])


def absent(path) -> InputError:
    """What to raise where no file has this name, but perhaps something else."""
    reason = "no such file"
    if os.path.exists(path):
        reason = f"this is a {'folder' if os.path.isdir(path) else 'pipe or a device'}, expected a file"
    return InputError(f"{str(path)[:200]}: {reason}")


def require_file(path):
    """Raise InputError unless `path` is a file that can be read."""
    path = Path(path)
    if not os.path.isfile(path):
        raise absent(path)
    with open_input(path):
        pass


def is_packed(path) -> bool:
    """Whether a file is gzip."""
    with open_input(path) as file:
        return file.read(2) == b"\x1f\x8b"


def refuse_packed(path, what=""):
    """Raise InputError for a gzip file (of `what`), where only the text itself can be read."""
    if is_packed(path):
        raise InputError(f"{path}: found a gzip file{what and ' of '}{what}; unpack it first")


@contextmanager
def open_unpacked(path):
    """The file opened for reading bytes, those of the unpacked text where it is gzip."""
    with open_input(path) as file:
        yield gzip.GzipFile(fileobj=file) if is_packed(path) else file


def is_cut_line(path) -> bool:
    """Whether the last line of a text that is not packed has no end, so that its last number may be cut."""
    if is_packed(path) or not os.path.getsize(path):
        return False  # what is packed tells by its own end
    with open_input(path) as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) != b"\n"


def warnings_of_end(path) -> list[str]:
    """A sentence on a text whose last number nothing but a line break would show to be whole."""
    if not is_cut_line(path):
        return []
    return [f"{path}: found no line break at its end; if the file is cut off, its last number may be wrong"]


def first_bytes(path) -> bytes:
    """The first 4096 bytes of the (unpacked) file, without a byte order mark, and more where comments are above.
    Raises InputError."""
    require_file(path)
    try:
        with open_unpacked(path) as file:
            start = file.read(BEGINNING).removeprefix(BYTE_ORDER_MARK)
            while len(start) < min(COMMENTS.match(start).end(), MOST_COMMENTS) + BEGINNING:
                if not (further := file.read(len(start))):
                    break
                start += further
            return start
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: found a damaged gzip file ({error})") from error


def first_line(start: bytes) -> bytes:
    """The first line of a text that is neither blank nor a comment."""
    for line in without_comments(start).splitlines():
        if line.strip():
            return line.strip()
    return b""


def line_number(path, position: int) -> int:
    """The number, from 1, of the line in which a byte of the (unpacked) file lies."""
    count = 1
    with open_unpacked(path) as file:
        while position > 0 and (text := file.read(min(PIECE, position))):
            count += text.count(b"\n")
            position -= len(text)
    return count


def pieces(path, comm, start=0, stop: int | None = None, continued=False):
    """The Pieces of the bytes start..stop of a file that fall to this rank; a line falls to where its first byte lies.

    `continued`: a line that ends with a comma goes on in the next one. Raises InputError.
    """
    if is_packed(path):
        if stop is not None:
            refuse_packed(path)
        yield from _packed_pieces(path, comm, start)
        return
    with open_input(path) as file:
        if start == 0 and file.read(3) == BYTE_ORDER_MARK:
            start = 3
        # the range of this rank, from the first line that begins in it
        stop = Path(path).stat().st_size if stop is None else stop
        low = start + (stop - start) * comm.rank // comm.size
        high = start + (stop - start) * (comm.rank + 1) // comm.size
        if low > start:
            file.seek(low - 1)
            low += len(file.readline()) - 1  # the rest of the line that began before
            while continued and low < stop and _goes_on(file, start, low):
                file.seek(low)
                low += len(file.readline())
        # whole lines up to its end
        file.seek(low)
        first = low
        while low < high:
            text = file.read(min(PIECE, high - low))
            if not text.endswith(b"\n"):
                text += file.readline()
            while continued and text.rstrip().endswith(b",") and low + len(text) < stop:
                text += file.readline()
            yield Piece(path, text, low, min((low + len(text) - first) / (high - first), 1.0))
            low += len(text)


def _goes_on(file, start, low):
    """Whether the text in front of the byte `low`, where a line begins, ends with a comma."""
    file.seek(max(low - ENOUGH, start))
    return file.read(low - file.tell()).rstrip().endswith(b",")


def records(path, comm, start, stop, first: re.Pattern):
    """As `pieces`, but cut only above lines that `first` matches at their beginning. Of files that are not packed."""
    with open_input(path) as file:
        if start == 0 and file.read(3) == BYTE_ORDER_MARK:
            start = 3
        low = start + (stop - start) * comm.rank // comm.size
        high = start + (stop - start) * (comm.rank + 1) // comm.size
        low = low if low == start else _next_record(file, low, stop, first)
        high = _next_record(file, high, stop, first)
        while low < high:
            cut = _next_record(file, min(low + PIECE, high), high, first)
            file.seek(low)
            yield Piece(path, file.read(cut - low), low)
            low = cut


def _next_record(file, at, stop, first):
    """The byte of the first line at or behind the byte `at` that `first` matches, or `stop`."""
    if at >= stop:
        return stop
    file.seek(at - 1)
    at += len(file.readline()) - 1
    while at < stop:
        text = file.read(min(PIECE, stop - at))
        if at + len(text) < stop:
            text += file.readline()
        match = first.search(text)
        if match:
            return at + match.start()
        if not text:
            break
        at += len(text)
    return stop


def _packed_pieces(path, comm, start):
    try:
        with open_unpacked(path) as file:
            file.read(start)
            rest, number = b"", 0
            while text := file.read(PIECE):
                text = rest + text
                cut = text.rfind(b"\n") + 1
                rest = text[cut:]
                if len(rest) > LONGEST_LINE:
                    raise InputError(f"{path}: found a line of more than {LONGEST_LINE >> 20} MB in a gzip file")
                if number % comm.size == comm.rank:
                    yield Piece(path, text[:cut], start)
                start += cut
                number += 1
            if rest and number % comm.size == comm.rank:
                yield Piece(path, rest, start)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: found a damaged gzip file ({error})") from error


def first_lines(comm, counts: list[tuple[int, int]]) -> dict[int, int]:
    """The first line, from 0, of the pieces of all ranks by their start, from (start, lines) of those of this rank.
    Collective."""
    starts, lines = np.array(sorted(sum(comm.allgather(counts), [])), np.int64).reshape(-1, 2).T
    return dict(zip(starts.tolist(), (np.cumsum(lines) - lines).tolist(), strict=True))


def end_to_end(arrays, decode) -> list[np.ndarray]:
    """The arrays that `decode` makes of each of the Pieces, end to end; without any, those of an empty one."""
    return _joined([decode(piece) for piece in arrays], decode)


def write_table(path, columns: dict, digits: int, head: str | None = None):
    """Write columns (n,) of numbers by name as a .csv with so many digits; on this rank. `head`: in place of the names.
    """
    np.savetxt(path, np.array(list(columns.values())).T, f"%.{digits}e", ",", header=head or ",".join(columns),
               comments="", encoding="utf-8")  # fmt: skip


def read_lines(path, comm, decode, start=0) -> list[np.ndarray]:
    """As `end_to_end` of the Pieces of a file, and the place in it of each line. Collective. Raises InputError."""
    with agreed(comm):
        decoded = {piece.start: decode(piece) for piece in pieces(path, comm, start)}
        arrays = _joined(decoded.values(), decode)
    first = first_lines(comm, [(begin, len(columns[0])) for begin, columns in decoded.items()])
    places = [first[begin] + np.arange(len(columns[0])) for begin, columns in decoded.items()]
    return [*arrays, np.concatenate([np.zeros(0, np.int64), *places])]


def _joined(tables, decode):
    return [np.concatenate(arrays) for arrays in zip(*(tables or [decode(Piece(Path(), b"", 0))]), strict=True)]


def without_comments(text: bytes) -> bytes:
    """The text, with nothing in the lines that are comments."""
    return COMMENT.sub(b"", text) if any(mark in text for mark in (b"%", b"#", b"**")) else text
