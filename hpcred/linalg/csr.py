"""Coordinates to rows: entries (row, column, value) of this rank's rows enter, CSR rows leave."""

import numpy as np


def compress(entries: dict, first: int, last: int, columns: int):
    """CSR of the rows first..last-1 on the union pattern of square matrices, with duplicates summed.

    `entries`: name -> (rows, columns, values) with global numbers from 0, emptied on the way. Returns indptr
    (rows + 1,), indices (nonzeros,) and a dict name -> values (nonzeros,).
    """
    names, keys, data = list(entries), {}, {}
    pattern = np.arange(last - first) * (columns + 1) + first  # the diagonal is always present, as PETSc wants it
    for name in names:
        i, j, data[name] = entries.pop(name)
        key = np.asarray(i, dtype=np.int64) - first  # 32-bit row numbers of PETSc overflow in the product
        key *= int(columns)
        key += j
        del i, j
        keys[name] = key
        pattern = np.union1d(pattern, key)
    values = {}
    for name in names:
        place = np.searchsorted(pattern, keys.pop(name))
        values[name] = np.bincount(place, weights=data.pop(name), minlength=pattern.size)
    rows, indices = np.divmod(pattern, columns)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=last - first))])
    return indptr, indices, values
