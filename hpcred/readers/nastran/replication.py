"""Expand replicated cards of Nastran bulk data.

A line that begins with = is made from the card above it, field by field: = repeats the field, == repeats it and all
fields after it, *(x) or *x adds x, and anything else replaces it. =(n) or =n alone in a line makes n more cards with
the increments of the line above it. Cards must have one line, in small or free field format.
"""

import re
from decimal import Decimal

import numpy as np

from ...files.text import Piece

REPEATED = re.compile(rb"(?m)^=")
AGAIN = re.compile(rb"=\(?([1-9]\d{0,4})\)?")
INCREMENT = re.compile(rb"\*(?:\(([^()]*)\)|([^()]*))")
WHOLE = re.compile(rb"[+-]?\d{1,18}")
REAL = re.compile(rb"([+-]?(?:\d+\.\d*|\.\d+))(?:[ED]?([+-]\d{1,3})|[ED](\d{1,3}))?")
DATA = 9  # fields of a line with its name
EXPECTED = "a line that repeats the card of one line above it: =, fields with =, ==, *(x), or =(n) alone"


def in_full(piece: Piece, plain: bytes) -> tuple[bytes, np.ndarray]:
    """Return the text, without remarks and in capitals, with all cards in full, and the old line of each."""
    lines, origin, above, steps = [], [], None, None
    for number, line in enumerate(plain.split(b"\n")):
        if not line.startswith(b"="):
            if line.strip():
                single = line[:1].isalpha() and b"*" not in line[:8]
                above, steps = (_fields(line) if single else None), None
            lines.append(line)
            origin.append(number)
            continue
        fields = _fields(line)
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


def _fields(line):
    """Return the name and the eight fields of data of a line in small or free form, without blanks around."""
    parts = line.split(b",") if b"," in line else [line[k : k + 8] for k in range(0, 8 * DATA, 8)]
    return [part.strip() for part in [*parts, *DATA * [b""]][:DATA]]


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
    numbers = [REAL.fullmatch(item) for item in (old, step)]
    if not all(numbers):
        return None
    values = [Decimal(item[1].decode()).scaleb(int(item[2] or item[3] or 0)) for item in numbers]
    total = sum(values)
    if abs(total.adjusted()) > 8:
        return f"{float(total)!r}".upper().encode()
    return f"{total:f}{'' if '.' in f'{total:f}' else '.'}".encode()
