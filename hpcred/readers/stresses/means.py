"""Take the mean, at each node, of the stresses of its elements."""

from collections.abc import Iterable

import numpy as np

from ...parallel.failures import InputError
from ...parallel.lookup import look_up, require_once, sort_over_ranks


def means_at_nodes(path, comm, steps: Iterable[tuple]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes (s,), displacements (steps, s, 3) and mean stresses (steps, s, 6) of this rank.

    `steps`: of each, nodes (k,), displacements (k, 3), and nodes (c,) with stresses (c, 6) of single elements.
    Collective. Raises InputError for nodes with two displacements or none, and for steps of different nodes.
    """
    nodes, moved, means = None, [], []
    for label, place, at, stress in steps:
        require_once(comm, label, lambda twice: (
            f"{path}: found two displacements of the node {twice} in step {len(means) + 1}, expected one"))  # fmt: skip
        at, *columns = sort_over_ranks(comm, at, list(stress.T))
        node, start, counts = np.unique(at, return_index=True, return_counts=True)
        mean = np.array([np.add.reduceat(sums, start) if len(start) else sums for sums in columns]).T / counts[:, None]
        there, values = look_up(comm, label, list(place.T), node)
        if comm.allreduce(int((~there).sum())):
            raise InputError(f"{path}: found stresses at nodes without displacements, expected those of all nodes, as "
                             "the deck of `hpcred recover --deck` asks for")  # fmt: skip
        same = nodes is None or np.array_equal(nodes, node)
        if not all(comm.allgather(same)):
            raise InputError(f"{path}: found steps with stresses of different nodes")
        nodes = node
        moved.append(np.array(values).T)
        means.append(mean)
    return nodes, np.stack(moved), np.stack(means)
