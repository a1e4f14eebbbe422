"""Places and rows of the nodes of elements, and values at these rows, against whole arrays."""

import numpy as np
import pytest
from helpers import gather

import hpcred
from hpcred.fe.element_rows import ValuesAtRows, element_rows, node_rows
from hpcred.linalg.blocks import View, random_block
from hpcred.parallel.failures import InputError
from hpcred.parallel.shares import row_range

pytestmark = pytest.mark.mpi


def two_tetrahedra(comm):
    """Nodes 10 to 14; node 10 is held in y and z, 11 wholly; node 99 of a third element has no displacement."""
    rng = np.random.default_rng(1)
    points = {number: rng.random(3) for number in (10, 11, 12, 13, 14)}
    free = [(10, 0), *((node, d) for node in (14, 12, 13) for d in range(3)), (14, 4)]
    stuck = [(10, 1), (10, 2), (11, 0), (11, 1), (11, 2)]
    dofs, held = (hpcred.Dofs(*(np.array(part) for part in zip(*pairs, strict=True)),
                              np.array([points[node] for node, _ in pairs])) for pairs in (free, stuck))  # fmt: skip
    cells = np.array([[10, 11, 12, 13], [14, 12, 13, 10], [99, 10, 11, 12]])[slice(*row_range(comm, 3))]
    eye = np.eye(len(free))
    first, last = row_range(comm, len(stuck))
    model = hpcred.SecondOrderModel.from_scipy(
        eye, eye, comm=comm, dofs=dofs, held=held.take(slice(first, last)), elements={"tetra": cells}
    )
    return model, points, free


def test_rows_and_places_of_elements(comm):
    model, points, free = two_tetrahedra(comm)
    with model:
        found = element_rows(model)
        assert list(found) == ["tetra"]
        tetra = found["tetra"]
        for nodes, places, rows, placed in zip(tetra.nodes, tetra.position, tetra.rows, tetra.placed, strict=True):
            assert placed == (99 not in nodes)
            for node, place, three in zip(nodes, places, rows, strict=True):
                assert np.isnan(place).all() if node == 99 else (place == points[node]).all()
                assert three.tolist() == [free.index((node, d)) if (node, d) in free else -1 for d in range(3)]
        assert comm.allreduce(len(tetra.nodes)) == 3
        assert (tetra.take(tetra.placed).nodes != 99).all()


def test_values_at_rows_are_those_of_the_columns(comm):
    model, *_ = two_tetrahedra(comm)
    with model:
        block = random_block(model.K, 5)
        whole = gather(block)
        rows = element_rows(model)["tetra"].rows
        wanted = np.where(rows[..., None] >= 0, whole.real[rows], 0.0)
        values = ValuesAtRows(model, rows)
        assert (values.of(block) == wanted).all()
        assert (values.of(View(block, 1, 3)) == wanted[..., 1:3]).all()


def test_all_elements_of_a_solid_have_rows_and_their_volume(comm):
    with hpcred.solid((3, 2, 2), None, 3, False, comm) as model:
        position, rows = node_rows(model, model.dofs.node)
        place = np.arange(model.local_rows)
        assert (rows[place, model.dofs.direction] == model.first_row + place).all()
        assert (position == model.dofs.position).all()
        elements = element_rows(model)["hexahedron"]
        assert elements.placed.all() and (elements.rows >= 0).all()
        assert np.allclose(np.ptp(elements.position, axis=1), 0.01)


def test_models_without_nodes_are_refused(comm):
    with (
        hpcred.SecondOrderModel.from_scipy(np.eye(4), np.eye(4), comm=comm) as model,
        pytest.raises(InputError, match=r"no node coordinates, which a field on its elements needs"),
    ):
        element_rows(model)
