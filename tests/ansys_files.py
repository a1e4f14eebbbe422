"""Writes small binary files of ANSYS as the documentation of the format describes them, for tests and benchmarks."""

import numpy as np

INTEGER, WINDOWS, BITS = 1 << 31, 1 << 28, 1 << 27
BLOCK = 16384  # words; files are filled up to a multiple
STANDARD = 100
REFERENCE = {"UX": 1, "UY": 2, "UZ": 3, "ROTX": 4, "ROTY": 5, "ROTZ": 6, "PRES": 19, "TEMP": 20}


def record(numbers, squeeze=None):
    """The words of a record of integers or floating-point numbers, plain or with zeros squeezed out."""
    numbers = np.ascontiguousarray(numbers)
    whole = numbers.dtype.kind in "iu"
    numbers = numbers.astype("<i4" if whole else "<f8")
    flags = INTEGER if whole else 0
    words = numbers.view("<i4")
    if squeeze == "bits":
        flags |= BITS
        kept = numbers != 0
        mask = sum(1 << k for k in np.flatnonzero(kept))
        words = np.concatenate([np.array([len(numbers), mask], "<u4").view("<i4"), numbers[kept].view("<i4")])
    elif squeeze == "windows":
        flags |= WINDOWS
        parts, count, k = [], 0, 0
        while k < len(numbers):
            if numbers[k] == 0:
                k += 1
                continue
            end = k
            while end < len(numbers) and numbers[end] != 0:
                end += 1
            window = numbers[k:end]
            if len(window) == 1 and k > 0:
                parts.append(np.concatenate([np.array([k], "<i4"), window.view("<i4")]))
            elif (window == window[0]).all():
                parts.append(np.concatenate([np.array([-k, -len(window)], "<i4"), window[:1].view("<i4")]))
            else:
                parts.append(np.concatenate([np.array([-k, len(window)], "<i4"), window.view("<i4")]))
            count, k = count + 1, end
        words = np.concatenate([np.array([len(numbers), count], "<i4"), *parts])
    head = np.array([len(words), flags], "<u4").view("<i4")
    return np.concatenate([head, words, head[:1]])


def lower_columns(matrix):
    """Rows and values of the columns of a symmetric matrix from the diagonal down; the diagonal comes last."""
    for k in range(len(matrix)):
        rows = k + 1 + np.flatnonzero(matrix[k + 1 :, k])
        rows = np.append(rows, k)
        yield (rows + 1).astype("<i4"), matrix[rows, k].astype("<f8")


def columns_record(matrix, squeeze=None):
    """The words of all columns, and how many entries they have."""
    parts, terms = [], 0
    for rows, values in lower_columns(matrix):
        parts += [record(rows, squeeze), record(values, squeeze)]
        terms += len(rows)
    return np.concatenate(parts), terms


def write_full(
    path, matrices, nodes, dofs=("UX", "UY", "UZ"), held=(), slaves=(), kinds=None, squeeze=None,
    squeeze_columns=None, diagonal=(), hole=0, **header,
):  # fmt: skip
    """Write K, M and perhaps D (n, n); `nodes`: number and how many of the dofs each has, in the order of the rows.

    `held`, `slaves`: rows (from 0). `diagonal`: matrices written as one record. `hole`: words that are left out in
    front of the matrices. `header`: items of the header by number, in place of what is right.
    """
    size = len(matrices["K"])
    kinds = kinds if kinds is not None else [k + 1 for _, count in nodes for k in range(count)]
    active = np.ones(size, bool)
    active[[*held, *slaves]] = False
    kind = np.where(np.isin(np.arange(size), held), -np.array(kinds), kinds)
    number = np.zeros(size, int)
    number[sorted(held)] = np.arange(1, len(held) + 1)
    table = np.array([number for number, _ in nodes]), np.array([count for _, count in nodes])
    item = np.zeros(160, "<i8")
    top = [record(np.array([REFERENCE[name] for name in dofs])), record(table[0])]
    place = 2 * STANDARD + 6 + 60 + sum(map(len, top)) + hole
    blocks = []

    def add(low, high, *records):
        nonlocal place
        item[low], item[high] = place & 0xFFFFFFFF, place >> 32
        for words in records:
            blocks.append(words)
            place += len(words)

    if slaves:
        rows = np.array(slaves) + 1
        add(30, 31, record(rows), record(np.zeros(len(rows))))
        item[20] = len(rows)
    tables = [record(item, squeeze) for item in (table[1], kind, number)]
    add(35, 36, *tables, record(np.zeros(len(held) or 1)))
    for key, (low, high), (terms_low, terms_high) in (
        ("K", (18, 19), (8, 9)), ("M", (26, 27), (33, 21)), ("D", (28, 29), (34, 39))
    ):  # fmt: skip
        if key not in matrices:
            continue
        if key in diagonal:
            words, terms = record(np.diag(matrices[key])), size
            item[10] = 1
        else:
            words, terms = columns_record(matrices[key], squeeze_columns)
        add(low, high, words)
        item[terms_low], item[terms_high] = terms & 0xFFFFFFFF, terms >> 32
    item[22], item[23] = place & 0xFFFFFFFF, place >> 32
    item[[0, 1, 2, 3, 4, 6, 7, 11, 32]] = (
        -4, size, active.sum(), len(matrices), 2, len(nodes), len(dofs), active.sum(), len(nodes)
    )  # fmt: skip
    for name, value in header.items():
        item[int(name.removeprefix("item"))] = value
    standard = np.zeros(STANDARD, "<i4")
    standard[[0, 99]] = 4, 654321
    item = item.astype("<u4").view("<i4") if (item >= 0).all() else (item & 0xFFFFFFFF).astype("<u4").view("<i4")
    with open(path, "wb") as file:
        for words in (record(standard), record(item), *top):
            words.tofile(file)
        file.seek(4 * hole, 1)
        for words in blocks:
            words.tofile(file)
        np.array([-1], "<i4").tofile(file)
        file.truncate(-(-file.tell() // (4 * BLOCK)) * 4 * BLOCK)


def write_rst(path, nodes, squeeze=None):
    """A result file without results: `nodes` (n, 7) are number, x, y, z and three angles in degrees."""
    standard, header, geometry = np.zeros(STANDARD, "<i4"), np.zeros(80, "<i4"), np.zeros(80, "<i4")
    standard[[0, 99]] = 12, 654321
    header[[0, 2, 15]] = 12, len(nodes), 2 * STANDARD - 14
    geometry[[3, 26]] = len(nodes), 2 * STANDARD - 14 + 83
    with open(path, "wb") as file:
        for words in (record(standard), record(header), record(geometry)):
            words.tofile(file)
        for k, node in enumerate(np.asarray(nodes, float)):
            record(node, squeeze if squeeze != "mixed" else (None, "bits", "windows")[k % 3]).tofile(file)
        file.truncate(-(-file.tell() // (4 * BLOCK)) * 4 * BLOCK)
