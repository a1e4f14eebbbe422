"""Digests of distributed rows: the same on any number of ranks and in both builds, other for other content."""

import numpy as np
import pytest
import scipy.sparse
from xxhash import xxh3_128

import hpcred as package
from hpcred.model.interfaces.nodes import Interface
from hpcred.parallel.digest import ROWS_OF_DIGEST, digest, digest_of_block
from hpcred.parallel.petsc import MPI


def by_hand(rows):
    """The digest of a list of rows, each a list of arrays, without any distribution."""
    chunks = [rows[low : low + ROWS_OF_DIGEST] for low in range(0, len(rows), ROWS_OF_DIGEST)]
    found = b""
    for chunk in chunks:
        text = b""
        for part in zip(*chunk, strict=True):
            text += np.array([len(row) for row in part], "<i8").tobytes() + b"".join(row.tobytes() for row in part)
        found += xxh3_128(text).digest()
    return xxh3_128(found).hexdigest()


@pytest.mark.mpi
@pytest.mark.parametrize("cuts", [(0.1, 0.9), (0.0, 0.0), (1.0, 1.0), (0.4, 0.4), (0.70, 0.72)])
def test_digest_does_not_depend_on_the_ranks(cuts, comm):
    """Ranks that end within a chunk, that are within one, that have no row."""
    random = np.random.default_rng(0)
    count = 2 * ROWS_OF_DIGEST + 1000
    starts = np.concatenate([[0], np.cumsum(random.integers(0, 4, count))])
    values, numbers = random.standard_normal(starts[-1]), random.integers(0, 99, starts[-1]).astype("<u4")
    rows = [[values[a:b], numbers[a:b]] for a, b in zip(starts[:-1], starts[1:], strict=True)]
    ends = [0, *(int(cut * count) for cut in cuts[: comm.size - 1]), count]
    first, last = ends[comm.rank], ends[comm.rank + 1]
    mine = slice(starts[first], starts[last])
    local = starts[first : last + 1] - starts[first]

    def found():
        def between(low, high):
            here = slice(local[low], local[high])
            return [(np.diff(local[low : high + 1]), array[mine][here]) for array in (values, numbers)]

        return digest(comm, first, last - first, between)

    before = found()
    assert before == by_hand(rows)
    values[starts[-1] // 2] *= 1 + 2**-52
    assert found() == by_hand(rows) != before


@pytest.mark.mpi
def test_digest_of_a_block(comm):
    values = np.random.default_rng(1).standard_normal((ROWS_OF_DIGEST + 7, 3))
    first, last = (len(values) * rank // comm.size for rank in (comm.rank, comm.rank + 1))
    found = digest_of_block(comm, first, values[first:last])
    assert found == by_hand([[row] for row in values])


@pytest.mark.mpi
def test_digests_of_a_model(comm):
    """Those of one rank and of scipy's arrays, in each build; stored zeros do not count, another model has K's."""
    K = scipy.sparse.diags([[2.0] * 9 + [1.0], [-1.0] * 9, [-1.0] * 9], [0, 1, -1]).tocsr()
    K.sort_indices()
    M = K.copy()
    M.data = np.where(M.data > 0, 1.0, -0.0)
    K_rows = [[K.indices[a:b].astype("<u4"), K.data[a:b]] for a, b in zip(K.indptr[:-1], K.indptr[1:], strict=True)]
    M_rows = [[np.array([i], "<u4"), np.ones(1)] for i in range(10)]
    with package.SecondOrderModel.from_scipy(K, M, comm=comm) as model:
        assert model.digest_of("K") == by_hand(K_rows) and model.digest_of("M") == by_hand(M_rows)
        assert model.digest_of("D") is None and model.digest_of("B") is None
        column = np.array([[1e-7 * (row == 2)] for row in range(10)])[model.first_row :][: model.local_rows]
        with model.with_inputs([3]) as loaded:
            assert loaded._known["digest", "K"] == model.digest_of("K")  # not computed again
            with model.with_inputs([4]) as other, model.with_input_columns(column, ["small"]) as scaled:
                assert len({item.digest_of("B") for item in (loaded, other, scaled)}) == 3
                assert loaded.digests == {"M": model.digest_of("M"), "K": model.digest_of("K"),
                                          "B": loaded.digest_of("B")}  # fmt: skip


@pytest.mark.mpi
def test_interface_nodes_do_not_make_digests_depend_on_the_ranks(comm):
    """The loads of an averaging set are sums over ranks, with other last digits on other ranks."""
    nodes = tuple(range(1, 25))
    found = {}
    for name, where in (("all", comm), ("one", MPI.COMM_SELF)):
        with package.solid((4, 2, 3), inputs=3, comm=where) as block:
            hub = Interface(name="hub", nodes=nodes)
            model = block.with_interfaces([hub]).with_inputs([("hub", "all")])
            found[name] = model.digest_of("B")
            other = model.with_inputs([("hub", "x")])
            assert other.digest_of("B") != found[name]
    assert found["all"] == found["one"]
