"""Complex shifts in real and complex builds."""

import numpy as np
import pytest
from helpers import dense_model, gather

import hpcred
from hpcred.linalg.blocks import as_pairs, create_block, from_dense
from hpcred.linalg.solvers.complex import ComplexSolver
from hpcred.model.frames import apply_frame
from hpcred.parallel.petsc import is_complex

pytestmark = pytest.mark.mpi


@pytest.fixture
def model(comm):
    with hpcred.solid((3, 2, 2), inputs=3, comm=comm) as model:
        yield model


def test_complex_shift_in_every_build(model):
    """Native in a complex build, the real form of twice the size in a real one."""
    K, M, B = dense_model(model)
    framed = apply_frame(model, None, hpcred.Rayleigh(20.0, 1e-5))
    s = 30.0 + 2j * np.pi * 700
    expected = np.linalg.solve(K + s * (20.0 * M + 1e-5 * K) + s * s * M, B.astype(complex))
    solution = create_block(model.K, 6)
    for form in ("real",) + (("native",) if is_complex() else ()):
        solver = ComplexSolver(framed.model, form=form)
        solver.factor(s * s, s)
        solver.solve(as_pairs(from_dense(model.B), model.K), solution)
        found = gather(solution)[:, 0::2] + 1j * gather(solution)[:, 1::2]
        assert np.allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
        solver.close()
