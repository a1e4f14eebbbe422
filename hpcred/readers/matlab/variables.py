"""List the variables of MATLAB files of all versions, and make entries of their lists of numbers."""

from dataclasses import dataclass

import numpy as np

from ...files.system_errors import damaged_file

NUMBERS_AT_A_TIME = 2**22


@dataclass(frozen=True)
class Variable:
    """A matrix of numbers: its `name` with the structs and cells it is in (nas.kaa.k0, parts(2).K, c{1}), its `shape`,
    whether it is `sparse` (then with `nonzeros`, where known) and `complex`, and the `place` that its reader needs."""

    name: str
    shape: tuple[int, ...]
    sparse: bool = False
    nonzeros: int | None = None
    complex: bool = False
    place: object = None
    logical: bool = False

    def in_words(self) -> str:
        """Return such as "54 x 54 sparse, 606 entries"."""
        size = " x ".join(str(number) for number in self.shape)
        entries = f", {self.nonzeros} entries" if self.nonzeros is not None else ""
        return f"{size} {'sparse' if self.sparse else 'dense'}{entries}{', complex' if self.complex else ''}"


def entries_of(path, variable, numbers, rank, size) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows, columns (from 0) and values of the share of a rank, from numbers low..high of the lists by name."""
    rows, columns = variable.shape
    first, last = columns * rank // size, columns * (rank + 1) // size
    tables = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
    if variable.place is None or not rows or not columns:
        return tables[0]
    # columns of a dense matrix, some at a time
    if not variable.sparse:
        step = max(1, NUMBERS_AT_A_TIME // rows)
        for low in range(first, last, step):
            values = numbers("values", low * rows, min(low + step, last) * rows).astype(float)
            there = np.flatnonzero(values)
            tables.append((there % rows, low + there // rows, values[there]))
        return tuple(map(np.concatenate, zip(*tables, strict=True)))
    # columns of a sparse one: where they begin, and what is in them
    starts = numbers("starts", first, last + 1).astype(np.int64)
    count, low, high = variable.nonzeros, int(starts[0]), int(starts[-1])
    begins_well, ends_well = first > 0 or low == 0, last < columns or high == count
    if (np.diff(starts) < 0).any() or not 0 <= low <= high <= count or not begins_well or not ends_well:
        raise damaged_file(path, f"columns of '{variable.name}' that do not ascend from 0 to its {count} entries")
    if low == high:
        return tables[0]
    i = whole(path, variable, numbers("rows", low, high), 0, rows - 1)
    v = numbers("values", low, high).astype(float)
    if not len(i) == len(v) == high - low:
        raise damaged_file(path, f"rows of '{variable.name}' beyond its {rows}")
    # rows ascend in each column
    ascends = np.diff(i) > 0
    ends = starts[1:-1] - low - 1  # the last entries of columns, but for the last column
    ascends[ends[(ends >= 0) & (ends < len(ascends))]] = True
    if not ascends.all():
        raise damaged_file(path, f"rows of '{variable.name}' that do not ascend in their column")
    return i, np.repeat(np.arange(first, last), np.diff(starts)), v


def whole(path, variable, values, low, high) -> np.ndarray:
    """Return rows or columns as whole numbers low..high. Raises InputError."""
    if len(values) and not ((values >= low) & (values <= high) & (values == np.floor(values))).all():
        raise damaged_file(path, f"rows or columns of '{variable.name}' beyond its {variable.in_words()}")
    return values.astype(np.int64)
