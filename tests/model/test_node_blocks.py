"""Rows of nodes in whole blocks, whatever their order, against a permutation in numpy."""


import numpy as np
import pytest
import scipy.linalg
from helpers import bar, dense_model, gather, to_dense

import hpcred
from hpcred.model.node_blocks import NodeBlocks

pytestmark = pytest.mark.mpi

ORDERS = {  # of (node, direction) of the rows
    "by node": None, "directions turned": lambda node, direction: (node, -direction),
    "by direction": lambda node, direction: (direction, node),
    "nodes mixed": lambda node, direction: (node // 2, direction, node % 2),
    "directions apart": lambda node, direction: (node // 2, direction, (node + direction) % 2),
}  # fmt: skip


@pytest.mark.parametrize("left_out", [False, True])
@pytest.mark.parametrize("order", ORDERS)
def test_matrices_are_those_of_whole_nodes(comm, order, left_out):
    """As many blocks as nodes, each with x, y, z in this order; rows that are left out have the given diagonal."""
    with hpcred.solid((3, 2, 2), comm=comm, inputs=1) as model:
        K, M, _ = dense_model(model)
        parts = comm.allgather(model.dofs)
    node, direction, position = (np.concatenate([getattr(part, key) for part in parts])
                                 for key in ("node", "direction", "position"))  # fmt: skip
    keys = ORDERS[order](node, direction) if ORDERS[order] else (node, direction)
    rows = np.lexsort(keys[::-1])
    rows = np.delete(rows, 7) if left_out else rows
    dofs = hpcred.Dofs(node[rows], direction[rows], position[rows])
    K, M = K[np.ix_(rows, rows)], M[np.ix_(rows, rows)]
    model = hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, dofs=dofs)
    with model:
        blocks = NodeBlocks(model)
        assert blocks.size == 3
        if order != "by node":
            assert blocks.expansion is not None
        size = np.abs(K).max()
        found = blocks.expanded(model.K, size)
        whole, moved = to_dense(found), gather(blocks.motions)
        assert found.getBlockSize() == 3
        if blocks.expansion is not None:
            found.destroy()
    missing = np.flatnonzero((whole == size * np.eye(len(whole))).all(axis=1))
    assert len(missing) == left_out and len(whole) == len(node)
    values = np.sort(np.append(scipy.linalg.eigvalsh(K), [size] * left_out))
    assert np.allclose(scipy.linalg.eigvalsh(whole), values, rtol=1e-9, atol=1e-9 * values[-1])
    translations = np.tile(np.eye(3), (len(whole) // 3, 1))
    translations[missing] = 0.0
    assert np.abs(moved[:, :3] - translations).max() < 1e-12
    arms = moved[:, 3:].reshape(-1, 3, 3)  # skew matrices of the places of nodes, the same in all rows of a block
    kept = np.delete(arms, missing // 3, axis=0)
    assert np.abs(kept + kept.transpose(0, 2, 1)).max() < 1e-12


def test_nodes_that_turn_have_blocks_of_six(comm):
    with bar(comm, 1.0, 6) as model:
        blocks = NodeBlocks(model)
        assert blocks.size == 6 and blocks.expansion is None
