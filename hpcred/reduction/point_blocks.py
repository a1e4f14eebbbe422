"""The blocks of one expansion point: made on the ranks that have its factor, joined to the basis on all ranks.

`chains_in_groups` splits the ranks into groups that factor different points at the same time, and brings their blocks
to the rows of the world. The blocks enter the basis in the order of the ingredients, as without groups.
"""

from dataclasses import dataclass, field

import numpy as np

from ..linalg.basis import Basis
from ..linalg.blocks import create_block, local_rows
from ..parallel.exchange import exchange
from ..parallel.failures import agreed
from .groups import copy_to_group


@dataclass
class Chain:
    """Orthonormal `vectors` of a point, and where its blocks begin: (label, columns offered, first vector)."""

    vectors: Basis
    parts: list = field(default_factory=list)

    def add(self, label, columns):
        """Note that the vectors since the last call are a block; returns the first of them."""
        start = self.parts[-1][3] if self.parts else 0
        self.parts.append((label, columns, start, self.vectors.size))
        return start

    def join(self, basis, context):
        """Add the vectors to the basis, block by block, and free them. Collective."""
        _join(self.parts, self.vectors.columns_between, basis, context)
        self.vectors.close()


def _join(parts, columns_between, basis, context):
    for label, columns, start, stop in parts:
        with context.progress.stage("orthogonalise"):
            kept = basis.extend(columns_between(start, stop))
        context.note(label, columns, kept)


@dataclass
class _Arrived:
    """A chain that other ranks made, in the rows of the world."""

    parts: list
    block: object
    width: int

    def join(self, basis, context):
        def between(start, stop):
            self.block.setActiveColumns(self.width * start, self.width * stop)
            return self.block

        _join(self.parts, between, basis, context)
        self.block.destroy()


def chains_in_groups(ingredients, contexts, groups):
    """The chains of the ingredients that have one, {(ingredient, context): chain}, each made by a group of ranks.

    Numbers are places in the lists. `contexts` get the records of all factorisations. Collective.
    """
    model = contexts[0].model
    comm = model.comm
    copied, number = copy_to_group(contexts[0].framed, groups)
    own = [contexts[0].on_group(copied)]
    if len(contexts) > 1:
        own.append(own[0].dual())
    points = [i for i, item in enumerate(ingredients) if hasattr(item, "chain")]
    arrived = {}
    try:
        for turn in range(0, len(points), groups):
            made = {}
            with agreed(comm):
                if turn + number < len(points):
                    for c, context in enumerate(own):
                        made[points[turn + number], c] = ingredients[points[turn + number]].chain(context)
            for i in points[turn : turn + groups]:
                for c in range(len(contexts)):
                    with contexts[0].progress.stage("merge"):
                        arrived[i, c] = _bring(model, copied.model, made.get((i, c)))
        first = copied.model.comm.rank == 0
        for c, context in enumerate(contexts):
            found = (own[c].records, own[c].analyses, [] if number else own[c].report) if first else ([], 0, [])
            for records, analyses, report in comm.allgather(found):
                context.add(records, analyses, report)
    finally:
        for item in (*own, copied, copied.model):
            item.close()
    return arrived


def _bring(model, copy, chain):
    """A chain of a group as a block with the rows of the world; the ranks of other groups give nothing. Collective."""
    comm = model.comm
    mine = (chain.parts, chain.vectors.width) if chain is not None else None
    parts, width = next(item for item in comm.allgather(mine) if item is not None)
    count = width * parts[-1][3] if parts else 0
    rows, columns = np.zeros(0, dtype=np.int64), [np.zeros(0)] * count
    if chain is not None:
        rows = np.arange(copy.first_row, copy.first_row + copy.local_rows)
        with local_rows(chain.vectors.columns) as values:
            columns = list(values.real.T.copy())
        chain.vectors.close()
    owner = np.searchsorted(model.row_starts, rows, side="right") - 1
    rows, *columns = exchange(comm, owner, [rows, *columns])
    block = create_block(model.K, max(count, 1))
    block.setActiveColumns(0, count)
    if count:
        with local_rows(block) as values:
            values[rows - model.first_row] = np.array(columns).T
    return _Arrived(parts, block, width)
