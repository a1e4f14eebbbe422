"""Make the Krylov sequence of an expansion point block by block, or take it from a store, without a factor.

A sequence depends on its point alone: its vectors are orthonormal by themselves, and nothing that a basis has enters.
What is in a store is therefore what would be computed, to the last digit where the ranks are as many.
"""

from __future__ import annotations

import numpy as np

from ...linalg.basis import Basis
from ...linalg.blocks import create_block
from ...parallel.failures import ComputationError
from ..run.store import Entry
from .point_blocks import Part, PointBlocks


class KrylovSequence:
    """Blocks of one point. A subclass says by which rule one follows from another. Call close(). Collective.

    `vectors`: the orthonormal vectors of all blocks; `ends`: the last vector of each, plus one; `offered`: columns that
    each was made of. `stored`: how many blocks came from the store. `wanted`: blocks that will be asked for, if known.
    """

    kind = Basis
    rule = ""  # names it in the key

    def __init__(self, run, wanted: int | None = None, **key):
        self.run, self.ends, self.offered, self.complete, self.massless = run, [], [], False, False
        self.labels = ("", "")  # of the factor, as FactorRecord has them
        self._place, self._residual, self._solver = 0, 0.0, None
        room = wanted * max(self._load_columns(), 1) if wanted else run.columns
        self.vectors = run.new_basis(room, deflate=False, kind=self.kind)
        self._key = {"kind": "krylov", "rule": self.rule, "tolerance": run.tolerance, **key}
        self._take_stored(wanted)
        self.stored = len(self.ends)

    # what a subclass has

    def _load_columns(self) -> int:
        """Return the number of columns of the loads."""
        raise NotImplementedError

    def _factor(self):
        """Return the solver of the point, with its factor. Raises SingularMatrix."""
        raise NotImplementedError

    def _next_load(self):
        """Return the loads of the next block, as a block."""
        raise NotImplementedError

    def _took(self, load, block):
        """Keep what later loads need of a new block; set `complete` if no block can follow."""

    def _offers(self, columns: int) -> int:
        """Return how many columns of a basis a block of so many real columns can bring."""
        return columns

    def _state(self) -> dict[str, np.ndarray]:
        """Return the arrays that further blocks need beside the vectors."""
        return {}

    def _go_on_from(self, state):
        """Restore the arrays of _state()."""

    # the sequence

    def factor(self):
        """Have the point factored. Raises SingularMatrix."""
        if self._solver is None:
            self._solver = self._factor()

    def advance(self) -> tuple[int, int]:
        """Return the next block, made if it is not there: its first vector and its end, the same where no load is left.

        Raises SingularMatrix.
        """
        if self.complete and self._place == len(self.ends):
            return self.vectors.size, self.vectors.size
        if self._place == len(self.ends):
            self._make()
        self._place += 1
        return self._start(self._place - 1), self.ends[self._place - 1]

    def _start(self, j):
        return self.ends[j - 1] if j else 0

    def _make(self):
        model, progress = self.run.model, self.run.progress
        self.factor()
        load = self._next_load()
        columns = load.getActiveColumns()[1]
        block = create_block(model.K, columns)
        with progress.stage("solve"):
            self._solver.solve(load, block)
        with progress.stage("orthogonalise"):
            start = self.vectors.size
            self.massless |= self.vectors.extend(block).massless > 0
            self.vectors.renew_mass_images(start, self.vectors.size)  # as those that come from a store have them
            self.complete = self.vectors.size == start
            self._took(load, block)
        self.run.notes.massless |= self.massless
        self.offered.append(self._offers(columns))
        self.ends.append(self.vectors.size)
        self._residual = max(self._residual, self._solver.records[-1].residual)

    def blocks(self, count: int, name: str) -> PointBlocks:
        """Return the first `count` blocks, fewer where the loads are exhausted, for a basis. Raises SingularMatrix."""
        blocks = []
        while self._place < count and not (self.complete and self._place == len(self.ends)):
            self.run.progress.step("blocks", self._place, count)
            start, stop = self.advance()
            j = self._place - 1
            blocks.append(Part(f"{name}, block {j}", self.offered[j], start, stop, j < self.stored))
        self.keep()
        return PointBlocks(self.vectors, blocks)

    def keep(self):
        """Have the store keep the sequence, if it has grown."""
        self.run.notes.needs(*self.labels)
        if len(self.ends) == self.stored:
            return
        width = self.vectors.width
        facts = {"ends": self.ends, "offered": self.offered, "complete": self.complete, "residual": self._residual,
                 "massless": self.massless}  # fmt: skip
        widths = tuple(width * (stop - self._start(j)) for j, stop in enumerate(self.ends))
        self.run.keep(self._key, Entry(facts, widths, self.vectors.columns, self._state()))

    def _take_stored(self, wanted):
        entry = self.run.stored(self._key, wanted)
        if entry is None:
            return
        count, facts = len(entry.widths), entry.facts
        try:
            if entry.block is not None:
                self.vectors.restore(entry.block, facts["ends"][:count])
        except ComputationError as error:
            self.run.remark(f"store: {error}; the point is made again")
            self.vectors = None  # whose memory is for the next ones
            self.vectors = self.run.new_basis(self.run.columns, deflate=False, kind=self.kind)
            return
        self.massless = facts["massless"]
        self.run.notes.massless |= self.massless
        self.ends, self.offered = facts["ends"][:count], facts["offered"][:count]
        if count == len(facts["ends"]):
            self.complete, self._residual = facts["complete"], facts["residual"]
            self._go_on_from(entry.arrays)
