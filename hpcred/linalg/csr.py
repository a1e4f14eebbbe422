"""Coordinates to rows: entries (row, column, value) of this rank's rows enter, CSR rows leave."""

import numpy as np


def compress(entries: dict, first: int, last: int, columns: int):
    """CSR of the rows first..last-1 on the union pattern of square matrices, with duplicates summed.

    `entries`: name -> (rows, columns, values) with global numbers from 0. Returns indptr (rows + 1,), indices
    (nonzeros,) and a dict name -> values (nonzeros,).
    """
    # 32-bit row numbers of PETSc overflow in the product
    keys = {name: (np.asarray(i, dtype=np.int64) - first) * int(columns) + j for name, (i, j, _) in entries.items()}
    diagonal = np.arange(last - first) * (columns + 1) + first  # always present, as PETSc wants it
    pattern = np.unique(np.concatenate([diagonal, *(np.unique(key) for key in keys.values())]))
    rows, indices = np.divmod(pattern, columns)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows.astype(np.int64), minlength=last - first))])
    values = {}
    for name, (_, _, data) in entries.items():
        place = np.searchsorted(pattern, keys[name])
        values[name] = np.bincount(place, weights=data, minlength=pattern.size)
    return indptr, indices, values
