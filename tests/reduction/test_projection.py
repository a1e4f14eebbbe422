"""The reduced matrices are projections onto an orthonormal basis."""

import numpy as np
import pytest
from helpers import dense_model, gather, moments

import hpcred
from hpcred import GivenDamping, Krylov, Modes, Rayleigh
from hpcred.examples import linkage as example
from hpcred.linalg.blocks import random_block
from hpcred.reduction.run.projection import WIDTH, project

pytestmark = pytest.mark.mpi


def test_the_basis_is_orthonormal_and_the_matrices_are_its_projections(solid):
    K, M, B = dense_model(solid)
    basis = [Modes(count=4), Krylov(0.0, 1), Krylov(1500.0, 1), Modes(band=(0.0, 1500.0))]
    with hpcred.reduce(solid, basis, damping=Rayleigh(3.0, 1e-6)) as rom:
        V = gather(rom.columns)
        assert np.abs(V.T @ M @ V - np.eye(rom.size)).max() < 1e-12
        for small, full in ((rom.K, K), (rom.M, M), (rom.D, 3.0 * M + 1e-6 * K)):
            assert np.abs(small - V.T @ full @ V).max() < 1e-9 * np.abs(small).max()
        assert np.allclose(rom.B, V.T @ B, atol=1e-9 * np.abs(rom.B).max())
        assert np.allclose(rom.C, rom.B.T, rtol=0, atol=0)
        off = rom.K - np.diag(np.diag(rom.K))
        assert np.abs(off).max() < 1e-9 * rom.K.max()
        assert np.allclose(np.sqrt(np.diag(rom.K)) / (2 * np.pi), rom.frequencies, rtol=1e-8)
        # the modes of the band were there already
        assert rom.record.components[-1].kept == 0


def test_many_columns_are_projected_in_parts_and_stay_as_they_are(solid):
    K, _, _ = dense_model(solid)
    V, W = (random_block(solid.K, count, seed=count) for count in (WIDTH + 3, 5))
    before = gather(V)
    for left in (None, W):
        expected = (before if left is None else gather(left)).T @ K @ before
        found = project(solid.K, V, left)
        assert found.shape == expected.shape and np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
        assert V.getActiveColumns() == (0, WIDTH + 3) and np.array_equal(gather(V), before)


def test_damping_that_is_given_is_projected(linkage):
    K, M, _ = dense_model(linkage)
    damper = np.zeros_like(K)
    damper[116, 116] = 50.0
    rows = np.arange(120)
    dofs = hpcred.Dofs(rows // 6 + 1, (rows % 6).astype(np.int8), example.positions()[rows // 6])
    with hpcred.SecondOrderModel.from_scipy(K, M, damper, linkage.comm, dofs=dofs) as model:
        model = model.with_inputs([(20, "z")])
        with hpcred.reduce(model, [Modes(count=110)], example.FRAME, GivenDamping()) as rom:
            V = gather(rom.columns)
            assert np.abs(rom.D - V.T @ damper @ V).max() < 1e-9 * np.abs(rom.D).max()
        assert model.D is not None  # the model is as it was
    with pytest.raises(hpcred.InputError, match="needs a damping matrix"):
        hpcred.reduce(linkage, [Modes(count=2)], example.FRAME, GivenDamping())


def test_outputs_other_than_inputs(solid):
    K, M, B = dense_model(solid)
    solid = solid.with_outputs([(30, "y"), (45, "x")])
    with hpcred.reduce(solid, [Krylov(500.0, 1)]) as rom:
        C = np.zeros((2, len(K)))
        C[0, 3 * 29 + 1] = C[1, 3 * 44] = 1.0
        shift = -((2 * np.pi * 500.0) ** 2)
        for a, b in zip(moments(K, M, B, C, shift, 2), moments(rom.K, rom.M, rom.B, rom.C, shift, 2), strict=True):
            assert np.abs(a - b).max() < 1e-9 * np.abs(a).max()
