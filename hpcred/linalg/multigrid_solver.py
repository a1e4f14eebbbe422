"""Solves with K + s^2 M for real s by conjugate gradients and multigrid: no factor, and residuals as with one."""

from __future__ import annotations

import time
from contextlib import ExitStack
from math import inf

import numpy as np

from ..parallel.failures import ComputationError, InputError, Owned
from ..parallel.petsc import SAME, PETSc
from .blocks import column_norms, copy_of, local_rows
from .conjugate_gradients import conjugate_gradients
from .factorisation import FactorRecord, LinearSolver, SingularMatrix
from .multigrid import Multigrid

WIDTH = 16  # columns solved for at once
RESTARTS = 3  # from the true residual
ACCEPTED = 1e-10  # relative residual of a solution, or
BACKWARD = 1e-14  # its backward error ||r|| / (||A|| ||x|| + ||b||), as of refined solutions
ROUND_OFF = 1e-16  # backward error below which no residual can be asked for


class MultigridSolver:
    """Solves with A = K + damping D + mass M for real, non-negative coefficients, or with M, in place of a
    ShiftedSolver, whose methods it has.

    `blocks`: a model.NodeBlocks, closed here. A is positive definite; for a free body A = K is solved in the space of
    self-equilibrated loads and of solutions that are M-orthogonal to the rigid-body modes `rigid`. `records` has one
    FactorRecord for each hierarchy of levels. Collective. Call close(). Raises InputError for an unsymmetric model.
    """

    analyses = 0

    def __init__(self, model, rigid, blocks, settings: LinearSolver, prefix="multigrid_"):
        self.model, self.rigid, self.settings, self._blocks, self._prefix = model, rigid, settings, blocks, prefix
        self.records: list[FactorRecord] = []
        self.factored, self._levels, self._matrix = None, None, None
        if not model.symmetric:
            blocks.close()
            raise InputError(
                f"solver.kind: found 'multigrid', but D of {model.name} is not symmetric; take 'direct'"
            )

    def release(self):
        """Free the levels."""
        self.factored = None
        if self._levels is not None:
            self._levels.close()
        if self._matrix is not None:
            self._matrix.destroy()
        self._levels = self._matrix = None

    def close(self):
        self.release()
        self._blocks.close()

    def factor(self, mass, damping=0.0):
        """Make the levels for A = K + damping D + mass M, unless they are there.

        Raises SingularMatrix, InputError for A that is not definite, or ComputationError.
        """
        if self.factored == (mass, damping):
            return
        self.release()
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
        if self._matrix is not matrix:
            matrix.destroy()
        threshold, sweeps = self.settings.threshold, self.settings.sweeps
        self._levels = Multigrid(self._matrix, self._blocks.motions, self._prefix, threshold, sweeps)
        self._began(str(mass), str(damping), "multigrid", start, self._levels.levels, self._levels.entries)
        self.factored = mass, damping

    def factor_mass(self):
        """Have solves with A = M, by conjugate gradients with its diagonal: consistent masses are well conditioned
        (Wathen, IMA J. Numer. Anal. 7(4), 1987). Raises SingularMatrix."""
        if self.factored == (inf, 0.0):
            return
        self.release()
        start = time.perf_counter()
        diagonal = self.model.M.getDiagonal()
        values = diagonal.getArray(readonly=True).real.copy()
        diagonal.destroy()
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
            analysis_seconds=0.0, factor_seconds=round(time.perf_counter() - start, 4), ordering="none",
            factor_entries=entries, flops=0.0, memory_mb_estimated_total=stored, memory_mb_estimated_max_rank=0,
            memory_mb_used_max_rank=stored // self.model.comm.size, memory_mb_used_total=stored, negative_pivots=0,
            null_pivots=0, workspace_retries=0, levels=levels,
        ))  # fmt: skip

    def solve(self, right, solution, steps=0):
        """solution = A^-1 right for all active columns, to the residual that is asked for, or to round-off.

        Raises ComputationError when the residual stays large, or A proves not to be definite.
        """
        self._solve(right, solution, self._terms, None)

    def solve_below(self, mass, right, solution, basis, squares):
        """solution = (K + mass M)^-1 right for a mass < 0, with the levels of K, where a basis V (a block, V^T M V = I)
        has all modes below: what is left of the matrix beside V is positive definite.

        `squares`: V^T K V (m, m). Deflated conjugate gradients (Nicolaides, SIAM J. Numer. Anal. 24(2), 1987). Raises
        NegativeCurvature where V lacks a mode that the loads move, or ComputationError.
        """
        small = squares + mass * np.eye(len(squares))
        terms = [(1.0, self.model.K), (mass, self.model.M)]
        self._solve(right, solution, terms, (basis, np.linalg.inv((small + small.T) / 2)))

    def _solve(self, right, solution, terms, deflation):
        start, record = time.perf_counter(), self.records[-1]
        with Owned(self.model.comm) as owned:
            load = owned.owns(copy_of(right, self.model.K))
            if self.rigid is not None:
                self.rigid.equilibrate(load)
            scale = column_norms(right)
            with ExitStack() as views:
                b, x = (views.enter_context(local_rows(block)) for block in (load, solution))
                if deflation is not None:
                    deflation = views.enter_context(local_rows(deflation[0])), deflation[1]
                for low in range(0, b.shape[1], WIDTH):
                    part = slice(low, low + WIDTH)
                    self._solve_columns(b[:, part], x[:, part], scale[part], terms, deflation)
        if self.rigid is not None:
            self.rigid.project(solution)
        record.columns_solved += len(scale)
        record.solve_seconds = round(record.solve_seconds + time.perf_counter() - start, 4)

    def _solve_columns(self, b, x, scale, terms, deflation):
        """x = A^-1 b for the rows of this rank."""
        comm, goal = self.model.comm, self.settings.residual
        x[...] = 0.0
        r, before, loaded = b.copy(order="F"), inf, scale > 0
        iterations = np.zeros(b.shape[1], dtype=int)
        with Owned(comm) as room:
            multiply = self._multiplication(room, b.shape[1], terms)
            precondition = self._preconditioner(room, b.shape[1])
            if deflation is not None:
                V, inverse = deflation
                momentum = self._multiplication(room, b.shape[1], [(1.0, self.model.M)])
                precondition = self._beside(V, inverse, multiply, momentum, precondition)
            for turn in range(RESTARTS + 2):
                if deflation is not None:
                    x += V @ (inverse @ comm.allreduce(V.T @ r))
                    _residual(multiply, b, x, r)
                size, far = self._norms(r), self._norms(x)
                floor = np.maximum(goal * scale, ROUND_OFF * self._norm * far)
                relative = float((size[loaded] / scale[loaded]).max(initial=0.0))
                backward = float((size / np.maximum(self._norm * far + scale, 1e-300)).max(initial=0.0))
                if (size <= floor).all() or not relative < before / 2 or turn > RESTARTS:
                    break
                before = relative
                iterations += conjugate_gradients(
                    comm, multiply, precondition, r, x, floor, self.settings.iterations)  # fmt: skip
                _residual(multiply, b, x, r)
        record = self.records[-1]
        record.iterations = max(record.iterations, int(iterations.max(initial=0)))
        record.residual = max(record.residual, relative)
        if not (relative <= ACCEPTED or backward <= BACKWARD):
            raise ComputationError(
                f"solver.kind 'multigrid': the relative residual stays at {relative:.1e} (backward error "
                f"{backward:.1e}) after {iterations.max()} iterations of conjugate gradients: the matrix is too "
                "ill-conditioned, or singular, for it; take another solver.threshold, more solver.sweeps, or kind "
                "'direct'"
            )

    def _beside(self, V, inverse, multiply, momentum, precondition):
        """The preconditioner whose results are A-orthogonal to V, for residuals orthogonal to V."""
        comm = self.model.comm

        def deflated(r, z):
            # what round-off brings back of V, whose modes are soft, would soon be all that is seen
            product = np.empty_like(r)
            momentum(V @ comm.allreduce(V.T @ r), product)
            r -= product
            precondition(r, z)
            multiply(z, product)
            z -= V @ (inverse @ comm.allreduce(V.T @ product))

        return deflated

    def _norms(self, rows):
        squares = np.array([np.vdot(column, column).real for column in rows.T])
        return np.sqrt(self.model.comm.allreduce(squares))

    def _multiplication(self, room, columns, terms):
        """p, q -> q = A p for the rows of this rank."""
        source, target = (room.owns(_dense(self.model.K, columns)) for _ in range(2))

        def multiply(p, q):
            source.getDenseArray()[...] = p
            q[...] = 0.0
            for factor, mat in terms:
                mat.matMult(source, target)
                q += factor * target.getDenseArray() if factor != 1 else target.getDenseArray()

        return multiply

    def _preconditioner(self, room, columns):
        if self._levels is None:
            return lambda r, z: np.multiply(r, self._inverse, out=z)
        cycle, blocks = self._levels.apply, self._blocks
        if blocks.expansion is not None:
            plain, wide, made = (room.owns(_dense(mat, columns)) for mat in (self.model.K, *[self._matrix] * 2))

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
            z -= R @ self.model.comm.allreduce(MR.T @ z)

        return precondition


def _residual(multiply, b, x, r):
    """r = b - A x."""
    multiply(x, r)
    np.subtract(b, r, out=r)


def not_definite(where) -> str:
    """Why there is no multigrid at a point, and what to do."""
    return (
        f"solver.kind 'multigrid' cannot solve at {where}: K + s^2 M is positive definite at real points alone, "
        "0 Hz or a decay; a real point of high order serves the low end of a band as well, or take kind 'direct'"
    )


def _dense(like, columns):
    """A dense matrix (n, columns) with the rows of another."""
    mat = PETSc.Mat().createDense(((like.getLocalSize()[0], like.getSize()[0]), (None, columns)), comm=like.comm)
    mat.setUp()
    mat.assemble()
    return mat
