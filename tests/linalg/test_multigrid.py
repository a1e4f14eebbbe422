"""Conjugate gradients with multigrid against dense numpy, against factors, and what cannot be solved that way."""


import numpy as np
import pytest
import scipy.linalg
from helpers import bar, block_from, block_with_ends, close, dense_model, few_on_ranks, gather, moments, to_dense

import hpcred
from hpcred import (
    Adaptive,
    Buckens,
    Chord,
    ComputationError,
    CraigBampton,
    Factoring,
    InputError,
    Krylov,
    LinearSolver,
    Modes,
    SecondOrderKrylov,
    SecondOrderModel,
    StaticCorrection,
    Tangent,
)
from hpcred.linalg import coarsening
from hpcred.linalg.blocks import create_block
from hpcred.linalg.conjugate_gradients import NegativeCurvature, NotSolved
from hpcred.linalg.multigrid import HIGH, LOW, Multigrid, _Level
from hpcred.linalg.solvers.base import SingularMatrix
from hpcred.linalg.solvers.multigrid import MultigridSolver
from hpcred.linalg.solvers.shifted import NEARBY, ShiftedSolver
from hpcred.model.frames import apply_frame
from hpcred.model.node_blocks import NodeBlocks
from hpcred.parallel.petsc import MPI, free_dropped
from hpcred.reduction import ConstraintModes
from hpcred.reduction.search.point_solver import ROUGH_LOADS

UNFIT = LinearSolver(unfit="multigrid")
MULTIGRID = Factoring(solver=LinearSolver(kind="multigrid"))
CELLS = (7, 4, 4)  # 525 dofs, on several levels


def solver_of(framed):
    blocks = NodeBlocks(framed.model)
    return MultigridSolver(framed.model, framed.rigid, blocks, LinearSolver())


def loads_of(model, columns=3):
    return np.random.default_rng(4).standard_normal((model.size, columns))


def solved(solver, model, loads):
    right, left = block_from(model.K, loads), create_block(model.K, loads.shape[1])
    solver.solve(right, left)
    found = gather(left)
    right.destroy()
    left.destroy()
    return found


def scrambled(comm):
    """The block with its rows in another order: x of all nodes, then z, then y; the rows of a node on all ranks."""
    with hpcred.solid(CELLS, inputs=3, comm=comm) as model:
        K, M, B = dense_model(model)
        dofs = [np.concatenate(comm.allgather(part)) for part in (model.dofs.node, model.dofs.direction)]
        position = np.concatenate(comm.allgather(model.dofs.position))
    order = np.lexsort((dofs[0], np.array([0, 2, 1])[dofs[1]]))
    labels = hpcred.Dofs(dofs[0][order], dofs[1][order], position[order])
    return SecondOrderModel.from_scipy(
        K[np.ix_(order, order)], M[np.ix_(order, order)], comm=comm, dofs=labels, inputs=B[order],
        input_names=("a", "b", "c"),
    )  # fmt: skip


MODELS = {
    "clamped": (lambda comm: hpcred.solid(CELLS, inputs=3, comm=comm), None),
    "chord": (lambda comm: hpcred.solid(CELLS, inputs=3, clamped=False, comm=comm), Chord(nodes=(1, 180, 25))),
    "scrambled": (scrambled, None),
    "beam": (lambda comm: bar(comm, 1.0, 60), Tangent(node=1)),
}


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("name", few_on_ranks(["scrambled", "clamped", "chord", "beam"]))
def test_solves_are_those_of_dense_numpy(comm, name):
    make, frame = MODELS[name]
    with make(comm) as model:
        framed = apply_frame(model, frame)
        K, M = (to_dense(mat) for mat in (framed.model.K, framed.model.M))
        loads, solver = loads_of(framed.model), solver_of(framed)
        for mass in (0.0, 1e6, np.inf):
            A = M if mass == np.inf else K + mass * M
            solver.factor(mass)
            exact = np.linalg.solve(A, loads)
            found = solved(solver, framed.model, loads)
            allowed = max(1e-11 * np.linalg.norm(loads), 10 * np.linalg.norm(A @ exact - loads))
            assert np.linalg.norm(A @ found - loads) < allowed
            assert close(found, exact) < 1e-8
        first = solver.records[0]
        assert first.kind == "multigrid" and first.levels > 1 and first.columns_solved == 3
        assert 0 < first.iterations < (60 if name != "beam" else 200)
        assert solver.records[-1].kind == "diagonal"
        assert not framed.model.K.getNearNullSpace()  # the matrix of a model keeps no vectors of size n
        solver.close()


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("name", few_on_ranks(["scrambled", "clamped"]))
def test_levels_keep_nothing_but_their_matrices(comm, name):
    """What PETSc keeps of a product of matrices would hold its factors."""
    settings = LinearSolver()
    with MODELS[name][0](comm) as model:
        blocks = NodeBlocks(model)
        matrix = blocks.expanded(model.K, model.mean_diagonal_of_k)
        made = Multigrid(matrix, blocks.motions, "multigrid_", settings.threshold, settings.sweeps)
        free_dropped(comm)
        assert made.levels > 1
        for level in made._levels:
            kept = [level.matrix] if level.interpolation is None else [level.interpolation, level.inverses]
            assert [mat.refcount for mat in kept] == [1] * len(kept)
        assert all(level.matrix.refcount == 1 for level in made._levels[1:])


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("slab", [2**16, 100])
def test_a_coarse_matrix_is_that_of_dense_numpy(comm, monkeypatch, slab):
    """Whether made at once or by slabs of rows, of which ranks have different numbers."""
    monkeypatch.setattr(coarsening, "SLAB", slab)
    settings = LinearSolver()
    with MODELS["scrambled"][0](comm) as model:
        blocks = NodeBlocks(model)
        matrix = blocks.expanded(model.K, model.mean_diagonal_of_k)
        fine, below = Multigrid(matrix, blocks.motions, "multigrid_", settings.threshold, settings.sweeps)._levels[:2]
        P = to_dense(fine.interpolation)
        assert close(to_dense(below.matrix), P.T @ to_dense(matrix) @ P) < 1e-13
        assert below.matrix.getBlockSize() == 6


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.costly
def test_a_free_body_is_solved_by_inertia_relief_as_with_a_factor(comm):
    model = hpcred.solid(CELLS, inputs=3, clamped=False, comm=comm)
    with model:
        framed = apply_frame(model, Buckens())
        loads, direct, solver = loads_of(model), ShiftedSolver(framed.model, framed.rigid), solver_of(framed)
        R = gather(framed.rigid.R)
        M = to_dense(model.M)
        for mass in (0.0, 1e6):
            direct.factor(mass)
            solver.factor(mass)
            found = solved(solver, model, loads)
            assert close(found, solved(direct, model, loads)) < 1e-9
            assert np.abs(R.T @ M @ found).max() < 1e-12 * np.abs(M @ found).max() * np.abs(R).max() * model.size
        solver.close()
        direct.close()


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.costly
def test_what_is_not_positive_definite_is_refused(comm):
    with hpcred.solid(CELLS, inputs=3, clamped=False, comm=comm) as model:
        framed = apply_frame(model, None)
        solver = solver_of(framed)
        with pytest.raises(SingularMatrix):
            solver.factor(0.0)
        with pytest.raises(InputError, match="cannot solve at 100 Hz: .* real points alone.*high order"):
            solver.factor(-((2 * np.pi * 100) ** 2))
        solver.factor(1e5)
        solver.close()
    with hpcred.solid(CELLS, inputs=3, comm=comm) as model:
        K, M, B = dense_model(model)
        values = np.linalg.eigvals(np.linalg.solve(M, K)).real
        pressed = K - 1.5 * np.sort(values)[0] * M  # past its buckling load
        dofs = [np.concatenate(comm.allgather(part)) for part in
                (model.dofs.node, model.dofs.direction, model.dofs.position)]  # fmt: skip
        other = SecondOrderModel.from_scipy(pressed, M, comm=comm, dofs=hpcred.Dofs(*dofs), inputs=B, input_names="abc")
        with other, pytest.raises(ComputationError, match="not positive definite.*negative curvature"):
            hpcred.reduce(other, [StaticCorrection()], factoring=MULTIGRID)


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.costly
def test_rough_solutions_leave_what_they_may_of_the_residual(comm):
    """At 0 Hz of the loads, and above modes that a basis has of what is left beside that."""
    with hpcred.solid(CELLS, inputs=3, comm=comm) as model:
        K, M, _ = dense_model(model)
        values, shapes = scipy.linalg.eigh(K, M)
        loads, solver, rough = loads_of(model), solver_of(apply_frame(model, None)), 1e-3
        solver.factor(0.0)
        right, left = block_from(model.K, loads), create_block(model.K, 3)
        V, mass = shapes[:, :8], -(values[5] + values[6]) / 2
        basis, beside = block_from(model.K, V), loads - M @ V @ (V.T @ loads)
        shifted = K + mass * M
        for solve, A, first in (
            (lambda *rough: solver.solve(right, left, 0, *rough), K, loads),
            (lambda *rough: solver.solve_below(mass, right, left, basis, V.T @ shifted @ V, *rough), shifted, beside),
        ):
            shares, iterations = [], []
            for asked in ((), (rough,)):
                solver.records[-1].iterations = 0
                solve(*asked)
                found = np.linalg.norm(loads - A @ gather(left), axis=0) / np.linalg.norm(first, axis=0)
                shares.append(found)
                iterations.append(solver.records[-1].iterations)
            assert shares[0].max() < 1e-11 and 1e-6 < shares[1].max() < 1.001 * rough
            assert 2 * iterations[1] < iterations[0]
        assert solver.records[-1].residual < 1e-10  # of solutions that are to be exact
        for block in (right, left, basis):
            block.destroy()
        solver.close()


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("frame", few_on_ranks([Buckens(), None]), ids=["free", "clamped"])
def test_moments_match_as_with_factors(comm, frame):
    basis = [Krylov(frequency=0.0, order=2), Krylov(decay=60000.0, order=1)]
    frequencies = np.linspace(0, 6000, 7)[1:]
    with hpcred.solid(CELLS, inputs=3, clamped=frame is None, comm=comm) as model:
        found = []
        for factoring in (MULTIGRID, None):
            with hpcred.reduce(model, basis, frame, factoring=factoring) as rom:
                small = rom.K, rom.M, rom.B, rom.C
                matched = [*moments(*small, 0.0, 6), *moments(*small, 60000.0**2, 4)]
                found.append((rom.size, matched, hpcred.frequency_response(rom, frequencies)))
                record = rom.record
                if factoring is not None:
                    assert [item.kind for item in record.factorisations] == ["multigrid"] * 2
                    assert max(item.residual for item in record.factorisations) < 1e-10
                    assert "2 by conjugate gradients with multigrid" in record.effort
        (size, ours, response), (theirs_size, theirs, exact) = found
        assert size == theirs_size == 15
        assert close(response, exact) < 1e-8
        if frame is None:
            K, M, B = dense_model(model)
            full = [*moments(K, M, B, B.T, 0.0, 6), *moments(K, M, B, B.T, 60000.0**2, 4)]
            for mine, other, true in zip(ours, theirs, full, strict=True):
                assert close(mine, true) < max(1e-10, 10 * close(other, true))


@pytest.mark.mpi(ranks=(1, 3))
def test_constraint_modes_are_those_of_factors(comm):
    with block_with_ends(comm, cells=(6, 3, 3)) as model:
        found = []
        for factoring in (MULTIGRID, None):
            with hpcred.reduce(
                model, [ConstraintModes()], Buckens(), coordinates="interface", factoring=factoring
            ) as rom:  # fmt: skip
                found.append((rom.K, rom.M))
        for ours, theirs in zip(*found, strict=True):
            assert close(ours, theirs) < 1e-9


def test_modes_are_those_of_factors():
    with block_with_ends(MPI.COMM_WORLD, cells=(6, 3, 3)) as model:
        found = []
        for factoring in (MULTIGRID, None):
            with hpcred.reduce(model, [CraigBampton(count=1)], Buckens(), factoring=factoring) as rom:
                found.append(rom.frequencies)
        assert np.allclose(*found, rtol=1e-8)
    with hpcred.solid((6, 3, 3), inputs=3) as model:
        for modes in (Modes(count=2), Modes(band=(0.0, 13000.0))):
            found = []
            for factoring in (MULTIGRID, None):
                with hpcred.reduce(model, [modes], factoring=factoring) as rom:
                    found.append(rom.frequencies)
            assert np.allclose(*found, rtol=1e-9)


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.costly
def test_a_tolerance_is_reached_by_the_chain_at_0_hz_and_proven_beside_the_basis(comm):
    band, cells = (0.0, 25000.0), (9, 5, 5)
    with hpcred.solid(cells, inputs=3, comm=comm) as model:
        K, M, B = dense_model(model)
        with hpcred.reduce(model, tolerance=1e-5, band=band, factoring=MULTIGRID) as rom:
            accuracy, record = rom.record.accuracy, rom.record
            assert accuracy.reached and len(record.factorisations) == 1
            where = [proof.frequency for proof in accuracy.proofs]
            assert accuracy.points[0].frequency == 0.0 and "(uncompressed model)" in accuracy.sentence
            assert max(where) > 0.99 * band[1] and min(where) <= band[1] / 2
            for proof in accuracy.proofs:
                assert 0.3 * proof.measured < proof.estimated < 3 * proof.measured or proof.measured < 1e-12
            for f in [*np.linspace(500.0, 25000.0, 9), *rom.frequencies[rom.frequencies < band[1]]]:
                A = (1 + 1j * accuracy.loss_factor) * K - (2 * np.pi * f) ** 2 * M
                H = B.T @ np.linalg.solve(A, B)
                small = (1 + 1j * accuracy.loss_factor) * rom.K - (2 * np.pi * f) ** 2 * rom.M
                Hr = rom.C @ np.linalg.solve(small, rom.B)
                assert np.linalg.norm(H - Hr) < 1.02e-5 * np.linalg.norm(H)
        with pytest.raises(InputError, match="adaptive.points.*real points alone"):
            asked = Adaptive(tolerance=1e-4, band=band, points=(3000.0,))
            hpcred.reduce(model, adaptive=asked, factoring=MULTIGRID)
    free = hpcred.solid(cells, inputs=3, clamped=False, comm=comm)
    with free, pytest.raises(InputError, match="at 0 Hz is infinite.*buckens"):
        hpcred.reduce(free, tolerance=1e-4, band=band, factoring=MULTIGRID)


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("direct", few_on_ranks([False, True]), ids=["levels of K", "a factor above"])
@pytest.mark.costly
def test_below_modes_that_a_basis_has_solves_are_as_with_a_factor(comm, direct):
    """Be it with the levels of K or, as far as a response needs it, with the factor of another point. A mode that the
    basis lacks is noticed, or seen in the response."""
    with hpcred.solid(CELLS, inputs=3, comm=comm) as model:
        framed = apply_frame(model, None)
        K, M, B = dense_model(model)
        values, shapes = scipy.linalg.eigh(K, M)
        count = 3 + int(np.diff(np.log(values[2:8])).argmax())
        mass, loads = -(values[count - 1] + values[count]) / 2, loads_of(model)
        solver = ShiftedSolver(model) if direct else solver_of(framed)
        solver.factor(-(values[count] + values[count + 1]) / 2 if direct else 0.0)
        right, left = block_from(model.K, loads), create_block(model.K, 3)
        near = shapes[:, :8] + 1e-3 * shapes[:, 20:28]  # roughly the modes, as a basis has them
        near = near @ np.linalg.inv(np.linalg.cholesky(near.T @ M @ near)).T
        basis, lacking = block_from(model.K, near), block_from(model.K, shapes[:, 1:8])
        A = K + mass * M
        solver.solve_below(mass, right, left, basis, near.T @ A @ near)
        exact = np.linalg.solve(A, loads)
        if direct:
            beside = exact - near @ np.linalg.solve(near.T @ A @ near, near.T @ loads)
            whole, left_out = (np.einsum("ij,ij->j", x, A @ x) for x in (beside, exact - gather(left)))
            assert (left_out <= NEARBY * (whole - left_out)).all() and (left_out > 1e-12 * whole).all()
        else:
            assert close(gather(left), exact) < 1e-8
        assert 0 < solver.records[-1].iterations < (3 if direct else 60)
        if direct:
            solver.solve_below(mass, right, left, lacking, np.diag(values[1:8] + mass))
            shows = [np.diag(loads.T @ V @ np.linalg.solve(V.T @ A @ V, V.T @ loads))
                     for V in (shapes[:, 1:8], np.hstack([shapes[:, 1:8], gather(left)]))]  # fmt: skip
            missed = np.diag(loads.T @ exact) - shows[0]
            assert (np.abs(shows[1] - shows[0] - missed) < 0.1 * np.abs(missed)).all()
        else:
            for rough in ((), (ROUGH_LOADS,)):
                with pytest.raises(NotSolved, match="negative curvature"):
                    solver.solve_below(mass, right, left, lacking, np.diag(values[1:8] + mass), *rough)
        for block in (right, left, basis, lacking):
            block.destroy()
        solver.close()


def test_a_search_goes_back_to_0_hz_where_its_basis_lacks_modes(monkeypatch):
    solve, refused = MultigridSolver.solve_below, []

    def once(self, mass, *rest):
        if not refused:
            refused.append(mass)
            raise NegativeCurvature()
        solve(self, mass, *rest)

    monkeypatch.setattr(MultigridSolver, "solve_below", once)
    model = hpcred.solid(CELLS, inputs=3)
    with model, hpcred.reduce(model, tolerance=1e-4, band=(0.0, 25000.0), factoring=MULTIGRID) as rom:
        accuracy = rom.record.accuracy
        assert accuracy.reached and [point.frequency for point in accuracy.points][:2] == [0.0, 0.0]
        assert accuracy.points[2].frequency > 0 and accuracy.proofs


def test_what_levels_take():
    """A number and its column for each entry, those of the finest level among them."""
    with hpcred.solid((10, 8, 8), inputs=1) as model:
        solver = solver_of(apply_frame(model, None))
        solver.factor(0.0)
        record = solver.records[-1]
        assert record.factor_entries > model.nonzeros > 1e5
        assert record.memory_mb_used_total == 12 * record.factor_entries // 2**20 > 0
        solver.close()


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.costly
def test_where_a_factor_does_not_fit_multigrid_takes_over_at_real_points(comm, monkeypatch):
    with hpcred.solid((7, 5, 5), inputs=1, comm=comm) as model:
        monkeypatch.setenv("HPCRED_MEMORY_MB", "1")
        to_tolerance = {"tolerance": 1e-3, "band": (0.0, 9000.0)}
        for basis, more in (([Krylov(frequency=0.0, order=1)], {}), ([Modes(count=1)], {}), ([], to_tolerance)):
            if isinstance(next(iter(basis), None), Modes) and comm.size > 1:
                continue  # many small messages
            with hpcred.reduce(model, basis, factoring=Factoring(solver=UNFIT), **more) as rom:
                assert {item.kind for item in rom.record.factorisations} == {"multigrid"}
                assert any("does not fit" in text and "multigrid instead" in text for text in rom.record.warnings)
        for solver in (LinearSolver(), UNFIT):
            with pytest.raises(ComputationError, match="does not fit.*unfit = 'multigrid' real points"):
                point = Krylov(frequency=0.0 if solver.unfit == "refuse" else 100.0)
                hpcred.reduce(model, [point], factoring=Factoring(solver=solver))


@pytest.mark.mpi(ranks=(2,))
def test_a_factor_that_does_not_fit_is_no_matter_of_groups(comm, monkeypatch):
    points = [Krylov(frequency=0.0), Krylov(frequency=0.0, decay=1e3)]
    with hpcred.solid((8, 6, 6), inputs=1, comm=comm) as model:
        monkeypatch.setenv("HPCRED_MEMORY_MB", "2")
        with hpcred.reduce(model, points, groups="auto", factoring=Factoring(solver=UNFIT)) as rom:
            assert {item.kind for item in rom.record.factorisations} == {"multigrid"}
        with pytest.raises(ComputationError, match="does not fit.*unfit = 'multigrid' real points"):
            hpcred.reduce(model, points, groups="auto")


def test_what_multigrid_cannot_do_is_refused(solid):
    for point, says in (
        (Krylov(frequency=100.0), "cannot solve at 100 Hz"), (Krylov(frequency=100.0, decay=3.0), "a complex point"),
        (SecondOrderKrylov(frequency=100.0), "a complex point"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=says):
            hpcred.reduce(solid, [point], damping=hpcred.Rayleigh(alpha=1.0, beta=1e-6), factoring=MULTIGRID)
    K, M, B = dense_model(solid)
    bare = SecondOrderModel.from_scipy(K, M, inputs=B, input_names=("a", "b", "c"))
    with bare, pytest.raises(InputError, match="no node coordinates, which multigrid needs"):
        hpcred.reduce(bare, [StaticCorrection()], factoring=MULTIGRID)


@pytest.mark.parametrize(
    "options",
    [{"kind": "amg"}, {"kind": "auto"}, {"unfit": "wait"}, {"residual": 1e-3}, {"iterations": 0}, {"sweeps": 0},
     {"threshold": 2.0}],
)  # fmt: skip
def test_solvers_that_make_no_sense(options):
    with pytest.raises(InputError, match=rf"solver\.{next(iter(options))}: found"):
        LinearSolver(**options)


@pytest.mark.parametrize("options", [{"package": "superlu_dist"}, {"precision": "single"}])
def test_settings_of_factors_have_no_effect_on_multigrid_and_are_refused(options):
    (key, value), *_ = options.items()
    said = rf"solver\.{key}: found '{value}' beside solver\.kind = 'multigrid'"
    with pytest.raises(InputError, match=said):
        LinearSolver(kind="multigrid", **options)
    assert getattr(LinearSolver(**options), key) == value
    LinearSolver(kind="multigrid", package="auto", precision="double")


@pytest.mark.parametrize("sweeps", [1, 2, 3, 5])
def test_the_smoother_is_a_chebyshev_polynomial(comm, sweeps):
    """What k sweeps leave of an eigenvector of eigenvalue z is T_k((m - z) / h) / T_k(m / h) on the interval m -+ h,
    which ends at the largest eigenvalue; with a diagonal that is not 1 the matrix and its diagonal go together."""
    count = 12
    T = 2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
    scale = np.diag(10.0 ** np.linspace(-2, 2, count))
    with SecondOrderModel.from_scipy(scale @ T @ scale, np.eye(count), comm=comm) as model:
        level = _Level(model.K)
        level.estimate()
        values, shapes = scipy.linalg.eigh(T / 2)
        assert 0.98 * values[-1] < level.top / HIGH <= values[-1] * (1 + 1e-12)
        errors = np.linalg.solve(scale, shapes)
        level.make_room(count)
        first, last = model.K.getOwnershipRange()
        level.x.getDenseArray()[...] = 0.0
        level.r.getDenseArray()[...] = (scale @ T @ scale @ errors)[first:last]
        level.smooth(sweeps)
        left = np.concatenate(comm.allgather(errors[first:last] - level.x.getDenseArray().real))
        rest = np.concatenate(comm.allgather(level.r.getDenseArray().real.copy()))
    middle, half = level.top * (1 + LOW) / 2, level.top * (1 - LOW) / 2
    polynomial = np.polynomial.chebyshev.Chebyshev.basis(sweeps)
    expected = polynomial((middle - values) / half) / polynomial(middle / half)
    assert np.abs(scale @ left - shapes * expected).max() < 1e-12
    assert np.abs(rest - scale @ T @ scale @ left).max() < 1e-12 * np.abs(scale @ T @ scale).max()
