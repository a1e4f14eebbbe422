"""Solve with the factors of one matrix of a model: what ShiftedSolver and ComplexSolver share."""

from __future__ import annotations

from ...parallel.petsc import PETSc
from ..refinement import refine
from .base import Solver
from .settings import Factoring


class DirectSolver(Solver):
    """A Solver with a matrix, in which a subclass puts its A, and its factors by a package.

    `prefix`: of the PETSc options; `inertia`: whether it will be asked for; `factoring`: a Factoring; `reserved_mb`:
    memory of a rank that is not for factors. Symmetric matrices take LDL^T, others LU.
    """

    def __init__(self, model, matrix, rigid, prefix, inertia=False, factoring=None, reserved_mb=0.0):
        self.model, self.matrix, self.rigid = model, matrix, rigid
        if model.symmetric:
            matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        factoring = factoring or Factoring()
        self.factors = factoring.package(matrix, model.symmetric, prefix, factoring, reserved_mb, inertia)

    @property
    def records(self):
        return self.factors.records

    @property
    def analyses(self):
        return self.factors.analyses

    def known(self):
        return self.factors.known()

    def release(self):
        self.factored = None
        self.factors.release()

    def close(self):
        self.factors.close()
        self.matrix.destroy()

    def _refine(self, matrix, back_substitute, load, solution, scale=None, steps=0):
        residual = refine(matrix, back_substitute, load, solution, scale, steps, self.factors.approximate())
        self.records[-1].residual = max(self.records[-1].residual, residual)
