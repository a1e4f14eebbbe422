"""Shifted solves, factorisation failures, and the mass-orthonormal basis."""

import numpy as np
import pytest
import scipy.linalg
from helpers import block_from, dense_model, gather, to_dense

import hpcred
from hpcred.linalg.basis import Basis
from hpcred.linalg.blocks import as_pairs, create_block, from_dense
from hpcred.linalg.complex_solver import DampedSolver
from hpcred.linalg.eigensolver import symmetric_eigenpairs
from hpcred.linalg.factorisation import SingularMatrix
from hpcred.linalg.solvers import ShiftedSolver
from hpcred.model.frames import apply_frame
from hpcred.parallel.petsc import PETSc, is_complex

pytestmark = pytest.mark.mpi


@pytest.fixture
def model(comm):
    with hpcred.solid((3, 2, 2), inputs=3, comm=comm) as model:
        yield model


def test_every_shift_is_solved_with_its_own_factor_and_one_analysis(model):
    K, M, B = dense_model(model)
    solver, loads = ShiftedSolver(model), from_dense(model.B)
    solution = create_block(model.K, 3)
    for frequency in (0.0, 900.0, 4000.0, 900.0):
        shift = -((2 * np.pi * frequency) ** 2)
        solver.factor(shift)
        solver.solve(loads, solution)
        expected = np.linalg.solve(K + shift * M, B)
        assert np.allclose(gather(solution), expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert solver.analyses == 1
    assert max(record["residual"] for record in solver.records) < 1e-9
    solver.close()


@pytest.mark.skipif(is_complex(), reason="no inertia in complex builds")
def test_inertia_follows_the_shift(model):
    K, M, _ = dense_model(model)
    values = scipy.linalg.eigh(K, M, eigvals_only=True)
    solver = ShiftedSolver(model, inertia=True)
    for below in (0, 3, 7, 20):
        solver.factor(-(values[below - 1] + values[below]) / 2 if below else 0.0)
        assert solver.negative_pivots == below
    solver.close()


def test_a_shift_on_an_eigenvalue_is_refused(model):
    K, M, _ = dense_model(model)
    value = scipy.linalg.eigh(K, M, eigvals_only=True)[0]
    solver, loads, solution = ShiftedSolver(model), from_dense(model.B), create_block(model.K, 3)
    with pytest.raises(SingularMatrix):
        solver.factor(-value)
    solver.factor(-value * (1 + 1e-6))  # the solver is of use after a failure
    solver.solve(loads, solution)
    assert solver.records[-1]["residual"] < 1e-6
    solver.close()


def test_a_workspace_that_is_too_small_is_enlarged(comm):
    """MUMPS' factor is unusable after INFOG(1) = -9; the shift after it must be right as well."""
    with hpcred.solid((8, 8, 8), inputs=1, comm=comm) as model:
        options = PETSc.Options("shift_")
        options["mat_mumps_icntl_14"] = -60
        options["mat_mumps_icntl_23"] = 0  # with the memory known, MUMPS takes what it needs at once
        loads, solution = from_dense(model.B), create_block(model.K, 1)
        solver = ShiftedSolver(model)
        for frequency in (0.0, 500.0):
            solver.factor(-((2 * np.pi * frequency) ** 2))
            solver.solve(loads, solution)
            assert solver.records[-1]["residual"] < 1e-9
        options.delValue("mat_mumps_icntl_14")
        options.delValue("mat_mumps_icntl_23")
        if comm.size == 1:
            assert solver.records[0]["workspace_retries"] > 0
        solver.close()


def test_complex_shift_in_every_build(model):
    """Native in a complex build, the real form of twice the size in a real one."""
    K, M, B = dense_model(model)
    framed = apply_frame(model, None, hpcred.Rayleigh(20.0, 1e-5))
    s = 30.0 + 2j * np.pi * 700
    expected = np.linalg.solve(K + s * (20.0 * M + 1e-5 * K) + s * s * M, B.astype(complex))
    solution = create_block(model.K, 6)
    for form in ("real",) + (("native",) if is_complex() else ()):
        solver = DampedSolver(framed.model, form=form)
        solver.factor(s)
        solver.solve(as_pairs(from_dense(model.B), model.K), solution)
        found = gather(solution)[:, 0::2] + 1j * gather(solution)[:, 1::2]
        assert np.allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
        solver.close()
    framed.close()


@pytest.mark.parametrize("scale", [1.0, 1e12, 1e-12])
def test_basis_finds_the_rank_of_a_block(model, scale):
    """SLEPc's own dependence flag and its Cholesky orthogonalisation fail on these."""
    mass = to_dense(model.M)
    random = np.random.default_rng(1)
    first = random.standard_normal((len(mass), 5))
    basis = Basis(model.M)
    assert basis.extend(block_from(model.M, first)) == 5
    block = random.standard_normal((len(mass), 8))
    block[:, 1] = first @ random.standard_normal(5)  # in the span
    block[:, 3] = block[:, 2]  # twice the same
    block[:, 5] = block[:, 4] + 1e-9 * block[:, 5]  # close, but new
    block[:, 7] = 0.0
    block[:, 6] *= 1e6
    assert basis.extend(block_from(model.M, block * scale)) == 5
    V = gather(basis.columns)
    assert np.abs(V.T @ mass @ V - np.eye(10)).max() < 1e-13
    assert basis.defect() < 1e-13
    assert basis.extend(block_from(model.M, block)) == 0
    spanned = V @ (V.T @ mass @ block)
    assert np.abs(spanned - block).max() < 1e-9 * np.abs(block).max()
    basis.close()


def test_basis_stays_orthogonal_to_what_it_deflates(model):
    mass = to_dense(model.M)
    random = np.random.default_rng(2)
    held = np.linalg.qr(random.standard_normal((len(mass), 4)))[0]
    held = held @ np.linalg.inv(np.linalg.cholesky(held.T @ mass @ held)).T
    basis = Basis(model.M, deflate=block_from(model.M, held))
    assert (
        basis.extend(block_from(model.M, np.hstack([held @ np.ones((4, 2)), random.standard_normal((len(mass), 3))])))
        == 3
    )
    assert np.abs(held.T @ mass @ gather(basis.columns)).max() < 1e-13
    basis.close()


def test_small_eigenproblem_against_lapack():
    random = np.random.default_rng(3)
    matrix = random.standard_normal((12, 12))
    matrix += matrix.T
    values, vectors = symmetric_eigenpairs(matrix)
    assert np.allclose(values, np.linalg.eigvalsh(matrix), atol=1e-12)
    assert np.allclose(matrix @ vectors, vectors * values, atol=1e-11)
