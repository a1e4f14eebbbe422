"""Numbers from text files, each rank a range of bytes; also from gzip, where each rank takes every so-manieth piece."""

import gzip
import warnings
from pathlib import Path

import numpy as np

from ..errors import InputError

PIECE = 2**24  # bytes of text parsed at a time
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
