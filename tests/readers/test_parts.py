"""Parts of a model from arrays, whichever rank gives which share, and each refusal."""

import numpy as np
import pytest
from scipy import sparse

from hpcred import InputError
from hpcred.readers import Parts
from hpcred.readers.assembly import assemble

pytestmark = pytest.mark.mpi(build="real")

K = np.diag([4.0, 4.0, 3.0, 3.0, 2.0, 2.0]) - np.eye(6, k=2) - np.eye(6, k=-2)
M = np.diag([1.0, 1.0, 2.0, 2.0, 3.0, 3.0])
NODES = np.array([[7, 0.0, 0, 0], [3, 0.1, 0, 0], [5, 0.2, 0.3, 0]])
DOFS = [(node, direction) for node in (7, 3, 5) for direction in (1, 2)]


def gather(comm, mine):
    return np.concatenate(comm.allgather(mine))


def share(comm, rows):
    """The rows of this rank, in the order of the ranks; None without any."""
    return np.array_split(rows, comm.size)[comm.rank] if len(rows) >= comm.size or not comm.rank else None


@pytest.mark.parametrize("how", ["shares", "first rank"])
def test_parts_of_ranks_make_one_model(comm, how):
    i, j = K.nonzero()
    if how == "first rank":
        first = comm.rank == 0
        given = [sparse.csr_matrix(A) if first else None for A in (K, M, 0.1 * M)]
        nodes, dofs = (NODES, DOFS) if first else (None, None)
    else:
        mine = np.arange(len(i)) % comm.size == comm.rank
        given = [sparse.coo_matrix((A[i, j][mine], (i[mine], j[mine])), (6, 6)) for A in (K, M, 0.1 * M)]
        nodes, dofs = share(comm, NODES), share(comm, DOFS)
    parts = Parts.from_arrays("a.txt", comm, *given, nodes=nodes, dofs=dofs, sets={"end": [5] if not comm.rank else []})
    with assemble(parts, comm) as model:
        node, place = gather(comm, model.dofs.node), gather(comm, model.dofs.position)
        assert node.tolist() == [7, 7, 3, 3, 5, 5] and np.array_equal(place, np.repeat(NODES[:, 1:], 2, axis=0))
        assert model.set_sizes == {"end": 1} and model.size == 6
        diagonal = gather(comm, model.K.getDiagonal().array.real)
        assert np.array_equal(diagonal, K.diagonal()) and model.D is not None


def test_nodes_without_dofs_stand_for_their_rows(comm):
    given = [sparse.csr_matrix(A) if comm.rank == comm.size - 1 else None for A in (K, M)]
    with assemble(Parts.from_arrays("a.txt", comm, *given, nodes=share(comm, NODES)), comm) as model:
        assert gather(comm, model.dofs.node).tolist() == [7, 7, 3, 3, 5, 5] and model.D is None
        assert gather(comm, model.dofs.direction).tolist() == [0, 1] * 3


def test_arrays_of_other_shapes_are_refused(comm):
    given = [sparse.csr_matrix(A) for A in (K, M)]
    for arrays, keys, says in (
        (given, {"nodes": [[1, 2, 3]]}, "a.txt: nodes: expected rows of number, x, y, z, found an array of 1 x 3"),
        (given, {"nodes": [[1.5, 0, 0, 0]]}, "expected rows of number, x, y, z, found the number 1.5"),
        (given, {"nodes": [[1, 0, np.nan, 0]]}, "found the y nan"),
        (given, {"dofs": [[1, 0]]}, "dofs: expected rows of node, direction, found the direction 0"),
        (given, {"held": [[1, 7]]}, "held: expected rows of node, direction, found the direction 7"),
        ([given[0], None], {}, "a.txt: found no M, expected K and M"),
        ([given[0] * (1 + 1j), given[1]], {}, "a.txt: K: found [0-9]+ entries with imaginary parts, expected real"),
    ):
        with pytest.raises(InputError, match=says):
            Parts.from_arrays("a.txt", comm, *arrays, **keys)
