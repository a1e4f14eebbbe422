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


def standard_header(number):
    """The first header of a file of a kind; texts have the letters of each word in reverse order."""
    words = np.zeros(STANDARD, "<i4")
    words[9] = np.frombuffer(b"15.0"[::-1], "<i4")[0]
    words[10:] = np.frombuffer(b" " * 4 * 90, "<i4")
    words[94:] = 0
    words[[0, 2, 3, 99]] = number, 120000, 20240101, 654321
    return words


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
    squeeze_columns=None, diagonal=(), hole=0, loads=None, prescribed=0.0, constant=0.0, scaling=None, **header,
):  # fmt: skip
    """Write K, M and perhaps D (n, n); `nodes`: number and how many of the dofs each has, in the order of the rows.

    `held`, `slaves`: rows (from 0). `diagonal`: matrices written as one record. `hole`: words that are left out in
    front of the matrices. `loads`, `scaling`: numbers of all rows; `prescribed`, `constant`: displacements of held
    dofs, and terms of constraint equations. `header`: items of the header by number, in place of what is right.
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
        add(30, 31, record(rows), record(np.full(len(rows), constant)))
        item[20] = len(rows)
    tables = [record(item, squeeze) for item in (table[1], kind, number)]
    add(35, 36, *tables, record(np.full(len(held) or 1, prescribed)))
    for (low, high), numbers in (((37, 38), loads), ((59, 60), scaling)):
        if numbers is not None:
            add(low, high, record(np.asarray(numbers)))
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
    standard = standard_header(4)
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
    standard, header, geometry = standard_header(12), np.zeros(80, "<i4"), np.zeros(80, "<i4")
    header[[0, 2, 15]] = 12, len(nodes), 2 * STANDARD - 14
    geometry[[3, 26]] = len(nodes), 2 * STANDARD - 14 + 83
    with open(path, "wb") as file:
        for words in (record(standard), record(header), record(geometry)):
            words.tofile(file)
        for k, node in enumerate(np.asarray(nodes, float)):
            record(node, squeeze if squeeze != "mixed" else (None, "bits", "windows")[k % 3]).tofile(file)
        file.truncate(-(-file.tell() // (4 * BLOCK)) * 4 * BLOCK)


def write_large(path, nodes, width):
    """K and M of `nodes` nodes of three dofs, `width` entries a column, without a loop over the columns.

    Returns the numbers of entries stored, and the sums of the values of both triangles of K and M.
    """
    size = 3 * nodes
    plain = size - width  # columns of full width; the others grow shorter
    top = [record(np.arange(1, 4)), record(np.arange(1, nodes + 1))]
    tables = [record(item) for item in (np.full(nodes, 3), np.tile([1, 2, 3], nodes), np.zeros(size, int), np.zeros(1))]
    item, place, sums = np.zeros(160, "<i8"), 266 + sum(map(len, top)), {}
    terms = plain * width + width * (width + 1) // 2
    words = 6 * size + 3 * terms
    item[[0, 1, 2, 3, 4, 6, 7, 11, 32]] = -4, size, size, 2, 2, nodes, 3, size, nodes
    item[[35, 8, 33]] = place, terms, terms
    item[18] = place + sum(map(len, tables))
    item[26] = item[18] + words
    item[22] = item[26] + words
    assert item.max() < 2**31
    standard = standard_header(4)
    rng = np.random.default_rng(1)
    with open(path, "wb") as file:
        for part in (record(standard), record(item), *top, *tables):
            part.tofile(file)
        for key in "KM":
            sums[key] = 0.0
            for low in range(0, plain, 10000):
                column = np.arange(low, min(low + 10000, plain))
                table = np.empty((len(column), 3 * width + 6), "<i4")
                table[:, [0, width + 2]] = width
                table[:, 1] = np.int32(-(2**31))
                table[:, 2 : width + 1] = column[:, None] + np.arange(2, width + 1)
                table[:, width + 1] = column + 1
                table[:, [width + 3, 3 * width + 5]] = 2 * width
                table[:, width + 4] = 0
                values = rng.standard_normal((len(column), width))
                table[:, width + 5 : 3 * width + 5] = values.view("<i4")
                table.tofile(file)
                sums[key] += 2 * values[:, :-1].sum() + values[:, -1].sum()
            for column in range(plain, size):
                rows = np.append(np.arange(column + 1, size), column)
                values = rng.standard_normal(len(rows))
                np.concatenate([record(rows + 1), record(values)]).tofile(file)
                sums[key] += 2 * values[:-1].sum() + values[-1]
        np.array([-1], "<i4").tofile(file)
        file.truncate(-(-file.tell() // (4 * BLOCK)) * 4 * BLOCK)
    return terms, sums["K"], sums["M"]


def archive(places, angles=None, form="(3i9,6e21.13e3)", announced=None, elements=""):
    """The lines of an archive that matter, with trailing zeros left out."""
    lines = []
    for number, xyz in places.items():
        reals = [*xyz, *(angles or {}).get(number, ())]
        while reals and reals[-1] == 0:
            reals.pop()
        lines.append(f"{number:9d}{0:9d}{0:9d}" + "".join(f"{x:21.13E}" for x in reals))
    return (
        "/COM,ANSYS RELEASE 2019 R2\n/PREP7\nET,        1,185\nET,2,181\n"
        f"NBLOCK,6,SOLID,{max(places):10d},{len(lines) if announced is None else announced:10d}\n{form}\n"
        + "\n".join(lines) + f"\nN,R5.3,LOC,       -1,\n{elements}FINISH\n"
    )  # fmt: skip


def element(type_, number, nodes):
    """The lines of an element in an EBLOCK."""
    head = [1, type_, 1, 1, 0, 0, 0, 0, len(nodes), 0, number]
    items = [f"{item:9d}" for item in (*head, *nodes)]
    return "".join(items[:19]) + "\n" + ("".join(items[19:]) + "\n" if items[19:] else "")


def turn(angles):
    """Rz Rx Ry, by hand."""
    a, b, c = np.deg2rad(angles)
    z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    y = np.array([[np.cos(c), 0, np.sin(c)], [0, 1, 0], [-np.sin(c), 0, np.cos(c)]])
    return z @ x @ y
