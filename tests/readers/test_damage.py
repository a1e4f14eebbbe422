"""Copies of files with seeded damage (see fuzz.real_files): refused with a sentence, or as good as the good file."""

import numpy as np
import pytest
import scipy.io
from conftest import DATA
from fuzz.mutations import lines_changed, words_changed
from fuzz.real_files import BINARY, INPUT, calculix, symmetric

from hpcred import InputError
from hpcred.readers.model_source import load_export

pytestmark = pytest.mark.mpi(ranks=(1,))

def state(path, comm):
    """What a model is made of, as arrays."""
    with load_export(path, comm) as model:
        arrays = [array for mat in model.matrices.values() for array in mat.getValuesCSR()]
        for dofs in (model.dofs, model.held):
            arrays += [] if dofs is None else [dofs.node, dofs.direction, dofs.position]
        return arrays


def same(one, other):
    return len(one) == len(other) and all(map(np.array_equal, one, other))


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


@pytest.mark.parametrize("kind", [kind for kind in BINARY if kind not in ("ANSYS .rst", "OP2 beside OP4")])
def test_damaged_words(comm, folder, kind):
    """Whole numbers, sizes, names and tags of binary files, and lines of the texts of CalculiX."""
    path, words = BINARY[kind](folder)
    good, rng, count = path.read_bytes(), np.random.default_rng(3), 150 if kind == "ANSYS .full" else 60
    copies = lines_changed(good, rng, count) if words is None else words_changed(good, words, rng, count)
    assert accepted(path, path, copies, comm) == []


def test_mesh_of_calculix(comm, folder):
    """A node that is lost, a cut in front of the step, and a keyword without a name."""
    path = calculix(folder)
    for text, says in [
        (INPUT.replace("3, 0., 2., 0.\n", ""), "found the node 3 in elements"),
        (INPUT[: INPUT.index("*STEP")], "found 0 .Step and 0 .End Step"),
        (INPUT[: INPUT.index("*END")], "found 1 .Step and 0 .End Step"),
        (INPUT.replace("*BOUNDARY", "*"), "data lines below a line with nothing behind its asterisk"),
    ]:
        path.write_text(text)
        with pytest.raises(InputError, match=says):
            load_export(path, comm)


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
