"""Read what CalculiX prints into a .dat file (*NODE PRINT with U, *EL PRINT with S), stresses taken to the nodes.

The elements are those of the input file of the same name beside it. Stresses of integration points are extrapolated to
the nodes of the element (model.shape_functions). Each rank reads a share.
"""

import re
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...fe.materials import NUMBER
from ...fe.point_stresses import MOST_POINTS, PointStresses
from ...fe.shape_functions import SOLIDS, extrapolation
from ...files.system_errors import damaged_file, mapped
from ...files.text import Piece, end_to_end, pieces
from ...files.text_numbers import labels, numbers, whole
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ..abaqus import input_file
from ..entries import joined
from .means import means_at_nodes

TITLE = re.compile(rb"(?m)^[ \t]*(\S.*?)[ \t]+for set .*? and time[ \t]+(\S+)[ \t]*\r?$")
STRESSES = b"stresses (elem, integ.pnt.,sxx,syy,szz,sxy,sxz,syz)"
IN_ORDER = [2, 3, 4, 5, 7, 6]  # columns of xx, yy, zz, xy, yz, zx
MOVED = b"displacements (vx,vy,vz)"
KINDS = (STRESSES, MOVED)
ASKED = "print U of all nodes and S (GLOBAL=YES) of all elements, and nothing else"
SET = b" for set "


class Block(NamedTuple):
    """A table of a set of nodes or elements at a time, in the bytes start..stop."""

    title: bytes
    time: bytes
    start: int
    stop: int


def begins(start: bytes) -> bool:
    """Test whether a file that starts so has such tables."""
    return start.lstrip().startswith(KINDS)


def read(path, comm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes (s,), displacements (steps, s, 3) and mean stresses (steps, s, 6) of this rank.

    Collective. Raises InputError.
    """
    steps = decided(comm, _steps, path)
    deck = Path(path).with_suffix(".inp")
    with agreed(comm):
        if not deck.is_file():
            raise InputError(f"{path}: found no input file {deck.name} beside it, expected that of the run, whose "
                             "elements have these stresses")  # fmt: skip
    mesh = input_file.read(deck, comm, calculix=True, steps=False)
    return means_at_nodes(path, comm, (_step(path, comm, blocks, mesh, deck.name) for blocks in steps))


def _steps(path) -> list[list[Block]]:
    """Return the tables of each time. Raises InputError."""
    heads = []
    with mapped(path) as data:
        if data[-1:] != b"\n":
            raise damaged_file(path, "no line break at its end", "cut off")
        at = 0
        while (at := data.find(SET, at)) >= 0:
            start, stop = data.rfind(b"\n", 0, at) + 1, data.find(b"\n", at) + 1
            line, at = data[start:stop], stop
            title = TITLE.fullmatch(line.rstrip(b"\n"))
            if title is None or title[1] not in KINDS:
                raise InputError(f"{path}: found '{line.decode('latin-1').strip()[:70]}', expected displacements and "
                                 f"stresses in global directions; {ASKED}")  # fmt: skip
            heads.append((title[1], title[2], start, stop))
        ends = [*(start for _, _, start, _ in heads[1:]), len(data)]
    blocks = [Block(title, time, stop, end) for (title, time, _, stop), end in zip(heads, ends, strict=True)]
    steps = [list(group) for _, group in groupby(blocks, lambda block: block.time)]
    for number, step in enumerate(steps, 1):
        if {block.title for block in step} != set(KINDS):
            raise InputError(f"{path}: found {'displacements' if step[0].title == MOVED else 'stresses'} only in step "
                             f"{number}, expected displacements and stresses; {ASKED}")  # fmt: skip
    if len({step[0].time for step in steps}) < len(steps):
        raise InputError(f"{path}: found tables of the same time apart from each other, expected one time a step")
    return steps


def _step(path, comm, blocks, mesh, name):
    """Return nodes (k,), displacements (k, 3), and nodes (c,) and stresses (c, 6) of single elements."""
    with agreed(comm):
        tables = {MOVED: [], STRESSES: []}
        for block in blocks:
            decode = _moved if block.title == MOVED else stresses_of
            tables[block.title].append(end_to_end(pieces(path, comm, block.start, block.stop), decode))
    label, place = (np.concatenate(column) for column in zip(*tables[MOVED], strict=True))
    columns = (np.concatenate(column) for column in zip(*tables[STRESSES], strict=True))
    stresses = PointStresses(comm, *columns, path, name)
    at, stress = [np.zeros(0, np.int64)], [np.zeros((0, 6))]
    for kind in SOLIDS:
        if kind not in mesh.elements:
            continue
        for scheme, mine, sigma in stresses.of_elements(kind, mesh.properties.table[kind][:, NUMBER]):
            at.append(mesh.elements[kind][mine].ravel())
            stress.append(np.einsum("kg,egc->ekc", extrapolation(kind, scheme), sigma).reshape(-1, 6))
    stresses.require_all()
    return label, place, np.concatenate(at), np.concatenate(stress)


def _moved(piece):
    """Return nodes and displacements."""
    table, lines = numbers(piece, 4, commas=False)
    piece.require(np.isfinite(table).all(axis=1), lines, "a node and three finite displacements")
    return labels(piece, table[:, 0], lines), table[:, 1:]


def read_points(path, comm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return numbers of elements (r,) and of points (r,) from 1, and stresses (r, 6) xx, yy, zz, xy, yz, zx of this
    rank, in the unit of the file. Collective. Raises InputError for other contents than stresses of one time."""
    with agreed(comm):
        tables, times = [], set()
        for piece in pieces(path, comm):
            for title, time in TITLE.findall(piece.text):
                if title.strip() != STRESSES:
                    raise InputError(
                        f"{path}: found '{title.decode(errors='replace')[:60]}', expected stresses in global "
                        "directions only; print nothing but S by *EL PRINT"
                    )
                times.add(time)
            tables.append(stresses_of(Piece(path, TITLE.sub(b"", piece.text), piece.start)))
        element, point, stress = joined(tables, (np.int64, np.int64, float))
    stress = stress.reshape(-1, 6)
    instants = sorted(set().union(*comm.allgather(times)))
    if len(instants) != 1:
        listed = ", ".join(time.decode(errors="replace") for time in instants) or "none"
        raise InputError(f"{path}: found stresses of the times {listed}, expected those of one")
    return element, point, stress


def stresses_of(piece: Piece) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return numbers of elements (r,) and of points (r,), and stresses (r, 6), of the lines of a piece."""
    table, lines = numbers(piece, 8, commas=False)
    piece.require(np.isfinite(table).all(axis=1), lines, "an element, a point and six finite stresses")
    element = labels(piece, table[:, 0], lines, "the number of an element")
    point = whole(piece, table[:, 1], lines, "the number of an integration point", 1, MOST_POINTS - 1)
    return element, point, table[:, IN_ORDER]
