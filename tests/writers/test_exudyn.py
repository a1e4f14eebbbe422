"""The file for Exudyn: Exudyn itself moves the body, and what its file does not hold is said."""

import re

import numpy as np
import pytest
from docs_pages import DOCS
from helpers import bar, exported

import hpcred
from hpcred import Buckens, Krylov, ModalDamping, Modes, Rayleigh, Simulation
from hpcred.body.body import body_of
from hpcred.body.node_shapes import interface_nodes
from hpcred.body.rotations import rotation
from hpcred.examples.linkage import Rod
from hpcred.fe.elements import surface_triangles
from hpcred.model.damping import Structural
from hpcred.model.interfaces.nodes import Interface, Nodes
from hpcred.parallel.failures import InputError
from hpcred.parallel.petsc import MPI
from hpcred.simulation import Joint
from hpcred.simulation.simulation import simulate
from hpcred.workflows.export import export_result
from hpcred.writers.exudyn import Exudyn


def body_with(damping):
    with (
        hpcred.linkage() as model,
        hpcred.reduce(model, [Modes(index=tuple(range(7, 13)))], Buckens(), damping) as rom,
    ):
        return body_of(model, rom, [1, 7, 14, 20])


@pytest.mark.peers("exudyn")
@pytest.mark.slow
def test_exudyn_moves_the_body_as_we_do(tmp_path):
    """The linkage spinning freely with damped vibrations: Exudyn's reduced-order object against our simulation."""
    import exudyn
    from exudyn.FEM import ObjectFFRFreducedOrderInterface

    body = body_with(ModalDamping(ratio=0.02))
    notes = exported(Exudyn, tmp_path / "body.npz", body)
    assert any("SetObjectParameter(object, 'dampingMatrixReduced'" in note for note in notes)
    spin, push, size, end = (4.0, 20.0, 12.0), (0.1, 0.0, 0.3), body.reduced.size, 0.1
    interface = ObjectFFRFreducedOrderInterface()
    interface.LoadFromFile(str(tmp_path / "body.npz"))
    mbs = exudyn.SystemContainer().AddSystem()
    own = interface.AddObjectFFRFreducedOrder(
        mbs, positionRef=[0, 0, 0], initialVelocity=list(push), initialAngularVelocity=list(spin),
        gravity=[0, 0, -9.81],
    )  # fmt: skip
    damping = exudyn.MatrixContainer(np.load(tmp_path / "body.npz")["dampingMatrixReduced"])
    mbs.SetObjectParameter(own["oFFRFreducedOrder"], "dampingMatrixReduced", damping)
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


def pendulum(kind):
    """A body and its node to hang it on; how long it swings (s), least elastic rotation (rad), tolerance (m).

    The mean of directions, by which the integrals of beams are taken, is used in other places by Exudyn than by us.
    """
    if kind == "linkage":
        with (
            hpcred.linkage() as model,
            hpcred.reduce(model, [Modes(index=tuple(range(7, 13)))], Buckens(), Rayleigh(2.0, 1e-4)) as rom,
        ):
            return body_of(model, rom, [1, 14]), 1, 0.2, 1e-3, 3e-5
    face = Nodes(box=((-1e-6, -1, -1), (1e-6, 1, 1)))
    with (
        hpcred.solid((6, 1, 1), [1.0, 0.1, 0.1], 3, False, young=2e7) as block,
        block.with_interfaces([Interface(name="hinge", nodes=face)]) as plain,
        plain.with_inputs([("hinge", "all")]) as model,
        hpcred.reduce(model, [Modes(index=(7, 8, 9)), Krylov(frequency=0.0)], Buckens(), Rayleigh(0.0, 1e-3)) as rom,
    ):
        return body_of(model, rom, [28, *interface_nodes(model)]), "hinge", 0.6, 0.03, 1e-6


@pytest.mark.peers("exudyn")
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["linkage", "interface of a solid"])
def test_exudyn_swings_a_pendulum_as_we_do(tmp_path, kind):
    """Falling from rest on a revolute joint; rotations of markers by the exponential map, as ours."""
    import exudyn
    from exudyn import itemInterface as items
    from exudyn.FEM import ObjectFFRFreducedOrderInterface

    body, hinge, end, bending, tolerance = pendulum(kind)
    exported(Exudyn, tmp_path / "body.npz", body)
    file = np.load(tmp_path / "body.npz")
    place = file["names"].tolist().index(str(hinge))
    interface = ObjectFFRFreducedOrderInterface()
    interface.LoadFromFile(str(tmp_path / "body.npz"))
    mbs = exudyn.SystemContainer().AddSystem()
    own = interface.AddObjectFFRFreducedOrder(mbs, positionRef=[0, 0, 0], gravity=[0, 0, -9.81])["oFFRFreducedOrder"]
    mbs.SetObjectParameter(own, "dampingMatrixReduced", exudyn.MatrixContainer(file["dampingMatrixReduced"]))
    ground = mbs.AddMarker(items.MarkerBodyRigid(
        bodyNumber=mbs.AddObject(items.ObjectGround()), localPosition=body.nodes[place].position.tolist()
    ))  # fmt: skip
    marker = mbs.AddMarker(items.MarkerSuperElementRigid(
        bodyNumber=own, meshNodeNumbers=file["markerNodes"][place].tolist(), weightingFactors=[0.25] * 4,
        useAlternativeApproach=True, rotationsExponentialMap=2,
    ))  # fmt: skip
    mbs.AddObject(items.GenericJoint(markerNumbers=[ground, marker], constrainedAxes=[1, 1, 1, 1, 0, 1]))
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = 1000, end
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.9
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    mbs.SolveDynamic(settings)
    theirs = [mbs.GetObjectOutputSuperElement(own, exudyn.OutputVariableType.Position, node) for node in (0, 1)]
    joint = Joint(hinge, kind="revolute", axis=(0.0, 1.0, 0.0))
    setup = Simulation(end=end, gravity=(0.0, 0.0, -9.81), constraint=(joint,), steps=20, relative_tolerance=1e-6,
                       absolute_tolerance=1e-9)  # fmt: skip
    ours = simulate(body, setup)
    assert ours.node_position[-1] == pytest.approx(np.array(theirs), abs=tolerance)
    assert np.linalg.norm(ours.node_displacement[-1], axis=1).max() > 0.1
    assert np.abs(ours.elastic @ body.nodes[place].psi.T).max() > bending  # rad
    assert ours.balance < 1e-4 and ours.rotation_drift < 1e-6


@pytest.mark.peers("exudyn")
@pytest.mark.parametrize("node", ["1", "14", "20"])
def test_the_page_hangs_a_body_on_any_node(tmp_path, monkeypatch, node):
    """The program of the page for another node than the first: the hinge is where the node is, and holds."""
    exported(Exudyn, tmp_path / "result_exudyn.npz", body_with(Rayleigh(2.0, 1e-4)))
    monkeypatch.chdir(tmp_path)
    program = re.search(r"```python\n(.*?)```", (DOCS / "export-exudyn.md").read_text(), re.S)[1]
    assert program.count('"20"') == 1
    exec(compile(program.replace('"20"', f'"{node}"'), "export-exudyn.md", "exec"), names := {})
    names["mbs"].Assemble()
    ends = [names["mbs"].GetMarkerOutput(names[key], names["exudyn"].OutputVariableType.Position)
            for key in ("ground", "bearing")]  # fmt: skip
    assert ends[0] == pytest.approx(ends[1], abs=1e-12)
    with hpcred.linkage() as model:
        place = model.dofs.position[model.dofs.node == int(node)][0]
    assert ends[1] == pytest.approx(place, abs=1e-12)


def bent(path, held, loaded, moment):
    """Rotation and displacement (3,) of a node by Exudyn under a moment (3,), with another node held."""
    import exudyn
    from exudyn import itemInterface as items
    from exudyn.FEM import ObjectFFRFreducedOrderInterface

    file = np.load(path)
    names = file["names"].tolist()
    interface = ObjectFFRFreducedOrderInterface()
    interface.LoadFromFile(str(path))
    mbs = exudyn.SystemContainer().AddSystem()
    own = interface.AddObjectFFRFreducedOrder(mbs, positionRef=[0, 0, 0])["oFFRFreducedOrder"]
    places = [file["xRef"].reshape(-1, 3)[names.index(name)] for name in (held, loaded)]
    markers = [
        mbs.AddMarker(items.MarkerSuperElementRigid(
            bodyNumber=own, meshNodeNumbers=file["markerNodes"][names.index(name)].tolist(), weightingFactors=[0.25] * 4
        ))
        for name in (held, loaded)
    ]  # fmt: skip
    body = mbs.AddObject(items.ObjectGround())
    ground = mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=body, localPosition=places[0].tolist()))
    mbs.AddObject(items.GenericJoint(markerNumbers=[ground, markers[0]]))
    mbs.AddLoad(items.LoadTorqueVector(markerNumber=markers[1], loadVector=moment.tolist()))
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    settings.staticSolver.verboseMode = 0
    mbs.SolveStatic(settings)
    turned = np.array(mbs.GetMarkerOutput(markers[1], exudyn.OutputVariableType.RotationMatrix)).reshape(3, 3)
    angles = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2
    return angles, np.array(mbs.GetMarkerOutput(markers[1], exudyn.OutputVariableType.Position)) - places[1]


def test_a_moment_turns_a_node_and_a_joint_holds_one(tmp_path):
    """A beam held at one end, with a moment at the other: M L / EI, by markers on the four points around each node."""
    length, rod, moment = 0.5, Rod(), np.array([1.0, 2.0, 3.0])
    inputs = [(node, d) for node in (1, 9) for d in ("x", "y", "z", "rx", "ry", "rz")]
    basis = [Modes(index=tuple(range(7, 13))), Krylov(frequency=0.0)]
    with (
        bar(MPI.COMM_WORLD, length, 8).with_inputs(inputs) as model,
        hpcred.reduce(model, basis, Buckens()) as rom,
    ):
        body = body_of(model, rom, [9, 4, 1])
    body.nodes[1].rotates = False
    notes = exported(Exudyn, tmp_path / "body.npz", body)
    assert any(note.startswith("rotations of nodes 9, 1: by MarkerSuperElementRigid") for note in notes)
    assert np.load(tmp_path / "body.npz")["markerNodes"][1].tolist() == [-1] * 4
    turned, moved = bent(tmp_path / "body.npz", "1", "9", moment)
    bending = rod.young * rod.second_moment
    torsion = rod.young / (1 + rod.poisson) * rod.second_moment
    angles = moment * length / np.array([torsion, bending, bending])
    assert turned == pytest.approx(angles, rel=1e-3)
    assert moved[1:] == pytest.approx([angles[2] * length / 2, -angles[1] * length / 2], rel=1e-3)


def test_interfaces_of_a_solid_take_moments(tmp_path):
    """Both ends of a bar of bricks as averaging interfaces: Exudyn's static solution is that of the reduced model."""
    faces = {"left": 0.0, "right": 0.06}
    interfaces = [Interface(name=name, nodes=Nodes(box=((x - 1e-6, -1, -1), (x + 1e-6, 1, 1))))
                  for name, x in faces.items()]  # fmt: skip
    with (
        hpcred.solid((6, 2, 2), clamped=False, inputs=3).with_interfaces(interfaces) as plain,
        plain.with_inputs([("left", "all"), ("right", "all")]) as model,
        hpcred.reduce(model, [Krylov(frequency=0.0)], Buckens()) as rom,
    ):
        body = body_of(model, rom)
    exported(Exudyn, tmp_path / "body.npz", body)
    moment = np.array([1.0, -2.0, 3.0])
    turned, moved = bent(tmp_path / "body.npz", "left", "right", moment)
    # of the reduced model: K q = (psi_R - psi_L)^T M, seen from the left end
    left, right = body.nodes
    twist = right.psi - left.psi
    q = np.linalg.solve(body.reduced.K, twist.T @ moment)
    assert turned == pytest.approx(twist @ q, rel=1e-4)
    arm = right.position - left.position
    assert moved == pytest.approx((right.phi - left.phi) @ q - np.cross(left.psi @ q, arm), abs=1e-4 * abs(moved).max())
    assert abs(turned).min() > 1e-7


def of_bricks(folder):
    """The export of a block of bricks, and the lengths of the block."""
    with (
        hpcred.solid((4, 2, 2), inputs=3) as model,
        hpcred.reduce(model, [Krylov(frequency=0.0)]) as rom,
    ):
        hpcred.write_result(folder / "result.h5", rom, model)
        lengths = np.ptp(model.dofs.position, axis=0) * [4 / 3, 1, 1]  # held nodes have no dofs
        return export_result(folder / "result.h5", "exudyn"), lengths


def test_the_surface_that_is_drawn(tmp_path):
    """Of a block of bricks: closed, of the right size, and it moves as its nodes do."""
    report, lengths = of_bricks(tmp_path)
    assert not any("no surface" in note for note in report["remarks"])
    file = np.load(report["output"])
    points, triangles = file["xRef"].reshape(-1, 3), file["trigList"]
    assert len(triangles) == 4 * (4 * 2 + 2 * 2 + 4 * 2)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a) / 2
    areas = lengths[[1, 2, 0]] * lengths[[2, 0, 1]]
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(2 * areas.sum())
    assert normals.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12 * areas.sum())
    assert np.einsum("ti,ti->", a, normals) / 3 == pytest.approx(np.prod(lengths))  # normals look outward
    shapes = dict(zip(map(tuple, points.round(9)), file["modeBasis"].reshape(len(points), 3, -1), strict=True))
    corner = hpcred.read_result(tmp_path / "result.h5").body([36]).nodes[0]
    assert np.array_equal(shapes[tuple(corner.position.round(9))], corner.phi) and corner.phi.any()


@pytest.mark.peers("exudyn")
def test_exudyn_reads_the_surface(tmp_path):
    from exudyn.FEM import ObjectFFRFreducedOrderInterface

    path = of_bricks(tmp_path)[0]["output"]
    interface = ObjectFFRFreducedOrderInterface()
    interface.LoadFromFile(str(path))
    file = np.load(path)
    assert interface.nNodes == len(file["xRef"]) // 3 and interface.trigList == file["trigList"].tolist()


@pytest.mark.parametrize("kind, cells, count", [
    ("tetra10", [[0, 1, 2, 3, *range(10, 16)], [1, 2, 3, 4, *range(16, 22)]], 6),
    ("wedge", [[0, 1, 2, 3, 4, 5]], 2 + 3 * 2),
    ("pyramid", [[0, 1, 2, 3, 4]], 4 + 2),
    ("hexahedron", [[0, 1, 2, 2, 4, 5, 6, 6]], 2 + 3 * 2),  # a wedge by corners put together
    ("quad8", [[0, 1, 2, 3, 4, 5, 6, 7]], 2),
    ("line", [[0, 1]], 0),
])  # fmt: skip
def test_faces_of_other_elements(kind, cells, count):
    assert len(surface_triangles({kind: np.array(cells)})) == count


def test_what_the_file_has_no_place_for_is_said(tmp_path):
    notes = exported(Exudyn, tmp_path / "body.npz", body_with(None))
    assert not [line for line in notes if "damping" in line]
    assert notes[-2:] == ["no surface is drawn: the result has no faces, no basis, or too many dofs",
                          "no stresses: the result has no stress modes, or those of too many nodes"]  # fmt: skip
    with pytest.raises(InputError, match=r"loss factor 0.02\) has no .* place in a file for Exudyn"):
        exported(Exudyn, tmp_path / "body.npz", body_with(Structural(0.02)))


@pytest.mark.peers("exudyn")
@pytest.mark.slow
def test_exudyn_moves_the_body_under_a_load_as_we_do(tmp_path):
    """A traction on a face of a spinning block by the user function of docs/export-exudyn.md, against simulate."""
    import exudyn
    from exudyn.FEM import ObjectFFRFreducedOrderInterface
    from exudyn.rigidBodyUtilities import EulerParameters2GLocal, EulerParameters2RotationMatrix

    end = Nodes(box=((0.059, -1.0, -1.0), (0.061, 1.0, 1.0)))
    side = hpcred.loads.Traction(name="side", on=end, value=(0.0, 1e8, 5e7))
    with (
        hpcred.solid((6, 2, 3), clamped=False, inputs=1) as model, model.with_loads([side]) as loaded,
        hpcred.reduce(loaded, [Modes(count=4), hpcred.StaticCorrection()], Buckens(), ModalDamping(ratio=0.02)) as rom,
    ):  # fmt: skip
        body = body_of(loaded, rom, origin=(0.02, 0.01, 0.0))
    notes = exported(Exudyn, tmp_path / "body.npz", body)
    assert "inputs side: by a user function with inputMatrixReduced and inputResultants" in notes
    assert "outputs that belong to no node are left out: side" in notes
    file = np.load(tmp_path / "body.npz", allow_pickle=True)
    interface = ObjectFFRFreducedOrderInterface()
    interface.LoadFromFile(str(tmp_path / "body.npz"))
    mbs = exudyn.SystemContainer().AddSystem()
    own = interface.AddObjectFFRFreducedOrder(mbs, positionRef=[0, 0, 0], initialAngularVelocity=[5, 10, 3])
    item = own["oFFRFreducedOrder"]
    mbs.SetObjectParameter(item, "dampingMatrixReduced", exudyn.MatrixContainer(file["dampingMatrixReduced"]))
    k = list(file["inputNames"]).index("side")
    force, moment = np.split(file["inputResultants"][k], 2)

    def push(mbs, t, item, q, q_t):
        p = q[3:7] + np.array([1.0, 0.0, 0.0, 0.0])
        turned = EulerParameters2RotationMatrix(p) @ force, EulerParameters2GLocal(p).T @ moment
        return np.sin(2 * np.pi * 2000 * t) * np.concatenate([*turned, file["inputMatrixReduced"][:, k]])

    mbs.SetObjectParameter(item, "forceUserFunction", push)
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = 4000, 0.002
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    mbs.SolveDynamic(settings)
    theirs = np.array(mbs.GetNodeOutput(own["nGenericODE2"], exudyn.OutputVariableType.Coordinates))
    place = np.array(mbs.GetNodeOutput(own["nRigidBody"], exudyn.OutputVariableType.Position))
    setup = Simulation(end=0.002, steps=10, angular_velocity=(5.0, 10.0, 3.0),
                       load=(hpcred.simulation.SineLoad("side", 1.0, 2000.0),), relative_tolerance=1e-9,
                       absolute_tolerance=1e-13)  # fmt: skip
    ours = simulate(body, setup)
    assert ours.elastic[-1] == pytest.approx(theirs, abs=1e-2 * np.abs(ours.elastic).max())
    assert ours.position[-1] == pytest.approx(place, rel=1e-4)
    assert np.abs(ours.elastic[-1]).max() > 1e-8
