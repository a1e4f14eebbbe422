"""Shifted solves against dense numpy and SuperLU; inertia; a shift on an eigenvalue."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from helpers import columns_of, dense_model, gather

import hpcred
from hpcred import Modes
from hpcred.linalg.blocks import create_block, from_dense
from hpcred.linalg.solvers.base import SingularMatrix
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.parallel.petsc import is_complex


@pytest.fixture
def model(comm):
    with hpcred.solid((3, 2, 2), inputs=3, comm=comm) as model:
        yield model


@pytest.mark.mpi
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
    assert max(record.residual for record in solver.records) < 1e-9
    solver.close()


@pytest.mark.mpi
@pytest.mark.skipif(is_complex(), reason="no inertia in complex builds")
def test_inertia_follows_the_shift(model):
    K, M, _ = dense_model(model)
    values = scipy.linalg.eigh(K, M, eigvals_only=True)
    solver = ShiftedSolver(model, inertia=True)
    for below in (0, 3, 7, 20):
        solver.factor(-(values[below - 1] + values[below]) / 2 if below else 0.0)
        assert solver.inertia == below
    solver.close()


@pytest.mark.mpi
def test_a_shift_on_an_eigenvalue_is_refused(model):
    K, M, _ = dense_model(model)
    value = scipy.linalg.eigh(K, M, eigvals_only=True)[0]
    solver, loads, solution = ShiftedSolver(model), from_dense(model.B), create_block(model.K, 3)
    with pytest.raises(SingularMatrix):
        solver.factor(-value)
    solver.factor(-value * (1 + 1e-6))  # the solver is of use after a failure
    solver.solve(loads, solution)
    assert solver.records[-1].residual < 1e-6
    solver.close()


@pytest.mark.slow
def test_a_solid_against_scipy():
    """K^-1 B, a shifted solve and the lowest modes of 27,000 dofs by SuperLU and ARPACK."""
    with hpcred.solid((24, 18, 18), inputs=3) as model:
        mats = [scipy.sparse.csr_matrix(m.getValuesCSR()[::-1], shape=m.getSize()) for m in (model.K, model.M)]
        B = columns_of(model.B)
        frequencies = [0.0, 1500.0]
        full = hpcred.frequency_response(model, frequencies)
        for f, H in zip(frequencies, full, strict=True):
            A = (mats[0] - (2 * np.pi * f) ** 2 * mats[1]).tocsc()
            expected = B.T @ scipy.sparse.linalg.splu(A, options={"SymmetricMode": True}, diag_pivot_thresh=0.0).solve(
                B
            )
            assert np.abs(H - expected).max() < 1e-7 * np.abs(expected).max()
        values = scipy.sparse.linalg.eigsh(mats[0], 6, mats[1], sigma=0.0, return_eigenvectors=False)
        with hpcred.reduce(model, [Modes(count=6)]) as rom:
            assert np.allclose(rom.frequencies, np.sort(np.sqrt(values)) / (2 * np.pi), rtol=1e-8)
