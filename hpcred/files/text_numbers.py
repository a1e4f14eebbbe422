"""Read the numbers in lines of text strictly: each to its last character, or refused with its line."""

import itertools
import re
import warnings

import numpy as np
import scipy

from .text import LARGEST_LABEL, Piece, without_comments

try:
    import fast_matrix_market
except ImportError:
    fast_matrix_market = None
SCIPY_HAS_IT = tuple(map(int, scipy.__version__.split(".")[:2])) >= (1, 12)  # behind scipy.io.mmread

BLOCK = 2**16  # bytes looked at in one step of numpy: four times as fast as the whole piece
EMPTY_FIELD = re.compile(rb"(?m)(?:,|^)[ \t]*,")
TWO_IN_A_FIELD = re.compile(rb"[^\s,][ \t]+[^\s,]")
BARE_EXPONENT = re.compile(rb"(?<=[0-9.])(?=[+-])")  # 1.5-100
LARGEST_WHOLE = 2**53  # up to here a float is exact
# fast_matrix_market stops at the end of a number and leaves the rest of the line: 1.5+02 is 1.5 to it. So each line
# gets NaN as an imaginary part, which is found again only where the value was read to its end: what is left of a text
# without the letter n may be a number (1.5.7e-98), but not this. It also takes "2 1.0" for row 2, column 1 and the
# value .0, so that fields are counted.
MARK = b" nan\n"
MANY = 2**62  # more rows than there will be


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
            row = parse(line)
            if row is None or row.size != len(line.split()):
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


def with_e(text: bytes) -> bytes:
    """The text with e for the D of Fortran's exponents, 1.5D-3."""
    return text.replace(b"D", b"e").replace(b"d", b"e")


def parse_fortran(text: bytes) -> np.ndarray | None:
    """As `parse`, where exponents may have D, or no letter, as Nastran and numbers that fill their field do."""
    return parse(BARE_EXPONENT.sub(b"e", with_e(text)))


def number_in(text: str, parse=parse_fortran) -> float | None:
    """The finite number that a text is to its last character; None for others."""
    values = parse(text.encode()) if text.isascii() else None
    return float(values[0]) if values is not None and len(values) == 1 and np.isfinite(values[0]) else None


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
        plain = _plain_triples(piece.text.replace(b",", b" ") if commas else piece.text)
        if plain is not None:
            return *plain, None
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

    matrix = mmread(source)
    return matrix.data, matrix.row, matrix.col


class _Marked:
    """A file for fast_matrix_market: a header and a text whose lines end with MARK, made block by block, as the whole
    would be new memory for every piece."""

    def __init__(self, head, text):
        starts = range(0, len(text), BLOCK)
        self._parts = itertools.chain([head], (text[low : low + BLOCK].replace(b"\n", MARK) for low in starts))

    def read(self, _):
        """The next block, of any size."""
        return next(self._parts, b"")
