"""Multigrid on bodies that are not cubes: bounded iterations, what is foretold of them, refusals, what "auto" takes."""

import numpy as np
import pytest
from bodies import block
from helpers import dense_model, gather, to_dense
from shape_models import SHAPES, housing, solid_model

import hpcred
from hpcred import ComputationError, Factoring, LinearSolver, StaticCorrection
from hpcred.linalg import coarsening
from hpcred.linalg.blocks import create_block, local_rows
from hpcred.linalg.coarsening import node_inverses
from hpcred.linalg.ritz_values import iterations_to, rate, ritz_values
from hpcred.linalg.solvers.base import DoesNotFit
from hpcred.linalg.solvers.multigrid import MultigridSolver, TooSlow
from hpcred.model.node_blocks import NodeBlocks

MOST = {  # iterations to 1e-12 of models of SHAPES at SIZE or 8, with room for other BLAS and ranks
    "cube": 35, "housing, hexahedra": 170, "housing, tetrahedra of 10": 110, "housing, shells": 120,
    "housing, shells on 3 points": 130, "random tetrahedra of 4": 110, "random tetrahedra of 10": 90,
    "slab of flat tetrahedra": 160, "ring, curved hexahedra of 20": 60, "rigid faces": 32, "soft layers, 1e-4": 75,
    "soft elements, 1e-4": 60, "nu = 0.499, B-bar": 300, "nu = 0.499, tetrahedra of 10": 290, "bar 100:1": 360,
}  # fmt: skip
SIZE = {"ring, curved hexahedra of 20": 16, "housing, tetrahedra of 10": 6}


def test_each_shape_has_a_bound():
    assert list(MOST) == list(SHAPES)


ON_RANKS = (
    "housing, tetrahedra of 10", "housing, shells on 3 points", "rigid faces", "soft layers, 1e-4",
    "ring, curved hexahedra of 20",
)  # fmt: skip


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.costly
@pytest.mark.parametrize("name", ON_RANKS)
def test_iterations_stay_in_bounds_on_ranks(comm, name):
    check_iterations(comm, name)


@pytest.mark.parametrize("name", [name for name in SHAPES if name not in ("cube", *ON_RANKS)])
def test_iterations_stay_in_bounds(comm, name):
    check_iterations(comm, name)


def check_iterations(comm, name):
    """Iterations are bounded, about those foretold, and the solution is that of the loads."""
    with SHAPES[name](comm, SIZE.get(name, 8)) as model:
        solver = MultigridSolver(model, None, NodeBlocks(model), LinearSolver())
        solver.factor(0.0)
        right, left = create_block(model.K, 2), create_block(model.K, 2)
        with local_rows(right) as rows:
            first = model.first_row
            rows[...] = np.random.default_rng(1).standard_normal((model.size, 2))[first : first + len(rows)]
        solver.solve(right, left)
        record = solver.records[-1]
        assert 0 < record.iterations <= MOST[name]
        assert record.iterations / 1.6 < record.expected_iterations < 1.6 * record.iterations + 5
        assert record.residual < 1e-7
        solver.close()


def test_corners_of_quadratic_elements_are_a_level_that_takes_rigid_motions_as_they_are(comm):
    with SHAPES["housing, tetrahedra of 10"](comm, 4) as model:
        blocks = NodeBlocks(model)
        interpolation, coarse = blocks.corners
        rows, columns = interpolation.getSize()
        assert columns < rows / 3
        assert np.abs(to_dense(interpolation) @ gather(coarse) - gather(blocks.motions)).max() < 1e-12
    points, elements = block(2, 2, 2)
    with solid_model(comm, "hexahedron", points, elements) as model:
        assert NodeBlocks(model).corners is None


@pytest.mark.parametrize("at_once", [1, 2])
def test_blocks_of_nodes_are_inverted_but_for_what_meets_nothing(comm, monkeypatch, at_once):
    monkeypatch.setattr(coarsening, "AT_ONCE", at_once)
    K = np.zeros((6, 6))
    K[:3, :3] = np.diag([1e8, 4.0, 1e-6]) + 0.1
    K[3, 3] = 2.0
    K[0, 3] = K[3, 0] = 5.0  # of two nodes
    with hpcred.SecondOrderModel.from_scipy(K, np.eye(6), comm=comm) as model:
        model.K.setBlockSize(3)
        inverse = to_dense(node_inverses(model.K))
    assert np.allclose(inverse[:3, :3] @ K[:3, :3], np.eye(3), atol=1e-6)
    assert np.allclose(inverse[3:, 3:], np.diag([0.5, 0, 0])) and not inverse[:3, 3:].any()


def test_ritz_values_are_eigenvalues_and_tell_of_negative_ones(comm):
    values = np.linspace(1.0, 9.0, 8)

    def product(p, q):
        q[...] = values[:, None] * p

    def same(r, z):
        z[...] = r

    if comm.size > 1:
        return
    found = ritz_values(comm, product, same, np.ones((8, 1)), 8)
    assert np.allclose(found, values)
    assert rate(found) == pytest.approx(0.5) and iterations_to(1e-12, found) == 43
    values[3] = -1.0
    assert ritz_values(comm, product, same, np.ones((8, 1)), 8)[0] < 0


@pytest.mark.mpi(ranks=(1, 3))
def test_bodies_on_which_multigrid_is_slow_are_refused_with_the_remedy(comm):
    with solid_model(comm, "hexahedron", *housing(8, wall=0.0001)) as model:
        says = (
            r"multigrid reduces the error by 0\.9\d+ an iteration, .* about \d+ iterations, more than "
            r"solver.iterations = 100 \(3 directions a node, no quadratic elements known\)"
            r".*take solver.kind 'direct', with out_of_core"
        )
        factoring = Factoring(solver=LinearSolver(kind="multigrid", iterations=100))
        with pytest.raises(ComputationError, match=says):
            hpcred.reduce(model, [StaticCorrection()], factoring=factoring)


@pytest.mark.mpi(ranks=(1, 3))
def test_unfit_takes_factors_that_fit_then_multigrid_that_converges_and_refuses_the_rest(comm, monkeypatch):
    def kinds(model, search=None, **settings):
        factoring = Factoring(solver=LinearSolver(unfit="multigrid", **settings))
        with hpcred.reduce(model, () if search else StaticCorrection(), factoring=factoring, adaptive=search) as rom:
            return {item.kind for item in rom.record.factorisations}

    with SHAPES["soft layers, 1e-4"](comm, 6) as model:
        assert kinds(model) == {"LDL^T"}
        monkeypatch.setenv("HPCRED_MEMORY_MB", "1")
        assert kinds(model) == {"multigrid"}
        with pytest.raises(TooSlow, match=r"does not fit: .*; in its place, multigrid reduces the error by"):
            kinds(model, iterations=5)
        K, M, B = dense_model(model)
    bare = hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, inputs=B, input_names="abc")
    search = hpcred.Adaptive(tolerance=1e-2, band=(0.0, 1e-3))
    for goal in (None, search):
        with pytest.raises(DoesNotFit, match="does not fit: .*lacks node coordinates .convert it with --nodes") as told:
            kinds(bare, goal)
        assert "unfit" not in str(told.value)  # which was taken
    bare.close()
