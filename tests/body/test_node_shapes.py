"""Shapes of single nodes against rows of the basis."""

import numpy as np
import pytest
from helpers import gather

import hpcred
from hpcred import Buckens, Modes
from hpcred.body.body import body_of, inputs_without_node, remarks
from hpcred.body.node_shapes import node_shapes, shapes_of_rows
from hpcred.fe.dofs import OWN, SCALAR, Dofs
from hpcred.parallel.failures import InputError


@pytest.mark.mpi
@pytest.mark.costly
def test_shapes_of_nodes_with_three_and_six_dofs(comm):
    with hpcred.linkage(comm) as linkage, hpcred.solid((4, 3, 2), None, 3, False, comm) as block:
        for model, node, count in ((block, 5, 3), (linkage, 20, 6)):
            with hpcred.reduce(model, [Modes(index=(7, 8))], Buckens()) as rom:
                (shape,) = node_shapes(model, rom.columns, [node])
                rows = gather(rom.columns)[count * (node - 1) : count * node]
                assert (shape.phi == rows[:3]).all()
                assert shape.rotates == (count == 6)
                assert (shape.psi == (rows[3:] if count == 6 else 0)).all()
                with pytest.raises(InputError, match="node 999 does not exist"):
                    node_shapes(model, rom.columns, [999])


def test_a_node_rotates_where_it_has_a_rotation_in_space():
    """Node 1 has rx alone, 2 has x, y, z and a pressure, 3 has x and rz; each row has a number of its own."""
    labels = [(1, 3), (2, 0), (2, 1), (2, 2), (2, SCALAR), (3, 0), (3, 5)]
    node, direction = np.array(labels).T
    rows = np.arange(1.0, 15.0).reshape(7, 2)
    shapes = shapes_of_rows([1, 2, 3], node, direction, np.zeros((7, 3)), rows, "body")
    assert [shape.rotates for shape in shapes] == [True, False, True]
    expected = np.zeros((3, 6, 2))
    for (number, place), row in zip(labels, rows, strict=True):
        if place < SCALAR:
            expected[number - 1, place] = row
    assert (np.array([np.concatenate([shape.phi, shape.psi]) for shape in shapes]) == expected).all()


@pytest.mark.mpi
def test_directions_that_are_not_known_make_no_interface_node(comm):
    """Node 3 has two directions of its own, 4 is a scalar point, 5 moves in space and has a pressure."""
    labels = [(1, 0), (1, 1), (1, 2), (3, OWN), (3, OWN + 1), (4, SCALAR), (5, 0), (5, 1), (5, 2), (5, SCALAR)]
    node, direction = np.array(labels).T
    places = {1: (0.0, 0.0, 0.0), 3: (1.0, 0.0, 0.0), 4: (0.0, 0.0, 0.0), 5: (0.0, 2.0, 1.0)}
    dofs = Dofs(node, direction.astype(np.int8), np.array([places[item] for item in node]))
    M, K = 2.0 * np.eye(len(labels)), np.diag(np.arange(1.0, 11.0))
    targets = [(5, "x"), (3, "own1"), (4, "scalar"), (1, "z")]
    with (
        hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, dofs=dofs) as plain,
        plain.with_inputs(targets) as model,
        hpcred.reduce(model, [Modes(count=6)]) as rom,
    ):
        body = body_of(model, rom)
        assert [shape.node for shape in body.nodes] == [1, 5]
        for wrong, says in ((3, "node 3 has the dofs own1, own2, which are none of x"), (4, "4 has the dofs scalar")):
            with pytest.raises(InputError, match=says):
                body_of(model, rom, [1, wrong])
    assert inputs_without_node(body)[0] == "inputs that belong to no node are left out: 3:own1, 4:scalar"
    assert body.floating_frame.mass == 4.0
    said = "2 dofs in directions of their own (own1 to own6) have no part in mass, inertia and couplings"
    assert said in remarks(body)
