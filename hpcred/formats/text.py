"""Numbers from text files, each rank a range of bytes; also from gzip, where each rank takes every so-manieth piece."""

import gzip
import io
import warnings
from pathlib import Path

import numpy as np

from ..parallel.failures import InputError

try:
    import fast_matrix_market
except ImportError:
    fast_matrix_market = None

PIECE = 2**24  # bytes of text parsed at a time
LARGEST = 2**62  # more rows than there will be
COMMENTS = (b"%", b"#", b"*")


def pieces(path, comm, start: int, stop: int | None = None, continued=False):
    """Whole lines of the bytes start..stop of a file that fall to this rank, in pieces of bytes.

    `continued`: a line that ends with a comma goes on in the next one.

    A line belongs to the rank (or piece) in which its first byte lies. For .gz the positions are those of the
    unpacked text; every rank unpacks the file, since gzip has no way in from the middle, but keeps its pieces only.
    """
    if Path(path).suffix == ".gz":
        yield from _gzip_pieces(path, comm, start)
        return
    stop = stop or Path(path).stat().st_size
    low = start + (stop - start) * comm.rank // comm.size
    high = start + (stop - start) * (comm.rank + 1) // comm.size
    with open(path, "rb") as file:
        if low > start:
            file.seek(low - 1)
            line = file.readline()  # the rest of the line that began before
            low += len(line) - 1
            while continued and line.rstrip().endswith(b","):
                line = file.readline()
                low += len(line)
        file.seek(low)
        while low < high:
            text = file.read(min(PIECE, high - low))
            if not text.endswith(b"\n"):
                text += file.readline()
            while continued and text.rstrip().endswith(b",") and low + len(text) < stop:
                text += file.readline()
            low += len(text)
            yield text


def _gzip_pieces(path, comm, start):
    with gzip.open(path, "rb") as file:
        file.read(start)
        rest, number = b"", 0
        while text := file.read(PIECE):
            text = rest + text
            cut = text.rfind(b"\n") + 1
            rest = text[cut:]
            if number % comm.size == comm.rank:
                yield text[:cut]
            number += 1
        if rest and number % comm.size == comm.rank:
            yield rest


def numbers(text: bytes, columns: int, path) -> np.ndarray:
    """The numbers of whole lines as (lines, columns). Raises InputError where the text is something else."""
    text = text.replace(b",", b" ").replace(b"D", b"e")
    if any(mark in text for mark in COMMENTS):
        text = b"\n".join(line for line in text.split(b"\n") if line.lstrip()[:1] not in COMMENTS)
    values = _parse(text)
    if values is None or values.size % columns:
        line = _bad_line(text, columns)
        raise InputError(
            f"{path}: found the line '{line}', expected {columns} numbers a line; the file is damaged or of "
            "another format"
        )
    return values.reshape(-1, columns)


def triples(text: bytes, path):
    """Rows, columns and values of whole lines of row, column, value; numbers from 1. Raises InputError.

    By fast_matrix_market where it is installed and the text is plain, else as `numbers`.
    """
    if fast_matrix_market is not None:
        plain = text.replace(b",", b" ") if b"," in text else text
        lines = np.count_nonzero(np.frombuffer(plain, np.uint8) == ord("\n")) + (not plain.endswith(b"\n"))
        head = b"%%%%MatrixMarket matrix coordinate real general\n%d %d %d\n" % (LARGEST, LARGEST, lines)
        try:
            (values, (rows, columns)), _ = fast_matrix_market.read_coo(io.BytesIO(head + plain), parallelism=1)
            return rows.astype(np.int64) + 1, columns.astype(np.int64) + 1, values
        except (ValueError, OverflowError):
            pass  # comments, blank lines, Fortran's exponents, or a bad line, which the next one names
    table = numbers(text, 3, path)
    if (table[:, :2] % 1).any():
        raise InputError(f"{path}: found row or column numbers that are not whole")
    return table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2].copy()


def _parse(text):
    """All numbers of a text, or None if something else is in it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=float, sep=" ")
        except (DeprecationWarning, ValueError):
            return None


def _bad_line(text, columns):
    for line in text.split(b"\n"):
        values = _parse(line)
        if line.strip() and (values is None or values.size != columns):
            return line.decode(errors="replace").strip()[:80]
    return ""


def require_file(path):
    """Raise InputError unless `path` is a file that can be read."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with open(path, "rb"):
            pass
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
