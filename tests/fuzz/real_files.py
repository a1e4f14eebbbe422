"""Damage to binary files, and to texts that other programs wrote: cases of convert leave, right is the undamaged model.

What no reader can see is left out: digits of numbers that could stand there (values, coordinates, numbers of rows that
keep the order), and what only pictures need.
"""

import functools
import gzip
import tempfile
from pathlib import Path

import numpy as np
import scipy.io
import scipy.sparse
from ansys_files import write_full, write_rst
from conftest import DATA

from .judge import Case, inside, run_good, write
from .matrices import model_numbers
from .mutations import lines_changed, words_changed

NODES = [(7, 3), (2, 3), (30, 3), (4, 3), (5, 3), (6, 3)]
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


def symmetric(size=18, seed=1):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, size)) * (rng.random((size, size)) < 0.5)
    return np.tril(root, -1) + np.tril(root, -1).T + np.diag(10 + rng.random(size))


def full_of_ansys(folder):
    """A .full file with its .rst, and the words of its header and of the tables of nodes, dofs and supports."""
    position = np.array([[number, *np.random.default_rng(number).random(3), 0, 0, 0] for number, _ in NODES])
    write_full(folder / "a.full", {"K": symmetric(), "M": symmetric(seed=2)}, NODES, held=[3, 4, 5, 9])
    write_rst(folder / "a.rst", position)
    return folder / "a.full", tables_of_full(folder / "a.full")


def tables_of_full(path):
    words = np.frombuffer(path.read_bytes(), "<i4")
    # those of the standard header say nothing of the model, imposed displacements are not read, and the dofs of nodes,
    # which stand behind the header, may be others
    tables = np.arange(103, int(words[105 + 18]))
    return np.setdiff1d(tables, [*np.flatnonzero(words == 0), *range(268, 268 + words[266])])


def real_full(folder):
    """The .full of a rotor with its .rst."""
    for suffix in ("rst", "full"):
        path = folder / f"rotorAnsys.{suffix}"
        path.write_bytes(gzip.decompress((DATA / "ansys" / f"{path.name}.gz").read_bytes()))
    return path, tables_of_full(path)


def rst(folder):
    """The result file beside a .full, and all of its words but coordinates and angles."""
    full_of_ansys(folder)
    words = np.frombuffer((folder / "a.rst").read_bytes(), "<i4")
    first = np.flatnonzero(words == 2 * 7)[0]  # the record of the first node: frame, numbers of two words, frame
    within = (np.arange(len(words)) - first) % (2 * 7 + 3)
    nodes = (np.arange(len(words)) >= first) & (np.arange(len(words)) < first + len(NODES) * (2 * 7 + 3))
    return folder / "a.rst", np.flatnonzero((words != 0) & ~(nodes & (within >= 4) & (within < 16)))


def op2(folder, name):
    """The OP2 beside an OP4, and its words that are whole numbers; in the end the OP4 is converted."""
    path, _ = op4(folder, name)
    words = np.frombuffer(path.with_suffix(".op2").read_bytes(), "<i4")
    return path.with_suffix(".op2"), np.flatnonzero((words != 0) & (np.abs(words.astype(np.int64)) < 10**6))


def op4(folder, name):
    """An OP4 with the OP2 beside it that knows its rows, and the words that are whole numbers."""
    source = DATA / "nastran" / name
    for file in source.parent.iterdir():
        packed = file.suffix == ".gz"
        target = folder / (file.stem if packed else file.name)
        target.write_bytes(gzip.decompress(file.read_bytes()) if packed else file.read_bytes())
    path = folder / source.name
    words = np.frombuffer(path.read_bytes()[: path.stat().st_size // 4 * 4], "<i4")
    return path, np.flatnonzero((words != 0) & (np.abs(words.astype(np.int64)) < 10**6))


def matlab(folder, form, packed=False):
    """A .mat file, and the words of sizes, names and tags."""
    K, M = (scipy.sparse.csc_matrix(symmetric(seed=seed)) for seed in (1, 2))
    path = folder / "a.mat"
    scipy.io.savemat(path, {"K": K, "M": M}, format=form, do_compression=packed)
    good = path.read_bytes()
    words = np.frombuffer(good[: len(good) // 4 * 4], "<i4").astype(np.int64)
    stay = np.arange(len(words)) >= (0 if form == "4" else 31)  # text of the header
    if not packed:
        stay &= (np.abs(words) > 18) & (np.abs(words) < 10**4)
        for start in range(len(words) if form == "5" else 0):  # where columns begin may be another place
            if any(np.array_equal(words[start : start + 19], item.indptr) for item in (K, M)):
                stay[start : start + 19] = False
    return path, np.flatnonzero(stay)


def calculix(folder):
    """The four files of a set of nine rows; returns the input file."""
    full = np.ones((9, 9)) + np.diag(np.arange(1.0, 10.0))
    (folder / "a.inp").write_text(INPUT)
    (folder / "a.dof").write_text("".join(f"{n}.{d}\n" for n in (1, 2, 3) for d in (1, 2, 3)))
    for name, mat in (("sti", full), ("mas", 2 * full)):
        lines = (f"{i + 1} {j + 1} {mat[i, j]:20.13e}\n" for j in range(9) for i in range(j + 1))
        (folder / f"a.{name}").write_text("".join(lines))
    return folder / "a.inp"


def _calculix(folder, suffix):
    return calculix(folder).with_suffix(f".{suffix}"), None


BINARY = {
    "ANSYS .full": full_of_ansys,
    "OP4 of EXTSEOUT": functools.partial(op4, name="extseout/nas2cam.op4"),
    "OP4 and OP2": functools.partial(op4, name="notall6/nas2cam_notall6_msc2017.op4"),
    "ANSYS .rst": rst, "ANSYS .full, real": real_full,
    "OP2 beside OP4": functools.partial(op2, name="notall6/nas2cam_notall6_msc2017.op4"),
    "MATLAB 4": functools.partial(matlab, form="4"), "MATLAB 5": functools.partial(matlab, form="5"),
    "MATLAB 5 packed": functools.partial(matlab, form="5", packed=True),
    "CalculiX .sti, lines": functools.partial(_calculix, suffix="sti"),
    "CalculiX .dof, lines": functools.partial(_calculix, suffix="dof"),
}  # fmt: skip


@functools.cache
def good(kind):
    """Files by name, the damaged one, the words to damage, and the numbers of the good model."""
    with tempfile.TemporaryDirectory() as name, inside(name):
        path, words = BINARY[kind](Path(name))
        files = {item.name: item.read_bytes() for item in Path(name).iterdir()}
    with tempfile.TemporaryDirectory() as name, inside(name):
        write(Case("", files, [], None, model_numbers), Path(name))
        run_good(command_of(path.name))
        return files, path.name, words, model_numbers(Path(name))


def case(rng, kind):
    files, name, words, expected = good(kind)
    changes = lines_changed(files[name], rng, 50) if words is None else words_changed(files[name], words, rng, 50)
    note, changed = next((note, text) for note, text in changes if text != files[name])
    return Case(f"{name}: {note}", {**files, name: changed}, command_of(name), expected, model_numbers)


def command_of(name):
    """The conversion of a file, or of the matrices beside it."""
    return ["convert", name.replace(".rst", ".full").replace(".op2", ".op4"), "m.h5"]


KINDS = dict.fromkeys(BINARY, case)
