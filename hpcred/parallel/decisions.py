"""Decisions that all ranks must share: how many columns, which signs, which eigenvectors, what to drop.

Ranks with other processors may have other BLAS kernels, whose last digits differ. What follows from small arrays by a
comparison, an eigenvector or a division is therefore computed on one rank and sent, here and nowhere else. Of arrays
that take long, ranks may compute parts, from which one decides: the same for all ranks of a run.
"""

from dataclasses import dataclass, field
from typing import Any

from .failures import agreed, common_to, sendable

MOST = 32  # ranks of a team: rank 0 gathers what all of them have computed


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


@dataclass
class Place:
    """A rank of a team: which one of how many, and what it has `made` for later parts of the same decision."""

    rank: int = 0
    size: int = 1
    made: dict[str, Any] = field(default_factory=dict)

    def share(self, items):
        """Return the items of this rank."""
        return items[self.rank :: self.size]


class Team:
    """The ranks of a communicator, at most MOST, that compute parts of a decision of rank 0 (see decided_with); by
    default this rank alone."""

    def __init__(self, comm=None):
        self._comm, self._is_asking = comm, False
        self._place = Place() if comm is None else Place(comm.rank, min(comm.size, MOST))

    @property
    def size(self) -> int:
        return self._place.size

    def each(self, function, *arguments) -> list:
        """Return function(place, *arguments) of all ranks: a local function of a module, to all of which the arguments
        are sent. On rank 0 alone, which decides; the others follow."""
        if self.size == 1:
            return [function(self._place, *arguments)]
        self._is_asking = True
        self._comm.bcast((function, arguments))
        outcomes = self._comm.gather(self._tried(function, arguments))[: self.size]
        self._is_asking = False
        for _, error in outcomes:
            if error is not None:
                raise error
        return [value for value, _ in outcomes]

    def follow(self):
        """Compute what rank 0 asks for, until it has decided."""
        while (task := self._comm.bcast(None)) is not None:
            self._comm.gather(self._tried(*task))

    def _tried(self, function, arguments):
        if self._place.rank >= self.size:
            return None
        try:
            return function(self._place, *arguments), None
        except Exception as error:
            return None, sendable(error)

    def dismiss(self):
        """Have the others follow no more. An interrupt within a question leaves them in it: the job ends."""
        if self.size > 1 and not self._is_asking:
            self._comm.bcast(None)


def decided_with(comm, function, *arguments):
    """function(team, *arguments) as rank 0 of `comm` finds it, on all ranks, where it may ask the team of all for
    parts that take long; what it raises is raised on all. Collective."""
    team = Team(comm)

    def lead():
        try:
            return function(team, *arguments)
        finally:
            team.dismiss()

    if comm.rank:
        team.follow()
    return decided(comm, lead)
