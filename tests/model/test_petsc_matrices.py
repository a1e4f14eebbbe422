"""Models from matrices that were assembled in PETSc: what is kept, what is copied, what is refused."""

import numpy as np
import pytest
import scipy.linalg
from helpers import few_on_ranks, to_dense

import hpcred
from hpcred import InputError, SecondOrderModel
from hpcred.parallel.petsc import PETSc, is_complex

pytestmark = pytest.mark.mpi


def assemble(comm, array, block=1, kind="aij"):
    """A PETSc matrix, as a library assembles it, from an array that all ranks have; rows in uneven shares."""
    size = len(array)
    rows = {1: [size], 2: [size // 2 + 3, size - size // 2 - 3], 3: [size // 2, 0, size - size // 2]}[comm.size]
    rows = rows[comm.rank]
    square = array.shape == (size, size)
    mat = PETSc.Mat().create(comm=comm)
    mat.setSizes(((rows, size), (rows if square else None, array.shape[1])))
    mat.setType(kind)
    if square and size % block == 0:
        mat.setBlockSize(block)
    mat.setUp()
    mat.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    if kind == "sbaij":
        mat.setOption(PETSc.Mat.Option.IGNORE_LOWER_TRIANGULAR, True)
    first, last = mat.getOwnershipRange()
    for row in range(first, last):
        columns = np.flatnonzero(array[row]).astype(PETSc.IntType)
        mat.setValues(row, columns, array[row, columns])
    mat.assemble()
    return mat


@pytest.fixture
def arrays(solid):
    return {"K": to_dense(solid.K), "M": to_dense(solid.M)}


@pytest.fixture
def taken(comm, arrays):
    """A function that gives a model of the arrays, and destroys the matrices that it was made of."""
    made = []

    def take(change=None, block=3, kind="aij", **keywords):
        mats = {key: assemble(comm, mat, block, kind) for key, mat in (arrays | (change or {})).items()}
        try:
            made.append(SecondOrderModel.from_petsc(**mats, **keywords))
        finally:
            for mat in mats.values():
                mat.destroy()
        return made[-1]

    yield take
    for model in made:
        model.close()


@pytest.fixture
def nodes(comm, solid, arrays):
    """Places of the nodes of this rank; `solid` spreads its rows otherwise."""
    mat = assemble(comm, arrays["K"], 3)
    first, last = mat.getOwnershipRange()
    mat.destroy()
    return np.concatenate(comm.allgather(solid.dofs.position))[first:last:3]


def lowest(K, M, count):
    return np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)[:count]) / (2 * np.pi)


def test_matrices_of_one_pattern_are_not_copied(comm, arrays):
    K, M = (assemble(comm, arrays["K"], 3) for _ in "KM")
    with SecondOrderModel.from_petsc(K, M) as model:
        assert model.K.handle == K.handle and model.M.handle == M.handle
        K.destroy()
        M.destroy()
        assert np.array_equal(to_dense(model.K), arrays["K"])  # references are enough to live on


def test_numbers_and_places_of_nodes_follow_the_rows(comm, solid, nodes, taken):
    """Also where ranks have other shares than hpcred would give them, or nothing."""
    model = taken(nodes=nodes)
    assert model.local_rows == 3 * len(nodes)
    everywhere = [np.concatenate(comm.allgather(part)) for part in (model.dofs.node, model.dofs.direction)]
    assert np.array_equal(everywhere[0], np.arange(model.size) // 3 + 1)
    assert np.array_equal(everywhere[1], np.arange(model.size) % 3)
    place = [np.concatenate(comm.allgather(each.dofs.position)) for each in (model, solid)]
    assert np.array_equal(*place)
    numbers = 1000 - model.dofs.node[::3]
    assert np.array_equal(taken(nodes=nodes, numbers=numbers).dofs.node[::3], numbers)


@pytest.mark.parametrize("frame", few_on_ranks([hpcred.Chord(nodes=(3, 20, 47)), hpcred.NoFrame()]))
@pytest.mark.costly
def test_bodies_in_blocks_are_reduced(arrays, nodes, taken, frame):
    """Block sizes do no harm to frames, modes and Krylov blocks."""
    found = []
    for block in (1, 3):
        model = taken(block=block, nodes=nodes)
        basis = [hpcred.Modes(count=4), hpcred.Krylov(frequency=100.0)]
        with model.with_inputs([(2, "x"), (46, "z")]) as loaded, hpcred.reduce(loaded, basis, frame) as reduced:
            found.append(reduced.frequencies)
    assert np.allclose(found[1], found[0], rtol=1e-9)
    if frame == hpcred.NoFrame():
        assert np.allclose(found[1][:4], lowest(arrays["K"], arrays["M"], 4), rtol=1e-9)


def test_other_patterns_become_one(arrays, taken):
    """A lumped mass, and dampers that have no entry at the transposed place."""
    change = {"M": np.diag(arrays["M"].sum(axis=1)), "D": np.zeros_like(arrays["K"])}
    change["D"][0, -1] = change["D"][7, 7] = 3.0
    model = taken(change)
    for key, mat in model.matrices.items():
        assert np.array_equal(to_dense(mat), (arrays | change)[key])
    transposed = model.D.transpose(PETSc.Mat())
    patterns = [mat.getValuesCSR()[:2] for mat in (model.K, model.M, model.D, transposed)]
    transposed.destroy()
    for indptr, indices in patterns[1:]:
        assert np.array_equal(indptr, patterns[0][0]) and np.array_equal(indices, patterns[0][1])


@pytest.mark.parametrize("kind", ["sbaij", "baij", "dense"])
def test_other_storage_is_converted(arrays, taken, kind):
    model = taken(kind=kind)
    assert model.K.getType() in ("seqaij", "mpiaij")
    for key, mat in model.matrices.items():
        assert np.array_equal(to_dense(mat), arrays[key])


@pytest.mark.parametrize("symmetric", [True, False])
def test_rows_of_boundary_conditions(comm, arrays, nodes, taken, symmetric):
    """As libraries leave them, with the columns cleared as well or not; removed they are not missed."""
    held = np.array([3, 4, 5, 100, 143])
    free = np.setdiff1d(np.arange(144), held)
    change = {}
    for key, mat in arrays.items():
        change[key] = mat.copy()
        change[key][held] = 0.0
        if symmetric:
            change[key][:, held] = 0.0
        change[key][held, held] = 1.0
    with pytest.raises(InputError, match=r"found \d rows with nothing beside the diagonal, the first is .*`held`"):
        taken(change, nodes=nodes)
    named = held if comm.rank == comm.size - 1 else held[:1]  # by whatever rank, and twice
    model = taken(change, nodes=nodes, held=named)
    expected = {key: mat[np.ix_(free, free)] for key, mat in arrays.items()}
    for key, mat in model.matrices.items():
        assert np.array_equal(to_dense(mat), expected[key])
    where = [np.concatenate(comm.allgather(part)) for part in (model.dofs.node, model.held.node, model.held.direction)]
    assert np.array_equal(where[0], free // 3 + 1)
    assert np.array_equal(where[1], held // 3 + 1) and np.array_equal(where[2], held % 3)
    with hpcred.reduce(model.with_inputs([(1, "x")]), [hpcred.Modes(count=3)]) as reduced:
        assert np.allclose(reduced.frequencies, lowest(expected["K"], expected["M"], 3), rtol=1e-9)
    kept = taken(change, nodes=nodes, held=[])
    assert kept.size == 144 and kept.held is None


def test_imaginary_parts_are_refused(comm, arrays, taken):
    if not is_complex():
        pytest.skip("real build")
    with pytest.raises(InputError, match=r"model: M: found \d+ entries with imaginary parts"):
        taken({"M": arrays["M"] + 1e-3j * np.eye(144)} if comm.rank == comm.size - 1 else {"M": arrays["M"] + 0j})


def test_what_does_not_belong_together_is_refused(comm, arrays, nodes, taken):
    K = arrays["K"]
    for change, keywords, match in [
        ({"M": np.eye(145)}, {}, "found 145 rows of M, but K has 144"),
        ({"M": K[:, :-3]}, {}, "found 144 x 141 for M, expected a square matrix"),
        ({}, {"nodes": np.vstack([nodes, [[0, 0, 0]]])}, r"nodes for \d+ rows of block size 3 on rank 0.*ghosts"),
        ({}, {"nodes": nodes[:, :2]}, "nodes: found an array"),
        ({}, {"nodes": nodes, "numbers": np.full(len(nodes), 7)}, "found the node 7 twice"),
        ({}, {"nodes": nodes, "numbers": 0.5 + np.arange(len(nodes))}, "numbers: found float64"),
        ({}, {"held": [144]}, "held: found the row 144, expected rows from 0 to 143"),
        ({}, {"held": np.zeros((2, 2))}, "held: found float64"),
        ({}, {"held": np.arange(144)}, "144 rows of which 144 are held"),
        ({"K": K + np.diag([np.nan] + [0] * 143)}, {}, "matrix K has entries that are NaN"),
        ({"M": -arrays["M"]}, {}, "144 negative diagonal entries|negative diagonal"),
    ]:
        with pytest.raises(InputError, match=match):
            taken(change, **keywords)


def test_matrices_that_are_not_ready(comm, arrays):
    K = assemble(comm, arrays["K"])
    empty = PETSc.Mat().createAIJ(K.getSizes(), comm=comm)
    for M, match in [(empty, "M is not assembled"), (arrays["M"], "found ndarray for M")]:
        with pytest.raises(InputError, match=match):
            SecondOrderModel.from_petsc(K, M)
    if comm.size > 1:
        other = PETSc.Mat().createAIJ((144, 144), comm=comm)  # in even shares
        other.setUp()
        other.assemble()
        with pytest.raises(InputError, match="expected one layout"):
            SecondOrderModel.from_petsc(K, other)
        other.destroy()
    K.destroy()
    empty.destroy()
