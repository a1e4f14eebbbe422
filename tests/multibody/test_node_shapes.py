"""Shapes of single nodes against rows of the basis."""

import pytest
from helpers import gather

import hpcred
from hpcred import Buckens, Modes
from hpcred.multibody.node_shapes import node_shapes
from hpcred.parallel.failures import InputError


@pytest.mark.mpi
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
