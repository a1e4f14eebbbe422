"""Sort and look up tables that no rank holds alone, by keys and columns of this rank."""

import numpy as np

from .exchange import exchange
from .failures import InputError

SAMPLES = 64  # of the keys of each rank, to find even shares


def sort_over_ranks(comm, keys: np.ndarray, arrays=()) -> list[np.ndarray]:
    """The keys, and arrays that belong to them, ascending over the ranks; equal keys on one rank. Collective.

    Equal keys keep their order by rank and place. Shares are about even, however the keys are spread.
    """
    if comm.size > 1:
        ordered = np.sort(keys)
        picks = ordered[np.linspace(0, len(ordered) - 1, min(SAMPLES, len(ordered))).astype(np.int64)]
        samples = np.sort(np.concatenate(comm.allgather(picks)))
        cuts = samples[[len(samples) * rank // comm.size for rank in range(1, comm.size)]] if samples.size else samples
        keys, *arrays = exchange(comm, np.searchsorted(cuts, keys, side="right"), [keys, *arrays])
    order = np.argsort(keys, kind="stable")
    return [keys[order], *(array[order] for array in arrays)]


def look_up(comm, keys: np.ndarray, arrays, wanted: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """The entries of the arrays at the wanted keys: which were found, and for each array its values. Collective.

    `keys` differ from each other over all ranks; they and `wanted` are not negative. Keys meet on the rank of the
    remainder of their division by the number of ranks. Values of keys that were not found mean nothing.
    """
    asked, back = np.unique(wanted, return_inverse=True)
    keys, *arrays = exchange(comm, keys % comm.size, [keys, *arrays])
    order = np.argsort(keys)
    query, sender, place = exchange(
        comm, asked % comm.size, [asked, np.full(len(asked), comm.rank), np.arange(len(asked))]
    )
    where = order[np.minimum(np.searchsorted(keys, query, sorter=order), len(keys) - 1)] if len(keys) else None
    hit = np.zeros(len(query), bool) if where is None else keys[where] == query
    answers = [np.zeros(len(query), array.dtype) if where is None else array[where] for array in arrays]
    place, hit, *answers = exchange(comm, sender, [place, hit, *answers])
    order = np.argsort(place)
    return hit[order][back], [answer[order][back] for answer in answers]


def repeated_key(comm, keys: np.ndarray) -> int | None:
    """A key that occurs twice or more, or None. Collective; the same answer on all ranks."""
    (ordered,) = sort_over_ranks(comm, keys)
    twice = ordered[1:][ordered[1:] == ordered[:-1]]
    repeated = [key for key in comm.allgather(int(twice[0]) if twice.size else None) if key is not None]
    return repeated[0] if repeated else None


def require_once(comm, keys: np.ndarray, sentence):
    """Raise InputError with `sentence(key)` where a key occurs twice or more. Collective."""
    if (twice := repeated_key(comm, keys)) is not None:
        raise InputError(sentence(twice))


def number_over_ranks(comm, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distinct keys, ascending over the ranks (the part of this rank), and the place of each key. Collective."""
    mine = np.unique(keys)
    distinct = np.unique(sort_over_ranks(comm, mine)[0])
    first = comm.exscan(len(distinct)) or 0
    _, (place,) = look_up(comm, distinct, [first + np.arange(len(distinct))], mine)
    return distinct, place[np.searchsorted(mine, keys)]
