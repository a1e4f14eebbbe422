"""Read the points of each superelement, with the sets of their dofs, and matrices from a file of Nastran's OUTPUT2.

A file is a sequence of Fortran records: single integers (keys) announce what follows. Rank 0 follows the sequence once;
of the tables BGPDT (positions), USET (sets), EQEXIN (numbers) and CSTM (coordinate systems) each rank reads its share.
"""

import struct
from dataclasses import dataclass

import numpy as np

from ...files.system_errors import damaged_file, mapped, read_numbers
from ...files.text import LARGEST_LABEL, first_bytes
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up, repeated_key
from ...parallel.shares import row_range
from .op4_matrix import COMPLEX, DOUBLE, Op4Matrix, matrix_of, real_values
from .points import DEPENDENT, HELD, OMITTED, SUPPORTED, Points, System

NAMES = ("SLIST", "BGPDT", "USET", "EQEXIN", "CSTM")
SHARE = 2**22  # bytes of a matrix that one rank decodes at a time, at least
SCALAR_CODE = 2
KIND, GRID, SCALAR = 3, 61, 12  # the place of the kind among the words of a point of the long form, and the kinds
# bits of USET that the sets have: m; s, by cards and by points; o; r
MEMBERS = {DEPENDENT: 1, HELD: 1 << 9 | 1 << 10, OMITTED: 1 << 2, SUPPORTED: 1 << 3}


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is one of OUTPUT2: a record of one word, 3 (a header) or 2 (a name)."""
    return _layout(start) is not None


def _layout(start):
    for order in "<>":
        for size in (4, 8):
            if len(start) >= size + 12 and struct.unpack_from(order + "i", start)[0] == size:
                key = struct.unpack_from(order + ("i" if size == 4 else "q"), start, 4)[0]
                if key in (2, 3) and struct.unpack_from(order + "i", start, 4 + size)[0] == size:
                    return order, size
    return None


def points_by_superelement(path, comm) -> list[tuple[int | None, Points]]:
    """Return number, if known, and points of each superelement with all tables, in the order of rows. Collective."""
    tables = decided(comm, lambda: [block for block in walk(path) if block.name.startswith(NAMES)])
    groups, group = [], {}
    for table in tables:
        key = next(name for name in NAMES if table.name.startswith(name))
        if key == "SLIST" or table.name.startswith("EQEXINX"):
            continue
        if key in group:
            groups.append(group)
            group = {}
        group[key] = table
    groups = [group for group in [*groups, group] if "BGPDT" in group]
    slist = next((table for table in tables if table.name == "SLIST"), None)
    numbers = slist.integers(0)[::7].tolist() if slist is not None else []
    if len(numbers) != len(groups):
        numbers = [None] * len(groups)
    by_number = [(number, _points(path, comm, group)) for number, group in zip(numbers, groups, strict=True)]
    return [(number, points) for number, points in by_number if points is not None]


class _Chain:
    """The Fortran records of a file, one after the other; `at`: the byte that it has come to."""

    def __init__(self, data, path, order, size):
        self.data, self.path, self.order, self.size, self.at = data, path, order, size, 0
        self._length = struct.Struct(order + "i").unpack_from
        self._number = struct.Struct(order + ("i" if size == 4 else "q")).unpack_from

    @property
    def ended(self) -> bool:
        return self.at >= len(self.data)

    def damaged(self, expected) -> InputError:
        return damaged_file(self.path, f"no {expected} at byte {self.at} of {len(self.data)}", "damaged or cut off")

    def record(self) -> tuple[int, int]:
        """Return the place of the next record and its bytes."""
        data, at = self.data, self.at
        if at + 8 > len(data):
            raise self.damaged("record")
        count = self._length(data, at)[0]
        if count < 0 or at + count + 8 > len(data) or self._length(data, at + 4 + count)[0] != count:
            raise self.damaged("whole record")
        self.at += count + 8
        return at + 4, count

    def key(self) -> int:
        place, count = self.record()
        if count != self.size:
            raise self.damaged("key of one word")
        return self._number(self.data, place)[0]

    def pass_key(self, expected, what):
        if self.key() != expected:
            raise self.damaged(what)

    def pieces(self, words, kind=0) -> list[tuple[int, int]]:
        """Return the parts of a record of so many words, each followed by the words of the next one."""
        pieces = []
        while words > 0:
            place, count = self.record()
            if kind == 0 and count != words * self.size:  # of a matrix, numbers are counted
                raise self.damaged(f"record of {words} words")
            pieces.append((place, count))
            words = self.key()
        return pieces

    def name(self, words) -> str:
        """Return a record with a name of so many words."""
        if words < 1:
            raise self.damaged("name of a table")
        place, count = self.pieces(words)[0]
        letters = self.data[place : place + count]
        if self.size == 8 and not any(letters[k + 4 : k + 8].strip() for k in range(0, count, 8)):  # four a word
            letters = b"".join(letters[k : k + 4] for k in range(0, count, 8))
        return letters.decode("latin-1").strip()

    def next_record(self) -> tuple[int, int]:
        """Return the kind of the next record (1: a column of a matrix) and its words; both 0 at the end."""
        self.pass_key(1, "start of a record")
        kind = self.key()
        if kind not in (0, 1):
            raise self.damaged("kind of a record")
        return kind, self.key()


@dataclass(frozen=True)
class Block:
    """A table or matrix of a file, with the `order` of bytes and the `size` of a word.

    Of a table, `records` of pieces (byte, bytes) behind the name; of a matrix, (byte, columns before) of `columns`.
    """

    path: str
    name: str
    order: str
    size: int
    trailer: tuple[int, ...]
    records: list
    columns: list

    def length(self, record: int) -> int:
        """Return bytes of a record; 0 where there is none."""
        return sum(count for _, count in self.records[record]) if record < len(self.records) else 0

    def bytes(self, record: int, low: int, high: int) -> np.ndarray:
        chunks, before = [np.zeros(0, np.uint8)], 0
        for at, count in self.records[record]:
            a, b = max(low - before, 0), min(high - before, count)
            if a < b:
                chunks.append(read_numbers(self.path, np.uint8, b - a, offset=at + a))
            before += count
        return np.concatenate(chunks)

    def integers(self, record: int, low=0, high=None) -> np.ndarray:
        """Return words low..high of a record as whole numbers."""
        high = self.length(record) // self.size if high is None else high
        raw = self.bytes(record, low * self.size, high * self.size)
        return raw.view(f"{self.order}i{self.size}").astype(np.int64)


def walk(path):
    """Yield the Blocks of a file, from one walk along its records on one rank. Raises InputError."""
    start = first_bytes(path)
    if not begins(start):
        raise InputError(f"{path}: found a file that begins with {start[:12]!r}, expected one of OUTPUT2")
    order, size = _layout(start)
    with mapped(path) as data:
        chain = _Chain(data, path, order, size)
        while not chain.ended:
            # what one run wrote begins with a header and ends with 0
            words = chain.key()
            if words == 0:  # the end of what one run wrote
                continue
            if words == 3:  # date, title and label
                chain.pieces(3)
                chain.pass_key(0, "end of the header")
                continue
            # a block: name, trailer, and records of a table or columns of a matrix
            name = chain.name(words)
            chain.pass_key(7, "trailer of 7 words")
            place, _ = chain.pieces(7)[0]
            trailer = struct.unpack_from(order + ("7i" if size == 4 else "7q"), data, place)
            block, number = Block(str(path), name, order, size, trailer, [], []), 0
            while True:
                at = chain.at
                kind, count = chain.next_record()
                if block.columns and (kind == 0 or at >= block.columns[-1][0] + SHARE):
                    block.columns.append((at, number))
                if (kind, count) == (0, 0):
                    break
                if kind and not block.columns:
                    block.columns.append((at, 0))
                elif not kind and block.columns:
                    raise chain.damaged("column of a matrix behind others")
                records = chain.pieces(count, kind)  # none for an empty column of a matrix
                number += kind
                if not kind:
                    block.records.append(records)
            del block.records[:1]  # the name again
            yield block


def _points(path, comm, group):
    """Return the Points of this rank of one set of tables, in order; None where tables are missing."""
    table = group["BGPDT"]

    def damaged(what):
        return InputError(f"{path}: found {what} in the table {table.name}; the file is damaged or of a kind that is "
                          "not read")  # fmt: skip

    # how many points there are, and how long each is
    with agreed(comm):
        total, width = _form(table, group.get("EQEXIN"), damaged)
    if width is None:
        return None
    with agreed(comm):
        first, last = row_range(comm, total)
        data = table.bytes(0, first * width, last * width)
    is_long = width != 4 * table.size
    many, size = ((6,), 8) if is_long else ((1,), table.size)
    rows = data.view(np.dtype([("words", f"{table.order}i{table.size}", many), ("place", f"{table.order}f{size}", 3)]))
    position, words = rows["place"].astype(float), rows["words"].astype(np.int64)
    # numbers and kinds of points, from the table itself or from EQEXIN
    numbered = _numbered(comm, group["EQEXIN"], first, len(rows), damaged) if "EQEXIN" in group else None
    if is_long:  # has numbers and kinds itself
        system, dof, label, code = words[:, :4].T
        scalar = code == SCALAR
        with agreed(comm):
            if not (scalar | (code == GRID)).all():
                raise damaged("points that are neither grids nor scalars")
            if numbered and not all(map(np.array_equal, (label, dof, scalar), numbered)):
                raise damaged("numbers of points or dofs other than those of EQEXIN")
    else:
        system, (label, dof, scalar) = words[:, 0], numbered
    with agreed(comm):
        if (dof < 1).any() or (label < 1).any() or (label > LARGEST_LABEL).any():
            raise damaged("numbers of points or dofs that are not positive")
        if not np.isfinite(position).all():
            raise damaged("places that are no numbers")
        # dofs follow each other, also from rank to rank
        dofs = np.where(scalar, 1, 6)
        before = dof[0] if len(dof) else 0
        if (dof != before + np.cumsum(dofs) - dofs).any():
            raise damaged("dofs that do not follow each other")
        systems = _systems(group["CSTM"]) if "CSTM" in group else {}
    if not all(comm.allgather(set(system[~scalar].tolist()) <= {0, *systems})):
        return None
    counts = comm.allgather(int(dofs.sum()))
    with agreed(comm):
        if len(dof) and before != 1 + sum(counts[: comm.rank]):
            raise damaged("dofs that do not follow each other")
        # sets of the dofs
        marks = np.zeros((len(label), 6), np.uint8)
        if "USET" in group:
            uset = group["USET"]
            if uset.length(0) != sum(counts) * uset.size:
                raise InputError(
                    f"{path}: found {uset.length(0) // uset.size} dofs in the table {uset.name}, expected the "
                    f"{sum(counts)} of {table.name}"
                )
            low = sum(counts[: comm.rank])
            members = uset.integers(0, low, low + counts[comm.rank])
            have = ~scalar[:, None] | (np.arange(6) == 0)
            for mark, bits in MEMBERS.items():
                marks[have] |= np.where(members & bits, mark, 0).astype(np.uint8)
        rough = width == 16  # coordinates of 32 bits
        return Points.in_systems(label, position, scalar, marks, system, systems, rough)


def _form(table, numbers, damaged):
    """Return how many points a BGPDT has, and bytes of each: with its numbers and doubles, or only system and place."""
    long, short = 6 * table.size + 24, 4 * table.size
    length = table.length(0)
    if numbers is None:  # the short form may have the length of the long one, but has no kinds of points
        is_long = length % long == 0 and length and table.integers(0, KIND, KIND + 1)[0] in (GRID, SCALAR)
        return length // long, long if is_long else None
    total = numbers.length(0) // (2 * numbers.size)
    width = next((width for width in (long, short) if width * total == length), None)
    if width is None or numbers.length(1) != numbers.length(0):
        raise damaged(f"{length} bytes for {total} points, which are neither {long} nor {short} each,")
    return total, width


def _numbered(comm, numbers, first, count_here, damaged):
    """Return number, first dof and whether scalar of the points `first` and so on, by EQEXIN. Collective."""
    with agreed(comm):
        count = numbers.length(0) // (2 * numbers.size)
        low, high = row_range(comm, count)
        # number and place in the order; number, and 10 times the dof plus the kind
        pairs = numbers.integers(0, 2 * low, 2 * high).reshape(-1, 2)
        codes = numbers.integers(1, 2 * low, 2 * high).reshape(-1, 2)
        if (pairs[:, 0] != codes[:, 0]).any() or (pairs < 1).any() or (codes < 1).any():
            raise damaged("numbers of points that do not agree")
    twice = repeated_key(comm, pairs[:, 1])
    wanted = first + 1 + np.arange(count_here)
    there, (label, code) = look_up(comm, pairs[:, 1], [pairs[:, 0], codes[:, 1]], wanted)
    with agreed(comm):
        if twice is not None or not there.all() or not np.isin(code % 10, (1, SCALAR_CODE)).all():
            raise damaged("numbers of points that do not agree")
    return label, code // 10, code % 10 == SCALAR_CODE


def _systems(table):
    """Return coordinate systems by number: two whole numbers with 12 reals each, or both in records of their own."""
    if len(table.records) > 1:
        heads = table.integers(0).reshape(-1, 4)
        reals = table.bytes(1, 0, table.length(1)).view(f"{table.order}f8")
        definitions = [(number, kind, reals[at - 1 : at + 11]) for number, kind, _, at in heads]
    else:
        kind = np.dtype([("whole", f"{table.order}i{table.size}", 2), ("real", f"{table.order}f{table.size}", 12)])
        if table.length(0) % kind.itemsize:
            raise InputError(f"{table.path}: found {table.length(0)} bytes in the table {table.name}, expected "
                             f"{kind.itemsize} a coordinate system")  # fmt: skip
        definitions = [(*row["whole"], row["real"]) for row in table.bytes(0, 0, table.length(0)).view(kind)]
    systems = {}
    for number, kind, values in definitions:
        axes = np.array(values[3:], dtype=float).reshape(-1, 3)
        if kind not in (1, 2, 3) or axes.shape != (3, 3) or np.abs(axes.T @ axes - np.eye(3)).max() > 1e-5:
            raise damaged_file(table.path, f"no axes of the coordinate system {number} in the table {table.name}")
        systems[int(number)] = System(int(kind), np.array(values[:3], dtype=float), axes)
    return systems


# Matrices (KGG, MGG, ...): a column is a sequence of records, each with the number of its first row and the values from
# there on; keys between them announce their lengths. Each rank decodes its share of whole columns.


@dataclass(frozen=True)
class Op2Matrix(Op4Matrix):
    """As Op4Matrix; `columns` (shares + 1,): so many columns lie in front of each of `starts`."""

    columns: tuple[int, ...] = ()


def contents(path) -> list[Op2Matrix]:
    """Return the matrices of a file, from one walk along its records on one rank."""
    return [_matrix(path, block) for block in walk(path) if block.columns]


def _matrix(path, block):
    """Return the Op2Matrix of a block with columns. Raises InputError."""
    _, columns, rows, form, kind, *_ = block.trailer
    starts, before = zip(*block.columns, strict=True)
    if before[-1] != columns:
        raise damaged_file(path, f"{before[-1]} columns of the matrix {block.name}, expected {columns}")
    place = {"starts": starts, "layout": (block.order, block.size), "is_text": False}
    matrix = matrix_of(path, f"byte {starts[0]}", (columns, rows, form, kind), block.name.encode("latin-1"), **place)
    return Op2Matrix(**vars(matrix) | {"columns": before})


def read(path, comm, matrix: Op2Matrix) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return rows and columns (from 0) and values of the shares of this rank. Collective. Raises InputError."""
    with agreed(comm), mapped(path) as data:
        return [_decode(path, data, matrix, k) for k in range(*row_range(comm, len(matrix.starts) - 1))]


def _decode(path, data, matrix, share):
    """Return rows and columns (from 0) and values of a share of columns."""
    order, size = matrix.layout
    # strings of each column: first row, then values
    number = size if size == 8 else 8 if matrix.kind in DOUBLE else 4  # bytes
    width = number * (2 if matrix.kind in COMPLEX else 1)
    rows, values, counts, columns = [], [], [], []
    chain = _Chain(data, path, order, size)
    chain.at = matrix.starts[share]
    for column in range(matrix.columns[share], matrix.columns[share + 1]):
        kind, words = chain.next_record()
        last = 0
        for place, count in chain.pieces(words, kind):
            first = int(np.frombuffer(data, f"{order}i{size}", 1, place)[0])
            length, rest = divmod(count - size, width)
            if rest or length < 1 or first <= last or first + length - 1 > matrix.shape[0]:
                raise InputError(
                    f"{path}: found {count} bytes for the row {first} of column {column + 1} of the matrix {matrix}, "
                    "expected strings of numbers that ascend in their column; the file is damaged"
                )
            last = first + length - 1
            rows.append(first - 1)
            columns.append(column)
            counts.append(length)
            values.append(np.array(np.frombuffer(data, f"{order}f{number}", (count - size) // number, place + size)))
    # rows and columns of all values
    counts = np.array(counts, np.int64)
    values = real_values(path, matrix, np.concatenate([np.zeros(0), *values]))
    i = np.repeat(np.array(rows, np.int64) - (np.cumsum(counts) - counts), counts) + np.arange(len(values))
    j = np.repeat(np.array(columns, np.int64), counts)
    there = values != 0
    return i[there], j[there], values[there]
