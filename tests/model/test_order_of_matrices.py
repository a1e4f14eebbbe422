"""Matrices that were given in another order are asked about, and models that are meant so are not."""

import bodies
import numpy as np
import pytest
from scipy.sparse import coo_array

import hpcred
from hpcred.model.order_of_matrices import questions_on_order
from hpcred.model.rigid_body.modes import exchange_of_matrices
from hpcred.parallel.progress import Progress
from hpcred.reduction.checks import doubts_of_matrices

pytestmark = pytest.mark.mpi
RAYLEIGH = {"both": (10.0, 1e-5), "mass": (10.0, 0.0), "stiffness": (0.0, 1e-4)}


def matrices(model):
    """(M, K) of a model as SciPy matrices of all ranks, each entry by the rank that has its row."""
    found = {}
    for key in "MK":
        indptr, indices, values = model.matrices[key].getValuesCSR()
        rows = model.first_row + np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        parts = [np.concatenate(part) for part in zip(*model.comm.allgather((rows, indices, values.real)), strict=True)]
        found[key] = coo_array((parts[2], (parts[0], parts[1])), (model.size, model.size)).tocsr()
    return found["M"], found["K"]


@pytest.fixture(params=[True, False], ids=["held", "free"])
def mass_and_stiffness(request):
    with hpcred.solid((4, 3, 3), (0.4, 0.1, 0.1), clamped=request.param) as model:
        return matrices(model)


def asked(M, D, K):
    with hpcred.SecondOrderModel(M, D, K) as model:
        exchanged = exchange_of_matrices(model)
        return [exchanged] if exchanged else questions_on_order(model)


@pytest.mark.parametrize("kind", RAYLEIGH)
def test_every_other_order_but_that_of_M_and_D_is_asked_about(mass_and_stiffness, kind):
    M, K = mass_and_stiffness
    alpha, beta = RAYLEIGH[kind]
    D = alpha * M + beta * K
    assert not asked(M, D, K)
    for order in ((M, K, D), (K, M, D), (K, D, M), (D, K, M)):
        sentences = asked(*order)
        assert len(sentences) == 1 and ("EXCHANGED" in sentences[0] or "in their order?" in sentences[0])


def test_two_matrices_in_the_other_order(mass_and_stiffness):
    M, K = mass_and_stiffness
    assert not asked(M, None, K) and "an equal displacement of all dofs meets nothing" in asked(K, None, M)[0]


def test_rotations_hide_the_motion_but_not_the_size(mass_and_stiffness):
    """Rows of no mesh, whose stiffness resists equal displacements."""
    M, K = mass_and_stiffness
    turned = np.random.default_rng(1).permutation(np.repeat([1.0, -1.0], M.shape[0] // 2 + 1))[: M.shape[0]]
    M, K = (coo_array(mat * turned[:, None] * turned[None, :]).tocsr() for mat in (M, K))
    assert not asked(M, None, K) and "K is expected to be the largest" in asked(K, None, M)[0]


@pytest.mark.parametrize("M, D, K", [
    (1.0, 2.0, 1.0), (1.0, 2.0, 1e-2), (1e-3, 5.0, 1.0), (1.0, 1e4, 1e4),
])  # fmt: skip
def test_numbers_without_units_are_no_matter(M, D, K):
    """Chains of unit masses, and a dashpot that outweighs all else at one of them."""
    chain = 2 * np.eye(9) - np.eye(9, k=1) - np.eye(9, k=-1)
    dashpot = np.zeros((9, 9))
    dashpot[4, 4] = D
    assert not asked(M * np.eye(9), dashpot, K * chain) and not asked(M * np.eye(9), 0.1 * D * chain, K * chain)


def test_reduce_convert_and_info_ask(mass_and_stiffness, tmp_path):
    M, K = mass_and_stiffness
    D = 1e-5 * K
    with hpcred.SecondOrderModel(M, K, D, np.eye(M.shape[0], 1)) as model:
        assert any("in their order?" in sentence for sentence in hpcred.inspect(model)["warnings"])
        with hpcred.reduce(model, [hpcred.Krylov(decay=10.0)]) as reduced:
            assert any("in their order?" in sentence for sentence in reduced.record.warnings)


def from_petsc(K, M, inputs):
    with hpcred.SecondOrderModel.from_scipy(K, M) as model:
        return hpcred.SecondOrderModel.from_petsc(model.K, model.M, inputs=inputs)


def from_file(folder, K, M, inputs):
    with hpcred.SecondOrderModel.from_scipy(K, M, inputs=inputs) as model:
        hpcred.write_model(folder / "model.h5", model)
    return hpcred.read_model(folder / "model.h5")


@pytest.mark.parametrize("way, lumped", [("constructor", False), ("constructor", True), ("from_scipy", False),
                                         ("from_petsc", False), ("file", False)])  # fmt: skip
def test_exchanged_matrices_are_told_of_before_anything_else(comm, way, lumped, tmp_path):
    """Also where the reduction then fails for another reason, as without the mass of every second dof."""
    n = 30
    K, M = 1e8 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)), 2 * np.eye(n)
    M[1::2] *= 0.0 if lumped else 1.0
    B, folder = np.eye(n, 1), comm.bcast(tmp_path)
    make = {
        "constructor": lambda K, M: hpcred.SecondOrderModel(M, K=K, B=B),
        "from_petsc": lambda *two: from_petsc(*two, B),
        "from_scipy": lambda *two: hpcred.SecondOrderModel.from_scipy(*two, inputs=B),
        "file": lambda *two: from_file(folder, *two, B),
    }[way]  # fmt: skip
    given = {"tolerance": 1e-2, "band": (0.0, 100.0)}
    right, other = (Progress(comm, show=False) for _ in range(2))
    with make(K, M) as model, hpcred.reduce(model, **given, progress=right):
        assert not right.warned
    with make(M, K) as model:
        if lumped:
            with pytest.raises(hpcred.InputError):
                hpcred.reduce(model, **given, progress=other)
        else:
            hpcred.reduce(model, **given, progress=other).close()
    assert "K AND M ARE EXCHANGED" in other.warned[0]


@pytest.mark.parametrize("name", ["block", "mapped", "quadratic"])
def test_no_mesh_without_matrices_is_doubted(comm, name):
    size = np.array([0.3, 0.1, 0.1])
    points, cells = {
        "block": lambda: bodies.block(3, 2, 2, size),
        "mapped": lambda: bodies.mapped_block(3, 2, 2, lambda x: x * size),
        "quadratic": lambda: bodies.mapped_block(2, 1, 1, lambda x: x * size, quadratic=True),
    }[name]()  # fmt: skip
    with bodies.model_of_mesh(points, cells if isinstance(cells, dict) else {"hexahedron": cells}, comm) as model:
        assert doubts_of_matrices(model, exchange_of_matrices(model)) == ()


@pytest.mark.parametrize("kilogram, second", [(1.0, 1.0), (1e-3, 1.0), (1e15, 1e6), (1.0, 1e3)])
@pytest.mark.parametrize("body", ["solid", "free solid", "crank", "linkage", "plate"])
def test_no_body_is_doubted(comm, body, kilogram, second):
    """With and without its nodes, in kg and s; t and s; pg and us; and kg and ms: how many are a kilogram, a second."""
    made = {
        "solid": lambda: hpcred.solid((4, 3, 3), (0.4, 0.1, 0.1), comm=comm), "crank": lambda: hpcred.crank(600, comm),
        "free solid": lambda: hpcred.solid((4, 3, 3), (0.4, 0.1, 0.1), clamped=False, comm=comm),
        "plate": lambda: hpcred.solid((6, 6, 1), (1.0, 1.0, 0.002), comm=comm), "linkage": lambda: hpcred.linkage(comm),
    }  # fmt: skip
    with made[body]() as model:
        assert doubts_of_matrices(model, exchange_of_matrices(model)) == ()
        M, K = matrices(model)
    with hpcred.SecondOrderModel(M * kilogram, None, K * kilogram / second**2) as model:
        assert doubts_of_matrices(model, exchange_of_matrices(model)) == ()


def test_units_that_no_body_has_are_asked_about(mass_and_stiffness):
    """Densities in kg/m^3 beside lengths in um, but not one penalty spring."""
    M, K = mass_and_stiffness
    penalty = coo_array(([1e40], ([0], [0])), K.shape)
    assert not asked(M, None, (K + penalty).tocsr())
    assert "in the units of one system?" in asked(M * 1e-18, None, K)[0]
