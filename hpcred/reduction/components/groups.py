"""Have groups of ranks make the blocks of different points, for the basis of all ranks.

Each group holds a copy of the model, distributed over its ranks, and has factors of its own, so that different points
are factored at the same time. The blocks enter the basis in the order of the components, as without groups.
"""

from dataclasses import dataclass

import numpy as np

from ...fe.dofs import Dofs
from ...linalg.blocks import View, create_block, dense_matrix, local_rows
from ...linalg.solvers.base import DoesNotFit
from ...model.frames import FramedModel
from ...model.rigid_body.modes import RigidBodyModes
from ...parallel.exchange import exchange
from ...parallel.failures import InputError, Owned, agreed, forget
from ...parallel.petsc import PETSc, free_dropped
from .component import PointComponent
from .point_blocks import join


class Group:
    """A copy of a framed model on the group of this rank: `framed`, the `number` of the group, its communicator.

    The ranks are split into `groups` groups of consecutive ranks, as equal as possible. Call close(), on all ranks of a
    group together, when nothing refers to its objects any more. Making one is collective over all ranks of the model.
    """

    def __init__(self, framed: FramedModel, groups: int):
        comm = framed.model.comm
        self.number = comm.rank * groups // comm.size
        self.comm = comm.Split(self.number, comm.rank)
        model = _copy(framed.model, self.comm, self.number, groups)
        rigid = RigidBodyModes(model, soft=True) if framed.rigid is not None else None
        self.framed = FramedModel(model, rigid=rigid, damping=framed.damping)

    @property
    def leads(self) -> bool:
        """Whether this rank is the first of its group."""
        return self.comm.rank == 0

    def close(self):
        self.framed = None
        free_dropped(self.comm)
        forget(self.comm)
        self.comm.Free()


def _copy(model, group, number, groups):
    comm, _ = model.comm, model.symmetry_defects  # of all ranks, which the copy takes over
    operator = model.operator.map(lambda mat: mat.getRedundantMatrix(groups, subcomm=PETSc.Comm(group)))
    K = operator["K"]
    # rows of B, C^T and the labels go to the rank that has the row, in every group
    starts = np.array(K.getOwnershipRanges()[:-1], dtype=np.int64)
    layouts = comm.allgather((number, group.rank, starts))
    columns = [np.arange(model.first_row, model.first_row + model.local_rows)]
    dense = [mat for mat in (model.B, model.Ct) if mat is not None]
    for mat in dense:
        columns += list(mat.getDenseArray().real.T)
    if model.dofs is not None:
        columns += [model.dofs.node, model.dofs.direction, *model.dofs.position.T]
    owners = []
    for target in range(groups):
        ranks = np.array([rank for rank, (owner, _, _) in enumerate(layouts) if owner == target])
        owners.append(ranks[np.searchsorted(layouts[ranks[0]][2], columns[0], side="right") - 1])
    owner = np.concatenate(owners)
    order = np.argsort(exchange(comm, owner, [np.tile(columns[0], groups)])[0])
    # column by column, so that no more than one is there for every group
    received = [exchange(comm, owner, [np.tile(column, groups)])[0][order] for column in columns[1:]]
    blocks = []
    for mat in dense:
        count = mat.getSize()[1]
        blocks.append(dense_matrix(K, np.array(received[:count]).T.reshape(-1, count)))
        received = received[count:]
    dofs = None
    if model.dofs is not None:
        dofs = Dofs(received[0], received[1], np.array(received[2:]).T.reshape(-1, 3))
    B, Ct = (None if mat is None else blocks[place] for mat, place in ((model.B, 0), (model.Ct, -1)))
    return model.with_rows(operator, B=B, Ct=Ct, dofs=dofs)


def number_of_groups(wanted, run, points: int) -> int:
    """Return how many groups of ranks make so many points; `wanted`: see Reduction. Collective. Raises InputError."""
    ranks = run.model.comm.size
    if wanted != "auto":
        if wanted > ranks:
            raise InputError(f"groups: found {wanted!r}, expected 1 to {ranks}, the number of ranks, or 'auto'")
        return min(wanted, max(points, 1))
    # "auto": as many as there are points, ranks, and memory or GPUs for their factors
    most = min(points, ranks)
    if most < 2 or run.solvers.multigrid:
        return 1
    with run.progress.stage("estimate"):
        solver, gpus = run.solvers.real(), None
        try:
            estimate = solver.estimate()
            gpus = solver.side_by_side()
        except DoesNotFit:  # the first point says what is done then
            estimate = None
        run.solvers.release()
    if estimate is None:
        run.progress.say("1 group of ranks: a factor does not fit, or what it needs is not known")
        return 1
    need, have = estimate
    if gpus is not None:
        groups = max(1, min(most, gpus))
        run.progress.say(f"{groups} groups of ranks, one on each of {gpus} GPUs: a factor needs about {need:.0f} MB, a "
                         f"GPU has {have:.0f} MB")  # fmt: skip
        return groups
    groups = max(1, min(most, int(have / (1.2 * max(need, 1)))))
    run.progress.say(f"{groups} groups of ranks: a factor needs about {need:.0f} MB, there are {have:.0f} MB")
    return groups


@dataclass
class _Arrived:
    """The blocks of a point that other ranks made, in the rows of the world."""

    parts: list
    block: object
    width: int

    def between(self, start, stop):
        """Return a view of the vectors start .. stop - 1."""
        return View(self.block, self.width * start, self.width * stop)

    def join(self, basis, run):
        join(self.parts, self.between, basis, run)


def blocks_in_groups(basis, runs, groups) -> dict:
    """Return the blocks of the points of a basis, {(component, run): blocks}, each made by a group of ranks.

    Numbers are places in the lists. `runs` get the records of all factorisations. Collective.
    """
    with Owned(runs[0].model.comm) as owned:
        return _blocks_by(owned.owns(Group(runs[0].framed, groups)), basis, runs, groups)


def _blocks_by(group, basis, runs, groups) -> dict:
    """The same, with this group."""
    model, progress = runs[0].model, runs[0].progress
    comm = model.comm
    points = [i for i, component in enumerate(basis) if isinstance(component, PointComponent)]
    arrived = {}
    with Owned(comm) as owned:
        own_runs = [owned.owns(runs[0].on_group(group.framed))]
        if len(runs) > 1:
            own_runs.append(owned.owns(own_runs[0].dual()))
        for first in range(0, len(points), groups):
            computed = {}
            with agreed(comm), Owned(group.comm):
                if first + group.number < len(points):
                    place = points[first + group.number]
                    for c, run in enumerate(own_runs):
                        computed[place, c] = basis[place].blocks(run)
            for i in points[first : first + groups]:
                for c in range(len(runs)):
                    with progress.stage("merge"):
                        arrived[i, c] = bring(model, group, computed.pop((i, c), None))
        for c, run in enumerate(runs):
            if c == 0 or run.notes is not runs[0].notes:
                run.take_over(own_runs[c], group.leads, components=c == 0)
    return arrived


def bring(model, group, blocks):
    """Return blocks of a group with the rows of the world; the ranks of other groups give nothing. Collective."""
    comm = model.comm
    mine = (blocks.parts, blocks.vectors.width) if blocks is not None else None
    own_parts, width = next(description for description in comm.allgather(mine) if description is not None)
    count = width * own_parts[-1].stop if own_parts else 0
    rows, columns = np.zeros(0, dtype=np.int64), [np.zeros(0)] * count
    if blocks is not None:
        first = group.framed.model.first_row
        rows = np.arange(first, first + group.framed.model.local_rows)
        with local_rows(blocks.vectors.columns) as values:
            columns = list(values.real.T.copy())
    owner = np.searchsorted(model.row_starts, rows, side="right") - 1
    rows, *columns = exchange(comm, owner, [rows, *columns])
    block = create_block(model.K, max(count, 1))
    block.setActiveColumns(0, count)
    if count:
        with local_rows(block) as values:
            values[rows - model.first_row] = np.array(columns).T
    return _Arrived(own_parts, block, width)
