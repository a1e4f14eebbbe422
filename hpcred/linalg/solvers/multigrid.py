"""Solve with K + s^2 M for real s by conjugate gradients and multigrid, to the residuals of a factor."""

from __future__ import annotations

import time
from math import inf

import numpy as np

from ...parallel.failures import ComputationError, InputError
from ...parallel.petsc import SAME, PETSc, free_dropped
from ...parallel.sums import summed
from ..blocks import create_dense, local_rows, multiply_dense
from ..conjugate_gradients import NegativeCurvature, negative_curvature
from ..csr import diagonal_of
from ..multigrid import Multigrid, TooDense
from ..ritz_values import iterations_to, rate, ritz_values
from .base import FactorRecord, SingularMatrix, Solver
from .iterative import IterativeSolves
from .settings import LinearSolver

STEPS = 40  # of Lanczos' method, at most, by which iterations are predicted
SLOW = 60  # iterations from which on smaller aggregates are tried
ACCEPTED = 1e-10  # relative residual of a solution


class TooSlow(ComputationError):
    """Conjugate gradients with multigrid would take too many iterations."""


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
        # A, and the levels below it
        start = time.perf_counter()
        matrix = model.K  # itself where nothing is added, for a copy would be a large part of the memory
        if self._terms[1:]:
            matrix = model.K.duplicate(copy=True)
            for factor, mat in self._terms[1:]:
                matrix.axpy(factor, mat, structure=SAME)
            matrix.stateIncrease()
        self._matrix = self._blocks.expanded(matrix, model.mean_diagonal_of_k)
        del matrix
        expected = self._make_levels()
        self._began(str(mass), str(damping), "multigrid", start, self._levels.levels, self._levels.entries)
        self.records[-1].expected_iterations = expected
        self.factored = mass, damping

    def _make_levels(self) -> int:
        """Make the levels that take the least work, and return how many iterations they will take. Raises TooSlow."""
        blocks, goal = self._blocks, self.settings.residual
        values = self._try_levels(aggressive=blocks.corners is None)
        if blocks.corners is None and iterations_to(goal, values) > SLOW:
            kept, before, entries = self._levels, values, self._matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
            try:
                values = self._try_levels(aggressive=False)
            except (TooDense, NegativeCurvature):
                self._levels = kept
            work = [iterations_to(goal, seen) * (entries + levels.entries)
                    for seen, levels in ((before, kept), (values, self._levels))]  # fmt: skip
            if work[0] <= work[1]:
                self._levels, values = kept, before
            del kept
            free_dropped(self.model.comm)
        expected = iterations_to(goal, values)
        if expected > self.settings.iterations:
            self.release()
            raise TooSlow(too_slow(expected, rate(values), self.settings.iterations, blocks))
        return expected

    def _try_levels(self, aggressive):
        """Make levels, and return eigenvalues of the preconditioned matrix. Raises TooDense, NegativeCurvature."""
        settings, blocks = self.settings, self._blocks
        self._levels = Multigrid(self._matrix, blocks.motions, self._prefix, settings.threshold, settings.sweeps,
                                 aggressive, blocks.corners)  # fmt: skip
        first, last = self.model.K.getOwnershipRange()
        load = np.random.default_rng(first).standard_normal((last - first, 1))
        if self.rigid is not None:
            with local_rows(self.rigid.R) as R, local_rows(self.rigid.MR) as MR:
                load -= MR.real @ summed(self.model.comm, R.real.T @ load)
        multiply, precondition = self._multiplication(1, self._terms), self._preconditioner(1)
        values = ritz_values(self.model.comm, multiply, precondition, load.astype(PETSc.ScalarType), STEPS)
        if values[0] <= 0:
            raise negative_curvature("the matrix, or the approximate inverse,")
        return values

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

    def solve(self, right, solution, steps=0, rough=0.0):
        """See Solver; to the residual that is asked for, or to round-off, or to `rough` times the norms of the loads.
        Raises NotSolved."""
        self._solve(right, solution, self._terms, rough=rough)

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
            plain, wide, result = (create_dense(mat, columns) for mat in (self.model.K, self._matrix, self._matrix))

            def cycle(r, z):
                plain.getDenseArray()[...] = r
                multiply_dense(blocks.expansion, plain, wide)
                self._levels.apply(wide.getDenseArray(), result.getDenseArray())
                multiply_dense(blocks.contraction, result, plain)
                z[...] = plain.getDenseArray()

        if self.rigid is None:
            return cycle
        with local_rows(self.rigid.R) as R, local_rows(self.rigid.MR) as MR:
            R, MR = R.copy(order="F"), MR.copy(order="F")

        def precondition(r, z):
            cycle(r, z)
            z -= R @ summed(self.model.comm, MR.T @ z)

        return precondition


def too_slow(expected, factor, most, blocks) -> str:
    """Why multigrid is not for a body, and what to do."""
    known = "quadratic elements by their corners" if blocks.corners else "no quadratic elements known"
    return (
        f"multigrid reduces the error by {factor:.3f} an iteration, so that a column would take about {expected} "
        f"iterations, more than solver.iterations = {most} ({blocks.size} directions a node, {known}): elements are "
        "too thin or too bad, or the material is nearly incompressible; take solver.kind 'direct', with out_of_core "
        "where memory is short (factors of thin bodies are small), more solver.sweeps, or more solver.iterations"
    )


def not_definite(where) -> str:
    """Why there is no multigrid at a point, and what to do."""
    return (
        f"solver.kind 'multigrid' cannot solve at {where}: K + s^2 M is positive definite at real points alone, "
        "0 Hz or a decay; a real point of high order serves the low end of a band as well, or take kind 'direct'"
    )
