"""Extend a basis block by block, and project the matrices on what is new each time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...linalg.basis import Basis
from ...linalg.blocks import Block, add_product, create_block, inner, view_of
from ...linalg.eigensolver import symmetric_part
from ...model.operator import Operator
from ..run.projection import project, project_stiffness
from ..run.run import Run
from ..small.pseudo_modal import Proportional, PseudoModal, diagonalised

HELD_BACK = 3  # columns at least that an estimate sees the model from


def extended(small, mat, new, columns, symmetric=True, cancels=None) -> np.ndarray:
    """Return V^T A V (m, m) of `columns` V, of which the last are the block `new`, from that of the others, `small`;
    exactly symmetric where A is `symmetric` but for round-off. `cancels`: of K, see project_stiffness, which the first
    columns are projected by. Collective."""
    start = len(small)
    if cancels is not None and symmetric and not start:
        return symmetric_part(project_stiffness(mat, new, cancels))
    right = project(mat, new, columns)
    left = right[:start].T if symmetric or not start else project(mat, columns.between(0, start), new)
    corner = right[start:]
    corner = (corner + corner.T) / 2 if symmetric else corner
    return np.block([[small, right[:start]], [left, corner]])


class Projected:
    """V^T A V (m, m) of the terms of some operators, and V^T L (m, l) of loads L, on a basis V that grows: small
    arrays, the same on all ranks. Methods are collective.

    `operators`: the constant one first, whose matrices have rows as `lifted(V)`, by default those of V;
    `symmetric(place, key)`: whether a matrix of them is; `small`: as these operators; `loads` L.
    """

    def __init__(self, run: Run, basis: Basis, loads: Block, operators, symmetric, lifted=view_of):
        self.run, self.basis, self.loads, self.operators = run, basis, loads, operators
        self._is_symmetric, self._lifted = symmetric, lifted
        self.restart()

    def restart(self):
        """Project on the whole basis."""
        self.small = [operator.map(lambda _: np.zeros((0, 0))) for operator in self.operators]
        self.L = np.zeros((0, self.loads.getActiveColumns()[1]))
        self.project_new()

    def project_new(self):
        """Project on the columns of the basis that are new."""
        start, stop = len(self.L), self.basis.size
        if start == stop:
            return
        new = self.basis.columns_between(start, stop)
        self.L = np.vstack([self.L, inner(new, self.loads)])
        new, columns, made = self._lifted(new), self._lifted(self.basis.columns), []
        for place, operator in enumerate(self.operators):
            mats = {}
            for key, mat in operator.matrices.items():
                cancels = self.run.cancels if key == "K" else None
                mats[key] = extended(self.small[place][key], mat, new, columns, self._is_symmetric(place, key), cancels)
            made.append(self.small[place].with_matrices(mats))
        self.small = made

    def rotate(self, turn):
        """Replace the basis by its combinations `turn` (m, k), orthonormal like itself, and project on these."""
        self.basis.multiply(turn)
        self.restart()


class Projections(Projected):
    """Projections on a mass-orthonormal basis, extended block by block. All methods are collective unless they say so.

    `operator`: V^T A V (m, m) of the terms of the model: K, which may be `symmetric`, D where `damped`, M where V^T M V
    does not count as the identity or is `measured`, and added terms. Models of columns of the basis are parts of them.
    `io`: inputs and outputs in terms of L; `damping`: the proportional damping of the models. Raises InputError (see
    io).
    """

    def __init__(self, run: Run, basis: Basis, damping: Proportional, damped: bool, measured=False):
        self.damping, self.damped, (loads, self.io) = damping, damped, run.independent_loads
        self.symmetric = run.model.is_symmetric("K")
        full = run.model.operator.with_matrices(run.model.operator.matrices | {
            "M": run.mass if run.tau or measured else None, "D": run.model.D if damped else None})  # fmt: skip
        super().__init__(run, basis, loads, [full], lambda _, key: key not in "KD" or run.model.is_symmetric(key))
        self._starts: list[int] = []  # first columns of the blocks

    def extend(self, block, mass_images=None) -> int:
        """Add the span of a block to the basis; returns how many columns are new. `mass_images`: M block if known."""
        start = self.basis.size
        with self.run.progress.stage("orthogonalise"):
            self.run.notes.massless |= self.basis.extend(block, mass_images).massless > 0
        self.project_new()
        if self.basis.size > start:
            self._starts.append(start)
        return self.basis.size - start

    def add_loss_factor(self, eta: float):
        """Measure responses with a loss factor besides the damping matrix; local."""
        self.damping = self.damping._replace(eta=eta)

    def note_silent(self, columns: tuple[int, ...], quiet: bool):
        """Keep which columns of C^T have responses that are round-off, and whether others are quiet; local."""
        if (columns, quiet) != (self.io.silent, self.io.quiet):
            self.io = self.io._replace(silent=columns, quiet=quiet)

    def rotate(self, turn):
        """Replace the basis by its combinations `turn` (m, m), orthonormal like itself, and project on these."""
        # the round-off of the product is measured
        self.operators = [self.operators[0].with_matrices(self.operators[0].matrices | {"M": self.run.mass})]
        super().rotate(turn)

    def replace(self, block):
        """Replace the basis by the span of a block."""
        self.basis.clear()
        self.basis.extend(block)
        self.restart()

    def restart(self):
        self._starts = [0]
        # models by their columns: those that were asked for since the basis grew last, and of the time before
        self._models: dict[tuple[int, ...], PseudoModal] = {}
        self._earlier: dict[tuple[int, ...], PseudoModal] = {}
        super().restart()

    def project_new(self):
        self._models, self._earlier = {}, self._models
        with self.run.progress.stage("project"):
            super().project_new()

    @property
    def operator(self) -> Operator:
        """The projected terms of the model; local."""
        return self.small[0]

    @property
    def beside(self) -> Operator:
        """The terms of the model that are not proportional to M and K: a given D, and added ones; local."""
        return Operator({key: term for key, term in self.operators[0].terms.items() if key not in "MK"})

    @property
    def is_damped(self) -> bool:
        """Whether A(s) has such terms; local."""
        return bool(self.beside)

    @property
    def blocks(self) -> list[tuple[int, int]]:
        """First column and end of each block that extended the basis; local."""
        return list(zip(self._starts, [*self._starts[1:], self.basis.size], strict=False))

    @property
    def first_held_back(self) -> int:
        """Where the newest blocks begin that are held back, to see the model of the columns before them; local."""
        return next((start for start in reversed(self._starts) if self.basis.size - start >= HELD_BACK), 0)

    def dynamic_stiffness(self, mass: float) -> np.ndarray:
        """Return V^T (K + mass M) V (m, m); local."""
        K, M = self.operator["K"], self.operator.get("M")
        return K + mass * (np.eye(len(K)) if M is None else M)

    def model(self, columns=None) -> PseudoModal:
        """Return the model of `columns` (places) of the basis, by default of all; it is kept while the basis grows by
        less than two blocks. Local."""
        k = np.arange(self.basis.size) if columns is None else columns
        key = tuple(k.tolist())
        made = self._models.get(key) or self._earlier.get(key)
        if made is None or made.damping != self.damping:
            made = self.model_of(self.operator.map(lambda matrix: matrix[np.ix_(k, k)]), self.L[k])
        elif made.io is not self.io:
            made = replace(made, io=self.io)
        self._models[key] = made
        return made

    @property
    def is_stiffness_alone(self) -> bool:
        """Whether models have a symmetric K, and M = I but for round-off, and no other terms; local."""
        return self.symmetric and not self.run.tau and self.operator.matrices.keys() == {"K"}

    def with_lowest_again(self, model: PseudoModal, count: int) -> PseudoModal:
        """Return the `model` of all columns in its own coordinates, with K projected anew on its `count` lowest
        pseudo-modes: with other round-off, smaller by as much as these are softer than the stiffest columns. For models
        of K alone. Collective."""
        run, basis = self.run, self.basis.columns
        lowest = create_block(run.model.K, count)
        add_product(lowest, basis, model.vectors[:, :count], beta=0.0)
        K = np.diag(model.eigenvalues)
        K[:, :count] = model.vectors.T @ project(run.model.K, lowest, basis)
        K[:count, count:] = K[count:, :count].T
        K[:count, :count] = symmetric_part(project_stiffness(run.model.K, lowest, run.cancels))
        return self.model_of(self.operator.map(lambda _: K), model.L)

    def model_of(self, operator: Operator, L: np.ndarray) -> PseudoModal:
        """Return the model of a small operator and its loads L, with the damping and the outputs of these; local."""
        M = operator.get("M")
        given = operator["K"], L, operator.get("D"), self.damping, self.io, operator.added, self.symmetric
        return diagonalised(*given, M, self.run.tau) if self.run.tau else diagonalised(*given, gram=M)
