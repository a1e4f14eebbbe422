"""Read Harwell-Boeing and Rutherford-Boeing files; each rank returns a share of the entries.

A file has three lists (column starts, row numbers, values) in lines of fixed format, which a header of four or five
lines declares. Each rank reads a range of bytes; then each gets the entries of its share with their columns.
"""

import re
from dataclasses import dataclass

import numpy as np

from ...files.system_errors import damaged_file
from ...files.text import Piece, first_bytes, first_lines, open_unpacked, pieces
from ...files.text_numbers import ragged, whole
from ...parallel.exchange import exchange
from ...parallel.failures import InputError, agreed
from ...parallel.shares import row_range
from ..base import Reader
from ..entries import Entries, both_triangles, require_sane
from ..fixed_width import Field, fields_of_format, separated

TYPE = re.compile(rb"^([RCPIQX])([USHZR])([AE])(?:\s|$)", re.IGNORECASE)
FORMATS = re.compile(rb"\((?:[^()]|\([^()]*\))*\)")
SECTIONS = ("pointers", "rows", "values", "right-hand sides")
LINES_OF_HEADER = 5


@dataclass(frozen=True)
class Header:
    """`symmetry`: u, s, z (skew) or r; `lines`: of the header; fields and numbers of the sections, their lines, and the
    number of right-hand sides."""

    symmetry: str
    shape: tuple[int, int]
    entries: int
    lines: int
    fields: tuple[list[Field], ...]
    counts: tuple[int | None, ...]
    cards: tuple[int, ...]
    sides: int


def begins(start: bytes) -> bool:
    """Test whether a file that starts so has a header: counts, a type with counts, and formats."""
    lines = start.split(b"\n")
    return (
        len(lines) > 4 and _counts(lines[1]) is not None and len(_counts(lines[1])) in (4, 5)
        and bool(TYPE.match(lines[2])) and _counts(lines[2][3:]) is not None and lines[3].lstrip()[:1] == b"("
    )  # fmt: skip


def _counts(line):
    """Return whole numbers of a line, or None where there is something else."""
    words = line.split()
    return [int(word) for word in words] if words and all(word.isdigit() for word in words) else None


def title(start: bytes) -> bytes:
    """Return the first line."""
    return start.split(b"\n", 1)[0].strip()


def read(path, comm) -> Entries:
    """Read a real assembled matrix; of symmetric files both triangles are given. Collective. Raises InputError."""
    header, sections = _read(path, comm)
    return _entries(path, comm, header, sections)


def read_right_hand_sides(path, comm) -> Entries | None:
    """Read the right-hand sides (n, k) of a file, None where it has none or is another. Collective. Raises InputError.
    """
    with agreed(comm):
        if not begins(first_bytes(path)) or not _header(path).cards[3]:
            return None
    header, sections = _read(path, comm)
    if header.counts[3] is None:
        raise InputError(f"{path}: found sparse right-hand sides, expected full ones (F in line 5)")
    place = np.concatenate([np.zeros(0, np.int64), *(begin + np.arange(len(v)) for begin, v in sections[3])])
    values = np.concatenate([np.zeros(0), *(v for _, v in sections[3])])
    rows = header.shape[0]
    mine = place < rows * header.sides  # guesses and solutions may follow
    return Entries((rows, header.sides), place[mine] % rows, place[mine] // rows, values[mine])


def _read(path, comm):
    """Return the header, and (number of the first, numbers) of this rank in each section."""
    with agreed(comm):
        header = _header(path)
        spans = [(piece.start, piece.text.count(b"\n") + (not piece.text.endswith(b"\n")))
                 for piece in pieces(path, comm)]  # fmt: skip
    first_line = first_lines(comm, spans)
    with agreed(comm):
        sections = [[], [], [], []]
        read_of = np.zeros(4, np.int64)
        for piece in pieces(path, comm):
            for section, number, values in _sections(piece, first_line[piece.start], header):
                read_of[section] += len(values)
                sections[section].append((number, values))
    for section, (total, expected) in enumerate(zip(comm.allreduce(read_of), header.counts, strict=True)):
        if expected is not None and total != expected:
            raise damaged_file(path, f"{total} numbers among the {SECTIONS[section]}, the header says {expected}")
    return header, sections


def _header(path):
    with open_unpacked(path) as file:
        lines = [file.readline(4096) for _ in range(LINES_OF_HEADER)]
    # kind and size of the matrix
    cards, kind, counts = _counts(lines[1]), lines[2][:3].decode("latin-1").lower(), _counts(lines[2][3:])
    rutherford = len(cards) == 4
    if kind[0] == "p":
        raise InputError(
            f"{path}: found a pattern without values ({kind.upper()}), expected a real matrix; stiffness and mass need "
            "numbers"
        )
    if kind[0] in "cqx" or kind[1] == "h":
        raise InputError(f"{path}: found a complex or external matrix ({kind.upper()}), expected a real one")
    if kind[2] == "e":
        raise InputError(f"{path}: found element matrices ({kind.upper()}), expected an assembled matrix")
    if len(counts) not in (3, 4):
        raise InputError(f"{path}, line 3: found {len(counts)} numbers, expected rows, columns and entries")
    rows, columns, entries = counts[:3]
    if kind[1] in "sz" and rows != columns or not rows or not columns:
        raise InputError(f"{path}, line 3: found {rows} x {columns} for {kind.upper()}, expected a square matrix")
    # formats of its lists
    formats = [*FORMATS.findall(lines[3]), b"", b"", b""]
    fields = [fields_of_format(layout, f"{path}, line 4") for layout in formats[:3]]
    for layout, name, whole_numbers in zip(fields, SECTIONS, (True, True, kind[0] == "i"), strict=False):
        if any(field.whole != whole_numbers for field in layout):
            raise InputError(f"{path}, line 4: found a format of {name} for other numbers, expected "
                             f"{'integers' if whole_numbers else 'floating-point numbers'}")  # fmt: skip
    numbers = [columns + 1, entries, entries, 0]
    # right-hand sides, which line 5 describes
    total, *cards = cards + [0] * rutherford
    right, sides = cards[3], 0
    if right:
        about = lines[4][:3].decode("latin-1").upper()
        words = lines[4][3:].split()
        if about[:1] == "F" and words and words[0].isdigit():
            vectors = 1 + (about[1:2] == "G") + (about[2:3] == "X")
            sides = int(words[0])
            numbers[3] = rows * sides * vectors
            fields.append(fields_of_format(formats[3] if formats[3].strip() else formats[2], f"{path}, line 4"))
        elif about[:1] == "M":
            numbers[3] = None  # sparse, in the formats of the matrix
            fields.append([])
        else:
            raise InputError(f"{path}, line 5: found right-hand sides of the type '{about}', expected F or M")
    else:
        fields.append([])
    # lines of each list, and of all together
    for name, number, line, count in zip(SECTIONS, numbers, fields, cards, strict=True):
        if number is not None and line and count != -(-number // len(line)):
            raise InputError(
                f"{path}, line 2: found {count} lines of {name}, expected {-(-number // len(line))} for {number} "
                "numbers; the file is damaged"
            )
    if total != sum(cards):
        raise InputError(
            f"{path}, line 2: found {total} lines in all, expected {sum(cards)}, those of the parts together; the file "
            "is damaged"
        )
    sections = tuple(fields), tuple(numbers), tuple(cards)
    return Header(kind[1], (rows, columns), entries, 4 + bool(right), *sections, sides)


def _sections(piece, line, header):
    """Yield (section, number of the first, numbers) of parts of a piece, whose first line is `line` from 0."""
    newlines = np.flatnonzero(np.frombuffer(piece.text, np.uint8) == ord("\n")) + 1
    ends = np.concatenate([[0], newlines, [len(piece.text)] * (not piece.text.endswith(b"\n"))]).astype(np.int64)
    lines = len(ends) - 1
    start = header.lines
    bounds = [(0, header.lines, None)]
    for section, cards in enumerate(header.cards):
        bounds.append((start, start + cards, section))
        start += cards
    bounds.append((start, line + lines + 1, len(SECTIONS)))
    for first, last, section in bounds:
        low, high = max(first - line, 0), min(last - line, lines)
        if low >= high or section is None:
            continue
        stop = ends[high]
        if section < len(SECTIONS) and header.fields[section] and line + high == last:
            # as Fortran, which reads no further than it must: old files have rests of other cards behind the numbers
            needed = header.counts[section] - (header.cards[section] - 1) * len(header.fields[section])
            wide = sum(field.width for field in header.fields[section][:needed])
            if stop - ends[high - 1] < wide and piece.text[stop - 1 : stop] != b"\n":
                raise piece.refusal(high - 1, f"{wide} characters; the file is cut off")
            stop = min(stop, ends[high - 1] + wide)
        run = Piece(piece.path, piece.text[ends[low] : stop], piece.start + int(ends[low]))
        if section == len(SECTIONS):
            if run.text.strip():
                raise run.refusal(next(k for k, text_line in enumerate(run.text.split(b"\n")) if text_line.strip()),
                                   "the end of the file")  # fmt: skip
            continue
        if not header.fields[section]:  # sparse right-hand sides
            continue
        fields = header.fields[section]
        values, counts, at = ragged(separated(run, fields), False, f"{len(fields)} numbers")
        begin = (line + low - first) * len(fields)
        expected = np.minimum(len(fields), max(header.counts[section] - begin, 0) - len(fields) * np.arange(high - low))
        have = np.zeros(high - low, np.int64)
        have[at] = counts
        if (wrong := np.flatnonzero(have != expected)).size:
            raise run.refusal(int(wrong[0]), f"{expected[wrong[0]]} numbers among the {SECTIONS[section]}")
        if section < 2:
            values = whole(run, values, np.repeat(at, counts), "a row or place", 1)
        yield section, begin, values


def _entries(path, comm, header, sections):
    """Return entries from the numbers of the sections, which meet where the share of an entry lies."""
    shares = np.array(comm.allgather(row_range(comm, header.entries)[0]))

    def owner(entry):
        return np.clip(np.searchsorted(shares, entry, side="right") - 1, 0, comm.size - 1)

    def read_here(section, kind=np.int64):
        """Return places and values of the numbers of a section that this rank has read."""
        place = np.concatenate([np.zeros(0, np.int64), *(begin + np.arange(len(v)) for begin, v in sections[section])])
        values = np.concatenate([np.zeros(0, kind), *(v for _, v in sections[section])])
        sections[section].clear()
        return place, values

    def met(section, kind=np.int64):
        """Return the numbers of a section that belong to the entries of this rank, in order."""
        place, values = read_here(section, kind)
        place, values = exchange(comm, owner(place), [place, values])
        return values[np.argsort(place, kind="stable")]

    # a rank has read any part of the text, so pointers are checked among neighbours first
    number, pointer = read_here(0)
    pointer -= 1
    with agreed(comm):
        order = np.argsort(number)
        low = pointer.min(initial=0), pointer.max(initial=0)
        ascending = (np.diff(pointer[order])[np.diff(number[order]) == 1] >= 0).all()
        ends = ((number == 0) & (pointer != 0)) | ((number == header.shape[1]) & (pointer != header.entries))
        if low[0] < 0 or low[1] > header.entries or not ascending or ends.any():
            raise _damaged(path, f"pointers that do not ascend from 1 to {header.entries + 1}")
    # each rank gets the columns that begin in its share, and counts those before them
    number, pointer = exchange(comm, owner(np.minimum(pointer, header.entries - 1)), [number, pointer])
    before = comm.exscan(len(pointer)) or 0
    # the rows and values of its share, wherever they were read
    rows, values = met(1) - 1, met(2, float)
    with agreed(comm):
        order = np.argsort(number)
        if (np.diff(number[order]) != 1).any() or (np.diff(pointer[order]) < 0).any() or (
            len(number) and number.min() != before):  # fmt: skip
            raise _damaged(path, f"pointers that do not ascend from 1 to {header.entries + 1}")
        low, high = row_range(comm, header.entries)
        # the column of an entry is the last one that begins at or before it
        begun = np.bincount(pointer[pointer < high] - low, minlength=max(high - low, 0))
        columns = before + np.cumsum(begun)[: high - low] - 1
        if len(rows) and rows.max() >= header.shape[0]:
            raise _damaged(path, f"the row {rows.max() + 1} of {header.shape[0]}")
        require_sane(values, f"{path}: found", "real")
        if ((np.diff(rows) <= 0) & (np.diff(columns) == 0)).any():
            # rows that do not ascend are no fault where no entry comes twice
            key = np.sort(columns * header.shape[0] + rows)
            if (twice := key[1:][key[1:] == key[:-1]]).size:
                column, row = divmod(int(twice[0]), header.shape[0])
                raise _damaged(path, f"two entries of row {row + 1}, column {column + 1}")
    # a triangle becomes a whole matrix
    if header.symmetry in "ur":
        return Entries(header.shape, rows, columns, values)
    sides = comm.allgather((bool((rows < columns).any()), bool((rows > columns).any())))
    if any(above for above, _ in sides) and any(below for _, below in sides):
        raise _damaged(path, "entries on both sides of the diagonal of a symmetric matrix")
    sign = -1.0 if header.symmetry == "z" else 1.0
    with agreed(comm):
        if sign < 0 and values[rows == columns].any():
            raise _damaged(path, "numbers on the diagonal of a skew-symmetric matrix")
    return Entries(header.shape, *both_triangles(rows, columns, values, sign))


def _damaged(path, found):
    return damaged_file(path, f"{found}")


class HarwellBoeing(Reader):
    """Harwell-Boeing and Rutherford-Boeing files."""

    name, packed = "Harwell-Boeing or Rutherford-Boeing", True
    told_by = "the four or five lines of its header"
    begins, read_matrix = staticmethod(begins), staticmethod(read)
