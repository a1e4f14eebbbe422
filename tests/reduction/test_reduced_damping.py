"""Damping ratios of the modes of the reduced model."""

import numpy as np
import pytest

import hpcred
from hpcred import ModalDamping, Modes, StaticCorrection

pytestmark = pytest.mark.mpi


@pytest.mark.costly
def test_modal_damping_ratios(solid):
    for damping, ratios in (
        (ModalDamping(ratio=0.02), lambda f: np.full(len(f), 0.02)),
        (ModalDamping(ratios=(0.01, 0.03)), lambda f: np.where(np.arange(len(f)) == 0, 0.01, 0.03)),
        (ModalDamping(table=((500.0, 0.01), (2000.0, 0.04))), lambda f: np.interp(f, [500, 2000], [0.01, 0.04])),
    ):
        with hpcred.reduce(solid, [Modes(count=6), StaticCorrection()], damping=damping) as rom:
            poles = rom.poles()
            poles = poles[poles.imag > 0]
            assert np.allclose(np.abs(poles), 2 * np.pi * rom.frequencies, rtol=1e-6)
            assert np.allclose(-poles.real / np.abs(poles), ratios(rom.frequencies), rtol=1e-6)
    with pytest.raises(hpcred.InputError, match="belong to a reduced model"):
        hpcred.frequency_response(solid, [10.0], damping=ModalDamping(ratio=0.02))


def test_a_long_caughey_series_holds_in_the_reduced_coordinates(comm):
    """Also where M is singular, so that the full model has no such damping matrix."""
    K = 1e4 * (2 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    damping = hpcred.Caughey((1.0, 1e-5, 1e-12))
    for mass in (1.0, 0.0):
        M = np.diag([1.0, 1, 1, 1, 1, mass])
        with (
            hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, inputs=np.eye(6)[:, :1]) as model,
            hpcred.reduce(model, [Modes(count=2), StaticCorrection()], damping=damping) as rom,
        ):
            eigenvalues = (2 * np.pi * rom.frequencies) ** 2
            assert np.allclose(rom.D, np.diag(1.0 + 1e-5 * eigenvalues + 1e-12 * eigenvalues**2), rtol=1e-9, atol=1e-9)
