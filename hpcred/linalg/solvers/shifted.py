"""Solve with K + s D + s^2 M for real coefficients: one matrix and one symbolic analysis for all s."""

from __future__ import annotations

from math import inf

import numpy as np

from ...parallel.petsc import SAME, PETSc, SLEPc
from ...parallel.sums import summed
from ..blocks import apply, column_norms, copy_of, create_block, inner, local_rows, random_block
from ..conjugate_gradients import EnergyBound, NotSolved, conjugate_gradients
from .base import SingularMatrix
from .direct import DirectSolver
from .iterative import ROUND_OFF, IterativeSolves, residual_of

NEAR_POLE = 1e-8  # relative distance in s^2 to an undamped eigenvalue below which A counts as singular
OF_K = 1e-13  # the same relative to the mean eigenvalue trace(K) / trace(M), for K alone
NEARBY = 0.5  # of what solutions with the factor of another point add to a basis, the energy that may be left
MOST = 20  # iterations for them


class NearbyFactor(IterativeSolves):
    """Conjugate gradients with the factor of a point above, for few columns: beside a basis that has all modes below
    both, A0^-1 A has its eigenvalues (lambda - omega^2) / (lambda - omega0^2) near 1, and none below it.

    Responses of drive points by the basis with the solutions are off by the energy of their errors, which is therefore
    what is bounded: to a `share` of what the solutions take of it. However good the basis is, that takes an iteration.
    """

    def __init__(self, solver, back_substitute, share):
        super().__init__(solver.model, solver.rigid, 0.0, 0.0, MOST)
        self._records, self._back_substitute = solver.records, back_substitute
        self._norm, self._share = solver.model.K.norm(PETSc.NormType.INFINITY), share

    def _solve_columns(self, b, x, scale, terms, deflation, rough):
        comm, (V, inverse) = self.model.comm, deflation
        multiply, r = self._multiplication(b.shape[1], terms), np.empty_like(b)
        # in the basis, but for which round-off cannot be told from residuals
        x[...] = V @ (inverse @ summed(comm, V.T @ b))
        residual_of(multiply, b, x, r)
        floor = ROUND_OFF * self._norm * self._norms(x)
        # and beside it
        energy = EnergyBound(b.shape[1], self._share)
        precondition = self._beside(V, inverse, multiply, None, self._preconditioner(b.shape[1]))
        iterations = conjugate_gradients(comm, multiply, precondition, r, x, floor, self._most, energy)
        size = self._norms(r)
        if not (energy.small | (size <= floor)).all():
            raise NotSolved(f"{iterations.max()} iterations of conjugate gradients with the factor of another point do "
                            "not come to an end: the basis may lack a mode below that")  # fmt: skip
        return int(iterations.max(initial=0)), float((size[scale > 0] / scale[scale > 0]).max(initial=0.0))

    def _preconditioner(self, columns):
        load, solution = (create_block(self.model.K, columns) for _ in range(2))

        def precondition(r, z):
            with local_rows(load) as rows:
                rows[...] = r
            self._back_substitute(load, solution)
            with local_rows(solution) as rows:
                z[...] = rows

        return precondition

    def _note(self, columns, seconds, iterations, residual):
        record = self._records[-1]
        record.iterations = max(record.iterations, iterations)
        record.nearby_residual = max(record.nearby_residual, residual)


class ShiftedSolver(DirectSolver):
    """Solves with A = K + damping * D + mass * M for one pair of real coefficients at a time.

    For the Laplace variable s: mass = s^2, damping = s (41, 47). For a free body right-hand sides are made
    self-equilibrated and solutions M-orthogonal to the rigid-body modes, and A = K is solved by inertia relief.
    """

    def __init__(self, model, rigid=None, prefix="shift_", inertia=False, factoring=None, reserved_mb=0.0):
        matrix = model.K.duplicate(copy=False)
        matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        super().__init__(model, matrix, rigid, prefix, inertia, factoring, reserved_mb)
        self._relief = False

    def estimate(self):
        self._begin_with(self.model.K)
        return self.factors.estimate()

    def side_by_side(self):
        return self.factors.side_by_side()

    @property
    def inertia(self):
        return self.factors.inertia

    @property
    def source(self):
        """The source of the inertia."""
        return self.factors.source

    def _begin_with(self, mat):
        self.factored = None
        mat.copy(self.matrix, structure=SAME)
        self.matrix.stateIncrease()

    def solve_below(self, mass, right, solution, basis, stiffness, rough=NEARBY):
        """Solve with K + mass M by the factor that there is for another mass, to the share `rough` of NearbyFactor."""
        NearbyFactor(self, self._back_substitute, rough).solve_below(mass, right, solution, basis, stiffness)

    def factor(self, mass, damping=0.0):
        """See Solver. Raises SingularMatrix also when s^2 is an undamped eigenvalue.

        A = K of a free body (mass = damping = 0 with rigid-body modes): six rows and columns are held, which
        makes K regular; with self-equilibrated loads the held dofs take no force, so that which rows were
        taken does not matter after the projection (inertia relief).
        """
        if self.factored == (mass, damping):
            return
        model, matrix = self.model, self.matrix
        self._begin_with(model.K if mass < inf else model.M)
        if damping and model.D is not None:
            matrix.axpy(damping, model.D, structure=SAME)
        if mass and mass < inf:
            matrix.axpy(mass, model.M, structure=SAME)
        self._relief = self.rigid is not None and mass == 0 and damping == 0
        if self._relief:
            matrix.zeroRowsColumns(self.rigid.supports, diag=model.mean_diagonal_of_k)
        damping_label = str(damping) if mass < inf else "0"
        self.factors.factor(mass=str(mass), damping=damping_label, inertia_relief=self._relief)
        if not damping and mass < inf:
            self._check_pole(mass)
        self.factored = mass, damping

    def solve(self, right: SLEPc.BV, solution: SLEPc.BV, steps=0):
        load = right
        if self.rigid is not None:
            load = copy_of(right, self.model.K)
            self.rigid.equilibrate(load)
        self._back_substitute(load, solution)
        # with the true K where rows are held: the supports take no force
        matrix = self.model.K if self._relief else self.matrix
        self._refine(matrix, self._back_substitute, load, solution, column_norms(right), steps)

    def _back_substitute(self, load, solution):
        if not self._relief:
            self.factors.back_substitute(load, solution)
        else:
            held = copy_of(load, self.model.K)
            with local_rows(held) as rows:
                rows[self.rigid.supports - self.model.first_row] = 0.0
            self.factors.back_substitute(held, solution)
        if self.rigid is not None:
            self.rigid.project(solution)

    def _check_pole(self, mass):
        """Raise SingularMatrix if s^2 is an eigenvalue of (K, M) to working precision; for shifts without D.

        Inverse iteration from a random vector: ||x|| / ||A^-1 M x|| comes down to the distance of s^2 to the
        nearest eigenvalue. One solve shows that there is none close by; whether the loads excite the mode does
        not matter.
        """
        model = self.model
        scale = max(abs(mass), model.mean_eigenvalue * OF_K / NEAR_POLE)
        x, product = random_block(model.K, 1), create_block(model.K, 1)
        if self.rigid is not None:
            self.rigid.project(x)
        apply(model.M, x, product)
        for step in range(4):
            before = _mass_norm(x, product)
            self._back_substitute(product, x)
            apply(model.M, x, product)
            after = _mass_norm(x, product)
            distance = before / after / scale if 0 < after < inf else 0.0
            # a random vector has about 1 / sqrt(n) of the mode in it
            close = distance < NEAR_POLE * (100 * model.size**0.5 if step == 0 else 1.0)
            if not close and (step == 0 or distance > 10 * NEAR_POLE):
                return
        if close:
            raise SingularMatrix(distance)


def _mass_norm(block, product):
    """M-norm of a column, given product = M block."""
    square = abs(inner(block, product)[0, 0])
    return square**0.5 if np.isfinite(square) else inf
