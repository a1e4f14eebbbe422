"""Damaged motions: refused by a sentence, or read as a second reading in plain Python does."""

import csv
import re

import h5py
import numpy as np
import pytest

from hpcred import InputError
from hpcred.parallel.petsc import MPI
from hpcred.readers.motions.source import read_coordinates

from .mutations import damaged_bytes, damaged_text
from .readings import Nonsense, lines_of, real, require

SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
COUNT = 3
RNG = np.random.default_rng(5)


def rows(width, count=5):
    table = np.column_stack([np.arange(count) / 8, RNG.standard_normal((count, width - 1)).round(4)])
    return "".join(",".join(f"{x:.10g}" for x in row) + "\n" for row in table)


OURS = ("t,energy,q1,q2,q3,qdot1,qdot2,qdot3\n" + rows(8)).encode()
FMU = ('"time","q[1]","q[2]","q[3]","der(v[2])","der(v[1])","der(v[3])"\n' + rows(7)).encode()


def second(text):
    """t, q, velocities and accelerations of a table; anything else is Nonsense."""
    head, *lines = lines_of(text.removeprefix(b"\xef\xbb\xbf"))
    require(text.endswith(b"\n"))
    (names,) = csv.reader([head.decode()], skipinitialspace=True)
    names = [name.strip() for name in names]
    require(len(set(names)) == len(names) and names[0].lower() in ("t", "time"))
    table = [[number(word) for word in re.split(rb"[,\s]+", line.strip().removesuffix(b","))] for line in lines
             if line.strip() and line.strip()[:1] not in (b"%", b"#") and line.strip()[:2] != b"**"]  # fmt: skip
    require(table and all(len(row) == len(names) for row in table))
    table = np.array(table)
    require((np.diff(table[:, 0]) > 0).all())
    found = [table[:, 0]]
    for families in (("q%d", "q[%d]"), ("qdot%d", "v[%d]", "der(q[%d])"), ("qddot%d", "der(v[%d])")):
        there = [family for family in families if any(family % k in names for k in range(1, COUNT + 1))]
        found.append(table[:, [names.index(there[0] % k) for k in range(1, COUNT + 1)]] if there else None)
    require(found[1] is not None and all(np.isfinite(part).all() for part in found if part is not None))
    return found


def number(word):
    """Also one that is none, which a column that is left out may have."""
    return float(word) if word.lower().lstrip(b"+-") in (b"inf", b"infinity", b"nan") else real(word)


def read(path):
    return read_coordinates(path, COUNT, "", {}, MPI.COMM_SELF)


def same(found, expected):
    arrays = found.t, found.q, found.velocity, found.acceleration
    return all((a is None) == (b is None) and (a is None or np.array_equal(a, b))
               for a, b in zip(arrays, expected, strict=True))  # fmt: skip


@pytest.mark.parametrize("good", [OURS, FMU], ids=["ours", "fmu"])
def test_the_second_reading_reads_good_tables(tmp_path, good):
    (tmp_path / "m.csv").write_bytes(good)
    assert same(read(tmp_path / "m.csv"), second(good))


@pytest.mark.parametrize("good", [OURS, FMU], ids=["ours", "fmu"])
@pytest.mark.parametrize("seed", SEEDS)
def test_damaged_tables(tmp_path, good, seed):
    rng, path, taken = np.random.default_rng(seed), tmp_path / "m.csv", 0
    for _ in range(150):
        note, damaged = damaged_text(good, rng)
        path.write_bytes(damaged)
        try:
            found = read(path)
        except InputError:
            continue
        taken += 1
        try:
            expected = second(damaged)
        except (Nonsense, ValueError, KeyError) as error:
            raise AssertionError(f"{note}: accepted, though {error!r}") from error
        assert same(found, expected), note
    assert taken > 3


@pytest.mark.parametrize("seed", SEEDS)
def test_damaged_hdf5(tmp_path, seed):
    """Bytes of names, headers and numbers: a sentence, or real numbers of the right shape."""
    with h5py.File(tmp_path / "good.h5", "w") as file:
        file["t"], file["q"], file["qdot"] = np.arange(5.0), np.ones((5, COUNT)), np.ones((5, COUNT))
        file.create_dataset("qddot", data=np.ones((5, COUNT)), chunks=(2, 2), compression="gzip")
    good, rng, path = (tmp_path / "good.h5").read_bytes(), np.random.default_rng(seed), tmp_path / "m.h5"
    for _ in range(6):
        _, damaged = damaged_bytes(good, rng)
        path.write_bytes(damaged)
        try:
            found = read(path)
        except InputError as error:
            assert str(path) in str(error) and len(str(error)) < 500
        else:
            assert found.q.shape[1] == COUNT and np.isfinite(found.q).all()
