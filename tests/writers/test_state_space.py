"""State-space matrices: python-control loads them, and its frequency response is that of the reduced model."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from helpers import block_with_ends, exported, to_dense
from mpi4py import MPI

import hpcred
from hpcred import Buckens, CraigBampton, GivenDamping, Krylov, Modes, Rayleigh, Structural
from hpcred.parallel.failures import InputError
from hpcred.writers.state_space import StateSpaceMat, StateSpaceNpz, state_space


def one_sided():
    with (
        hpcred.linkage() as model,
        hpcred.reduce(model, [Modes(index=tuple(range(7, 27)))], Buckens(), Rayleigh(2.0, 1e-5)) as rom,
    ):
        return rom


def two_sided():
    """M is I to round-off; K and D are neither symmetric nor diagonal."""
    with hpcred.linkage() as model:
        model = model.with_inputs([(20, "z"), (1, "x")]).with_outputs([(7, "y"), (10, "z")])
        basis = [Krylov(frequency=30.0, order=2)]
        with hpcred.reduce(model, basis, Buckens(), Rayleigh(2.0, 1e-5), projection="two_sided",
                           allow_unstable=True) as rom:  # fmt: skip
            return rom


def other_coordinates():
    """The one-sided model in coordinates whose mass matrix is full, as interface coordinates have it."""
    rom, rng = one_sided(), np.random.default_rng(1)
    T = np.linalg.qr(rng.standard_normal((rom.size, rom.size)))[0] * rng.uniform(0.5, 2.0, rom.size)
    return replace(rom, M=T.T @ rom.M @ T, D=T.T @ rom.D @ T, K=T.T @ rom.K @ T, B=T.T @ rom.B, C=rom.C @ T)


@pytest.mark.peers("control")
@pytest.mark.parametrize("make", [one_sided, two_sided, other_coordinates])
@pytest.mark.parametrize("writer, read", [(StateSpaceNpz, np.load), (StateSpaceMat, scipy.io.loadmat)])
def test_python_control_has_the_transfer_function(tmp_path, make, writer, read):
    import control  # here, since it takes seconds to load

    reduced = make()
    assert exported(writer, tmp_path / "file", reduced) == []
    file = read(tmp_path / "file")
    names = {key: [str(np.ravel(name)[0]) for name in np.ravel(file[f"{key}_names"])]
             for key in ("input", "output", "velocity")}  # fmt: skip
    assert names["input"] == list(reduced.input_names) and names["output"] == list(reduced.output_names)
    system = control.ss(
        file["A"], file["B"], np.concatenate([file["C"], file["C_velocity"]]), np.tile(file["D"], (2, 1)),
        inputs=names["input"], outputs=names["output"] + names["velocity"],
    )  # fmt: skip
    omega = 2 * np.pi * np.array([1.0, 20.0, 1.01 * reduced.frequencies[0], 50.0, 100.0, 200.0, 300.0])
    found = np.asarray(system(1j * omega, squeeze=False))
    for w, H in zip(omega, np.moveaxis(found, 2, 0), strict=True):
        s, expected = 1j * w, reduced.transfer_function(1j * w)
        half = len(expected)
        for part, exact in ((H[:half], expected), (H[half:], s * expected)):
            assert np.abs(part - exact).max() < 1e-12 * np.abs(exact).max()
        descriptor = file["C"] @ np.linalg.solve(s * file["E"] - file["EA"], file["EB"])
        second_order = s * s * file["mass"] + s * file["damping"] + file["stiffness"]
        second_order = file["output_matrix"] @ np.linalg.solve(second_order, file["input_matrix"])
        for part in (descriptor, second_order):
            assert np.abs(part - expected).max() < 1e-12 * np.abs(expected).max()


def test_what_a_state_space_cannot_hold_is_refused_or_said():
    reduced = one_sided()
    with pytest.raises(InputError, match=r"loss factor 0.02\) has no meaning in time and no place in a state space"):
        state_space(replace(reduced, loss_factor=Structural(0.02).loss_factor))
    grows = state_space(replace(reduced, D=-reduced.D))
    assert f"the model is unstable: {2 * reduced.size} poles" in str(grows["comment"])


def test_a_free_body_that_carries_a_rotor_is_not_called_unstable():
    """Gyroscopic terms take no power; round-off spreads double zeros of rigid-body motions to both half-planes."""
    with block_with_ends(MPI.COMM_SELF) as model:
        K, M = to_dense(model.K), to_dense(model.M)
        turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        D = 20.0 * M @ np.kron(np.eye(len(M) // 3), turn)
        interfaces = [item.definition for item in model.interfaces]
        plain = hpcred.SecondOrderModel.from_scipy(K, M, (D - D.T) / 2, MPI.COMM_SELF, dofs=model.dofs)
    with plain, plain.with_interfaces(interfaces) as marked:
        spun = marked.with_inputs([(item.name, "all") for item in interfaces])
    basis, settings = [CraigBampton(count=25)], {"coordinates": "interface"}
    with spun, hpcred.reduce(spun, basis, Buckens(), GivenDamping(), **settings) as rom:
        assert rom.rigid_size == 6
        assert "unstable" not in str(state_space(rom)["comment"])
