"""The file for Exudyn: Exudyn itself moves the body, and what its file does not hold is said."""

import re

import numpy as np
import pytest

import hpcred
from hpcred import Buckens, ModalDamping, Modes, Rayleigh, Simulation
from hpcred.formats.exudyn import rayleigh_coefficients, write_exudyn
from hpcred.model.damping import Structural
from hpcred.multibody.body import body_of
from hpcred.multibody.equations_of_motion import rotation
from hpcred.multibody.simulation import simulate
from hpcred.parallel.failures import InputError


def body_with(damping):
    with (
        hpcred.linkage() as model,
        hpcred.reduce(model, [Modes(index=tuple(range(7, 13)))], Buckens(), damping) as rom,
    ):
        return body_of(model, rom, [1, 7, 14, 20])


def test_exudyn_moves_the_body_as_we_do(tmp_path):
    """The linkage spinning freely with damped vibrations: Exudyn's reduced-order object against our simulation."""
    exudyn = pytest.importorskip("exudyn")
    from exudyn.FEM import ObjectFFRFreducedOrderInterface

    body = body_with(Rayleigh(40.0, 1e-5))
    note = write_exudyn(tmp_path / "body.npz", body)[-1]
    damping = {key: float(value) for key, value in re.findall(r"(\w+ProportionalDamping) = ([^,]+)", note)}
    assert len(damping) == 2
    spin, push, size, end = (4.0, 20.0, 12.0), (0.1, 0.0, 0.3), body.reduced.size, 0.1
    interface = ObjectFFRFreducedOrderInterface()
    interface.LoadFromFile(str(tmp_path / "body.npz"))
    mbs = exudyn.SystemContainer().AddSystem()
    own = interface.AddObjectFFRFreducedOrder(
        mbs, positionRef=[0, 0, 0], initialVelocity=list(push), initialAngularVelocity=list(spin),
        gravity=[0, 0, -9.81], **damping,
    )  # fmt: skip
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = 4000, end
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    mbs.SolveDynamic(settings)
    theirs = np.array(mbs.GetNodeOutput(own["nGenericODE2"], exudyn.OutputVariableType.Coordinates))
    place = np.array(mbs.GetNodeOutput(own["nRigidBody"], exudyn.OutputVariableType.Position))
    axes = np.array(mbs.GetNodeOutput(own["nRigidBody"], exudyn.OutputVariableType.RotationMatrix)).reshape(3, 3)
    setup = Simulation(end=end, gravity=(0.0, 0.0, -9.81), velocity=push, angular_velocity=spin, steps=10,
                       relative_tolerance=1e-8, absolute_tolerance=1e-12)  # fmt: skip
    ours = simulate(body, setup)
    assert theirs.shape == (size,)
    assert ours.elastic[-1] == pytest.approx(theirs, abs=2e-3 * np.abs(ours.elastic).max())
    assert ours.position[-1] == pytest.approx(place, abs=5e-6)
    assert rotation(ours.quaternion[-1]) == pytest.approx(axes, abs=1e-4)
    assert np.abs(ours.elastic[-1]).max() > 5e-5


@pytest.mark.parametrize("alpha, beta", [(2.0, 1e-5), (0.0, 1e-3), (30.0, 0.0), (1e-3, 1e-2)])
def test_coefficients_of_rayleigh_damping(alpha, beta):
    found = rayleigh_coefficients(body_with(Rayleigh(alpha, beta)).reduced)
    assert found == pytest.approx((alpha, beta), rel=1e-6, abs=0.0)


def test_damping_that_is_lost_is_said(tmp_path):
    (_, note) = write_exudyn(tmp_path / "body.npz", body_with(ModalDamping(ratio=0.02)))
    assert "no damping, and D is not alpha M + beta K, so that it is lost" in note
    assert not [line for line in write_exudyn(tmp_path / "body.npz", body_with(None)) if "damping" in line]
    with pytest.raises(InputError, match=r"loss factor 0.02\) has no .* place in a file for Exudyn"):
        write_exudyn(tmp_path / "body.npz", body_with(Structural(0.02)))
