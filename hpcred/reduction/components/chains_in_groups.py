"""Several points of a search at once: each group of ranks makes the chain of one; all ranks add them to the basis."""

from __future__ import annotations

from ...parallel.failures import Owned, agreed
from .groups import Group, bring


def chains_in_groups(run, groups, points, make):
    """The blocks of each point (Hz), with the rows of the world, and what is known of the points. Collective.

    make(run, f) gives blocks and a Point on the ranks of a group; `run` gets the records of all factorisations.
    """
    comm, arrived = run.model.comm, []
    with Owned(comm) as owned:
        group = owned.owns(Group(run.framed, groups))
        own = owned.owns(run.on_group(group.framed))
        made = None
        with agreed(comm), Owned(group.comm):
            if group.number < len(points):
                made = make(own, points[group.number])
        facts = comm.allgather(made[1] if made and group.leads else None)
        for number in range(len(points)):
            mine = made[0] if made and group.number == number else None
            with run.progress.stage("merge"):
                arrived.append(bring(run.model, group, mine))
        for told in comm.allgather(own.told() if group.leads else None):
            if told is not None:
                run.add(*told[:2], [], *told[3:])
    return arrived, [item for item in facts if item is not None]


def join_round(projections, arrived, proves) -> tuple[list[int], int]:
    """Add the blocks of several points to the basis, and free them. Collective.

    Returns the columns of the basis but for those of the last block of each point, which are held back; and, where the
    last point `proves` the model of the others and so comes after them, how many columns came before it.
    """
    basis, held_back = projections.basis, set()
    for some in (arrived[:-1], arrived[-1:]) if proves else (arrived,):
        seen = basis.size
        for last, chosen in ((False, slice(-1)), (True, slice(-1, None))):
            for blocks in some:
                for part in blocks.parts[chosen]:
                    start = basis.size
                    projections.extend(blocks.between(part.start, part.stop))
                    if last:
                        held_back.update(range(start, basis.size))
    for blocks in arrived:
        blocks.close()
    return [k for k in range(basis.size) if k not in held_back], seen
