"""Geometric stiffness from stresses of solids: closed forms, the choice of the support, and refusals."""

import numpy as np
import pytest
from helpers import block_from, block_with_ends, columns_of, dense_model, face, gather
from solid_meshes import mesh, model_of, stiffness

import hpcred
from hpcred import Buckens, Chord, Modes, Tangent
from hpcred.body.geometric_stiffness import VELOCITIES
from hpcred.body.stress_stiffness import assembled, node_stiffness
from hpcred.body.unit_states import geometric_stiffness
from hpcred.fe import Material
from hpcred.fe.element_rows import element_rows
from hpcred.fe.element_rules import RULES, rule_of
from hpcred.fe.shape_functions import gradients_in_space, integration_points, shape_functions
from hpcred.linalg.blocks import apply, create_block, local_rows
from hpcred.model.rigid_body.modes import rigid_body_quantities, rigid_motions
from hpcred.parallel.failures import InputError

TYPES = [("CalculiX", name, kind) for name, kinds in RULES["CalculiX"].items() for kind in kinds]
TYPES += [("Abaqus", "C3D8", "hexahedron")]
STRESS = np.array([3.0, -1.0, 2.0, 0.5, -0.7, 1.1])  # xx, yy, zz, xy, yz, zx


def ends(length, kind="rigid"):
    return [face("left", 0.0, kind=kind), face("right", length, kind=kind)]


@pytest.mark.mpi
@pytest.mark.parametrize(("program", "type_", "kind"), TYPES)
def test_stiffness_of_a_constant_stress(comm, program, type_, kind):
    """u^T K_sigma u of displacements u = G x is the volume times sigma : G^T G, on any mesh."""
    points, elements = mesh(kind, distortion=0.2)
    gradient = np.random.default_rng(1).normal(size=(3, 3))
    steel = Material(name="steel", young=2e11, poisson=0.3)
    with model_of(kind, program, type_, points, elements, steel, comm) as model:
        rule = rule_of(program, type_, kind)
        cells = element_rows(model)[kind]
        mean = rule.strain == "mean"
        count = 1 if mean else len(integration_points(kind, rule.scheme)[1])
        stress = np.broadcast_to(STRESS[:, None], (len(cells.nodes), count, 6, 1))
        matrix = assembled(model, [(node_stiffness(kind, rule, cells.position, stress)[0], cells.rows)])
        block, product = block_from(model.K, (points @ gradient.T).reshape(-1, 1)), create_block(model.K, 1)
        apply(matrix, block, product)
        found = gather(block).ravel() @ gather(product).ravel()
        for item in (block, product, matrix):
            item.destroy()
    xx, yy, zz, xy, yz, zx = STRESS
    tensor = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
    volume = _volume(kind, "full" if mean else rule.scheme, points, elements)
    assert found == pytest.approx(volume * np.trace(tensor @ gradient.T @ gradient), rel=1e-10)


def _volume(kind, scheme, points, elements):
    """The volume of a mesh by its integration points."""
    places, weights = integration_points(kind, scheme)
    _, determinant = gradients_in_space(shape_functions(kind, places)[1], points[elements])
    return float((determinant * weights).sum())


def equilibrium(model, values):
    """The acceleration and angular acceleration of a rigid body about the origin under forces at its ends."""
    body = rigid_body_quantities(model)
    w = values["w"]
    centre = body.centre
    inertia = body.inertia + body.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    skew = np.cross(centre, np.eye(3)).T
    mass = np.block([[body.mass * np.eye(3), -body.mass * skew], [body.mass * skew, inertia]])
    force = sum(f for _, f in values["forces"])
    moment = sum(np.cross(at, f) for at, f in values["forces"])
    force = force - body.mass * np.cross(w, np.cross(w, centre))
    moment = moment - np.cross(w, inertia @ w)
    return np.linalg.solve(mass, np.concatenate([force, moment]))


@pytest.mark.mpi
@pytest.mark.costly
def test_the_support_does_not_count_where_loads_and_inertia_are_in_equilibrium(comm):
    """Sums of states by inertia relief, by clamps at either end, and by three nodes, of one basis."""
    rng = np.random.default_rng(5)
    with hpcred.solid((6, 2, 2), (0.6, 0.1, 0.08), 3, False, comm) as plain, plain.with_interfaces(ends(0.6)) as model:
        with hpcred.reduce(model, [Modes(count=4)], Buckens()) as rom:
            frames = [Buckens(), Tangent("left"), Tangent("right"), Chord((10, 46, 12))]
            found = [geometric_stiffness(model, rom.columns, frame, origin=(0.1, 0.0, 0.02)) for frame in frames]
        at = {item.name: np.array(item.position) - [0.1, 0.0, 0.02] for item in model.interfaces}
        w, forces = rng.normal(size=3) * 100, {name: rng.normal(size=3) * 1e4 for name in at}
        with plain.with_fields() as moved:
            shifted = hpcred.Dofs(moved.dofs.node, moved.dofs.direction, moved.dofs.position - [0.1, 0.0, 0.02])
            with moved.with_fields(dofs=shifted) as there:
                a = equilibrium(there, {"w": w, "forces": [(at[name], force) for name, force in forces.items()]})
    values = dict(zip(("ax", "ay", "az", "alphax", "alphay", "alphaz"), a, strict=True))
    values |= {f"w{d}^2": x * x for d, x in zip("xyz", w, strict=True)}
    values |= {"wx wy": w[0] * w[1], "wy wz": w[1] * w[2], "wx wz": w[0] * w[2]}
    values |= {f"{name}:{d}": x for name, force in forces.items() for d, x in zip("xyz", force, strict=True)}
    sums = [item.sum({key: value for key, value in values.items() if key in item.states}) for item in found]
    assert "ax" not in found[0].states and "left:x" not in found[1].states and "right:ry" not in found[2].states
    for other in sums[1:]:
        assert other == pytest.approx(sums[0], abs=1e-8 * np.abs(sums[0]).max())
    single = [item.of(["wz^2"])[0] for item in found]
    assert np.abs(single[1] - single[0]).max() > 0.1 * np.abs(single[0]).max()


def test_a_column_buckles_at_the_load_of_euler(comm):
    """det(K - P K_sigma) = 0 for a clamped column: P = pi^2 EI / (2 L)^2."""
    with (
        hpcred.solid((60, 1, 1), (1.0, 0.02, 0.02), 3, False, comm, poisson=0.0) as plain,
        plain.with_interfaces(ends(1.0)) as model,
        hpcred.reduce(model, [Modes(count=6)], Tangent("left")) as rom,
    ):
        pull = geometric_stiffness(model, rom.columns, Tangent("left")).of(["right:x"])[0]
        # bending stiffness as the mesh has it, from the first frequency of the same clamped beam
        stiff = (2 * np.pi * rom.frequencies[0]) ** 2 * 7850 * 0.02**2 / (1.8751041 / 1.0) ** 4
    loads = np.linalg.eigvals(np.linalg.solve(pull, rom.K))
    assert np.sort(loads.real)[0] == pytest.approx(np.pi**2 * stiff / 4, rel=1e-2)


def test_flapping_of_a_blade_rises_with_its_speed():
    """Southwell's coefficient of a clamped uniform beam is 1.193 for flapping, and 1 less in the plane of rotation."""
    with (
        hpcred.solid((40, 2, 2), (1.0, 0.02, 0.03), 3, False, poisson=0.0) as plain,
        plain.with_interfaces(ends(1.0)) as model,
        hpcred.reduce(model, [Modes(count=2)], Tangent("left")) as rom,
    ):
        found = geometric_stiffness(model, rom.columns, Tangent("left"))
    for state in ("wz^2", "wy^2"):
        assert np.diag(found.of([state])[0]) == pytest.approx(1.193, rel=3e-3)


@pytest.mark.mpi
@pytest.mark.costly
def test_averaging_interfaces_and_nodes_of_solids(comm):
    """The sum of forces at all nodes of an end is a force at its interface, as is the stress."""
    with (
        hpcred.solid((4, 1, 1), (0.4, 0.1, 0.1), 3, False, comm) as plain,
        plain.with_interfaces(ends(0.4, "averaging")) as model,
        hpcred.reduce(model, [Modes(count=4)], Buckens()) as rom,
    ):
        nodes = [17, 18, 19, 20, "right", "left"]
        found = geometric_stiffness(model, rom.columns, Buckens(), nodes=nodes)
        default = geometric_stiffness(model, rom.columns, Buckens())
    single = found.of([f"{node}:x" for node in nodes[:4]]).sum(axis=0) / 4
    assert single == pytest.approx(found.of(["right:x"])[0], abs=1e-8 * np.abs(single).max())
    assert default.of(["left:ry"])[0] == pytest.approx(found.of(["left:ry"])[0])
    assert default.states[-12:] == tuple(f"{end}:{d}" for end in ("left", "right")
                                         for d in ("x", "y", "z", "rx", "ry", "rz"))  # fmt: skip


@pytest.mark.mpi
@pytest.mark.costly
def test_what_has_no_geometric_stiffness_of_its_own(comm):
    with (
        hpcred.linkage(comm) as model,
        hpcred.reduce(model, [Modes(index=(7, 8))], Buckens()) as rom,
        pytest.raises(InputError, match=r"geometric stiffness: .*expected solids.*of beams, shells and other elements"),
    ):
        geometric_stiffness(model, rom.columns, Buckens())
    with (
        hpcred.solid((3, 2, 2), None, 3, True, comm) as whole,
        whole.with_fields(held=None) as model,  # without the elements beside the clamp
        hpcred.reduce(model, [Modes(count=2)]) as rom,
        pytest.raises(InputError, match=r"the strain energy of the solid elements of solid is 0\.\d+ of that of K"),
    ):
        geometric_stiffness(model, rom.columns)
    with (
        hpcred.solid((3, 2, 2), None, 3, False, comm) as model,
        hpcred.reduce(model, [Modes(count=2)], Buckens()) as rom,
    ):
        with pytest.raises(InputError, match="'crank' is no interface of solid"):
            geometric_stiffness(model, rom.columns, Buckens(), nodes=["crank"])
        with pytest.raises(InputError, match="node 1000 does not exist"):
            geometric_stiffness(model, rom.columns, Buckens(), nodes=[1000])
        with (
            model.with_material(Material(name="soft", young=1e9, poisson=0.3)) as soft,
            pytest.raises(InputError, match="or other materials"),
        ):
            geometric_stiffness(soft, rom.columns, Buckens())


@pytest.mark.mpi
def test_a_mechanism_has_no_stress_under_unit_loads(comm):
    """Two elements that meet at one edge: a hinge, which no frame holds."""
    points = np.array([[x, y, z] for x in (0, 1, 2) for y in (0, 1) for z in (0, 1)], float)
    cells = np.array([[0, 4, 6, 2, 1, 5, 7, 3], [4, 8, 10, 6, 5, 9, 11, 7]])
    # the second element has the edge at y = 0 in common only
    points = np.concatenate([points, points[[6, 7]] + [0.1, 0, 0]])
    cells[1, [3, 7]] = [12, 13]
    steel = Material(name="steel", young=2e11, poisson=0.3)
    K = stiffness("hexahedron", rule_of("hpcred", "hexahedron", "hexahedron"), points, cells, 2e11, 0.3)
    with (
        model_of("hexahedron", "hpcred", "hexahedron", points, cells, steel, comm, K=K) as model,
        model.with_inputs([(1, "x")]) as model,
    ):
        block = create_block(model.K, 1)
        with local_rows(block) as rows:
            rows[...] = 1.0
        with pytest.raises(InputError, match="geometric stiffness: K of model is singular on the support of the frame"):
            geometric_stiffness(model, block, Buckens())
        block.destroy()


@pytest.mark.mpi
def test_stresses_turn_with_the_body(comm):
    """K_sigma of a rotation by theta is theta x f, node by node, for the forces f that a state has in equilibrium: all
    states of a free body in interface coordinates, whose basis has the rotations; f by numpy."""
    with block_with_ends(comm) as model:
        basis = [hpcred.reduction.ConstraintModes(), hpcred.reduction.FixedInterfaceModes(count=3)]
        rom = hpcred.reduce(model, basis, Buckens(), coordinates="interface")
        found = hpcred.geometric_stiffness(model, rom.columns, Buckens())
        V, R, B = gather(rom.columns), gather(rigid_motions(model)), columns_of(model.B)
        _, M, _ = dense_model(model)
        x, names = np.concatenate(comm.allgather(model.dofs.position))[::3], model.input_names
    turns = np.linalg.lstsq(V, R[:, 3:], rcond=None)[0]
    assert np.abs(V @ turns - R[:, 3:]).max() < 1e-10
    assert found.states == (*VELOCITIES, *names)
    for state, matrix in zip(found.states, found.matrices, strict=True):
        if state in names:
            f = B[:, names.index(state)]
        else:
            a, b = ("xyz".index(letter) for letter in state.replace("^2", state[1]) if letter in "xyz")
            W = np.zeros((3, 3))
            W[a, b] = W[b, a] = 1.0
            f = -M @ (x @ W - x * (a == b)).ravel()  # of w x (w x r) = w (w . r) - r w^2
        f = f - M @ R @ np.linalg.solve(R.T @ M @ R, R.T @ f)
        expected = np.stack([V.T @ np.cross(axis, f.reshape(-1, 3)).ravel() for axis in np.eye(3)], axis=1)
        assert matrix @ turns == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
