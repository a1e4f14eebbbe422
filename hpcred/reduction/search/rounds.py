"""Take several points of a search at once: each group of ranks makes the blocks of one, and all ranks add them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...parallel.decisions import decided_with
from ...parallel.failures import Owned, agreed
from ..components.groups import Group, bring
from .expansion import Expansion, expanded
from .judging import Judgement


def take_round(expansion: Expansion, groups: int, frequencies) -> tuple[Judgement, bool | None]:
    """Have each group of ranks make the blocks of a point, and add all; returns what was judged of them. Collective.

    A group judges its blocks over its part of the band. The estimate holds back the last block of every group. Without
    a candidate the last point proves the model of the others, and so is added after them; also returns whether the
    estimate of that model was small, None where no model was made so.
    """
    run, judge, comm, first = expansion.run, expansion.judge, expansion.run.model.comm, expansion.projections.basis.size
    with Owned(comm) as owned:
        arrived, found = _made_by(owned.owns(Group(run.framed, groups)), run, expansion.settings, frequencies)
    proves = judge.candidate is None and len(frequencies) > 1
    columns, seen = _join(expansion.projections, arrived, proves)
    expansion.look_at_damping()
    expansion.look_at_outputs()
    fine = None
    if proves:
        judge.check_next(columns[columns < seen], seen)
        fine = judge.is_fine(decided_with(comm, judge.estimate_of_candidate))
    at = [point.frequency for point in found]  # some may have been moved off an eigenfrequency
    judged = decided_with(comm, judge.judge_round, at[-1:] if proves else at, columns)
    expansion.take([*found[:-1], replace(found[-1], estimate=judged.estimate)])
    where, size = ", ".join(f"{f:.6g}" for f in at), expansion.projections.basis.size
    run.note(f"adaptive {where} Hz", sum(point.columns for point in found), size - first)
    run.progress.say(f"{size} columns, estimated error {judged.estimate:.1e}")
    judge.keep(judged)
    return judged, fine


def _made_by(group, run, settings, frequencies):
    """Return the blocks of each point (Hz), with the rows of the world, and the Points; `run` gets all records.
    Collective."""
    low, high = settings.band
    width = (high - low) / len(frequencies)
    comm, arrived = run.model.comm, []
    with Owned(comm) as owned:
        own = owned.owns(run.on_group(group.framed))
        made = None
        with agreed(comm), Owned(group.comm):
            if group.number < len(frequencies):
                f = frequencies[group.number]
                made = expanded(own, replace(settings, band=(max(low, f - width), min(high, f + width))), f)
        facts = comm.allgather(made[1] if made and group.leads else None)
        for number in range(len(frequencies)):
            mine = made[0] if made and group.number == number else None
            with run.progress.stage("merge"):
                arrived.append(bring(run.model, group, mine))
        run.take_over(own, group.leads)
    return arrived, [point for point in facts if point is not None]


def _join(projections, arrived, proves) -> tuple[np.ndarray, int]:
    """Add the blocks of several points to the basis. Collective.

    Returns the columns of the basis but for those of the last block of each point, which are held back; and, where the
    last point `proves` the model of the others and so comes after them, how many columns came before it.
    """
    basis, held_back = projections.basis, []
    for some in (arrived[:-1], arrived[-1:]) if proves else (arrived,):
        seen = basis.size
        for last, chosen in ((False, slice(-1)), (True, slice(-1, None))):
            for blocks in some:
                for part in blocks.parts[chosen]:
                    start = basis.size
                    projections.extend(blocks.between(part.start, part.stop))
                    held_back += range(start, basis.size) if last else ()
    return np.setdiff1d(np.arange(basis.size), held_back), seen
