"""Interface nodes against beam theory, against dense least squares, and against a model made rigid by hand."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from helpers import bar, block_with_ends, columns_of, dense_model, face, gather, rigid_motions_at, to_dense

import hpcred
from hpcred import Buckens, Interface, Modes, Nodes, StaticCorrection, Tangent
from hpcred.fe.elements import surface_areas
from hpcred.model.rigid_body.modes import rigid_motions

pytestmark = pytest.mark.mpi


def everywhere(model, key):
    return np.concatenate(model.comm.allgather(getattr(model.dofs, key)))


@pytest.mark.parametrize("kind", ["averaging", "rigid"])
def test_rigid_motion_of_the_body_moves_the_interfaces_with_it(comm, kind):
    with block_with_ends(comm, kind) as model:
        R = gather(rigid_motions(model))
        expected = rigid_motions_at([item.position for item in model.interfaces])
        assert np.abs(to_dense(model.Gt).T @ R - expected).max() < 1e-12
        assert model.input_names == tuple(f"{end}:{d}" for end in ("left", "right")
                                          for d in ("x", "y", "z", "rx", "ry", "rz"))  # fmt: skip
        assert np.array_equal(columns_of(model.B), to_dense(model.Gt))


def test_averaging_is_the_weighted_least_squares_rigid_motion(comm):
    """Against lstsq on the nodes of the set, with weights of any size and a place of its own, wherever the body is."""
    with hpcred.solid((2, 2, 1), clamped=False, comm=comm) as model:
        node, direction, position = (everywhere(model, key) for key in ("node", "direction", "position"))
        nodes, at, rng = (3, 7, 12, 16), np.array([0.03, -0.01, 0.02]), np.random.default_rng(1)
        weights = tuple(rng.uniform(1, 3, 4).tolist())
        heavy, away = tuple(1e6 * weight for weight in weights), np.array([0.0, -1e4, 0.0])
        far = model.with_fields(dofs=replace(model.dofs, position=model.dofs.position + away))
        marked = [body.with_interfaces([Interface(name="a", nodes=nodes, at=tuple(place), weights=given)])
                  for body, place, given in ((model, at, weights), (model, at, heavy), (far, at + away, weights))]
        u = rng.standard_normal(model.size)
        rows = [np.flatnonzero((node == n) & (direction == d))[0] for n in nodes for d in range(3)]
        E = np.concatenate([rigid_motions_at([position[row] - at])[:3] for row in rows[::3]])
        root = np.sqrt(np.repeat(weights, 3))
        expected = np.linalg.lstsq(root[:, None] * E, root * u[rows], rcond=None)[0]
        for one, digits in zip(marked, (1e-12, 1e-12, 1e-8), strict=True):
            assert np.abs(to_dense(one.Gt).T @ u - expected).max() < digits * np.abs(expected).max()


def test_weights_by_area_are_those_of_the_surface(comm):
    """A face of 2 x 3 equal cells: inner nodes have four quarters of a cell, edges two, corners one."""
    with hpcred.solid((3, 2, 3), clamped=False, comm=comm) as model:
        node, position = everywhere(model, "node"), everywhere(model, "position")
        nodes, first = np.unique(node[position[:, 0] < 1e-9], return_index=True)
        points = position[position[:, 0] < 1e-9][first]
        areas = surface_areas(comm, model.elements, nodes, points)
        assert areas.sum() == pytest.approx(0.02 * 0.03, rel=1e-12)
        quarters = np.round(areas / 0.25e-4)
        assert sorted(quarters) == [1] * 4 + [2] * 6 + [4] * 2
        assert np.allclose(areas, 0.25e-4 * quarters, rtol=1e-12)
        # the same face of tetrahedra, five a cell, and of quadrilaterals as a skin on the solid
        five = np.array([(0, 1, 3, 4), (1, 2, 3, 6), (4, 5, 6, 1), (4, 6, 7, 3), (1, 3, 4, 6)])
        bricks = model.elements["hexahedron"]
        split = {"tetra": bricks[:, five].reshape(-1, 4)}
        assert surface_areas(comm, split, nodes, points).sum() == pytest.approx(0.02 * 0.03, rel=1e-12)
        skinned = model.elements | {"quad": bricks[:, [0, 4, 7, 3]]}
        assert np.allclose(surface_areas(comm, skinned, nodes, points), areas, rtol=1e-12)
        equal = model.with_interfaces([face("a", 0.0)])
        area = model.with_interfaces([face("a", 0.0, weights="area")])
        assert np.allclose(equal.interfaces[0].position, area.interfaces[0].position)
        assert np.abs(to_dense(area.Gt) - to_dense(equal.Gt)).max() > 0.01


def test_the_place_of_a_bore_is_the_centre_of_its_surface(comm):
    """On an uneven ring of nodes by the sides of its polygon; without elements, and with weights, the mean."""
    with hpcred.crank(2000, comm) as model:
        bore = Interface(name="big", nodes=Nodes(set="BIG_EYE"))
        (node,) = model.with_interfaces([bore]).interfaces
        numbers = np.concatenate(comm.allgather(model.sets["BIG_EYE"]))
        points = np.unique(everywhere(model, "position")[np.isin(everywhere(model, "node"), numbers)], axis=0)
        assert node.count == len(points) == len(numbers)
        ring = np.unique(points[:, :2].round(12), axis=0)
        ring = ring[np.argsort(np.arctan2(ring[:, 1], ring[:, 0]))]
        following = np.roll(ring, -1, axis=0)
        length = np.linalg.norm(following - ring, axis=1)
        expected = length @ (ring + following) / 2 / length.sum()
        assert np.allclose(node.position, [*expected, 0.0], atol=1e-12)
        mean = points.mean(axis=0)
        assert np.linalg.norm(mean) > 5 * np.linalg.norm(node.position)  # the axis is at the origin
        bare = model.with_fields(elements={})
        assert np.allclose(bare.with_interfaces([bore]).interfaces[0].position, mean, atol=1e-12)
        three = tuple(numbers[[0, 4, 9]].tolist())
        given = Interface(name="a", nodes=three, weights=(1.0, 2.0, 5.0))
        where = everywhere(model, "position")[::3][[list(everywhere(model, "node")[::3]).index(n) for n in three]]
        assert np.allclose(model.with_interfaces([given]).interfaces[0].position, [1, 2, 5] @ where / 8)


def test_end_to_end_flexibility_is_that_of_beam_theory(comm):
    """A slender block clamped at one end, without lateral strain: within what the cells and Saint-Venant allow."""
    length, side, young = 0.32, 0.02, 2.1e11
    inertia = side**4 / 12
    beam = {
        "x": length / (young * side**2), "y": length**3 / (3 * young * inertia),
        "rx": length / (young / 2 * 0.1406 * side**4), "rz": length / (young * inertia),
    }  # fmt: skip
    found = {}
    for kind in ("averaging", "rigid"):
        with hpcred.solid((64, 4, 4), size=(length, side, side), poisson=0.0, comm=comm) as model:
            marked = model.with_interfaces([face("end", length, kind=kind)]).with_inputs([("end", "all")])
            H = hpcred.frequency_response(marked, [0.0])[0].real
        assert np.abs(H - H.T).max() < 1e-9 * np.abs(H).max()
        found[kind] = {name: H[i, i] for i, name in enumerate(("x", "y", "z", "rx", "ry", "rz")) if name in beam}
        for name, expected in beam.items():
            assert found[kind][name] == pytest.approx(expected, rel=0.06), (kind, name)
        # a moment about z moves the end sideways by l^2 / 2EI
        assert H[1, 5] == pytest.approx(length**2 / (2 * young * inertia), rel=0.06)
    assert all(found["rigid"][name] < found["averaging"][name] for name in beam)


@pytest.mark.parametrize("height", [0.03, 0.1, 0.7])
def test_a_flat_set_that_moves_in_its_plane_has_the_directions_of_the_plane(comm, height):
    """Its centre has round-off of the height, which is no arm."""
    with hpcred.solid((3, 2, 2), size=(0.03, 0.02, height), clamped=True, comm=comm) as model:
        top = Nodes(box=((0.001, 0.0, height * 0.99), (1.0, 1.0, height * 1.01)))
        marked = model.with_interfaces([Interface(name="top", nodes=top, kind="rigid", directions=("x", "y"))])
        assert marked.interfaces[0].directions == ("x", "y", "rz")


def test_numbers_of_reference_nodes_do_not_collide(comm):
    with hpcred.solid((4, 2, 2), comm=comm) as model:
        marked = model.with_interfaces([face("a", 0.04, node=37), face("b", 0.02)])
        assert [item.node for item in marked.interfaces] == [37, 46]  # 38 to 45 are held
        assert marked.with_interfaces([]).interfaces == ()


@pytest.mark.parametrize("directions", [("x", "y", "z", "rx", "ry", "rz"), ("x", "y")])
def test_a_rigid_set_is_a_model_made_rigid_by_hand(comm, directions):
    """T^T A T in dense numpy, with T from the positions; all or some directions coupled."""
    with hpcred.solid((3, 2, 2), clamped=True, inputs=2, comm=comm) as model:
        marked = model.with_interfaces([face("end", 0.03, kind="rigid", directions=directions, at=(0.04, 0.0, 0.01))])
        K, M, B = dense_model(marked)
        direction, position = everywhere(marked, "direction"), everywhere(marked, "position")
        follow = (np.abs(position[:, 0] - 0.03) < 1e-9) & (direction < len(directions))
        moves = [0, 1, 2, 3, 4, 5] if len(directions) == 6 else [0, 1, 3, 4, 5]  # z of the reference moves nothing
        T = np.zeros((model.size, len(moves) + int((~follow).sum())))
        T[np.flatnonzero(~follow), np.arange((~follow).sum())] = 1.0
        for row in np.flatnonzero(follow):
            arm = position[row] - np.array([0.04, 0.0, 0.01])
            T[row, -len(moves) :] = rigid_motions_at([arm])[direction[row], moves]
        eigenvalues = scipy.linalg.eigvalsh(T.T @ K @ T, T.T @ M @ T)
        with hpcred.reduce(marked, [Modes(count=6)]) as rom:
            assert np.allclose(rom.frequencies, np.sqrt(eigenvalues[:6]) / 2 / np.pi, rtol=1e-9)
            V = gather(rom.columns)
        assert np.abs(V - T @ np.linalg.lstsq(T, V, rcond=None)[0]).max() < 1e-9 * np.abs(V).max()
        assert np.abs(to_dense(marked.Gt).T[moves] @ T[:, -len(moves) :] - np.eye(len(moves))).max() < 1e-12
        if len(moves) < 6:
            with pytest.raises(hpcred.InputError, match="found 'z', expected x, y, rx, ry, rz or all"):
                marked.with_inputs([("end", "z")])
        A = T.T @ (K - (2 * np.pi * 900) ** 2 * M) @ T
        expected = (T.T @ B).T @ np.linalg.solve(A, T.T @ B)
        found = hpcred.frequency_response(marked, [900.0])[0]
        assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


def test_a_tangent_frame_at_a_rigid_interface_clamps_the_face(comm):
    with block_with_ends(comm, "rigid", cells=(4, 2, 2)) as model, hpcred.solid((4, 2, 2), comm=comm) as clamped:
        marked = clamped.with_interfaces([face("right", 0.04, kind="rigid")]).with_inputs([("right", "all")])
        found = hpcred.frequency_response(model.with_inputs([("right", "all")]), [0.0, 3000.0], Tangent("left"))
        expected = hpcred.frequency_response(marked, [0.0, 3000.0])
        assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()
        with pytest.raises(hpcred.InputError, match="averaging one; take kind = 'rigid'"):
            hpcred.reduce(block_with_ends(comm, cells=(4, 2, 2)), [Modes(count=2)], Tangent("left"))


@pytest.mark.mpi
def test_interfaces_are_inputs_unless_the_model_has_others(comm):
    ends = [Interface(name=name, nodes=Nodes(set=name)) for name in ("BIG_EYE", "SMALL_EYE")]
    with (
        hpcred.crank(600, comm) as rod,
        rod.with_interfaces(ends) as jointed,
        jointed.with_inputs([(name, "all") for name in ("BIG_EYE", "SMALL_EYE")]) as by_hand,
    ):
        assert jointed.input_names == by_hand.input_names and len(jointed.input_names) == 12
        assert jointed.digest_of("B") == by_hand.digest_of("B")
        named = jointed.with_inputs(["SMALL_EYE", ("BIG_EYE", "x")])
        assert named.input_names == (*jointed.input_names[6:], "BIG_EYE:x")
        assert jointed.with_interfaces(ends[1:]).input_names == jointed.input_names[6:]  # in place of the others
        assert rod.with_interfaces(ends).with_interfaces([]).B is None
        assert rod.with_inputs([7]).with_interfaces(ends).input_names == ("dof 7",)



def test_a_single_node_with_rotations_is_its_own_rigid_interface(comm):
    with bar(comm, 1.0, 4) as beam:
        marked = beam.with_interfaces([Interface(name="tip", nodes=(5,), kind="rigid")])
        named = marked.with_inputs([("tip", "all")])
        plain = beam.with_inputs([(5, d) for d in ("x", "y", "z", "rx", "ry", "rz")])
        responses = [hpcred.frequency_response(model, [0.0, 40.0], Buckens()) for model in (named, plain)]
        assert np.abs(responses[0] - responses[1]).max() < 1e-9 * np.abs(responses[1]).max()


def test_a_single_node_is_its_own_rigid_interface_wherever_it_lies(comm):
    """Also where the centre of its three dofs is its place but for round-off, as (0.2 + 0.2 + 0.2) / 3 is."""
    with bar(comm, 1.0, 5) as beam:
        for number in range(1, 7):
            marked = beam.with_interfaces([Interface(name="tip", nodes=(number,), kind="rigid")])
            expected = np.zeros((36, 6))
            expected[6 * number - 6 : 6 * number] = np.eye(6)
            assert np.abs(to_dense(marked.Gt) - expected).max() < 1e-12


def test_a_single_node_of_a_plane_does_not_turn(comm):
    """Nor far from the origin, where the round-off of its place is more than 1e-9 of the size of the body."""
    node, direction = np.repeat([1, 2], 2), np.tile([0, 1], 2)
    for size, far in ((1.0, 0.1), (1e-4, 1e5 / 13)):
        position = np.repeat([[-far, 0.0, 0.0], [size - far, 0.0, 0.0]], 2, axis=0)
        dofs = hpcred.Dofs(node, direction, position)
        with hpcred.SecondOrderModel.from_scipy(np.eye(4), np.eye(4), comm=comm, dofs=dofs) as model:
            marked = model.with_interfaces([Interface(name="tip", nodes=(2,), weights=(0.7,))])
            assert marked.interfaces[0].directions == ("x", "y")
            assert np.allclose(to_dense(marked.Gt)[2:, :2], np.eye(2))


def test_shapes_and_files_know_the_reference_nodes(comm, folder):
    """phi and psi by finite rotation of the set; the SID file has them, and a result is evaluated by its record."""
    with block_with_ends(comm, clamped=True) as model, hpcred.reduce(model, tolerance=1e-4, band=(0, 9000)) as rom:
        hpcred.write_model(folder / "model.h5", model)
        hpcred.write_result(folder / "result.h5", rom, model)
        shape = hpcred.read_result(folder / "result.h5", comm).nodes[-1]
        assert (shape.name, shape.rotates) == ("right", True)
        motion = to_dense(model.Gt).T @ gather(rom.columns)
        assert np.abs(np.concatenate([shape.phi, shape.psi]) - motion).max() < 1e-12 * np.abs(motion).max()
        (row,) = hpcred.info(folder / "result.h5", comm=comm)["interfaces"]
        place = {"x": pytest.approx(0.06), "y": pytest.approx(0.01), "z": pytest.approx(0.015)}
        assert row == {"interface": "right", "node": shape.node, "kind": "averaging", "nodes": 12} | place
        report = hpcred.evaluate(folder / "result.h5", folder / "model.h5", frequencies=(100.0, 5000.0))
        assert max(report["eps"]) < 1e-4
        hpcred.export(folder / "result.h5", "sid", folder / "body.SID_FEM")
        node = hpcred.writers.read_sid(folder / "body.SID_FEM").nodes[-1]
        assert node.node == shape.node
        assert np.allclose(node.objects["psi"].m0, shape.psi)


REFUSALS = [
    ([face("a", 0.5)], "none lies there; the nodes of solid lie between"),
    ([face("a", 0.04), face("a", 0.02)], "expected each once"),
    ([Interface(name="a", nodes=(1, 99999))], "node 99999 does not exist"),
    ([Interface(name="a", nodes=Nodes(set="LEFT"))], "has no set 'LEFT'; it has none"),
    ([Interface(name="a", nodes=(1,))], r"do not define the motion in .*; take several nodes around .*at = \["),
    ([Interface(name="a", nodes=(1, 2, 3))], "motion in rz; take several nodes around the place, not all on one"),
    ([face("a", 0.04, kind="rigid"), Interface(name="b", nodes=(36, 35, 33), kind="rigid")], "follow one reference"),
    ([face("a", 0.04, node=5)], "the number 5 is taken"),
    ([face("a", 0.04, weights="area"), Interface(name="b", nodes=(1, 5, 12), weights="area")], "a face on the set"),
]  # fmt: skip


def test_a_set_of_nodes_without_rows_is_refused(comm):
    """As that of a rigid body of the program that wrote the matrices."""
    with hpcred.solid((4, 2, 2), clamped=True, comm=comm) as model:
        beside = np.arange(1000, 1007) if comm.rank == comm.size - 1 else np.zeros(0, np.int64)
        with (
            model.with_fields(sets={"BORE": beside}) as marked,
            pytest.raises(hpcred.InputError, match="none of the 7 nodes of the set 'BORE' has a row in solid; nodes"),
        ):
            marked.with_interfaces([Interface(name="a", nodes=Nodes(set="BORE"))])


def test_nodes_without_rows_are_said_and_keep_their_numbers(comm):
    """Nodes of a set that follow others, as those of a rigid body, and a ROT node of CalculiX: no row, but a number."""
    with hpcred.solid((4, 2, 2), clamped=True, comm=comm) as model:
        part = np.unique(model.dofs.node[model.dofs.position[:, 0] > 0.0399])
        count = len(set(np.concatenate(comm.allgather(part)).tolist()))
        mine = np.append(part, 1000 + comm.rank)
        with (
            model.with_fields(sets={"END": mine, "ROT": np.array([2000 + comm.rank])}) as marked,
            marked.with_interfaces([Interface(name="a", nodes=Nodes(set="END")), face("b", 0.04)]) as loaded,
            loaded.with_inputs([("a", "x")]) as loaded,
        ):
            assert [item.node for item in loaded.interfaces] == [2000 + comm.size, 2001 + comm.size]
            assert [item.count for item in loaded.interfaces] == [count, count]
            with hpcred.reduce(loaded, [Modes(count=2)]) as rom:
                (said,) = [line for line in rom.record.warnings if "no row" in line]
            assert f"interface 'a': {comm.size} of the {count + comm.size} nodes of the set 'END' have no row" in said


@pytest.mark.parametrize(("interfaces", "words"), REFUSALS, ids=[words[:20] for _, words in REFUSALS])
def test_what_defines_no_interface_is_refused(comm, interfaces, words):
    with hpcred.solid((4, 2, 2), clamped=True, comm=comm) as model, pytest.raises(hpcred.InputError, match=words):
        model.with_interfaces(interfaces)


def test_advice_for_a_node_without_rotations_leads_somewhere(comm):
    """What it says, done: an interface with several nodes there, of kind rigid for a frame."""
    with hpcred.solid((4, 2, 2), clamped=False, comm=comm) as model:
        leads = r"x, y, z; declare an \[\[interface\]\] with several nodes there"
        with pytest.raises(hpcred.InputError, match=f"no dof in direction rx; it has {leads}.*name its direction rx"):
            model.with_inputs([(1, "rx")])
        with pytest.raises(hpcred.InputError, match=f"six dofs, node 1 has {leads}.*of kind 'rigid', and name it"):
            hpcred.reduce(model.with_inputs([(45, "x")]), [Modes(count=2)], Tangent(1))
        marked = model.with_interfaces([face("end", 0.0, kind="rigid")])
        assert marked.with_inputs([("end", "rx")]).input_names == ("end:rx",)
        with hpcred.reduce(marked.with_inputs([(45, "x")]), [Modes(count=2)], Tangent("end")) as rom:
            assert rom.size == 2


def test_a_set_with_a_held_node_is_refused(comm):
    with hpcred.solid((4, 2, 2), clamped=True, comm=comm) as model:
        held = hpcred.Dofs(np.array([77]), np.array([2], dtype=np.int8), np.array([[0.04, 0.0, 0.0]]))
        empty = held.take(slice(0, 0))
        model = model.with_fields(held=held if comm.rank == 0 else empty)
        with pytest.raises(hpcred.InputError, match="node 77 of its set is held"):
            model.with_interfaces([face("a", 0.04)])


def test_static_correction_by_interface_loads_needs_no_rotations(solid):
    """A moment on a set of nodes without rotations is a set of forces with that moment and no resultant."""
    marked = solid.with_interfaces([face("end", 0.04)]).with_inputs([("end", "rx")])
    R, B = gather(rigid_motions(marked)), columns_of(marked.B)
    centre = marked.interfaces[0].position
    assert np.abs(R.T @ B - rigid_motions_at([centre]).T[:, [3]]).max() < 1e-12
    with hpcred.reduce(marked, [StaticCorrection()]) as rom:
        assert rom.size == 1


@pytest.mark.parametrize("way", ["cylinder", "bore", "pin"])
def test_an_axis_has_two_ends(way):
    at, along = (0.1, 0.2, 0.3), (0.1, 0.2, 0.4)
    assert getattr(hpcred.Nodes(**{way: (at, along, 0.01)}), way)[2] == 0.01
    with pytest.raises(hpcred.InputError, match=f"nodes.{way}: its two points are the same"):
        hpcred.Nodes(**{way: (at, at, 0.01)})
    with pytest.raises(hpcred.InputError, match="nodes: found radius 0 m"):
        hpcred.Nodes(**{way: (at, along, 0.0)})
