"""Solve with A(s) for complex s, in every build: blocks are pairs Re, Im of complex columns (see blocks.fold)."""

from __future__ import annotations

import numpy as np

from ...parallel.petsc import is_complex
from ..blocks import add_product, as_pairs, copy_of, create_block, inner, unfold
from ..complex_forms import NativeForm, RealForm
from .direct import DirectSolver


class ComplexSolver(DirectSolver):
    """Solves with A(s) for one complex s at a time; blocks are pairs Re, Im of complex columns (see blocks.fold).

    For a free body solutions are those of the elastic part, x with R^T M x = 0 and A x - b in the span of M R.
    `form`: "native" or "real" (see complex_forms), by default what the build can.
    """

    def __init__(self, model, rigid=None, prefix="complex_", form=None, factoring=None, reserved_mb=0.0):
        form = form or ("native" if is_complex() else "real")
        self._form = NativeForm(model) if form == "native" else RealForm(model)
        super().__init__(model, self._form.matrix, rigid, prefix, factoring=factoring, reserved_mb=reserved_mb)
        self._accelerated = None

    def factor_at(self, s: complex, stiffness: complex = 1.0):
        """Have solves be with A(s), see factor()."""
        self.factor(s * s, s, stiffness, self.model.added.coefficients(s).tolist())

    def release(self):
        self._accelerated = None
        super().release()

    def factor(self, mass: complex, damping: complex = 0.0, stiffness: complex = 1.0, added=()):
        """See Solver, for mass M + damping D + stiffness K + sum added K_v, without factors of the added terms none of
        them: A(s) = s^2 M + s D + (1 + i loss_factor) K + sum c(s) K_v."""
        if self.factored == (mass, damping, stiffness, *added):
            return
        self.factored = None
        by_term = dict(zip(self.model.added.terms, added, strict=False))
        self._form.fill({"M": mass, "D": damping, "K": stiffness} | by_term)
        self.factors.factor(mass=str(mass), damping=str(damping), inertia_relief=False)
        if self.rigid is not None:
            # A^-1 M R, which is R / s^2 when D R = 0
            loads = as_pairs(self.rigid.MR, self.model.K)
            self._accelerated = None
            self._accelerated = create_block(self.model.K, loads.getSizes()[1])
            self._solve(loads, self._accelerated)
            self._held = self._momentum(self._accelerated)
        self.factored = mass, damping, stiffness, *added

    def solve(self, right, solution, steps=0):
        load = copy_of(right, self.model.K)
        if self.rigid is not None:
            self.rigid.equilibrate(load)
        self._solve(load, solution, steps)
        if self.rigid is not None:
            share = np.linalg.solve(self._held, self._momentum(solution))
            add_product(solution, self._accelerated, unfold(share), alpha=-1.0)

    def _solve(self, load, solution, steps=0):
        columns = load.getActiveColumns()[1] // 2
        b, x = (create_block(self.matrix, columns) for _ in range(2))
        self._form.put(load, b)
        self.factors.back_substitute(b, x)
        self._refine(self.matrix, self.factors.back_substitute, b, x, steps=steps)
        self._form.get(x, solution)

    def _momentum(self, pairs):
        """R^T M x (count, columns) of complex columns."""
        gram = inner(self.rigid.MR, pairs)
        return gram[:, 0::2] + 1j * gram[:, 1::2]
