"""Bodies: what body_of puts together, and which bodies cannot move in time."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import block_from, gather

import hpcred
from hpcred import Buckens, CraigBampton, Interface, Krylov, Modes, Nodes
from hpcred.body.body import body_of, check_elastic, check_moving, has_no_inertia, inputs_without_node, remarks
from hpcred.body.floating_frame import floating_frame
from hpcred.model.damping import Structural
from hpcred.parallel.failures import InputError
from hpcred.simulation.simulation import Simulation, simulate


@pytest.mark.mpi
def test_a_body_has_the_nodes_of_inputs_and_outputs(comm):
    with hpcred.linkage(comm) as model:
        model = model.with_inputs([(20, "z"), 1])
        model = model.with_outputs([(7, "x")])
        with hpcred.reduce(model, [Modes(index=(7, 8))], Buckens()) as rom:
            body = body_of(model, rom, origin=(0.1, 0.0, 0.0))
            rows = gather(rom.columns)
    assert [shape.node for shape in body.nodes] == [7, 20]
    assert (body.nodes[1].phi == rows[114:117]).all()
    assert body.floating_frame.origin.tolist() == [0.1, 0.0, 0.0] and body.reduced is rom
    assert inputs_without_node(body) == ["inputs that belong to no node are left out: dof 1"]
    with pytest.raises(InputError, match="the basis of the reduced model is closed"):
        body_of(model, rom)


def test_a_two_sided_projection_gives_no_body():
    with hpcred.linkage() as model:
        model = model.with_outputs([(7, "z")])
        rom = hpcred.reduce(
            model, [Krylov(frequency=10.0)], hpcred.Tangent(node=1), projection="two_sided", allow_unstable=True
        )
        with rom, pytest.raises(InputError, match="two-sided projection has no floating frame"):
            body_of(model, rom)


def test_structural_damping_is_refused_in_time():
    with (
        hpcred.linkage() as model,
        hpcred.reduce(model, [Modes(index=(7, 8))], Buckens(), Structural(0.03)) as rom,
    ):
        body = body_of(model, rom)
    says = r"loss factor 0.03\) has no meaning in time and no place in a simulation; .* 'modal' and ratio = 0.015"
    with pytest.raises(InputError, match=says):
        check_moving(body, "a simulation")


@pytest.mark.parametrize("directions, says", [((0, 1), "no mass in z"), ((2,), "no mass in x and y")])
def test_a_body_without_a_direction_is_refused_in_time(directions, says):
    """A chain of solids of which only some dofs are there."""
    body = chain_body(directions)
    with pytest.raises(InputError, match=f"the body has {says}"):
        check_moving(body, "a SID file")
    assert any("the masses in x, y, z are" in line for line in remarks(body))


def test_a_body_on_a_line_has_no_inertia_about_it():
    """A file of it is written with a remark; in time its rotation about the line is undetermined."""
    body = chain_body((0, 1, 2))
    assert any("no inertia about one of its axes" in line for line in remarks(body))
    with pytest.raises(InputError, match="no inertia about one of its axes, .* which a simulation needs"):
        simulate(body, Simulation(end=1.0, steps=10))


def chain_body(directions, left_out=()):
    """Three nodes of 2 kg with some of the directions, one spring between neighbours and one to the ground."""
    names = [(node, d) for node in (1, 2, 3) for d in directions if (node, d) not in left_out]
    node, direction = (np.array(item) for item in zip(*names, strict=True))
    K = 1e4 * np.array([[(d == e) * (2.5 * (a == b) - (abs(a - b) == 1)) for b, e in names] for a, d in names])
    dofs = hpcred.Dofs(node, direction.astype(np.int8), node[:, None] * [1.0, 0.5, 0.2])
    with hpcred.SecondOrderModel.from_scipy(K, 2 * np.eye(len(K)), dofs=dofs) as model:
        model = model.with_inputs([1])
        with hpcred.reduce(model, [Modes(index=(1, 2))]) as rom:
            return body_of(model, rom, [1])


def test_masses_that_differ_are_said():
    assert not [line for line in remarks(chain_body((0, 1, 2))) if "the masses" in line]
    (line,) = [line for line in remarks(chain_body((0, 1, 2), [(1, 2)])) if "the masses" in line]
    assert "the masses in x, y, z are 6, 6, 4 kg" in line


def test_directions_that_a_set_leaves_open_are_said(tmp_path):
    """A pin that holds the bore in x and y only: in z its node is one of the body frame."""
    ends = {"pin": (("x", "y"), 0.0), "hub": (("x", "y", "z", "rx", "ry", "rz"), 0.04)}
    interfaces = [
        Interface(name=name, nodes=Nodes(box=((x, 0, 0), (x, 1, 1))), kind="rigid", directions=directions)
        for name, (directions, x) in ends.items()
    ]
    with hpcred.solid((4, 2, 2), inputs=3, clamped=False) as model, model.with_interfaces(interfaces) as jointed:
        loaded = jointed.with_inputs([(name, "all") for name in ends])
        with hpcred.reduce(loaded, [Krylov(frequency=100.0, order=0)], Buckens()) as rom:
            hpcred.write_result(tmp_path / "result.h5", rom, loaded)
    body = hpcred.read_result(tmp_path / "result.h5").body()
    assert [len(np.flatnonzero(shape.phi.any(axis=1))) for shape in body.nodes] == [2, 3]
    assert remarks(body) == [
        "the set of interface 'pin' does not move it in z, where it follows the body frame: let no joint or force act "
        "there"
    ]


def test_motion_that_grows_is_said():
    with hpcred.linkage() as model, hpcred.reduce(model, [Modes(index=(7, 8))], Buckens()) as rom:
        body = body_of(model, rom, [20])
    body = replace(body, reduced=replace(body.reduced, D=np.diag([1.0, 0.0])))
    assert not [line for line in remarks(body) if "unstable" in line]
    body = replace(body, reduced=replace(body.reduced, D=np.diag([1.0, -2.0])))
    assert "the model is unstable: 2 poles in the right half-plane, so that motion grows in time" in remarks(body)


@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_a_small_body_in_interface_coordinates_can_move(scale):
    """Its interface coordinates have masses of 1e-8 kg and inertias of 1e-18 kg m^2, its modal ones 1."""
    edges = tuple(scale * np.array([0.6, 0.2, 0.1]))
    tip = Interface(name="tip", nodes=Nodes(box=((0.99 * edges[0], 0.0, 0.0), edges)))
    with (
        hpcred.solid((3, 2, 1), edges, 3) as model,
        model.with_interfaces([tip]).with_inputs([("tip", "all")]) as held,
        hpcred.reduce(held, [CraigBampton(count=6)], coordinates="interface") as rom,
    ):
        body = body_of(held, rom)
    check_moving(body, "a test")
    without = np.diag(np.r_[np.diag(body.floating_frame.Me)[:-1], 0.0])  # mass of one
    body = replace(body, floating_frame=replace(body.floating_frame, Me=without))
    with pytest.raises(InputError):
        check_moving(body, "a test")


def test_rigid_body_modes_are_not_elastic():
    with hpcred.linkage() as model:
        with hpcred.reduce(model, [Modes(index=(7,))], Buckens()) as rom:
            body = body_of(model, rom, [20])
        position, direction = model.dofs.position, model.dofs.direction
        # a translation along x and a turn about it
        along = [(1.0, -x[2], x[1], 1.0, 0, 0)[d] for x, d in zip(position, direction, strict=True)]
        columns = block_from(model.M, np.array(along)[:, None])
        body.floating_frame = floating_frame(model, columns)
        columns.destroy()
    with pytest.raises(InputError, match="rigid-body motions"):
        check_elastic(body)


def test_coordinates_that_are_nearly_parallel_are_elastic_none_the_less():
    """Two modes and their sum with 1e-5 of a third: what is left of each beside the rigid-body motions counts in
    combinations of one size."""
    with hpcred.linkage() as model:
        with hpcred.reduce(model, [Modes(index=(7, 8))], Buckens()) as rom:
            body, V = body_of(model, rom, [20]), gather(rom.columns)
        columns = block_from(model.M, V @ np.array([[1.0, 1.0], [0.0, 1e-5]]))
        body.floating_frame = floating_frame(model, columns)
        columns.destroy()
    check_elastic(body)


@pytest.mark.parametrize("about, none", [(0.0, True), (1e-14, True), (1e-3, False)])
def test_masses_on_a_line_have_no_inertia_about_it(about, none):
    frame = SimpleNamespace(J=np.diag([about, 1.0, 1.0]), mc=np.zeros(3), mass=1.0)
    assert has_no_inertia(SimpleNamespace(floating_frame=frame)) == none
