"""The distributed matrices and their common pattern."""

import numpy as np
import pytest
import scipy.sparse
from helpers import dense_model, to_dense, with_columns

import hpcred
from hpcred import Dofs, InputError, SecondOrderModel
from hpcred.linalg.matrix_estimates import symmetry_defect
from hpcred.parallel.shares import row_range

pytestmark = pytest.mark.mpi


def test_symmetric_pattern_of_an_unsymmetric_matrix(solid):
    """D may have entries where D^T has none; all matrices share one pattern, its transpose included."""
    K, M, B = dense_model(solid)
    D = np.zeros_like(K)
    D[0, -1] = 3.0
    with hpcred.SecondOrderModel.from_scipy(K, M, D, solid.comm) as model:
        assert np.array_equal(to_dense(model.D), D)
        transposed = model.D.transpose()
        assert np.array_equal(transposed.getValuesCSR()[1], model.K.getValuesCSR()[1])
        transposed.destroy()


def test_imaginary_parts_are_refused(solid):
    K, M, _ = dense_model(solid)
    with pytest.raises(hpcred.InputError, match="imaginary parts"):
        hpcred.SecondOrderModel.from_scipy(K + 1e-3j * K, M, comm=solid.comm)
    with hpcred.SecondOrderModel.from_scipy(K + 0j, M, comm=solid.comm) as model:
        assert np.array_equal(to_dense(model.K), K)


def test_what_follows_from_a_damping_matrix_goes_with_it(solid):
    """An unsymmetric D that is left out does not make the model unsymmetric."""
    K, M, _ = dense_model(solid)
    D = 1e-5 * K
    D[3, 5] += 10.0
    with hpcred.SecondOrderModel.from_scipy(K, M, D, comm=solid.comm) as model:
        assert not model.symmetric
        with model.with_damping_matrix(None) as undamped:
            assert undamped.symmetric
            with undamped.with_damping_matrix(model.K.copy()) as damped:
                assert damped.symmetric and set(damped.symmetry_defects) == {"M", "D", "K"}
        assert not model.symmetric


def test_a_model_says_what_it_is(solid):
    lines = str(solid).splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("solid: 144 dofs") and "symmetric" in lines[1] and "inputs" in lines[2]


def test_models_share_their_matrices_and_close_by_themselves(solid):
    expected = to_dense(solid.K)
    with solid.with_inputs([(45, "x")]) as other:
        assert other.input_names == ("45:x",) and solid.input_names != ("45:x",)
    assert np.array_equal(to_dense(solid.K), expected)


SIX = scipy.sparse.identity(6, format="csr")
LABELS = Dofs(np.repeat([1, 2], 3), np.tile([0, 1, 2], 2), np.eye(6)[:, :3])


@pytest.mark.parametrize(
    ("matrices", "keywords", "message"),
    [
        ((SIX, SIX[:3, :3]), {}, "^from_scipy: found 6 rows of K, 3 rows of M, expected the same number"),
        ((SIX, SIX, SIX[:3, :3]), {}, "found 6 rows of K, 6 rows of M, 3 rows of D"),
        (("K", SIX), {}, "^from_scipy: K: found .* expected a square matrix of numbers"),
        ((SIX, SIX), {"inputs": np.ones(6)}, r"^from_scipy: inputs: found an array \(6,\) .* numbers \(6, columns\)"),
        ((SIX, SIX), {"inputs": np.ones((9, 2))}, r"^from_scipy: inputs: found an array \(9, 2\)"),
        ((SIX, SIX), {"inputs": 1j * np.ones((6, 2))}, "of complex128, expected real numbers"),
        ((SIX, SIX), {"outputs": np.nan * np.ones((6, 2))}, "^from_scipy: outputs: found NaN or Inf in column 1"),
        ((SIX, SIX), {"inputs": np.eye(6), "input_names": ["a"]}, "^model: inputs: found 1 names for 6 columns"),
        ((SIX, SIX), {"dofs": LABELS.take(slice(3))}, "^from_scipy: dofs: found 3, expected one for each of 6 rows"),
        ((SIX, SIX), {"dofs": Dofs(LABELS.node, LABELS.direction + 13, LABELS.position)}, "direction: found 13"),
        ((SIX, SIX), {"dofs": Dofs(LABELS.node, LABELS.direction, LABELS.position * np.nan)}, "position: found NaN"),
        ((SIX, SIX), {"dofs": 3}, "dofs: found 3, expected Dofs"),
        ((SIX, SIX), {"dofs": LABELS}, r"position: found node 1 at \[1.0, .*\] and \[0.0, .*expected one place"),
        ((SIX, SIX), {"dofs": Dofs([1, 2, 1, 2, 1, 2], [0, 0, 1, 1, 2, 0], np.zeros((6, 3)))},
         "dofs: found two rows of node 2, x, expected one"),
        ((SIX, SIX), {"elements": {"tet": [[1, 2, 3, 4]]}}, "found elements of the kind 'tet', expected one of line, "),
        ((SIX, SIX), {"elements": {"tetra": [[1, 2, 3]]}}, r"shape \(1, 3\) for tetra, .* \(elements, 4\)"),
    ],
)
def test_matrices_and_columns_that_do_not_fit_are_refused(comm, matrices, keywords, message):
    with pytest.raises(InputError, match=message):
        SecondOrderModel.from_scipy(*matrices, comm=comm, **keywords)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ([0, 2, 0, 1, 1, 2], None),
        ([2, 0, 1, 0, 2, 1], None),
        ([0, 2, 1, 1, 1, 2], r"found the column 1 \(from 0\) twice in the row of dof 2, expected each column once"),
        ([0, 3, 0, 1, 1, 2], r"found the column 3 \(from 0\), expected 0 to 2"),
        ([0, 2, 0, 1, -1, 2], r"found the column -1 \(from 0\), expected 0 to 2"),
    ],
)
def test_columns_of_csr_rows(comm, columns, message):
    first, last = row_range(comm, 3)
    entries = slice(2 * first, 2 * last)
    values = {key: np.arange(1.0, 7.0)[entries] for key in "KM"}
    arguments = comm, 3, 2 * np.arange(last - first + 1), np.array(columns)[entries], values
    if message:
        with pytest.raises(InputError, match=message):
            SecondOrderModel.from_csr(*arguments)
        return
    with SecondOrderModel.from_csr(*arguments) as model:
        expected = scipy.sparse.csr_matrix((np.arange(1.0, 7.0), columns, [0, 2, 4, 6])).toarray()
        assert np.array_equal(to_dense(model.K), expected)


def test_labels_are_arrays_of_one_length():
    assert Dofs([1], [2], [[0, 0, 0]]).position.shape == (1, 3)
    for node, direction, position in (([1], [0, 1], [[0, 0, 0]]), ([1], [0], [[0, 0]]), ([1], ["x"], [[0, 0, 0]])):
        with pytest.raises(InputError, match="^dofs.(direction|position): found an array"):
            Dofs(node, direction, position)


def test_columns_without_names_are_numbered(comm):
    columns = scipy.sparse.csr_matrix(np.eye(6)[:, :2])
    with SecondOrderModel.from_scipy(SIX, SIX, comm=comm, inputs=columns, outputs=np.ones((6, 1)).tolist()) as model:
        assert model.input_names == ("input 1", "input 2") and model.output_names == ("output 1",)
        assert np.allclose(hpcred.frequency_response(model, 0.0), 1.0)


def test_columns_of_a_rank_that_do_not_fit_are_refused_on_all(solid):
    last = solid.comm.rank == solid.comm.size - 1
    rows = solid.local_rows
    for wrong in (np.ones((rows + 1, 2)), np.ones(rows), "x", np.full((rows, 2), np.inf)):
        columns = wrong if last else np.ones((rows, 2))
        with pytest.raises(InputError, match="^solid: inputs: found"):
            solid.with_input_columns(columns, ["a", "b"])
    if solid.comm.size > 1:
        with pytest.raises(InputError, match="^solid: outputs: found 1 to 2 columns on the ranks"):
            solid.with_output_columns(np.ones((rows, 1 + last)), ["a", "b"])


@pytest.mark.mpi
def test_misspelled_keywords_and_names_for_classes_are_refused(solid):
    for call, says in (
        (lambda: hpcred.reduce(solid, tolerence=1e-4), "reduce: unknown keyword 'tolerence' .did you mean 'tolerance'"),
        (lambda: hpcred.reduce(solid, frame="buckens"), r"frame: found 'buckens', .*, such as Buckens\(\.\.\.\)"),
        (lambda: hpcred.natural_modes(solid, frame="tangent"), r"such as Tangent\(\.\.\.\)"),
        (lambda: hpcred.reduce(solid, damping="rayleigh"), r"damping: found 'rayleigh', .*, such as Rayleigh\("),
        (lambda: hpcred.SecondOrderModel.from_scipy(1, 1, dof=None), "from_scipy: .*'dof' .did you mean 'dofs'"),
        (lambda: solid.with_inputs(["tip"]), "'tip' is no interface of"),
        (lambda: hpcred.SecondOrderModel(SIX, None, SIX, np.eye(6), circulatory="yes"),
         "circulatory: found 'yes', expected True or False"),
        (lambda: hpcred.SecondOrderModel.from_scipy(SIX, SIX, circulatory=1), "circulatory: found 1, expected True"),
        (lambda: solid.with_fields(circulatory="no"), "circulatory: found 'no', expected True or False"),
    ):
        with pytest.raises(hpcred.InputError, match=says):
            call()



@pytest.mark.parametrize("targets", [1, [1.0], [True], "x", [(1, 0)], [(1, "x", 2)], {(1, "x")}, None, []])
def test_dofs_that_are_none_are_refused(solid, targets):
    for method in (solid.with_inputs, solid.with_outputs):
        with pytest.raises(InputError, match="^(in|out)puts: found .* expected (a list of|dof numbers)"):
            method(targets)
    with pytest.raises(InputError, match="^interfaces: found 'crank', expected a list of Interface"):
        solid.with_interfaces("crank")


@pytest.mark.mpi
def test_one_rank_alone_may_show_a_model(comm):
    model = hpcred.linkage(comm)
    if comm.rank == 0:
        assert repr(model) == "<SecondOrderModel linkage: 120 dofs, 1 inputs, 1 outputs>"
    model.close()
    assert "closed" in repr(model)


@pytest.mark.mpi
def test_symmetry_is_free_of_units_and_of_the_mesh(comm):
    """The largest difference of two entries beside them or their diagonal, against a loop over entries."""
    rng = np.random.default_rng(5)
    n = 23
    A = np.diag(rng.uniform(1, 2, n)) + np.where(rng.random((n, n)) < 0.2, 1e-5 * rng.standard_normal((n, n)), 0.0)
    A[3, 3] = 0.0
    B = np.zeros((n, n))
    B[4, 15], B[15, 4] = 1e-11, -1e-11
    symmetric = (A + A.T) / 2
    for matrix, skew in ((A, 1), (symmetric, 1), (symmetric + B, 1), (A - A.T, -1)):
        size = np.abs(np.diag(matrix))
        scale = np.maximum(np.maximum(np.abs(matrix), np.abs(matrix.T)), 1e-3 * np.sqrt(np.outer(size, size)))
        expected = (np.abs(matrix - skew * matrix.T) / np.where(scale > 0, scale, 1.0)).max()
        units = 10.0 ** rng.integers(-12, 12, n)
        for each in (matrix, units[:, None] * matrix * units):
            with hpcred.SecondOrderModel.from_scipy(np.eye(n), np.eye(n), each, comm=comm) as model:
                assert symmetry_defect(model.D, skew=skew < 0) == pytest.approx(expected, rel=1e-9, abs=1e-14)
                assert skew < 0 or model.is_symmetric("D") == (matrix is symmetric)


def test_digests_of_loads_have_about_seven_digits(solid):
    """Of the size of a column, and of its large entries beside it."""
    B = np.outer(np.linspace(0.5, 0.9, solid.size), [3.0, 1e6])

    def digest(change):
        with with_columns(solid, "input", B * change) as model:
            return model.digest_of("B")

    entry = np.eye(1, solid.size, 7).T
    for change in (np.ones((1, 1)), entry):
        assert digest(1 + 1e-12 * change) == digest(np.ones((1, 1))) != digest(1 + 1e-6 * change)
    for large in (1, -1):  # an entry far below the largest has digits of its own, but not beyond those of that
        small = large * (1 - (1 - 1e-4) * entry)
        assert digest(small) != digest(small + 1e-9 * entry)
        assert digest(small * (1 - entry)) == digest(small * (1 - entry) + 1e-16 * entry)


def test_all_directions_of_a_node_ascend_whatever_the_order_of_its_rows(comm):
    dofs = hpcred.Dofs(np.ones(3, int), np.array([2, 0, 1]), np.zeros((3, 3)))
    K = np.diag([3.0, 1.0, 2.0])
    with hpcred.SecondOrderModel.from_scipy(K, np.eye(3), comm=comm, dofs=dofs) as model:
        named = model.with_inputs([(1, "all")])
        assert named.input_names == ("1:x", "1:y", "1:z")
        assert np.array_equal(dense_model(named)[2], np.eye(3)[[2, 0, 1]])
