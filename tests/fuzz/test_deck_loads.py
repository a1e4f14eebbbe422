"""Damaged loads of input files: refused by a sentence, or read as a second, strict reading in plain Python does."""

import re
from collections import Counter

import numpy as np
import pytest
from ansys_files import write_full, write_rst

from hpcred import InputError
from hpcred.parallel.petsc import MPI
from hpcred.readers.abaqus import loads as abaqus
from hpcred.readers.ansys import full_loads
from hpcred.readers.entries import node_and_direction
from hpcred.readers.nastran import loads as nastran

from .mutations import damaged_bytes, damaged_text
from .readings import Nonsense, real, require

SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))]
POINTS = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
NODES = (1, 2, 4, 3, 5, 6, 8, 7)  # of the one hexahedron
INP = "*NODE\n" + "".join(f"{k}, {x}, {y}, {z}\n" for k, (x, y, z) in enumerate(POINTS, 1)) + (
    f"*ELEMENT, TYPE=C3D8, ELSET=EALL\n1, {', '.join(map(str, NODES))}\n*NSET, NSET=ENDS\n1, 8\n*HEADING\nloads\n"
)
STEP = b"""*STEP
*STATIC
*CLOAD
1, 1, 2.5
ENDS, 3, -1.5e1
2, 2, 4
*DLOAD
1, P2, 3.0
EALL, P5, -2.5
EALL, GRAV, 10., 0., 0., -2.
*END STEP
"""
FACES = {"P1": (1, 2, 3, 4), "P2": (5, 6, 7, 8), "P3": (1, 2, 5, 6), "P4": (2, 4, 6, 8), "P5": (3, 4, 7, 8),
         "P6": (1, 3, 5, 7)}  # fmt: skip
BDF = "BEGIN BULK\n" + "".join(f"GRID,{k},,{x}.,{y}.,{z}.\n" for k, (x, y, z) in enumerate(POINTS, 1)) + (
    f"CHEXA,1,1,{','.join(map(str, NODES[:6]))}\n,{NODES[6]},{NODES[7]}\n"
)
CARDS = b"""FORCE,3,1,,2.5,1.,0.,-2.
FORCE,3,8,0,1.5,0.,1.,0.
FORCE,4,2,,9.,1.,0.,0.
PLOAD4,3,1,3.,,,,5,8
GRAV,3,,10.,0.,0.,-1.
"""


def meaning(found):
    """Forces by node and direction, pressures by the corners of faces, and the acceleration."""
    forces, pressures = Counter(), Counter()
    for node, value in found.nodal:
        for k, row in zip(node.tolist(), value, strict=True):
            for direction in np.flatnonzero(row).tolist():
                forces[k, direction] += row[direction]
    for faces, value in found.pressed:
        for corners, pressure in zip(faces.corners.tolist(), value.tolist(), strict=True):
            pressures[tuple(sorted(corners))] += pressure
    return forces, pressures, np.array(found.acceleration)


def second_of_abaqus(text):
    """The same of the step; anything else is Nonsense."""
    forces, pressures, acceleration, keyword = Counter(), Counter(), np.zeros(3), None
    begun, ended = 0, False
    for raw in text.replace(b"\r", b" ").split(b"\n"):
        line = raw.strip()
        if not line or line.startswith((b"**", b"%", b"#")):
            continue
        if line.startswith(b"*"):
            keyword = re.sub(rb"\s", b"", line[1:].lower()).partition(b",")[0]
            begun += keyword == b"step"
            ended = keyword == b"endstep" or (ended and keyword != b"step")
            require(begun != 1 or ended or keyword in (b"step", b"static", b"cload", b"dload"), "another keyword")
            continue
        if begun != 1 or keyword in (b"step", b"static", b"endstep"):
            continue
        words = [word.strip() for word in line.rstrip(b", \t").split(b",")]
        if keyword == b"cload":
            require(len(words) == 3)
            direction, value = real(words[1]), real(words[2])
            require(direction in (1, 2, 3, 4, 5, 6))
            nodes = (1, 8) if words[0].strip(b'"').lower() == b"ends" else (int(words[0]),)
            for node in nodes:
                forces[node, int(direction) - 1] += value
        elif keyword == b"dload":
            require(len(words) >= 3)
            whole = words[0].strip(b'"').lower() in (b"eall", b"")
            require(whole or (words[0].isdigit() and int(words[0]) == 1))
            label = words[1].upper().decode("latin-1")
            if label == "GRAV":
                require(len(words) == 6)
                axis = np.array([real(word) for word in words[3:]])
                require(axis.any())
                acceleration += real(words[2]) * axis / np.linalg.norm(axis)
            else:
                require(len(words) == 3 and re.fullmatch("P0*[1-6]", label) and words[0])
                pressures[tuple(sorted(FACES[f"P{int(label[1:])}"]))] += real(words[2])
    return forces, pressures, acceleration


def same(one, other):
    for a, b in zip(one[:2], other[:2], strict=True):
        if not all(np.isclose(a[key], b[key], rtol=1e-12, atol=1e-300) for key in {*a, *b}):
            return False
    return np.allclose(one[2], other[2], rtol=1e-12)


def test_the_second_reading_reads_the_step():
    forces, pressures, acceleration = second_of_abaqus(STEP)
    assert forces == {(1, 0): 2.5, (1, 2): -15.0, (8, 2): -15.0, (2, 1): 4.0}
    assert pressures == {(5, 6, 7, 8): 3.0, (3, 4, 7, 8): -2.5} and acceleration.tolist() == [0, 0, -10]


@pytest.mark.parametrize("seed", SEEDS)
def test_damaged_steps(tmp_path, seed):
    rng, path, read = np.random.default_rng(seed), tmp_path / "a.inp", 0
    for _ in range(120):
        note, damaged = damaged_text(STEP, rng)
        path.write_bytes(INP.encode() + damaged)
        try:
            found = meaning(abaqus.read_loads(path, 1, MPI.COMM_SELF))
        except InputError:
            continue
        read += 1
        try:
            expected = second_of_abaqus(damaged)
        except (Nonsense, ValueError) as error:
            raise AssertionError(f"{note}: accepted {damaged!r}, though {error!r}") from error
        assert same(found, expected), (note, damaged)
    assert read > 3


def number(word):
    return real(word, True) if word else 0.0


def second_of_nastran(text):
    """The same of the load set 3, of cards with commas on one line."""
    forces, pressures, acceleration = Counter(), Counter(), np.zeros(3)
    for raw in text.split(b"\n"):
        line = re.sub(rb"\$.*", b"", raw).upper().rstrip()
        if not line:
            continue
        words = [word.strip() for word in line.split(b",")]
        require(words[0] in (b"FORCE", b"PLOAD4", b"GRAV"), "another card")
        if words[1] != b"3" and not (words[1].isdigit() and int(words[1]) == 3):
            continue
        words += [b""] * (9 - len(words))
        if words[0] == b"FORCE":
            require(words[3] in (b"", b"0") and not any(words[8:]))
            for k in range(3):
                value = number(words[4]) * number(words[5 + k])
                if value:
                    forces[int(words[2]), k] += value
        elif words[0] == b"GRAV":
            require(words[2] in (b"", b"0"))
            vector = np.array([number(word) for word in words[4:7]])
            acceleration += number(words[3]) * vector
        else:
            require(words[2] == b"1" and not any(words[4:7]) and {words[7], words[8]} in (
                {b"5", b"8"}, {b"6", b"7"}))  # fmt: skip
            pressures[5, 6, 7, 8] += number(words[3])
    return forces, pressures, acceleration


@pytest.mark.parametrize("seed", SEEDS)
def test_damaged_sets_of_nastran(tmp_path, seed):
    """What the second reading understands is read alike; the rest is refused, or more of the format than it knows."""
    rng, path, read = np.random.default_rng(seed), tmp_path / "a.bdf", 0
    for _ in range(120):
        note, damaged = damaged_text(CARDS, rng)
        path.write_bytes(BDF.encode() + damaged + b"\nENDDATA\n")
        try:
            found = meaning(nastran.read_loads(path, 3, MPI.COMM_SELF))
        except InputError:
            continue
        try:
            expected = second_of_nastran(damaged)
        except (Nonsense, ValueError):
            continue
        read += 1
        assert same(found, expected), (note, damaged)
    assert read > 3


def second_of_full(data):
    """Forces by node and direction from 0 of a load vector, and the dofs without one, of a file with dofs x, y, z."""
    words = np.frombuffer(data, "<i4", len(data) // 4)

    def record(at):
        length, flags = int(words[at]), int(words[at + 1]) & 0xFFFFFFFF
        require(length >= 0 and flags in (0, 1 << 31) and words[at + 2 + length] == length)
        part = words[at + 2 : at + 2 + length]
        return (part if flags else part.view("<f8")), at + length + 3

    header, at = record(103)
    require(header[0] == -4 and header[4] == 0 and header[20] == 0 and not header[24] and not header[13])
    kinds, at = record(at)
    nodes, _ = record(at)
    counts, at = record(int(header[35]))
    kind, at = record(at)
    _, at = record(at)
    prescribed, _ = record(at)
    loads, _ = record(int(header[37]))
    require(len(nodes) == header[6] and sum(counts) == len(kind) == len(loads) == header[1] and not prescribed.any())
    forces, without = Counter(), set()
    for node, k, value in zip(np.repeat(nodes, counts).tolist(), kind.tolist(), loads.tolist(), strict=True):
        direction = int(kinds[abs(k) - 1]) - 1
        if k < 0:
            without.add((node, direction))
        elif value:
            forces[node, direction] = value
    return forces, without


@pytest.mark.parametrize("seed", SEEDS)
def test_damaged_load_vectors_of_ansys(tmp_path, seed):
    """Bits, words and lengths of a small file; what is read is what a second reading finds there."""
    rng, path, read = np.random.default_rng(seed), tmp_path / "a.full", 0
    write_full(path, {"K": np.eye(6)}, [(7, 3), (2, 3)], held=[1], item4=0, loads=np.arange(6.0))
    write_rst(tmp_path / "a.rst", np.array([[k, *range(k, k + 3), 0, 0, 0.0] for k in (2, 7)]))
    good = path.read_bytes()
    used = 4 * int(np.frombuffer(good, "<i4")[105 + 18])  # behind it lies K, which is not read
    for _ in range(150):
        note, damaged = damaged_bytes(good[:used], rng)
        path.write_bytes(damaged + good[used:])
        try:
            found = full_loads.read_loads(path, MPI.COMM_SELF)
        except InputError:
            continue
        read += 1
        try:
            forces, without = second_of_full(damaged + good[used:])
        except (Nonsense, ValueError, IndexError) as error:
            raise AssertionError(f"{note}: accepted, though {error!r}") from error
        assert meaning(found)[0] == forces, note
        labels = zip(*(part.tolist() for part in node_and_direction(found.unknown)), strict=True)
        assert set(labels) == without, note
    assert read > 3
