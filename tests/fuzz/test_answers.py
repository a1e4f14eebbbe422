"""Damaged results of programs: refused by a sentence, or read as a second reading in plain Python does."""

import struct
from collections import defaultdict

import numpy as np
import pytest
from calculix_prints import DECK, linear_field, printed
from op2_files import displaced, op2, stressed

from hpcred import InputError
from hpcred.parallel.petsc import MPI
from hpcred.readers.stresses.source import read_answers

from .mutations import damaged_bytes, damaged_text
from .readings import Nonsense, lines_of, real, require, whole

SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))]
HALF = 3**0.5
TITLES = {b"stresses (elem, integ.pnt.,sxx,syy,szz,sxy,sxz,syz)": 8, b"displacements (vx,vy,vz)": 4}
NODES = {7: range(1, 9), 3: range(5, 13)}


def second_of_dat(text):
    """Displacements by node and mean stresses by node, of each time; anything else is Nonsense."""
    times, kind, moved, points = [], None, {}, {}
    require(text.endswith(b"\n"))
    for line in lines_of(text):
        if b" for set " in line:
            title, _, rest = line.strip().partition(b" for set ")
            kind = TITLES[title.strip()]
            time = rest.rpartition(b"time")[2].strip()
            if not times or times[-1][0] != time:
                moved, points = {}, {}
                times.append((time, moved, points))
            continue
        words = line.split()
        require(kind == len(words))
        if kind == 4:
            require(whole(words[0]) not in moved)
            moved[whole(words[0])] = [real(word) for word in words[1:]]
        else:
            key = whole(words[0]), whole(words[1])
            require(key not in points)
            xx, yy, zz, xy, zx, yz = (real(word) for word in words[2:])
            points[key] = np.array([xx, yy, zz, xy, yz, zx])
    found = []
    for _, moved, points in times:
        require(set(points) == {(element, k) for element in NODES for k in range(1, 9)} and moved)
        corners = defaultdict(list)
        for element, nodes in NODES.items():
            for k, node in enumerate(nodes):
                x, y, z = (int(k % 4 in (1, 2)), int(k % 4 > 1), k // 4)
                total = 0
                for g in range(8):
                    factor = 1.0
                    for mine, other in ((x, g & 1), (y, g >> 1 & 1), (z, g >> 2)):
                        factor *= (1 + HALF if mine == other else 1 - HALF) / 2
                    total = total + factor * points[element, g + 1]
                corners[node].append(total)
        found.append((moved, {node: np.mean(values, axis=0) for node, values in corners.items()}))
    return found


def second_of_op2(data):
    """The same of a file of OUTPUT2 with words of four bytes, little-endian."""
    at, keys = 0, []

    def record():
        nonlocal at
        (length,) = struct.unpack_from("<i", data, at)
        require(0 <= length <= len(data) - at - 8 and struct.unpack_from("<i", data, at + 4 + length)[0] == length)
        at += length + 8
        return data[at - length - 4 : at - 4]

    def key():
        (found,) = struct.unpack("<i", record())
        keys.append(found)
        return found

    tables = []
    while at < len(data):
        words = key()
        if words in (0, 3):
            if words:
                for _ in range(7):
                    record()
            continue
        name = record().decode("latin-1").strip()
        require(words == 2 and key() < 0 and key() == 7)
        record()
        require(key() < 0)
        records = []
        while True:
            require(key() == 1 and key() == 0)
            length = key()
            if length == 0:
                break
            content = b""
            while length > 0:
                part = record()
                require(len(part) == 4 * length)
                content, length = content + part, key()
            records.append(content)
        tables.append((name, records[1:]))
    moved, stresses = defaultdict(dict), defaultdict(lambda: defaultdict(list))
    for name, records in tables:
        for about, content in zip(records[::2], records[1::2], strict=True):
            words = struct.unpack("<146i", about)
            subcase = words[3]
            require(words[0] // 10 == 1 and words[8] == 1)
            if name.startswith("OES"):
                require(words[1] == 5 and words[2] == 67 and words[9] == 193 and words[10] in (0, 1))
                for row in (content[k : k + 772] for k in range(0, len(content), 772)):
                    head = struct.unpack("<ii4si", row[:16])
                    require(head[1:3] == (0, b"GRID") and head[0] > 9)
                    for k in range(1, 9):
                        corner = row[16 + 84 * k : 100 + 84 * k]
                        s = struct.unpack("<20f", corner[4:])
                        node = struct.unpack("<i", corner[:4])[0]
                        stresses[subcase][node].append([s[k] for k in (0, 8, 14, 1, 9, 15)])
            elif name.startswith("OUG"):
                require(words[1] == 1 and words[9] == 8)
                for row in (content[k : k + 32] for k in range(0, len(content), 32)):
                    grid, point, *u = struct.unpack("<ii6f", row)
                    if point == 1:
                        moved[subcase][grid // 10] = u[:3]
    return [(moved[k], {node: np.mean(values, axis=0) for node, values in stresses[k].items()}) for k in sorted(moved)]


def same(found, expected):
    """Whether answers are those of a second reading."""
    for k, (moved, stress) in enumerate(expected):
        if found.node.tolist() != sorted(stress):
            return False
        for i, node in enumerate(found.node.tolist()):
            scale = np.abs(stress[node]).max()
            if not np.allclose(found.displacement[k, i], moved[node], rtol=1e-12, atol=0):
                return False
            if not np.allclose(found.stress[k, i], stress[node], rtol=1e-9, atol=1e-12 * scale):
                return False
    return len(expected) == len(found.stress)


DAT = "".join(printed(linear_field(seed), seed) for seed in (1, 2)).encode()
MOVED = {grid: np.arange(3.0) + grid for grid in range(1, 13)}
ELEMENTS = {7: {grid: np.arange(6.0) - grid for grid in NODES[7]},
            9: {grid: np.arange(6.0) + grid for grid in NODES[3]}}  # fmt: skip
OP2 = op2([("OUGV1", displaced(1, MOVED) + displaced(2, MOVED)),
           ("OES1X1", stressed(1, ELEMENTS) + stressed(2, ELEMENTS))])  # fmt: skip


FORMATS = {"dat": (DAT, damaged_text, second_of_dat), "op2": (OP2, damaged_bytes, second_of_op2)}


@pytest.mark.parametrize("kind", FORMATS)
def test_the_second_readings_read_good_files(tmp_path, kind):
    good, _, second = FORMATS[kind]
    (tmp_path / "job.inp").write_text(DECK)
    (tmp_path / f"job.{kind}").write_bytes(good)
    assert same(read_answers(tmp_path / f"job.{kind}", MPI.COMM_SELF), second(good))


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("seed", SEEDS)
def test_damaged_answers(tmp_path, kind, seed):
    good, damage, second = FORMATS[kind]
    rng, path, read = np.random.default_rng(seed), tmp_path / f"job.{kind}", 0
    (tmp_path / "job.inp").write_text(DECK)
    for _ in range(100):
        note, damaged = damage(good, rng)
        path.write_bytes(damaged)
        try:
            found = read_answers(path, MPI.COMM_SELF)
        except InputError:
            continue
        read += 1
        try:
            expected = second(damaged)
        except (Nonsense, ValueError, KeyError, struct.error) as error:
            raise AssertionError(f"{note}: accepted, though {error!r}") from error
        assert same(found, expected), note
    assert read > 3
