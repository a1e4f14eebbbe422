"""Decisions that all ranks must share: how many columns, which signs, which eigenvectors, what to drop.

Ranks with other processors may have other BLAS kernels, whose last digits differ. What follows from small arrays by a
comparison, an eigenvector or a division is therefore computed on one rank and sent, here and nowhere else.
"""

from .failures import agreed, common_to


def decided(comm, function, *arguments):
    """function(*arguments) as rank 0 of `comm` finds it, on all ranks; what it raises is raised on all. Collective."""
    if comm.size == 1:
        return function(*arguments)
    outcome = None
    if comm.rank == 0:
        try:
            outcome = function(*arguments), None
        except Exception as error:
            outcome = None, error
    value, error = comm.bcast(outcome)
    if error is not None:
        raise common_to(comm, error)
    return value


def shared_out(comm, function, items) -> list:
    """[function(item) for item in items] on all ranks, each found on one of them; local functions of small arrays that
    take long. Collective."""
    with agreed(comm):
        mine = [function(item) for item in items[comm.rank :: comm.size]]
    by_rank = comm.allgather(mine)
    return [by_rank[i % comm.size][i // comm.size] for i in range(len(items))]
