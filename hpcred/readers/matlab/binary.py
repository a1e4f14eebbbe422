"""Read the variables of MATLAB files of version 4 and 5 (also 6 and 7), and columns or rows of one.

Version 5 is a list of elements, optionally compressed by zlib. A compressed element is unpacked up to the wanted
part; others are read in place. Structs and cells are searched up to a depth. SciPy reads the same, and crashes on
damaged files.
"""

import zlib
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path

import numpy as np

from ...files.system_errors import open_input
from ...parallel.failures import InputError
from ...parallel.memory import MB, node_mb
from .variables import Variable, entries_of, whole

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
MATRIX, PACKED = 14, 15
CELL, STRUCT, OBJECT, CHAR, SPARSE = 1, 2, 3, 4, 5
NUMERIC = range(6, 16)
FUNCTION, OPAQUE = 16, 17  # function handles; strings, tables, times and all other objects of classes
COMPLEX, LOGICAL = 0x0800, 0x0200
DOUBLES = 9
DEPTH, MOST_ITEMS = 12, 1000  # structs in structs, and items of a cell or struct array, that are looked into
VERSION_4 = {0: "f8", 1: "f4", 2: "i4", 3: "i2", 4: "u2", 5: "u1"}
BYTES_AT_A_TIME = 2**22  # bytes unpacked at a time
LETTERS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
LONGEST_TEXT = 2**16  # bytes; longer ones are no names


def begins_version_5(start: bytes) -> bool:
    """Test whether a file that starts so is of version 5."""
    return len(start) >= 128 and start[124:128] in (b"\x00\x01IM", b"\x01\x00MI")


def begins_version_4(start: bytes) -> bool:
    """Test whether a file that starts so is of version 4: the header of a matrix with a name."""
    return _header_4(start[:20]) is not None and _name_4(start) is not None


@dataclass(frozen=True)
class Run:
    """Numbers in a row: the byte where they begin in their element, their type, and how many they are."""

    offset: int
    dtype: str
    count: int


@dataclass(frozen=True)
class Place:
    """The bytes `start`, `size` of an element in the file, whether it is packed, and the runs of a matrix in it.

    A sparse one has its rows and either, in version 5, where its columns start, or, in version 4, the column of each.
    """

    start: int
    size: int
    packed: bool
    values: Run | None = None
    rows: Run | None = None
    starts: Run | None = None
    columns: Run | None = None
    imaginary: Run | None = None


class _Element:
    """The bytes of an element, unpacked, to be read forwards or again. Raises InputError where it ends too early."""

    def __init__(self, path, file, place):
        self._path, self._file, self._place = path, file, place
        self._restart()

    def _restart(self):
        self.position, self._taken, self._rest = 0, 0, b""
        self._unpack = zlib.decompressobj() if self._place.packed else None

    def read(self, count) -> bytes:
        chunks = []
        while count:
            chunk = self._some(min(count, BYTES_AT_A_TIME))
            if not chunk:
                raise damaged(self._path, self._place.start + self.position, "an element that ends too early")
            chunks.append(chunk)
            count -= len(chunk)
            self.position += len(chunk)
        return b"".join(chunks)

    def _some(self, count):
        if self._unpack is None:
            self._file.seek(self._place.start + self.position)
            return self._file.read(min(count, self._place.size - self.position))
        while True:
            text = self._rest
            if not text and not self._unpack.eof:
                self._file.seek(self._place.start + self._taken)
                text = self._file.read(min(BYTES_AT_A_TIME, self._place.size - self._taken))
                self._taken += len(text)
            if self._unpack.eof:
                return b""
            try:
                unpacked = self._unpack.decompress(text, count)
            except zlib.error as error:
                unreadable = f"a packed element that cannot be read ({error})"
                raise damaged(self._path, self._place.start, unreadable) from error
            self._rest = self._unpack.unconsumed_tail
            if unpacked or (not text and not self._rest):
                return unpacked

    def skip(self, count):
        if self._unpack is None and self.position + count <= self._place.size:
            self.position += count
            return
        while count:
            count -= len(self.read(min(count, BYTES_AT_A_TIME)))

    def numbers(self, run, first, last) -> np.ndarray:
        """Return the numbers first..last of a run."""
        dtype = np.dtype(run.dtype)
        begin = run.offset + first * dtype.itemsize
        if begin < self.position:
            self._restart()
        self.skip(begin - self.position)
        return np.frombuffer(self.read((last - first) * dtype.itemsize), dtype)

    def finish(self):
        """Read a packed element to its end, so that its checksum is looked at."""
        if self._unpack is not None:
            while chunk := self._some(BYTES_AT_A_TIME):
                self.position += len(chunk)
            if not self._unpack.eof or self._unpack.unused_data or self._taken < self._place.size:
                raise damaged(self._path, self._place.start, "a packed element of another length than it says")


def damaged(path, position, found) -> InputError:
    return InputError(f"{path}: found {found} at byte {position}; the file is damaged, or no MATLAB file")


def variables(path) -> list[Variable]:
    """Return all numeric matrices of a file, those in structs and cells included. Raises InputError."""
    with open_input(path) as file:
        start = file.read(128)
        if not begins_version_5(start):
            return _variables_4(path, file)
        # without a name: what MATLAB keeps for objects
        return [variable for level in _levels_5(path, file, start) for variable in level.found if variable.name]


def arrays(path, names) -> tuple[dict[str, np.ndarray], dict[str, list[str]]]:
    """Return those of these variables that are full arrays of numbers, and the rows of those that are texts, or cells
    of texts, of a file of version 5. On this rank. Raises InputError."""
    numbers, texts = {}, {}
    with open_input(path) as file:
        start = file.read(128)
        if not begins_version_5(start):
            raise InputError(f"{path}: found no MATLAB file of version 5 to 7, expected one that save wrote with '-v7'")
        for level in _levels_5(path, file, start):
            for variable in level.found:
                if variable.name in names and not variable.sparse:
                    numbers[variable.name] = _array_of(path, file, variable)
            for name, shape, letters in level.texts:
                if (name := name.partition("{")[0]) in names:
                    rows = np.array(list(letters)).reshape(shape[0], -1, order="F") if letters else [""]
                    texts.setdefault(name, []).extend("".join(row).rstrip() for row in rows)
    return numbers, texts


def _array_of(path, file, variable) -> np.ndarray:
    """Return a full array."""
    if 16 * prod(variable.shape) > MB * (free := node_mb()):
        raise InputError(f"{path}: found {variable.name}, {variable.in_words()}, and {free:.0f} MB are free")
    element = _Element(path, file, variable.place)
    values = element.numbers(variable.place.values, 0, variable.place.values.count)
    if variable.complex:
        real, values = values, np.empty(len(values), dtype=complex)
        values.real, values.imag = real, element.numbers(variable.place.imaginary, 0, variable.place.imaginary.count)
    return values.astype(bool if variable.logical else values.dtype).reshape(variable.shape, order="F")


def _levels_5(path, file, start):
    """Yield what the elements of a file of version 5 have, which begins so. Raises InputError."""
    order = "<" if start[126:128] == b"IM" else ">"
    size, at = Path(path).stat().st_size, 128
    while at < size:
        file.seek(at)
        tag = file.read(8)
        if len(tag) < 8:
            raise damaged(path, at, "a few bytes behind the last element")
        kind, count = (int(number) for number in np.frombuffer(tag, f"{order}u4"))
        if kind not in (MATRIX, PACKED) or at + 8 + count > size:
            raise damaged(path, at, f"an element of type {kind} and {count} bytes")
        try:
            level = _Level5(path, file, Place(at + 8, count, kind == PACKED), order)
        except (ValueError, IndexError, OverflowError) as error:
            if isinstance(error, InputError):
                raise
            raise damaged(path, at, "a variable that fits no rule") from error
        yield level
        at += 8 + count


class _Level5:
    """The variables `found` in one element of version 5, and its `texts`: name, shape and letters."""

    def __init__(self, path, file, place, order):
        self._path, self._place, self._order = path, place, order
        self._stream = _Element(path, file, place)
        self.found, self.texts = [], []
        if place.packed:
            kind, _, _ = self._tag()
            if kind != MATRIX:
                raise self._wrong(f"a packed element of type {kind}")
        self._matrix("", 0)
        self._stream.finish()

    def _wrong(self, what):
        return damaged(self._path, self._place.start + (0 if self._place.packed else self._stream.position), what)

    def _tag(self):
        """Return Type, number of bytes, and how many bytes of padding follow them."""
        word = self._stream.read(4)
        number = int(np.frombuffer(word, f"{self._order}u4")[0])
        if number >> 16:  # type, number of bytes, and the data in eight bytes
            if number >> 16 > 4:
                raise self._wrong(f"a small element of {number >> 16} bytes")
            return number & 0xFFFF, number >> 16, 4 - (number >> 16)
        count = int(np.frombuffer(self._stream.read(4), f"{self._order}u4")[0])
        return number, count, -count % 8

    def _small(self, expected, most=2**20) -> np.ndarray:
        """Return the numbers of an element that has few, as one of the expected types."""
        kind, count, padding = self._tag()
        if kind not in expected or count > most or count % np.dtype(NUMBERS[kind]).itemsize:
            raise self._wrong(f"an element of type {kind} and {count} bytes, where type {expected[0]} is expected,")
        data = self._stream.read(count)
        self._stream.skip(padding)
        return np.frombuffer(data, self._order + NUMBERS[kind])

    def _run(self, truths=None) -> Run:
        return self._run_and_last(truths)[0]

    def _run_and_last(self, truths=None) -> tuple[Run, int]:
        """Return a run, and its last number if whole; `truths`: how many, of a sparse logical matrix."""
        kind, count, padding = self._tag()
        if kind == DOUBLES and count == truths:  # MATLAB says doubles, and writes a byte each
            kind = 2
        width = np.dtype(NUMBERS.get(kind, "u1")).itemsize
        if kind not in NUMBERS or count % width:
            raise self._wrong(f"numbers of type {kind} and {count} bytes")
        run = Run(self._stream.position, self._order + NUMBERS[kind], count // width)
        last = self._stream.numbers(run, run.count - 1, run.count) if run.count else np.zeros(1)
        self._stream.skip(padding)
        return run, int(last[0]) if np.isfinite(last[0]) else -1

    def _matrix(self, name, depth):
        """A matrix behind its tag; `name`: what it is called where that is not its own name."""
        flags = self._small((6,), 8)
        if len(flags) != 2:
            raise self._wrong("flags of a matrix that are no two numbers")
        kind, is_complex, is_logical = int(flags[0]) & 0xFF, *(bool(int(flags[0]) & bit) for bit in (COMPLEX, LOGICAL))
        if kind in (FUNCTION, OPAQUE):  # hold no matrix of their own, and have no shape; whoever called knows their end
            return
        # shape and name
        shape = tuple(int(number) for number in self._small((5,), 8 * 32))
        own = self._small((1, 2), 2**16).astype(np.uint8).tobytes().decode("latin-1")
        if len(shape) < 2 or min(shape) < 0:
            raise self._wrong(f"a matrix of shape {shape}")
        self._require_names([own])
        name, count = name or own, int(np.prod(shape, dtype=object))
        # the content by its class
        if kind in NUMERIC:
            runs = [self._run() for _ in range(1 + is_complex)]
            if any(run.count != count for run in runs):
                raise self._wrong(f"{runs[0].count} numbers for the matrix '{name}' of {count}")
            place = replace(self._place, values=runs[0], imaginary=runs[1] if is_complex else None)
            self.found.append(Variable(name, shape, complex=is_complex, logical=is_logical, place=place))
        elif kind == SPARSE:
            self._sparse(name, shape, is_complex, is_logical, int(flags[1]))
        elif kind == CHAR:
            self._text(name, shape, count)
        elif kind == CELL:
            self._items([f"{name}{{{k + 1}}}" for k in range(min(count, MOST_ITEMS))], count, depth)
        elif kind in (STRUCT, OBJECT):
            if kind == OBJECT:
                self._small((1, 2), 2**16)
            self._fields(name, count, depth)
        else:
            raise InputError(
                f"{self._path}: found the variable '{name}' of a kind that cannot be read (class {kind}); save the "
                "matrices without it"
            )

    def _text(self, name, shape, total):
        kind, count, padding = self._tag()
        if kind in LETTERS and count <= LONGEST_TEXT:
            code = LETTERS[kind] + {"<": "-le", ">": "-be"}[self._order] * (LETTERS[kind] in ("utf-16", "utf-32"))
            letters = self._stream.read(count).decode(code, "replace")
            if len(letters) == total:  # else some take more than 16 bits, and the shape does not count letters
                self.texts.append((name, shape, letters))
            count = 0
        self._stream.skip(count + padding)

    def _sparse(self, name, shape, is_complex, is_logical, room):
        rows = self._run()
        starts, count = self._run_and_last()
        values = [self._run(room if is_logical else None) for _ in range(1 + is_complex)][0]
        if len(shape) != 2 or starts.count != shape[1] + 1 or not count <= min(rows.count, values.count, room):
            raise self._wrong(f"a sparse matrix '{name}' whose lists do not fit each other,")
        place = replace(self._place, values=values, rows=rows, starts=starts)
        self.found.append(Variable(name, shape, True, count, is_complex, place))

    def _fields(self, name, count, depth):
        length = int(self._small((5,), 4).sum())
        names = self._small((1, 2), 2**24).astype(np.uint8).tobytes()
        if length < 1 or len(names) % length:
            raise self._wrong(f"a struct '{name}' with {len(names)} letters in names of {length}")
        fields = [names[k : k + length].split(b"\0")[0].decode("latin-1") for k in range(0, len(names), length)]
        self._require_names(fields)
        names = [f"{name}.{field}" if count == 1 else f"{name}({k + 1}).{field}"
                 for k in range(min(count, MOST_ITEMS)) for field in fields]  # fmt: skip
        self._items(names, count * len(fields), depth)

    def _require_names(self, names):
        wrong = next((name for name in names if name and not name.isidentifier()), None)
        if wrong is not None:
            raise self._wrong(f"the name {wrong!r}, which MATLAB does not give,")

    def _items(self, names, count, depth):
        for k in range(count):
            kind, size, padding = self._tag()
            if kind != MATRIX:
                raise self._wrong(f"an element of type {kind} in a struct or cell")
            end = self._stream.position + size + padding
            if size and k < len(names) and depth < DEPTH:
                self._matrix(names[k], depth + 1)
            if self._stream.position > end:
                raise self._wrong("an element that is longer than the one around it")
            self._stream.skip(end - self._stream.position)


def _header_4(header):
    """Return byte order, type of numbers, text or sparse, rows, columns, complex, length of the name; or None."""
    if len(header) < 20:
        return None
    for order, machine in (("<", 0), (">", 1)):
        kind, rows, columns, imaginary, length = (int(number) for number in np.frombuffer(header, f"{order}i4"))
        thousands, hundreds, tens, ones = kind // 1000, kind // 100 % 10, kind // 10 % 10, kind % 10
        if (
            thousands == machine and hundreds == 0 and tens in VERSION_4 and ones in (0, 1, 2)
            and rows >= 0 and columns >= 0 and imaginary in (0, 1) and 1 < length <= 64
        ):  # fmt: skip
            return order, order + VERSION_4[tens], ones, rows, columns, bool(imaginary), length
    return None


def _name_4(start):
    """Return the name behind a header of version 4, or None where it is none."""
    length = _header_4(start[:20])[-1]
    name = start[20 : 20 + length]
    text = name.rstrip(b"\0").decode("latin-1")
    return text if len(name) == length and name.endswith(b"\0") and text.isidentifier() else None


def _variables_4(path, file):
    size, at, listed = Path(path).stat().st_size, 0, []
    while at < size:
        # the header of a variable, and where its numbers end
        file.seek(at)
        start = file.read(20 + 64)
        header = _header_4(start[:20])
        name = _name_4(start) if header else None
        if name is None:
            raise damaged(path, at, "no header of a matrix")
        _, dtype, kind, rows, columns, is_complex, length = header
        begin, width = at + 20 + length, np.dtype(dtype).itemsize
        count = rows * columns * (1 + (is_complex and kind == 0))
        if begin + count * width > size:
            raise damaged(path, at, f"a matrix '{name}' of {rows} x {columns} numbers that the file does not have")
        # a full matrix is one run of numbers; a sparse one has columns of row, column and value
        runs = [Run(k * rows * width, dtype, rows) for k in range(columns if kind == 2 else 0)]
        if kind == 0:
            place = Place(begin, count * width, False, Run(0, dtype, rows * columns))
            listed.append(Variable(name, (rows, columns), complex=is_complex, place=place))
        elif kind == 2:
            if columns not in (3, 4) or rows < 1:
                raise damaged(path, at, f"a sparse matrix '{name}' of {rows} x {columns} numbers")
            element = _Element(path, file, Place(begin, count * width, False))
            # the last row of a sparse matrix has its shape
            shape = tuple(int(element.numbers(run, rows - 1, rows)[0]) for run in runs[:2])
            i, j, v = (Run(run.offset, dtype, rows - 1) for run in runs[:3])
            place = Place(begin, count * width, False, v, i, columns=j)
            listed.append(Variable(name, shape, True, rows - 1, columns == 4, place))
        at = begin + count * width
    return listed


def entries(path, variable, rank, size) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows, columns (from 0) and values of the share of one of `size` ranks. Raises InputError."""
    place = variable.place
    with open_input(path) as file:
        element = _Element(path, file, place)
        if place.columns is None or not all(variable.shape):
            return entries_of(path, variable, lambda key, low, high: element.numbers(getattr(place, key), low, high),
                              rank, size)  # fmt: skip
        count = place.values.count
        first, last = count * rank // size, count * (rank + 1) // size
        i, j, v = (element.numbers(run, first, last) for run in (place.rows, place.columns, place.values))
    i, j = (whole(path, variable, numbers, 1, limit) - 1 for numbers, limit in zip((i, j), variable.shape, strict=True))
    return i, j, v.astype(float)


def table_of(path, variable, first, last, across) -> np.ndarray:
    """Return rows (`across`: columns) first..last of a dense matrix, one in each row. Raises InputError."""
    rows, columns = variable.shape
    with open_input(path) as file:
        element, values = _Element(path, file, variable.place), variable.place.values
        if across:
            return np.array(element.numbers(values, first * rows, last * rows), dtype=float).reshape(-1, rows)
        columns_read = [element.numbers(values, k * rows + first, k * rows + last) for k in range(columns)]
    return np.array(columns_read, dtype=float).reshape(columns, last - first).T
