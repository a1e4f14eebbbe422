"""Copies of files with seeded damage: each is refused with a sentence, or gives what the good file gives.

What no reader can see is left out: digits of numbers that could stand there (values, coordinates, numbers of rows that
keep the order), and what only pictures need.
"""

import gzip
import re

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from ansys_files import write_full, write_rst
from conftest import DATA

from hpcred import InputError
from hpcred.formats.model_source import load_export

pytestmark = pytest.mark.mpi(ranks=(1,))

NODES = [(7, 3), (2, 3), (30, 3), (4, 3), (5, 3), (6, 3)]
FLOAT = re.compile(rb"[-+]?\d*\.\d*(?:[EeDd][-+]?\d+)?,?")


def symmetric(size=18, seed=1):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, size)) * (rng.random((size, size)) < 0.5)
    return np.tril(root, -1) + np.tril(root, -1).T + np.diag(10 + rng.random(size))


def state(path, comm):
    """What a model is made of, as arrays."""
    with load_export(path, comm) as model:
        arrays = [array for mat in model.matrices.values() for array in mat.getValuesCSR()]
        for dofs in (model.dofs, model.held):
            arrays += [] if dofs is None else [dofs.node, dofs.direction, dofs.position]
        return arrays


def same(one, other):
    return len(one) == len(other) and all(map(np.array_equal, one, other))


def words_changed(good, words, rng, count):
    """Copies with a bit of one of the words flipped, a word left out, or the end cut off."""
    for _ in range(count):
        word = int(rng.choice(words))
        kind = rng.choice(["bit", "bit", "bit", "drop", "cut"])
        copy = bytearray(good)
        if kind == "bit":
            copy[4 * word + int(rng.integers(4))] ^= 1 << int(rng.integers(8))
        elif kind == "drop":
            del copy[4 * word : 4 * word + 4]
        else:
            del copy[4 * word + int(rng.integers(4)) :]
        yield f"{kind} at word {word}", bytes(copy)


def lines_changed(good, rng, count):
    """Copies with a character outside of values changed or left out, lines lost, doubled or exchanged, the end cut."""
    lines = good.splitlines(keepends=True)
    for _ in range(count):
        k, other = (int(number) for number in rng.integers(len(lines), size=2))
        kind = rng.choice(["change", "change", "leave out", "lose", "double", "exchange", "cut"])
        copy = list(lines)
        words = [m.span() for m in re.finditer(rb"\S+", lines[k]) if not FLOAT.fullmatch(m.group())]
        if kind in ("change", "leave out"):
            if not words:
                continue
            at = int(rng.integers(*words[int(rng.integers(len(words)))]))
            new = bytes([lines[k][at] ^ 1 << int(rng.integers(7))]) if kind == "change" else b""
            copy[k] = lines[k][:at] + new + lines[k][at + 1 :]
        elif kind == "lose":
            del copy[k]
        elif kind == "double":
            copy.insert(k, lines[k])
        elif kind == "exchange":
            copy[k], copy[other] = lines[other], lines[k]
        else:
            copy[k:] = [lines[k][: int(rng.integers(len(lines[k])))]]
        yield f"{kind} at line {k + 1}", b"".join(copy)


def accepted(main, path, copies, comm):
    """The names of the copies of `path` with which the model of `main` is another one."""
    good, expected = path.read_bytes(), state(main, comm)
    wrong, refused = [], 0
    for name, content in copies:
        if content == good:
            continue
        path.write_bytes(content)
        try:
            if not same(state(main, comm), expected):
                wrong.append(name)
        except InputError as error:
            refused += "\n" not in str(error)
    path.write_bytes(good)
    assert refused > 20
    return wrong


def test_full_file_of_ansys(comm, folder):
    """The header and the tables of nodes, dofs and supports; node 2 is held as a whole."""
    position = np.array([[number, *np.random.default_rng(number).random(3), 0, 0, 0] for number, _ in NODES])
    write_full(folder / "a.full", {"K": symmetric(), "M": symmetric(seed=2)}, NODES, held=[3, 4, 5, 9])
    write_rst(folder / "a.rst", position)
    good = (folder / "a.full").read_bytes()
    words = np.frombuffer(good, "<i4")
    # those of the standard header say nothing of the model, and imposed displacements are not read
    tables = np.arange(103, int(words[105 + 18]))
    imposed = np.flatnonzero(np.frombuffer(good, "<i4") == 0)
    copies = words_changed(good, np.setdiff1d(tables, imposed), np.random.default_rng(3), 150)
    assert accepted(folder / "a.full", folder / "a.full", copies, comm) == []


@pytest.mark.parametrize("name", ["extseout/nas2cam.op4", "notall6/nas2cam_notall6_msc2017.op4"])
def test_op4(comm, folder, name):
    """Whole numbers of the file, in a model that knows its rows by an OP2."""
    source = DATA / "nastran" / name
    for file in source.parent.iterdir():
        packed = file.suffix == ".gz"
        target = folder / (file.stem if packed else file.name)
        target.write_bytes(gzip.decompress(file.read_bytes()) if packed else file.read_bytes())
    path = folder / source.name
    words = np.frombuffer(path.read_bytes()[: path.stat().st_size // 4 * 4], "<i4")
    whole = np.flatnonzero((words != 0) & (np.abs(words.astype(np.int64)) < 10**6))
    copies = words_changed(path.read_bytes(), whole, np.random.default_rng(4), 60)
    assert accepted(path, path, copies, comm) == []


INPUT = """*NODE, NSET=Nall
1, 0., 0., 0.
2, 1., 0., 0.
3, 0., 2., 0.
4, 0., 0., 3.
*ELEMENT, TYPE=C3D4, ELSET=E
1, 1, 2, 3, 4
*BOUNDARY
4, 1, 3
*STEP
*FREQUENCY, SOLVER=MATRIXSTORAGE
2
*END STEP
"""


def triangle(matrix):
    return "".join(f"{i + 1} {j + 1} {matrix[i, j]:20.13e}\n" for j in range(9) for i in range(j + 1))


@pytest.mark.parametrize("suffix", ["dof", "sti", "mas"])
def test_calculix(comm, folder, suffix):
    full = np.ones((9, 9)) + np.diag(np.arange(1.0, 10.0))
    (folder / "a.inp").write_text(INPUT)
    (folder / "a.dof").write_text("".join(f"{n}.{d}\n" for n in (1, 2, 3) for d in (1, 2, 3)))
    for name, mat in (("sti", full), ("mas", 2 * full)):
        (folder / f"a.{name}").write_text(triangle(mat))
    path = folder / f"a.{suffix}"
    copies = lines_changed(path.read_bytes(), np.random.default_rng(5), 60)
    assert accepted(folder / "a.inp", path, copies, comm) == []


def test_mesh_of_calculix(comm, folder):
    """A node that is lost, a cut in front of the step, and a keyword without a name."""
    test_calculix(comm, folder, "dof")
    for text, says in [
        (INPUT.replace("3, 0., 2., 0.\n", ""), "found the node 3 in elements"),
        (INPUT[: INPUT.index("*STEP")], "found 0 .Step and 0 .End Step"),
        (INPUT[: INPUT.index("*END")], "found 1 .Step and 0 .End Step"),
        (INPUT.replace("*BOUNDARY", "*"), "nothing behind its asterisk"),
    ]:
        (folder / "a.inp").write_text(text)
        with pytest.raises(InputError, match=says):
            load_export(folder / "a.inp", comm)


@pytest.mark.parametrize("form, packed", [("4", False), ("5", False), ("5", True)])
def test_matlab(comm, folder, form, packed):
    """Sizes, names and tags; one triangle's numbers alone make K unsymmetric, which is seen later."""
    K, M = (scipy.sparse.csc_matrix(symmetric(seed=seed)) for seed in (1, 2))
    path = folder / "a.mat"
    scipy.io.savemat(path, {"K": K, "M": M}, format=form, do_compression=packed)
    good = path.read_bytes()
    words = np.frombuffer(good[: len(good) // 4 * 4], "<i4")
    stay = np.arange(len(words)) >= (0 if form == "4" else 31)  # text of the header
    if not packed:
        stay &= (np.abs(words.astype(np.int64)) > 18) & (np.abs(words.astype(np.int64)) < 10**4)
    copies = words_changed(good, np.flatnonzero(stay), np.random.default_rng(6), 60)
    assert accepted(path, path, copies, comm) == []


def test_names_in_matlab_files(comm, folder):
    path = folder / "a.mat"
    scipy.io.savemat(path, {"K": symmetric(), "M": np.eye(18), "dofs": np.ones((18, 2))})
    path.write_bytes(path.read_bytes().replace(b"dofs", b"dof\x08"))
    with pytest.raises(InputError, match="the name 'dof.x08'"):
        load_export(path, comm)


@pytest.mark.parametrize("place", [9, 18, 34])
def test_entries_of_dmig_given_twice(comm, folder, place):
    for file in (DATA / "nastran" / "test_1").iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    path = folder / "test_case.pch1"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:place], lines[place - 1], *lines[place:]]))
    with pytest.raises(InputError, match="of the matrix KAAX more than once"):
        load_export(path, comm)
