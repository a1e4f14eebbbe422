"""Solve with K + s^2 M for real s by conjugate gradients and multigrid, to the residuals of a factor."""

from __future__ import annotations

import time
from math import inf

import numpy as np

from ...parallel.failures import InputError
from ...parallel.petsc import SAME, PETSc, free_dropped
from ...parallel.sums import summed
from ..blocks import create_dense, local_rows
from ..csr import diagonal_of
from ..multigrid import Multigrid
from .base import FactorRecord, SingularMatrix, Solver
from .iterative import IterativeSolves
from .settings import LinearSolver

ACCEPTED = 1e-10  # relative residual of a solution


class MultigridSolver(IterativeSolves, Solver):
    """Solves with A for real, non-negative coefficients, or with M, in place of a ShiftedSolver.

    `blocks`: a model.NodeBlocks. A is positive definite. `records` has one FactorRecord for each hierarchy
    of levels. Raises InputError for an unsymmetric model.
    """

    advice = (
        ": the matrix is too ill-conditioned, or singular, for solver.kind 'multigrid'; take another solver.threshold, "
        "more solver.sweeps, or kind 'direct'"
    )

    def __init__(self, model, rigid, blocks, settings: LinearSolver, prefix="multigrid_"):
        super().__init__(model, rigid, settings.residual, ACCEPTED, settings.iterations)
        self.settings, self._blocks, self._prefix = settings, blocks, prefix
        self.records: list[FactorRecord] = []
        self.factored, self._levels, self._matrix = None, None, None
        if not model.symmetric:
            key = "D" if model.is_symmetric("K") else "K"
            raise InputError(
                f"solver.kind: found 'multigrid', but {key} of {model.name} is not symmetric; take 'direct'"
            )

    def release(self):
        self.factored = self._levels = self._matrix = None
        free_dropped(self.model.comm)

    def close(self):
        self.release()

    def factor(self, mass, damping=0.0):
        """See Solver. Raises InputError for A that is not definite."""
        if self.factored == (mass, damping):
            return
        self.release()
        if mass == inf:
            self._take_mass()
            return
        if mass < 0 or damping < 0:
            raise InputError(not_definite(f"{(-mass) ** 0.5 / (2 * np.pi):.6g} Hz"))
        model = self.model
        self._terms = [(1.0, model.K)] + [(mass, model.M)] * (mass > 0)
        if damping and model.D is not None:
            self._terms.append((damping, model.D))
        if len(self._terms) == 1 and self.rigid is None and self._blocks.free:
            raise SingularMatrix()
        start = time.perf_counter()
        matrix = model.K.duplicate(copy=True)
        for factor, mat in self._terms[1:]:
            matrix.axpy(factor, mat, structure=SAME)
        matrix.stateIncrease()
        self._matrix = self._blocks.expanded(matrix, model.mean_diagonal_of_k)
        del matrix
        threshold, sweeps = self.settings.threshold, self.settings.sweeps
        self._levels = Multigrid(self._matrix, self._blocks.motions, self._prefix, threshold, sweeps)
        self._began(str(mass), str(damping), "multigrid", start, self._levels.levels, self._levels.entries)
        self.factored = mass, damping

    def _take_mass(self):
        """Have solves with A = M, by conjugate gradients with its diagonal: consistent masses are well conditioned
        (Wathen, IMA J. Numer. Anal. 7(4), 1987). Raises SingularMatrix."""
        start = time.perf_counter()
        values = diagonal_of(self.model.M)
        if not all(self.model.comm.allgather(bool((values > 0).all()))):
            raise SingularMatrix()
        self._inverse, self._terms = 1 / values[:, None], [(1.0, self.model.M)]
        self._began("inf", "0", "diagonal", start, 0, self.model.size)
        self.factored = inf, 0.0

    def _began(self, mass, damping, kind, start, levels, entries):
        self._norm = sum(factor * mat.norm(PETSc.NormType.INFINITY) for factor, mat in self._terms)
        stored = int(12 * entries / 2**20)  # a number and its column
        self.records.append(FactorRecord(
            mass=mass, damping=damping, inertia_relief=self.rigid is not None and mass == "0.0", kind=kind,
            package="none", factor_seconds=round(time.perf_counter() - start, 4), factor_entries=entries,
            memory_mb_estimated_total=stored, memory_mb_used_max_rank=stored // self.model.comm.size,
            memory_mb_used_total=stored, levels=levels,
        ))  # fmt: skip

    def solve(self, right, solution, steps=0):
        """See Solver; to the residual that is asked for, or to round-off. Raises NotSolved."""
        self._solve(right, solution, self._terms)

    def _note(self, columns, seconds, iterations, residual):
        record = self.records[-1]
        record.columns_solved += columns
        record.solve_seconds = round(record.solve_seconds + seconds, 4)
        record.iterations = max(record.iterations, iterations)
        record.residual = max(record.residual, residual)

    def _preconditioner(self, columns):
        if self._levels is None:
            return lambda r, z: np.multiply(r, self._inverse, out=z)
        cycle, blocks = self._levels.apply, self._blocks
        if blocks.expansion is not None:
            plain, wide, made = (create_dense(mat, columns) for mat in (self.model.K, self._matrix, self._matrix))

            def cycle(r, z):
                plain.getDenseArray()[...] = r
                blocks.expansion.matMult(plain, wide)
                self._levels.apply(wide.getDenseArray(), made.getDenseArray())
                blocks.contraction.matMult(made, plain)
                z[...] = plain.getDenseArray()

        if self.rigid is None:
            return cycle
        with local_rows(self.rigid.R) as R, local_rows(self.rigid.MR) as MR:
            R, MR = R.copy(order="F"), MR.copy(order="F")

        def precondition(r, z):
            cycle(r, z)
            z -= R @ summed(self.model.comm, MR.T @ z)

        return precondition


def not_definite(where) -> str:
    """Why there is no multigrid at a point, and what to do."""
    return (
        f"solver.kind 'multigrid' cannot solve at {where}: K + s^2 M is positive definite at real points alone, "
        "0 Hz or a decay; a real point of high order serves the low end of a band as well, or take kind 'direct'"
    )
