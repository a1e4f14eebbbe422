"""Solve with A(s) = s^2 M + s D + (1 + i eta) K + sum c(s) K_v for complex s, in either build of PETSc.

Blocks are pairs Re, Im of complex columns (see blocks.fold). A complex build has A(s) as it is (complex symmetric
LDL^T, no conjugation). A real build takes the symmetric real form of twice the size,

    [ Re A  -Im A ] [Re x]   [ Re b]
    [-Im A  -Re A ] [Im x] = [-Im b]      for A x = b,

in which each rank has its real rows first and its imaginary rows after them, so that no value moves between ranks.
"""

from __future__ import annotations

import numpy as np

from ...parallel.petsc import SAME, PETSc, is_complex
from ..blocks import add_product, as_pairs, copy_of, create_block, inner, local_rows, unfold
from .direct import DirectSolver


class NativeForm:
    """A(s) as a complex matrix of a complex build."""

    def __init__(self, model):
        self.model, self.matrix = model, model.K.duplicate(copy=False)

    def fill(self, coefficients):
        """matrix = the sum of coefficients times the terms of the model, by key."""
        self.model.K.copy(self.matrix, structure=SAME)
        self.matrix.scale(coefficients["K"])
        for key, mat in self.model.matrices.items():
            if key != "K" and key in coefficients:
                self.matrix.axpy(coefficients[key], mat, structure=SAME)

    def put(self, pairs, block):
        """The complex columns of pairs."""
        with local_rows(pairs) as z, local_rows(block) as x:
            x[...] = z[:, 0::2].real + 1j * z[:, 1::2].real

    def get(self, block, pairs):
        """The pairs of complex columns."""
        with local_rows(block) as x, local_rows(pairs) as z:
            z[:, 0::2], z[:, 1::2] = x.real, x.imag


class RealForm:
    """A(s) as the symmetric real matrix of twice the size."""

    def __init__(self, model):
        self.model = model
        # twice the entries of a rank may be more than 32 bits count
        indptr, columns = (array.astype(np.int64) for array in model.K.getValuesCSR()[:2])
        rows, size = model.local_rows, model.size
        starts = model.row_starts
        widths = np.append(starts[1:], size) - starts
        owner = np.searchsorted(starts, columns, side="right") - 1
        real = columns + starts[owner]
        imaginary = real + widths[owner]
        # positions that put the real and the imaginary columns of every row together, sorted
        row = np.repeat(np.arange(rows), np.diff(indptr))
        self._order = np.lexsort((np.concatenate([real, imaginary]), np.tile(row, 2)))
        indices = np.concatenate([real, imaginary])[self._order]
        self._indptr = np.concatenate([2 * indptr[:-1], 2 * indptr + 2 * indptr[-1]]).astype(PETSc.IntType)
        self._indices = np.tile(indices, 2).astype(PETSc.IntType)
        self.matrix = PETSc.Mat().createAIJ(
            ((2 * rows, 2 * size), (2 * rows, 2 * size)),
            csr=(self._indptr, self._indices, np.zeros(len(self._indices))),
            comm=model.K.comm,
        )

    def fill(self, coefficients):
        """matrix = the real form of the sum of coefficients times the terms of the model, by key."""
        values = sum(coefficients[key] * mat.getValuesCSR()[2].real
                     for key, mat in self.model.matrices.items() if key in coefficients)  # fmt: skip
        upper = np.concatenate([values.real, -values.imag])[self._order]
        lower = np.concatenate([-values.imag, -values.real])[self._order]
        self.matrix.setValuesCSR(self._indptr, self._indices, np.concatenate([upper, lower]))
        self.matrix.assemble()

    def put(self, pairs, block):
        """Columns (Re b, -Im b) of pairs."""
        rows = self.model.local_rows
        with local_rows(pairs) as z, local_rows(block) as x:
            x[:rows], x[rows:] = z[:, 0::2], -z[:, 1::2]

    def get(self, block, pairs):
        """The pairs of columns (Re x, Im x)."""
        rows = self.model.local_rows
        with local_rows(block) as x, local_rows(pairs) as z:
            z[:, 0::2], z[:, 1::2] = x[:rows], x[rows:]


class ComplexSolver(DirectSolver):
    """Solves with A(s) for one complex s at a time; blocks are pairs Re, Im of complex columns (see blocks.fold).

    For a free body solutions are those of the elastic part, x with R^T M x = 0 and A x - b in the span of M R.
    `form`: "native" or "real" (NativeForm, RealForm), by default what the build can.
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
