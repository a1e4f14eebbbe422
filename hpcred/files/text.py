"""Read text files of numbers: whole lines of this rank, as bytes and as strictly read numbers.

Each rank reads a range of bytes; of a gzip file, which has no way in from the middle, every size-th piece.
"""

import gzip
import itertools
import os
import re
import warnings
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from ..parallel.failures import InputError, agreed, printable
from .system_errors import open_input, reading_from

try:
    import fast_matrix_market
except ImportError:
    fast_matrix_market = None
SCIPY_HAS_IT = tuple(map(int, scipy.__version__.split(".")[:2])) >= (1, 12)  # behind scipy.io.mmread

PIECE = 2**19  # bytes of text parsed at a time: what is copied on the way stays in the cache
LONGEST_LINE = 2**26  # bytes; a small gzip file may hold one of any length
ENOUGH = 2**10  # bytes in front of a line that show how the line above ends
BLOCK = 2**16  # bytes looked at in one step of numpy: four times as fast as the whole piece
COMMENT = re.compile(rb"(?m)^[ \t]*(?:%|#|\*\*).*$")
CONTROL = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")  # characters that are neither signs nor blanks
EMPTY_FIELD = re.compile(rb"(?m)(?:,|^)[ \t]*,")
TWO_IN_A_FIELD = re.compile(rb"[^\s,][ \t]+[^\s,]")
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
BARE_EXPONENT = re.compile(rb"(?<=[0-9.])(?=[+-])")  # 1.5-100
LARGEST_WHOLE = 2**53  # up to here a float is exact
LARGEST_LABEL = 2**31 - 1
# fast_matrix_market stops at the end of a number and leaves the rest of the line: 1.5+02 is 1.5 to it. So each line
# gets NaN as an imaginary part, which is found again only where the value was read to its end: what is left of a text
# without the letter n may be a number (1.5.7e-98), but not this. It also takes "2 1.0" for row 2, column 1 and the
# value .0, so that fields are counted.
MARK = b" nan\n"
MANY = 2**62  # more rows than there will be


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
        found = shown(self.text.split(b"\n", line + 1)[line])
        number = line_number(self.path, self.start) + line
        return InputError(f"{self.path}, line {number}: found '{found}', expected {expected}")

    def require(self, fits: np.ndarray, lines: np.ndarray | None, expected: str):
        """Raise InputError for the first item that does not fit; `lines` of the items, None where each is one."""
        if not fits.all():
            wrong = int(fits.argmin())
            raise self.refusal(wrong if lines is None else int(lines[wrong]), expected)


def shown(line: bytes, most=80) -> str:
    """The beginning of a line of a file for a message, which nothing in it can break or colour."""
    text = line.decode("latin-1").strip()[:most]
    return printable(text).replace("\n", " ")


def absent(path) -> InputError:
    """What to raise where no file has this name."""
    folder = os.path.isdir(path)
    return InputError(f"{str(path)[:200]}: {'this is a folder, expected a file' if folder else 'no such file'}")


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
    with reading_from(path), (gzip.open if is_packed(path) else open)(path, "rb") as file:
        yield file


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
    """The first 4096 bytes of the (unpacked) file, without a byte order mark. Raises InputError."""
    require_file(path)
    try:
        with open_unpacked(path) as file:
            return file.read(4096).removeprefix(BYTE_ORDER_MARK)
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
        stop = Path(path).stat().st_size if stop is None else stop
        low = start + (stop - start) * comm.rank // comm.size
        high = start + (stop - start) * (comm.rank + 1) // comm.size
        if low > start:
            file.seek(low - 1)
            low += len(file.readline()) - 1  # the rest of the line that began before
            while continued and low < stop and _goes_on(file, start, low):
                file.seek(low)
                low += len(file.readline())
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


def places(comm, counts: list[tuple[int, int]]) -> np.ndarray:
    """The place in the file of every line of this rank, from (start, lines) of its pieces. Collective."""
    mine = {start for start, _ in counts}
    before, parts = 0, []
    for start, lines in sorted(item for part in comm.allgather(counts) for item in part):
        if start in mine:
            parts.append(np.arange(before, before + lines))
        before += lines
    return np.concatenate(parts) if parts else np.zeros(0, np.int64)


def end_to_end(found, decode) -> list[np.ndarray]:
    """The arrays that `decode` makes of each of the Pieces, end to end; without any, those of an empty one."""
    return _joined([decode(piece) for piece in found], decode)


def read_lines(path, comm, decode, start=0) -> list[np.ndarray]:
    """As `end_to_end` of the Pieces of a file, and the place in it of each line. Collective. Raises InputError."""
    with agreed(comm):
        found = {piece.start: decode(piece) for piece in pieces(path, comm, start)}
        arrays = _joined(found.values(), decode)
    return [*arrays, places(comm, [(begin, len(part[0])) for begin, part in found.items()])]


def _joined(parts, decode):
    return [np.concatenate(items) for items in zip(*(parts or [decode(Piece(Path(), b"", 0))]), strict=True)]


def numbers(piece: Piece, columns: int, commas=True) -> tuple[np.ndarray, np.ndarray]:
    """The numbers (lines, columns) of the lines, and which line of the piece each row is.

    Blank lines and comments are left out; between numbers stand blanks, or commas where allowed. Exponents may
    be Fortran's (1.5D+02). Raises InputError that names the line.
    """
    expected = f"{columns} number{'s' * (columns > 1)}"
    values, counts, lines = ragged(piece, commas, expected)
    piece.require(counts == columns, lines, f"{expected} a line")
    return values.reshape(-1, columns), lines


def ragged(piece: Piece, commas=True, expected="numbers", blanks=True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All numbers of the lines in one array, how many are in each line, and which line of the piece each is.

    `commas`, `blanks`: whether these alone may stand between two numbers. Raises InputError that names the line.
    """
    text = without_comments(piece.text)
    if commas:
        refuse_empty_fields(piece, text)
    if not blanks:
        require_commas(piece, text)
    plain = with_e(text.replace(b",", b" ") if commas else text)
    values = parse(plain)
    bytes_ = np.frombuffer(plain, np.uint8)
    blank = bytes_ <= ord(" ")
    begins = ~blank
    begins[1:] &= blank[:-1]
    line_of_number = np.cumsum(bytes_ == ord("\n"))[begins]
    if values is None or values.size != line_of_number.size:
        for index, line in enumerate(plain.split(b"\n")):
            found = parse(line)
            if found is None or found.size != len(line.split()):
                raise piece.refusal(index, f"{expected} a line")
    counts = np.bincount(line_of_number)
    lines = np.flatnonzero(counts)
    return values, counts[lines], lines


def padded(values, counts, width) -> np.ndarray:
    """The numbers of lines from ragged(), one row of `width` a line; what a line leaves out is zero."""
    table = np.zeros((len(counts), width))
    table[np.arange(width) < counts[:, None]] = values
    return table


def refuse_empty_fields(piece: Piece, text: bytes):
    """Raise InputError where nothing stands between two commas, or in front of one: what is left out is not known.

    `text`: that of the piece without comments, or as many lines made of it.
    """
    if b"," in text and (empty := EMPTY_FIELD.search(text)):
        raise piece.refusal(text[: empty.end()].count(b"\n"), "a number between two commas")


def require_commas(piece: Piece, text: bytes):
    """Raise InputError where nothing but blanks stands between two numbers, one of which a program would not see.

    `text`: that of the piece without comments, or as many lines made of it.
    """
    if two := TWO_IN_A_FIELD.search(text):
        raise piece.refusal(text[: two.end()].count(b"\n"), "a comma between two numbers")


def without_comments(text: bytes) -> bytes:
    """The text, with nothing in the lines that are comments."""
    return COMMENT.sub(b"", text) if any(mark in text for mark in (b"%", b"#", b"**")) else text


def with_e(text: bytes) -> bytes:
    """The text with e for the D of Fortran's exponents, 1.5D-3."""
    return text.replace(b"D", b"e").replace(b"d", b"e")


def parse_fortran(text: bytes) -> np.ndarray | None:
    """As `parse`, where exponents may have D, or no letter, as Nastran and numbers that fill their field do."""
    return parse(BARE_EXPONENT.sub(b"e", with_e(text)))


def parse(text):
    """All numbers of a text, or None if something else is in it."""
    if not text.strip():
        return np.zeros(0)  # numpy finds a -1 in a blank text
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=float, sep=" ")
        except (DeprecationWarning, ValueError):
            return None


def whole(piece: Piece, values: np.ndarray, lines: np.ndarray, what: str, low=1, high=LARGEST_WHOLE) -> np.ndarray:
    """Whole numbers from low to high, as int64. Raises InputError that names the line."""
    limit = f"{low} to {high}" if high < LARGEST_WHOLE else f"at least {low}"
    with np.errstate(invalid="ignore"):
        fits = (values >= low) & (values <= high) & (values % 1 == 0)
    piece.require(fits, lines, f"{what} as a whole number of {limit}")
    return values.astype(np.int64)


def labels(piece: Piece, values: np.ndarray, lines: np.ndarray, what="the node number", low=1) -> np.ndarray:
    """Numbers of nodes or elements from `low` on, as int64. Raises InputError that names the line."""
    return whole(piece, values, lines, what, low, LARGEST_LABEL)


def triples(piece: Piece, commas=False) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Rows and columns (from 0; from 1 in the file) and values of lines of row, column, value, which the caller copies.

    And which line of the piece each is, or None where each line is one. By fast_matrix_market where it is installed,
    or SciPy has it, and the text is plain, else as `numbers`. Raises InputError that names the line.
    """
    if commas:
        refuse_empty_fields(piece, without_comments(piece.text))
    if fast_matrix_market is not None or SCIPY_HAS_IT:
        found = _plain_triples(piece.text.replace(b",", b" ") if commas else piece.text)
        if found is not None:
            return *found, None
    table, lines = numbers(piece, 3, commas)
    rows, columns = (whole(piece, table[:, k], lines, f"the {what} number") - 1
                     for k, what in enumerate(("row", "column")))  # fmt: skip
    return rows, columns, table[:, 2], lines


def _plain_triples(text):
    """Rows, columns and values, or None where there are comments, blank lines, D exponents, NaN or anything wrong."""
    if b"n" in text or b"N" in text:
        return None
    if not text.endswith(b"\n"):
        text += b"\n"
    bytes_ = np.frombuffer(text, np.uint8)
    lines, ends = 0, 0
    for low in range(0, len(bytes_), BLOCK):
        blank = bytes_[low : low + BLOCK + 1] <= ord(" ")
        lines += np.count_nonzero(bytes_[low : low + BLOCK] == ord("\n"))
        ends += np.count_nonzero(blank[:-1] < blank[1:])
    if ends != 3 * lines:
        return None
    head = b"%%%%MatrixMarket matrix coordinate complex general\n%d %d %d\n" % (MANY, MANY, lines)
    try:
        values, rows, columns = _by_fast_matrix_market(_Marked(head, text))
    except (ValueError, OverflowError):
        return None
    if len(values) != lines or not np.isnan(values.imag).all():
        return None
    return rows, columns, values.real


def _by_fast_matrix_market(source):
    if fast_matrix_market is not None:
        (values, (rows, columns)), _ = fast_matrix_market.read_coo(source, parallelism=1)
        return values, rows, columns
    from scipy.io import mmread  # slow to import

    found = mmread(source)
    return found.data, found.row, found.col


class _Marked:
    """A file for fast_matrix_market: a header and a text whose lines end with MARK, made block by block, as the whole
    would be new memory for every piece."""

    def __init__(self, head, text):
        starts = range(0, len(text), BLOCK)
        self._parts = itertools.chain([head], (text[low : low + BLOCK].replace(b"\n", MARK) for low in starts))

    def read(self, _):
        """The next block, of any size."""
        return next(self._parts, b"")
