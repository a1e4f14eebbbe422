"""Read displacements and stresses of solids at nodes from tables of Nastran's OUTPUT2; each rank reads a share.

In the tables OUG (displacements) and OES (stresses) a record of 146 words describes the next one: the subcase, the type
of elements, the form of numbers, and the words of an entry. An entry of displacements is 10 times the grid plus the
device, the kind of the point, and six numbers. One of a solid is 10 times its number plus the device, its coordinate
system, GRID, how many nodes it has, and for its centre and each corner 21 words: grid, sxx, sxy, then of the axis x
five numbers and the von Mises stress, syy, syz, four numbers, szz, szx, four numbers.
"""

from typing import NamedTuple

import numpy as np

from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import require_once
from ...parallel.shares import row_range
from ..nastran.op2 import Block, walk
from .means import means_at_nodes
from .nastran_punch import CORNERS

DESCRIPTION = 146  # words, and the places of some:
APPROACH, CONTENT, TYPE, SUBCASE, FORM, WIDTH, KIND = 0, 1, 2, 3, 8, 9, 10
STATIC, REAL = 1, 1
DISPLACEMENTS, STRESSES = 1, 5  # contents, of real numbers by subcase (SORT1)
OF_STRESS = (0, 1)  # kinds: with the octahedral stress or that of von Mises beside it; others are strains
GRID, SCALAR = 1, 2  # kinds of points
HEAD, CORNER = 4, 21  # words
PLACES = [1, 9, 15, 2, 10, 16]  # of xx, yy, zz, xy, yz, zx
BASIC = ("OUG1", "OUGV1")  # before those that are turned for other programs (OUGV1PAT, BOUGV1)


class Entries(NamedTuple):
    """Displacements (`type_` 0) or stresses of a type of elements: a record of `count` entries of `width` words."""

    table: Block
    record: int
    subcase: int
    type_: int
    count: int
    width: int

    def words(self, comm) -> tuple[np.ndarray, np.ndarray]:
        """Return the share (c, width) of this rank, as whole numbers and as floating-point ones."""
        low, high = row_range(comm, self.count)
        size = self.table.size
        data = self.table.bytes(self.record, low * self.width * size, high * self.width * size)
        whole, real = (data.view(f"{self.table.order}{kind}{size}").reshape(-1, self.width) for kind in "if")
        return whole.astype(np.int64), real.astype(float)

    def damaged(self, found) -> InputError:
        return InputError(f"{self.table.path}: found {found} in the table {self.table.name}, subcase {self.subcase}; "
                          "the file is damaged or of a kind that is not read")  # fmt: skip


def read(path, comm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes (s,), displacements (steps, s, 3) and mean stresses (steps, s, 6) of this rank.

    Collective. Raises InputError.
    """
    return means_at_nodes(path, comm, (_step(comm, step) for step in decided(comm, _steps, path)))


def _steps(path) -> list[list[Entries]]:
    """Return the records of each subcase, in ascending order. Raises InputError."""
    tables = [table for table in walk(path) if table.name.startswith(("OUG", "BOUG", "OES"))]
    if any(table.name in BASIC for table in tables):
        tables = [table for table in tables if table.name in BASIC or table.name.startswith("OES")]
    steps = {}
    for table in tables:
        if len(table.records) % 2 or any(table.length(k) != DESCRIPTION * table.size
                                         for k in range(0, len(table.records), 2)):  # fmt: skip
            raise InputError(f"{path}: found a record of the table {table.name} without one of {DESCRIPTION} words "
                             "that describes it; the file is damaged or of a kind that is not read")  # fmt: skip
        for k in range(0, len(table.records), 2):
            entries = _described(table, k)
            others = steps.setdefault(entries.subcase, {})
            if entries.type_ in others:
                of = f"stresses of the element type {entries.type_}" if entries.type_ else "displacements"
                raise InputError(f"{path}: found {of} twice in subcase {entries.subcase}, expected those of one run")
            others[entries.type_] = entries
    without = [number for number, step in sorted(steps.items()) if 0 not in step or len(step) == 1]
    if without or not steps:
        where = f" in subcase {without[0]}" if without else ""
        raise InputError(f"{path}: found not both displacements (OUG) and stresses of solids (OES){where}, expected "
                         "both of each subcase, as the deck of `hpcred recover --deck` asks for")  # fmt: skip
    return [list(steps[number].values()) for number in sorted(steps)]


def _described(table, k) -> Entries:
    """Return the Entries behind a description. Raises InputError for those that are not read."""
    words = table.integers(k)
    content = STRESSES if table.name.startswith("OES") else DISPLACEMENTS
    subcase, width = int(words[SUBCASE]), int(words[WIDTH])
    if words[APPROACH] // 10 != STATIC or words[CONTENT] != content or words[FORM] != REAL:
        raise InputError(
            f"{table.path}: found the table {table.name} of the approach {words[APPROACH] // 10}, code "
            f"{words[CONTENT]} and form {words[FORM]}, expected real results of a static analysis by subcase (SOL 101, "
            f"SORT1): approach {STATIC}, code {content}, form {REAL}"
        )
    type_ = int(words[TYPE]) if content == STRESSES else 0
    if content == STRESSES and type_ not in CORNERS:
        raise InputError(f"{table.path}: found stresses of the element type {type_} in the table {table.name}, "
                         "expected solids (CTETRA 39, CHEXA 67, CPENTA 68); ask for STRESS of these only")  # fmt: skip
    if content == STRESSES and words[KIND] not in OF_STRESS:
        raise InputError(f"{table.path}: found the kind {words[KIND]} of the table {table.name}, expected stresses "
                         "(0 or 1), no strains")  # fmt: skip
    expected = HEAD + CORNER * (1 + CORNERS[type_]) if type_ else 8
    entries = Entries(table, k + 1, subcase, type_, 0, expected)
    if width != expected or subcase < 1:
        raise entries.damaged(f"entries of {width} words, expected {expected},")
    count, rest = divmod(table.length(k + 1), expected * table.size)
    if rest:
        raise entries.damaged(f"{table.length(k + 1)} bytes, expected entries of {expected} words,")
    return entries._replace(count=count)


def _step(comm, step):
    """Return nodes (k,), displacements (k, 3), and nodes (c,) and stresses (c, 6) of corners of elements."""
    at, stress = [np.zeros(0, np.int64)], [np.zeros((0, 6))]
    for entries in step:
        with agreed(comm):
            whole, real = entries.words(comm)
            number, head = whole[:, 0] // 10, whole[:, 1:HEAD]
            if (number < 1).any():
                raise entries.damaged(f"the number {number.min()}")
            if entries.type_:
                _require_solids(entries, whole, number, head)
                corners = (-1, 1 + CORNERS[entries.type_], CORNER)
                grid, values = (words[:, HEAD:].reshape(corners)[:, 1:] for words in (whole, real))
                grid, values = grid[..., 0].ravel(), values[..., PLACES].reshape(-1, len(PLACES))
                at.append(grid)
                stress.append(values)
            else:
                kind = whole[:, 1]
                if not np.isin(kind, (GRID, SCALAR)).all():
                    raise entries.damaged(f"points of the kind {kind[~np.isin(kind, (GRID, SCALAR))][0]}")
                grid, values = number[kind == GRID], real[kind == GRID, 2:5]
                label, place = grid, values
            if (grid < 1).any() or not np.isfinite(values).all():
                raise entries.damaged("numbers of grids that are not positive, or values that are not finite,")
        require_once(comm, number, lambda twice, entries=entries: str(
            entries.damaged(f"{'the element' if entries.type_ else 'the point'} {twice} twice")))  # fmt: skip
    return label, place, np.concatenate(at), np.concatenate(stress)


def _require_solids(entries, whole, number, head):
    """Raise InputError for solids with stresses in other axes, at other points, or without their centre first."""
    turned = head[:, 0] != 0
    if turned.any():
        raise InputError(
            f"{entries.table.path}: found stresses of element {number[turned][0]} in the coordinate system "
            f"{head[turned][0, 0]}, expected the basic one (CORDM of PSOLID blank or 0)"
        )
    letters = b"GRID" if entries.table.size == 4 else b"GRID    "
    at_grids = head[:, 1] == int(np.frombuffer(letters, f"{entries.table.order}i{entries.table.size}")[0])
    if not at_grids.all() or (head[:, 2] < CORNERS[entries.type_]).any() or whole[:, HEAD].any():
        raise entries.damaged("elements without stresses at their centre and at their grids (GRID)")
