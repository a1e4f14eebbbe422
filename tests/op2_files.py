"""Writes files of Nastran's OUTPUT2 with tables of results, as the documentation of the format describes them."""

import numpy as np

CORNERS = {39: 4, 67: 8, 68: 6}


def op2(tables, order="<", size=4):
    """The bytes of a file of tables: a name and its records (bytes) each."""
    parts = []

    def record(content):
        length = np.array([len(content)], f"{order}i4").tobytes()
        parts.extend([length, content, length])

    def key(*values):
        for value in values:
            record(np.array([value], f"{order}i{size}").tobytes())

    def text(letters):
        length = len(letters) * size // 4
        if letters[:1] == b"N":  # a word has four letters, but that names of tables are not cut
            letters = b"".join(letters[k : k + 4].ljust(size) for k in range(0, len(letters), 4))
        return letters.ljust(length)

    key(3)
    record(np.array([1, 2, 26], f"{order}i{size}").tobytes())
    key(7)
    record(text(b"NASTRAN FORT TAPE ID CODE - "))
    key(2)
    record(text(b"XXXXXXXX"))
    key(-1, 0)
    for name, records in tables:
        letters = name.encode().ljust(8)
        key(2)
        record(text(letters))
        key(-1, 7)
        record(np.arange(101, 108).astype(f"{order}i{size}").tobytes())
        key(-2, 1, 0, 2)
        record(text(letters))
        key(-3)
        for number, content in enumerate(records, 4):
            key(1, 0, len(content) // size)
            record(content)
            key(-number)
        key(1, 0, 0)
    key(0)
    return b"".join(parts)


def described(content, subcase, width, entries, *, type_=0, approach=1, form=1, kind=1, device=1, order="<", size=4):
    """Two records: of what follows, and the entries (words as whole numbers or floats)."""
    words = np.zeros(146, f"{order}i{size}")
    words[[0, 1, 2, 3, 4, 8, 9, 10]] = 10 * approach + device, content, type_, subcase, subcase, form, width, kind
    rows = []
    for entry in entries:
        for word in entry:
            rows.append(np.array([word], f"{order}{'i' if isinstance(word, int) else 'f'}{size}").tobytes())
    return [words.tobytes(), b"".join(rows)]


def displaced(subcase, moved, point=1, **options):
    """Records of displacements by grid."""
    entries = [(10 * grid + 1, point, *map(float, u), 0.0, 0.0, 0.0) for grid, u in moved.items()]
    return described(1, subcase, 8, entries, **options)


def stressed(subcase, elements, type_=67, system=0, letters=b"GRID", order="<", size=4, **options):
    """Records of solids: by element the stresses xx, yy, zz, xy, yz, zx by corner."""
    name = int(np.frombuffer(letters.ljust(size), f"{order}i{size}")[0])
    entries = []
    for element, corners in elements.items():
        entry = [10 * element + 1, system, name, len(corners)]
        for grid, s in [(0, [0.0] * 6), *corners.items()]:
            xx, yy, zz, xy, yz, zx = map(float, s)
            other = (0.5, 0.5, 0.5, 0.5)
            entry += [grid, xx, xy, *other, 7.0, 8.0, yy, yz, *other, zz, zx, *other]
        entries.append(entry)
    width = 4 + 21 * (1 + CORNERS.get(type_, 8))
    return described(5, subcase, width, entries, type_=type_, order=order, size=size, **options)
