"""Elements keep their nodes that are held: those of the readers have the forces of K at all nodes."""

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from foreign import gathered, write
from solid_meshes import mass, mesh, stiffness

from hpcred.fe.element_rules import B_BAR, FULL
from hpcred.fe.solids import Solids
from hpcred.readers.model_source import load_export, load_source
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi

HELD = [1, 2, 3, 4]  # nodes at x = 0
POINTS, CELLS = mesh("hexahedron", (3, 1, 1), (3.0, 1.0, 1.0))
NODE, DIRECTION = np.repeat(np.arange(1, len(POINTS) + 1), 3), np.tile([1, 2, 3], len(POINTS))
FREE = np.flatnonzero(~np.isin(NODE, HELD))
M = mass("hexahedron", POINTS, CELLS, 7850.0).toarray()


def matrices(rule):
    return {"K": stiffness("hexahedron", rule, POINTS, CELLS, 2e11, 0.3).toarray(), "M": M}


def deck(comm, path, boundary="CLAMP, 1, 3", end=""):
    """An input file of the mesh with its material and its supports."""
    nodes = "".join(f"{k}, {x!r}, {y!r}, {z!r}\n" for k, (x, y, z) in enumerate(POINTS.tolist(), 1))
    cells = "".join(f"{k}, {', '.join(map(str, row))}\n" for k, row in enumerate((CELLS + 1).tolist(), 1))
    write(path, (
        f"*Node\n{nodes}*Element, type=C3D8, elset=ALL\n{cells}*Nset, nset=CLAMP\n{', '.join(map(str, HELD))}\n"
        f"*Boundary\n{boundary}\n*Material, name=STEEL\n*Elastic\n2e11, 0.3\n*Density\n7850.\n"
        f"*Solid Section, elset=ALL, material=STEEL\n{end}"
    ), comm)  # fmt: skip


def lines_of(matrix, row, column=None):
    """Lines of the upper triangle, by columns, also of zeros: names of the row and of the column, value."""
    j, i = np.tril_indices(len(matrix))
    return "".join(f"{row(a)}{(column or row)(b)}{matrix[a, b]: .13e}\n" for a, b in zip(i, j, strict=True))


def check(comm, model, held=HELD, told=()):
    with model:
        assert comm.allreduce(len(model.elements["hexahedron"])) == len(CELLS)
        found = [] if model.held is None else np.unique(np.concatenate(comm.allgather(model.held.node))).tolist()
        assert found == held and np.array_equal(gathered(comm, model.dofs.node)[0], NODE[FREE])
        warnings = Solids(model).warnings()
        assert len(warnings) == len(told) and all(map(str.startswith, warnings, told))


def test_supports_of_abaqus(comm, folder):
    """1e36 on the diagonal of K."""
    deck(comm, folder / "a.inp")
    for key, suffix in (("K", "STIF1"), ("M", "MASS1")):
        matrix = matrices(B_BAR)[key].copy()
        stuck = np.flatnonzero(np.isin(NODE, HELD))
        if key == "K":
            matrix[stuck, stuck] = 1e36
        write(folder / f"a_{suffix}.mtx", lines_of(matrix, lambda a: f"{NODE[a]}, {DIRECTION[a]}, "), comm)
    check(comm, load_export(folder / "a.inp", comm))


def test_supports_of_calculix(comm, folder):
    """*Boundary of the input file."""
    deck(comm, folder / "a.inp", end="*Step\n*Frequency, solver=matrixstorage\n1\n*End Step\n")
    for key, suffix in (("K", "sti"), ("M", "mas")):
        text = lines_of(matrices(FULL)[key][np.ix_(FREE, FREE)], lambda a: f"{a + 1} ", lambda b: f"{b + 1} ")
        write(folder / f"a.{suffix}", text, comm)
    write(folder / "a.dof", "".join(f"{NODE[row]}.{DIRECTION[row]}\n" for row in FREE), comm)
    check(comm, load_export(folder / "a.sti", comm))


@pytest.mark.parametrize("boundary", ["CLAMP, 1, 3", "CLAMP, ENCASTRE"])
def test_an_input_file_beside_a_list_of_rows(comm, folder, boundary):
    """*Boundary where it is a list of directions; what then lacks elements is said."""
    deck(comm, folder / "mesh.inp", boundary)
    for key in "KM":
        part = scipy.sparse.coo_array(matrices(B_BAR)[key][np.ix_(FREE, FREE)])
        if comm.rank == 0:
            scipy.io.mmwrite(folder / f"{key}.mtx", part, symmetry="general")
    write(folder / "dofs.txt", "".join(f"{NODE[row]} {DIRECTION[row]}\n" for row in FREE), comm)
    source = Source(*(str(folder / f"{key}.mtx") for key in "KM"), nodes=str(folder / "mesh.inp"),
                    dofs=str(folder / "dofs.txt"))  # fmt: skip
    model = load_source(source, comm)
    named = boundary.endswith("ENCASTRE")
    assert any("nodes without rows are not taken as held" in text for text in model.remarks) == named
    told = ("stress: elements at 4 nodes that have no row", "stress: the forces of the solid elements of") * named
    check(comm, model, [] if named else HELD, told)
