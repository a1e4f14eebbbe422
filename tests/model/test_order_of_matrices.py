"""Matrices that were given in another order are asked about, and models that are meant so are not."""

import numpy as np
import pytest
from scipy.sparse import coo_array

import hpcred
from hpcred.model.order_of_matrices import questions_on_order

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
        return questions_on_order(model)


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
