"""Split bulk data of Nastran into cards and fields, in small, large and free field format.

A card begins with a line that begins with a letter, and has the continuation lines after it.
"""

import re
from dataclasses import dataclass
from decimal import Decimal

import numpy as np

from ...files.text import CONTROL, LARGEST_LABEL, Piece, line_number
from ...files.text_numbers import number_in, parse_fortran
from ...parallel.failures import InputError

CARD = re.compile(rb"(?m)^[A-Za-z]")
REMARK = re.compile(rb"\$[^\n]*")
WIDTH = 24  # of a field in free form, without blanks around
SMALL, LARGE = 8, 4  # data fields a line
REPEATED = re.compile(rb"(?m)^=")
AGAIN = re.compile(rb"=\(?([1-9]\d{0,4})\)?")
INCREMENT = re.compile(rb"\*(?:\(([^()]*)\)|([^()]*))")
WHOLE = re.compile(rb"[+-]?\d{1,18}")
REAL = re.compile(rb"([+-]?(?:\d+\.\d*|\.\d+))(?:[ED]?([+-]\d{1,3})|[ED](\d{1,3}))?")
DATA = 9  # fields of a line with its name
EXPECTED = "a line that repeats the card of one line above it: =, fields with =, ==, *(x), or =(n) alone"


@dataclass(frozen=True)
class Card:
    """A card of which there are few: its fields without the empty ones at the end, and where it stands."""

    name: str
    fields: tuple[str, ...]
    file: str
    start: int
    line: int

    def error(self, sentence: str) -> InputError:
        """Return an InputError that names the line."""
        line = line_number(self.file, self.start) + self.line
        return InputError(f"{self.file}, line {line}: {self.name}: {sentence}")

    def text(self, k: int) -> str:
        """Return the field k, from 0 behind the name; empty where there is none."""
        return self.fields[k] if k < len(self.fields) else ""

    def whole(self, k: int, what: str, empty: int | None = None) -> int:
        """Return the whole number in the field k."""
        return whole_of(self.text(k), self.error, what, empty)

    def real(self, k: int, what: str, empty: float = 0.0) -> float:
        """Return the number in the field k."""
        return number_of(self.text(k), self.error, what, empty)

    def directions(self, k: int) -> np.ndarray:
        """Return which of the directions 1 to 6 (6,) the field k names."""
        if not set(self.text(k)) <= set("0123456"):
            raise self.error(f"found the directions '{self.text(k)}', expected digits of 1 to 6")
        return np.array([str(d) in self.text(k) for d in range(1, 7)])

    def points(self, first: int) -> tuple[list[int], list[int]]:
        """Return lowest and highest numbers of a list of points that may say THRU, from the field `first` on."""
        words = [word for word in self.fields[first:] if word]
        low, high = [], []
        while words:
            number = last = whole_of(words.pop(0), self.error, "a point")
            if len(words) > 1 and words[0] == "THRU":
                last = whole_of(words[1], self.error, "a point")
                del words[:2]
                if words and words[0] in ("BY", "EXCEPT"):
                    raise self.error(f"found '{words[0]}' behind THRU, which is not read; list the points")
            if last < number:
                raise self.error(f"found {number} THRU {last}, expected ascending numbers")
            low.append(number)
            high.append(last)
        return low, high


@dataclass
class Lines:
    """Lines of some cards of a piece.

    `card` (lines,): which card of the piece each belongs to; `name` (lines,) of that card, `starts` (lines,) whether
    the card begins here, `number` (lines,) in the piece, `count` (lines,) of data fields and `fields` (lines, 8).
    `total`: number of all cards of the piece.
    """

    piece: Piece
    card: np.ndarray
    name: np.ndarray
    starts: np.ndarray
    number: np.ndarray
    count: np.ndarray
    fields: np.ndarray
    total: int

    def of(self, name: str) -> "Lines":
        """Return only those of the cards of one name."""
        mine = self.name == name.encode()
        columns = (getattr(self, key)[mine] for key in ("card", "name", "starts", "number", "count", "fields"))
        return Lines(self.piece, *columns, self.total)

    def table(self, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the first `width` fields (cards, width) of each card, and the lines (cards,) where they begin."""
        first = np.flatnonzero(self.starts)
        which, place = self._places()
        have = (np.arange(SMALL) < self.count[:, None]) & (place < width)
        table = np.full((len(first), width), b"", dtype=self.fields.dtype)
        table[np.broadcast_to(which[:, None], have.shape)[have], place[have]] = self.fields[have]
        return table, self.number[first]

    def beyond(self, width: int) -> np.ndarray:
        """Return the lines of the piece with a field, not empty, behind the first `width` of its card."""
        return self.number[((self._places()[1] >= width) & (self.fields != b"")).any(axis=1)]

    def _places(self):
        """Return which of the cards a line belongs to, and the places (lines, 8) of its fields in that card."""
        which = np.cumsum(self.starts) - 1
        before = np.cumsum(self.count) - self.count
        return which, (before - before[np.flatnonzero(self.starts)][which])[:, None] + np.arange(SMALL)

    def listed(self) -> list[Card]:
        """Return the cards, which are few."""
        rows = []
        for name, starts, number, count, fields in zip(
            self.name, self.starts, self.number, self.count, self.fields, strict=True
        ):
            if starts:
                rows.append((name.decode(), [], int(number)))
            rows[-1][1].extend(field.decode("latin-1") for field in fields[:count])
        for _, fields, _ in rows:
            while fields and not fields[-1]:
                fields.pop()
        return [Card(name, tuple(fields), str(self.piece.path), self.piece.start, line) for name, fields, line in rows]


def lines_of(piece: Piece, wanted: re.Pattern, strict=False) -> Lines:
    """Return the lines of cards whose name (upper case) `wanted` matches wholly. Raises InputError.

    `strict`: for cards that a program wrote: refused are also remarks that do not begin their line, what is behind the
    80th column, and other cards between those of one first field.
    """
    # text without remarks and tabs, replicated cards in full
    plain = REMARK.sub(b"", piece.text).upper().replace(b"\r", b" ")
    if control := CONTROL.search(plain):
        raise piece.refusal(plain.count(b"\n", 0, control.start()), "a card, without control characters")
    if b"\t" in plain:
        plain = plain.expandtabs(8)
    origin = None
    if not strict and REPEATED.search(plain):
        plain, origin = in_full(piece, plain)
    # lines with something in them; a letter begins a card
    text = np.frombuffer(plain if plain.endswith(b"\n") else plain + b"\n", np.uint8)
    stop = np.flatnonzero(text == ord("\n"))
    start = np.concatenate([[0], stop[:-1] + 1])
    visible = np.concatenate([[0], np.cumsum(text > ord(" "))])
    used = visible[stop] > visible[start]
    number = np.flatnonzero(used) if origin is None else origin[np.flatnonzero(used)]
    start, stop = start[used], stop[used]
    head = _gather(text, start, np.minimum(start + 8, stop), 8)
    starts = (head[:, 0] >= ord("A")) & (head[:, 0] <= ord("Z"))
    card = np.cumsum(starts) - 1
    total = int(np.count_nonzero(starts))
    # names of cards, and which of them are wanted
    ended = np.maximum.accumulate((head == ord(" ")) | (head == ord(",")) | (head == ord("*")), axis=1)
    names = np.where(ended, 0, head).astype(np.uint8)[starts].copy().view("S8").ravel()
    distinct, back = np.unique(names, return_inverse=True)
    fits = np.array([wanted.fullmatch(name) is not None for name in distinct], bool)[back] if len(names) else []
    mine = (card >= 0) & np.asarray(fits, bool)[card] if len(names) else np.zeros(len(card), bool)
    # lines that belong to no card, or to another than that above
    stray = (card < 0) | (~starts & ~np.isin(head[:, 0], np.frombuffer(b" +*,", np.uint8)))
    stray &= (card < 0) | mine | (head[:, 0] != ord("="))  # cards that are not wanted may be repeated
    piece.require(~stray, number, "a card, or a line that continues one")
    if (apart := number[_apart(text, start, stop, head, starts)]).size:
        raise piece.refusal(int(apart[0]), "a line that continues the one above, which does not end with its name "
                            "(field 10); put the lines of each card below each other")  # fmt: skip
    lines = piece.text.split(b"\n") if strict and b"$" in piece.text else ()
    for k in [k for k, line in enumerate(lines) if b"$" in line and not line.startswith(b"$")]:
        place = np.searchsorted(number, k, side="right") - 1  # of the line itself, or the last in front of a remark
        if place >= 0 and mine[place]:
            raise piece.refusal(k, "a card without a remark behind it")
    # the wanted cards alone
    card, start, stop, number, head, starts = (column[mine] for column in (card, start, stop, number, head, starts))
    if strict:
        piece.require(visible[stop] <= visible[np.minimum(start + 80, stop)], number, "a card of at most 80 columns")
    count, fields = _fields(piece, text, start, stop, head, number)
    if strict and starts.any():
        first, label = card[starts], fields[starts, 0]
        gap = (np.diff(first) > 1) & (label[1:] == label[:-1])
        piece.require(~gap, number[starts][1:] - 1, "none but cards of one matrix here")
    name = names[card] if len(names) else np.zeros(0, "S8")
    return Lines(piece, card, name, starts, number, count, fields, total)


def _apart(text, start, stop, head, starts):
    """Return which lines continue another card than that above them, by their names and that at its end."""
    named = ((head[:, 0] == ord("+")) | (head[:, 0] == ord("*"))) & (head[:, 1] > ord(" ")) & (head[:, 1] != ord(","))
    child = np.flatnonzero(named & ~starts)
    own = _name(np.where(np.logical_or.accumulate(head[child] == ord(","), axis=1), ord(" "), head[child]))
    start, stop, star = start[child - 1], stop[child - 1], _is_large(head[child - 1])
    comma = np.append(np.flatnonzero(text == ord(",")), [len(text)] * (SMALL + 2))
    first = np.searchsorted(comma, start)
    free, last = comma[first] < stop, first + np.where(star, LARGE, SMALL)
    low = np.where(free, comma[last] + 1, start + 72)
    above = _gather(text, low, np.minimum(np.where(free, comma[last + 1], start + 80), stop), 2 * SMALL)
    return child[(own != _name(above)) & (own != _name(above[:, 1:]))]  # the first character there does not count


def _name(characters):
    """Return the names of continuations in characters (lines, width)."""
    characters = np.ascontiguousarray(characters, np.uint8)
    return np.char.strip(characters.view(f"S{characters.shape[1]}").ravel(), b" +*")


def _is_large(head):
    """Test whether lines (n,), by their first field (n, 8), have large fields: a star in front of the first comma."""
    comma, star = (np.where((head == ord(sign)).any(axis=1), (head == ord(sign)).argmax(axis=1), 8) for sign in ",*")
    return star < comma


def _fields(piece, text, start, stop, head, number):
    """Return number of data fields (lines,) and the fields (lines, 8) without blanks around."""
    # fields of fixed width, from the first of data on
    commas = np.concatenate([[0], np.cumsum(text == ord(","))])
    free = commas[stop] > commas[start]
    star = _is_large(head)
    count = np.where(star, LARGE, SMALL)
    width = np.where(star, 16, 8)
    low = start[:, None] + 8 + width[:, None] * np.arange(SMALL)
    high = np.minimum(low + width[:, None], stop[:, None])
    # in free form commas tell where they begin and end
    if free.any():
        at = np.flatnonzero(text == ord(","))
        line = np.searchsorted(start, at, side="right") - 1
        within = (line >= 0) & (at < stop[line]) & free[line]
        at, line = at[within], line[within]
        place = np.arange(len(at)) - np.searchsorted(line, line)
        end = np.where(np.append(line[1:] == line[:-1], False), np.append(at[1:], 0), stop[line]) if len(at) else at
        data = place < count[line]
        low[free], high[free] = 0, 0
        low[line[data], place[data]], high[line[data], place[data]] = at[data] + 1, end[data]
        visible = np.concatenate([[0], np.cumsum(text > ord(" "))])
        inside = (place <= count[line]) | (visible[end] <= visible[np.minimum(at + 1, end)])
        piece.require(inside, number[line], f"at most {SMALL + 2} fields a line")
    # without blanks in front and behind
    low, high = np.minimum(low, stop[:, None]), np.maximum(high, np.minimum(low, stop[:, None]))
    last = len(text) - 1
    while (blank := (low < high) & (text[np.minimum(low, last)] == ord(" "))).any():  # in front
        low = low + blank
    far = np.minimum(low + WIDTH, high)
    visible = np.concatenate([[0], np.cumsum(text > ord(" "))])
    piece.require((visible[high] <= visible[far]).all(axis=1), number, f"fields of at most {WIDTH} characters")
    flat = _gather(text, low.ravel(), far.ravel(), WIDTH)
    flat = np.where(np.maximum.accumulate(flat[:, ::-1] > ord(" "), axis=1)[:, ::-1], flat, 0)  # blanks behind
    fields = flat.astype(np.uint8).view(f"S{WIDTH}").reshape(len(start), SMALL)
    return count, fields


def _gather(text, low, high, width):
    """Return characters (lines, width) of the places low..high of a text, with blanks behind."""
    at = low[:, None] + np.arange(width)
    return np.where(at < high[:, None], text[np.minimum(at, len(text) - 1)], ord(" ")).astype(np.uint8)


def reals(piece: Piece, fields: np.ndarray, lines: np.ndarray, what: str, empty=0.0) -> np.ndarray:
    """Return finite numbers of fields (n,); `lines` (n,) for messages. Raises InputError that names the line."""
    filled = np.where(fields == b"", str(empty).encode(), fields)
    values = parse_fortran(b"\n".join(filled.tolist()))
    if values is None or len(values) != len(fields) or not np.isfinite(values).all():
        for field, line in zip(filled.tolist(), lines, strict=True):
            if number_in(field.decode("latin-1")) is None:
                raise piece.refusal(int(line), f"{what}, a number")
    return values


def _characters(fields):
    """Return fields (n,) as codes (n, width), 0 behind the last character."""
    return np.ascontiguousarray(fields).view(np.uint8).reshape(len(fields), fields.dtype.itemsize)


def wholes(piece, fields, lines, what, low=0, high=LARGEST_LABEL, empty=None) -> np.ndarray:
    """Return whole numbers low..high of fields (n,); an empty field is `empty`, or refused. Raises InputError."""
    filled = fields if empty is None else np.where(fields == b"", str(empty).encode(), fields)
    characters = _characters(filled)
    digit = (characters >= ord("0")) & (characters <= ord("9"))
    good = (digit | (characters == 0)).all(axis=1) & digit.any(axis=1) & (digit.sum(axis=1) <= 10)
    value = whole_numbers(characters, digit & good[:, None])
    piece.require(good & (value >= low) & (value <= high), lines, f"{what}, a whole number of {low} to {high}")
    return value


def whole_numbers(characters, digit) -> np.ndarray:
    """Return the numbers (n,) that the digits among characters (n, width) make."""
    value = np.zeros(len(characters), np.int64)
    for k in range(characters.shape[1]):
        value = np.where(digit[:, k], 10 * value + characters[:, k] - ord("0"), value)
    return value


def components(piece, fields, lines, what) -> np.ndarray:
    """Return which of the directions 1 to 6 (n, 6) the digits of fields (n,) name; 0 or none: no direction."""
    characters = _characters(fields)
    fits = ((characters == 0) | ((characters >= ord("0")) & (characters <= ord("6")))).all(axis=1)
    piece.require(fits, lines, f"{what}, digits of 1 to 6")
    return (characters[:, :, None] == ord("1") + np.arange(6)).any(axis=1)


def number_of(field: str, where, what: str, empty=None) -> float:
    """Return the number in a field of one of few cards. Raises InputError, by `where` from a sentence."""
    text = field or ("" if empty is None else str(empty))
    value = number_in(text)
    if value is None:
        raise where(f"found '{field}' for {what}, expected a number")
    return value


def whole_of(field: str, where, what: str, empty=None) -> int:
    """Return the whole number, not negative, in a field of a card of which there are few. Raises InputError."""
    text = field or ("" if empty is None else str(empty))
    if not (text.isascii() and text.isdigit() and len(text) < 11):
        raise where(f"found '{field}' for {what}, expected a whole number")
    return int(text)


# Expand replicated cards of Nastran bulk data.
# A line that begins with = is made from the card above it, field by field: = repeats the field, == repeats it and all
# fields after it, *(x) or *x adds x, and anything else replaces it. =(n) or =n alone in a line makes n more cards with
# the increments of the line above it. Cards must have one line, in small or free field format.


def in_full(piece: Piece, plain: bytes) -> tuple[bytes, np.ndarray]:
    """Return the text, without remarks and in capitals, with all cards in full, and the old line of each."""
    lines, origin, above, steps = [], [], None, None
    for number, line in enumerate(plain.split(b"\n")):
        if not line.startswith(b"="):
            if line.strip():
                single = line[:1].isalpha() and b"*" not in line[:8]
                above, steps = (_words_of(line) if single else None), None
            lines.append(line)
            origin.append(number)
            continue
        fields = _words_of(line)
        again = AGAIN.fullmatch(fields[0])
        if above is None or (steps is None if again else fields[0] != b"=") or (again and any(fields[1:])):
            raise piece.refusal(number, EXPECTED)
        steps = steps if again else fields
        for _ in range(int(again[1]) if again else 1):
            above = _next(above, steps)
            if above is None:
                raise piece.refusal(number, EXPECTED)
            lines.append(b",".join(above))
            origin.append(number)
    return b"\n".join(lines), np.array(origin)


def _words_of(line):
    """Return the name and the eight fields of data of a line in small or free form, without blanks around."""
    words = line.split(b",") if b"," in line else [line[k : k + 8] for k in range(0, 8 * DATA, 8)]
    return [word.strip() for word in [*words, *DATA * [b""]][:DATA]]


def _next(above, steps):
    """Return the fields of a card from those of the card above it, or None where they have none."""
    result = [above[0]]
    for field, old in zip(steps[1:], above[1:], strict=True):
        if field == b"==":
            break
        step = INCREMENT.fullmatch(field)
        if field.startswith((b"%", b"/", b"(")) or (b"=" in field and field != b"=") or (b"*" in field and not step):
            return None
        result.append(_sum(old, step[1] or step[2] or b"") if step else old if field == b"=" else field)
        if result[-1] is None:
            return None
    behind = steps[len(result) + 1 :]
    return None if any(behind) else result + above[len(result) :]


def _sum(old, step):
    """Return a number, an empty one being zero, plus an increment of the same kind; or None."""
    old = old or (b"0" if WHOLE.fullmatch(step) else b"0.")
    if WHOLE.fullmatch(old) and WHOLE.fullmatch(step):
        return b"%d" % (int(old) + int(step))
    numbers = [REAL.fullmatch(text) for text in (old, step)]
    if not all(numbers):
        return None
    values = [Decimal(text[1].decode()).scaleb(int(text[2] or text[3] or 0)) for text in numbers]
    total = sum(values)
    if abs(total.adjusted()) > 8:
        return f"{float(total)!r}".upper().encode()
    return f"{total:f}{'' if '.' in f'{total:f}' else '.'}".encode()
