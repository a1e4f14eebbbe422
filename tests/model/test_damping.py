"""Damping models against dense matrices; which are proportional."""

import numpy as np
import pytest
from helpers import close, damped, dense_model, gather

import hpcred
from hpcred import Caughey, GivenDamping, Krylov, Modes, Rayleigh, SecondOrderKrylov
from hpcred.model.damping import is_proportional, warnings_of_damping

pytestmark = pytest.mark.mpi


@pytest.mark.costly
def test_caughey_series_against_dense_matrices(comm):
    """Five terms; full and reduced D, and Rayleigh as the series of two."""
    with hpcred.solid((2, 2, 2), inputs=2, comm=comm) as model:
        K, M, B = dense_model(model)
        a = (5.0, 2e-6, 3e-15, 1e-24, 4e-34)
        power, D = np.eye(len(K)), np.zeros_like(K)
        for coefficient in a:
            D += coefficient * M @ power
            power = np.linalg.solve(M, K) @ power
        frequencies = [0.0, 300.0, 2500.0]
        expected = []
        for s in 2j * np.pi * np.array(frequencies):
            expected.append(B.T @ np.linalg.solve(s * s * M + s * D + K, B.astype(complex)))
        full = hpcred.frequency_response(model, frequencies, damping=Caughey(a))
        assert close(np.array(expected), full) < 1e-8
        with hpcred.reduce(model, [Krylov(0.0, 1), Krylov(2500.0, 1)], damping=Caughey(a)) as rom:
            eigenvalues = (2 * np.pi * rom.frequencies) ** 2
            assert close(np.diag(sum(c * eigenvalues**k for k, c in enumerate(a))), rom.D) < 1e-8
            assert hpcred.relative_error(full, hpcred.frequency_response(rom, frequencies)).max() < 1e-4
        with hpcred.reduce(model, [Modes(count=len(K))], damping=Caughey(a)) as rom:  # where nothing is left out
            V = gather(rom.columns)
            assert close(V.T @ D @ V, rom.D) < 1e-8
        two = hpcred.frequency_response(model, frequencies, damping=Caughey(a[:2]))
        assert close(two, hpcred.frequency_response(model, frequencies, damping=Rayleigh(*a[:2]))) < 1e-12


def test_proportional_damping_is_recognised(solid):
    model, K, M, D, _ = damped(solid)
    with model:
        assert not is_proportional(model)
        with pytest.raises(hpcred.InputError, match="'second_order_krylov' fits"):
            hpcred.reduce(model, [Krylov(300.0, decay=20.0)], damping=GivenDamping())
        hpcred.reduce(model, [Krylov(300.0)], damping=GivenDamping()).close()
    with hpcred.SecondOrderModel.from_scipy(K, M, 3.0 * M + 1e-6 * K, solid.comm) as model:
        assert is_proportional(model)
    with pytest.raises(hpcred.InputError, match="'krylov' fits"):
        hpcred.reduce(solid, [SecondOrderKrylov(300.0)], damping=Caughey((1.0, 1e-6, 1e-16)))


@pytest.mark.parametrize(
    "damping, says",
    [
        (hpcred.ModalDamping(ratio=2.0), "the ratio 2, where 1 is critical"),
        (hpcred.ModalDamping(ratios=(0.01, 1.5)), "the ratio 1.5"),
        (hpcred.ModalDamping(table=((0.0, 1.0), (9.0, 0.5))), "the ratio 1,"),
        (hpcred.Structural(loss_factor=3.0), "the loss factor 3"),
        (hpcred.ModalDamping(ratio=0.99), None),
        (Rayleigh(2.0, 1e-5), None),
    ],
)
def test_ratios_in_per_cent_are_warned_of(damping, says):
    found = warnings_of_damping(damping)
    assert found == () if says is None else says in found[0] and "0.01 is 1 %" in found[0]


def test_a_reduction_records_the_warning(comm):
    with (
        hpcred.solid((2, 2, 2), inputs=2, comm=comm) as model,
        hpcred.reduce(model, [Krylov(0.0, 0)], damping=hpcred.ModalDamping(ratio=1.0)) as rom,
    ):
        assert "0.01 is 1 %" in rom.record.warnings[-1]
