"""Text tables of nodes and of rows."""

import numpy as np
import pytest
from foreign import gathered, write

from hpcred import InputError
from hpcred.readers.nodes import table as node_table

pytestmark = pytest.mark.mpi(build="real")


def test_nodes_keep_the_order_of_the_file(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.files.text.PIECE", 20)
    labels = np.random.default_rng(2).permutation(50) + 1
    path = write(folder / "nodes.txt", "# node x y z\r\n" + "".join(f"{n}; {n}.5, 0 1\r\n".replace(";", "")
                                                                     for n in labels), comm)  # fmt: skip
    nodes = node_table.read(path, comm)
    label, position, place = gathered(comm, nodes.label, nodes.position, nodes.place)
    assert np.array_equal(label[np.argsort(place)], labels)
    assert np.array_equal(position, np.array([label + 0.5, 0 * label, 0 * label + 1]).T)


@pytest.mark.parametrize(
    "text, says",
    [
        ("1 0 0 0\n2 0 0\n3 0 0 0 0\n", "line 2: found '2 0 0', expected 4 numbers a line"),
        ("1 0 0 0 2 0 0 0\n", "line 1: .* expected 4 numbers a line"),
        ("1.5 0 0 0\n", "expected the node number as a whole number"),
        ("0 0 0 0\n", "expected the node number as a whole number"),
        ("1 0 0 0\n-1 0 0 0\n", "line 2: .* expected the node number as a whole number"),
        ("1e10 0 0 0\n", "expected the node number as a whole number of 1 to 2147483647"),
        ("1 0 inf 0\n", "line 1: .* expected finite node coordinates"),
        ("1 0 1e300 0\n", "line 1: .* expected finite node coordinates"),
        ("1 0 0 0 0 0\n", "line 1: .* expected 4 numbers a line"),
        ("node;x;y;z\n1;0;0;0\n", "line 1: .* expected 4 numbers a line"),
        ("1 0,5 0 0\n", "line 1: .* expected 4 numbers a line"),
        ("99999999999999999999 0 0 0\n", "expected the node number as a whole number"),
        ("nan 0 0 0\n", "expected the node number as a whole number"),
        ("1 0 0 0\n2 0 0 0\n1 0 0 0\n", "found the node 1 more than once"),
        ("1 0 0x1 0\n", "line 1: found '1 0 0x1 0'"),
        ("1 0 0 0\n2 0 0 0\n1 1 0 0\n", "found the node 1 more than once"),
        ("# nothing\n", "found no nodes"),
    ],
)
def test_node_tables_that_are_none_are_refused(comm, folder, text, says):
    path = write(folder / "nodes.txt", text, comm)
    with pytest.raises(InputError, match=says):
        node_table.read(path, comm)


@pytest.mark.parametrize(
    "text, says",
    [
        ("1 1\n1 7\n", "line 2: found '1 7', expected the direction .* of 1 to 6"),
        ("1 1\n1 1.5\n", "line 2: .* expected the direction"),
        ("1 0\n", "line 1: .* expected the direction"),
        ("0 1\n", "expected the node number as a whole number"),
        ("1.5 1\n", "expected the node number as a whole number"),
        ("3e9 1\n", "expected the node number as a whole number"),
        ("1 x\n", "line 1: found '1 x', expected 2 numbers a line"),
        ("1 1 1\n1 2 3\n", "line 1: .* expected 2 numbers a line"),
        ("1 1\n1 2 3\n", "line 2: .* expected 2 numbers a line"),
        ("1 1\n1 2\n1 1\n", "found two rows of 1:x"),
    ],
)
def test_row_tables_that_are_none_are_refused(comm, folder, text, says):
    path = write(folder / "dofs.txt", text, comm)
    with pytest.raises(InputError, match=says):
        node_table.read_row_labels(path, comm)
