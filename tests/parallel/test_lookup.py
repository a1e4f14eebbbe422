"""Tables over the ranks, against numpy on one."""

import numpy as np
import pytest

from hpcred.parallel.lookup import look_up, number_over_ranks, repeated_key, sort_over_ranks

pytestmark = pytest.mark.mpi


def test_tables_over_ranks(comm):
    everything = [np.random.default_rng(rank).integers(0, 10**12, 200 * rank) for rank in range(comm.size)]
    everything[0] = np.array([3, 3, 7])
    mine, whole = everything[comm.rank], np.concatenate(everything)
    keys, back = sort_over_ranks(comm, mine, [mine * 2])
    assert np.array_equal(np.concatenate(comm.allgather(keys)), np.sort(whole)) and np.array_equal(back, keys * 2)
    distinct, place = number_over_ranks(comm, mine)
    assert np.array_equal(np.concatenate(comm.allgather(distinct)), np.unique(whole))
    assert np.array_equal(place, np.searchsorted(np.unique(whole), mine))
    found, (value,) = look_up(comm, distinct, [distinct + 0.5], np.append(mine, 10**13 + comm.rank))
    assert found[:-1].all() and not found[-1] and np.array_equal(value[:-1], mine + 0.5)
    assert repeated_key(comm, mine) == 3 and repeated_key(comm, distinct) is None


def test_shares_are_even_however_far_one_key_lies(comm):
    keys = np.arange(1000) * comm.size + comm.rank
    keys[-1] += 10**9
    share = len(sort_over_ranks(comm, keys)[0])
    assert 800 < share < 1200
