"""The file for Exudyn: Exudyn itself moves the body, and what its file does not hold is said."""

import re
from dataclasses import replace

import numpy as np
import pytest

import hpcred
from hpcred import Buckens, Joint, ModalDamping, Modes, Rayleigh, Simulation, StaticCorrection
from hpcred.formats.exudyn import rayleigh_coefficients, write_exudyn
from hpcred.model.damping import Structural
from hpcred.multibody.body import body_of
from hpcred.multibody.node_shapes import NodeShape
from hpcred.multibody.rotations import rotation, skew
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


def interface_of(shapes, node):
    """The shape of a reference node at the centre of others, which follows them by least squares."""
    place = np.mean([shape.position for shape in shapes], axis=0)
    arms = [skew(shape.position - place) for shape in shapes]
    inertia = sum(arm.T @ arm for arm in arms)
    psi = np.linalg.solve(inertia, sum(arm @ shape.phi for arm, shape in zip(arms, shapes, strict=True)))
    return NodeShape(node, place, np.mean([shape.phi for shape in shapes], axis=0), psi, True)


def test_exudyn_swings_a_pendulum_as_we_do(tmp_path):
    """A soft block on a revolute joint at the middle of one end face, an averaging interface of its four corners."""
    exudyn = pytest.importorskip("exudyn")
    from exudyn.FEM import ObjectFFRFreducedOrderInterface
    from exudyn.itemInterface import GenericJoint, MarkerBodyRigid, MarkerSuperElementRigid, ObjectGround

    edges, end = [1.0, 0.1, 0.1], 0.6
    with hpcred.solid((6, 1, 1), edges, 3, False, young=2e7) as model:
        corners, tip = [1, 2, 3, 4], 28
        inputs = [(node, direction) for node in corners for direction in "xyz"]
        with (
            model.with_inputs(inputs) as loaded,
            hpcred.reduce(loaded, [Modes(index=(7, 8, 9)), StaticCorrection()], Buckens(), Rayleigh(0.0, 1e-3)) as rom,
        ):
            body = body_of(loaded, rom, [*corners, tip])
    note = write_exudyn(tmp_path / "body.npz", body)[-1]
    beta = float(re.search(r"stiffnessProportionalDamping = ([^,]+)", note)[1])
    hinge = interface_of(body.nodes[:4], 99)
    interface = ObjectFFRFreducedOrderInterface()
    interface.LoadFromFile(str(tmp_path / "body.npz"))
    mbs = exudyn.SystemContainer().AddSystem()
    own = interface.AddObjectFFRFreducedOrder(mbs, positionRef=[0, 0, 0], gravity=[0, 0, -9.81],
                                              stiffnessProportionalDamping=beta)  # fmt: skip
    ground = mbs.AddMarker(MarkerBodyRigid(bodyNumber=mbs.AddObject(ObjectGround()), localPosition=hinge.position))
    face = mbs.AddMarker(MarkerSuperElementRigid(
        bodyNumber=own["oFFRFreducedOrder"], meshNodeNumbers=[0, 1, 2, 3], weightingFactors=[0.25] * 4,
        useAlternativeApproach=True, rotationsExponentialMap=2,
    ))  # fmt: skip
    mbs.AddObject(GenericJoint(markerNumbers=[ground, face], constrainedAxes=[1, 1, 1, 1, 0, 1]))
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = 1000, end
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.9
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    mbs.SolveDynamic(settings)
    theirs = [
        mbs.GetObjectOutputSuperElement(own["oFFRFreducedOrder"], exudyn.OutputVariableType.Position, node)
        for node in (0, 4)
    ]
    joint = Joint("hinge", kind="revolute", axis=(0.0, 1.0, 0.0))
    setup = Simulation(end=end, gravity=(0.0, 0.0, -9.81), constraint=(joint,), steps=20, relative_tolerance=1e-6,
                       absolute_tolerance=1e-9)  # fmt: skip
    ours = simulate(replace(body, nodes=[*body.nodes, hinge], names={"hinge": 99}), setup)
    places = ours.node_position[-1][[0, 4]]
    assert places == pytest.approx(np.array(theirs), abs=2e-6)
    assert np.linalg.norm(ours.node_displacement[-1, 4]) > 1.0
    assert np.abs(ours.elastic @ hinge.psi.T).max() > 0.03  # rad: more than linear rotations could hide
    assert ours.balance < 1e-4 and ours.rotation_drift < 1e-6


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
