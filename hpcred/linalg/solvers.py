"""Solves with A(s) = s^2 M + s D + K for blocks: one matrix and one symbolic analysis for all s, residuals checked.

ShiftedSolver has real coefficients of M and D, ComplexSolver complex ones; both refine and record in the same way.
"""

from __future__ import annotations

from functools import cached_property
from math import inf

import numpy as np

from ..parallel.failures import Owned
from ..parallel.petsc import SAME, PETSc, SLEPc, is_complex
from .blocks import (
    add_product,
    apply,
    as_pairs,
    column_norms,
    copy_of,
    create_block,
    inner,
    local_rows,
    random_block,
    unfold,
)
from .complex_forms import NativeForm, RealForm
from .factorisation import Factorisation, FactorRecord, SingularMatrix
from .iterative_solver import IterativeSolver
from .refinement import refine

NEAR_POLE = 1e-8  # relative distance in s^2 to an undamped eigenvalue below which A counts as singular
NEARBY = 1e-9  # relative residual asked of solutions with the factor of another point
MOST = 20  # iterations for them, from each restart
ROUND_OFF = 1e-13  # the same relative to the mean eigenvalue trace(K) / trace(M), for K alone


class Solver:
    """What the solvers of a model share: a matrix, its factors, records, and the end of both.

    `rigid`: rigid-body modes (model.RigidBodyModes) of a free body, or None. `prefix`: of the PETSc options.
    `reserved_mb`: memory of a rank that is not for factors. Symmetric matrices take LDL^T, others LU. All methods are
    collective. Owns PETSc objects: call close().
    """

    def __init__(self, model, matrix, rigid, prefix, settings=None, factoring=None, reserved_mb=0.0):
        self.model, self.matrix, self.rigid = model, matrix, rigid
        if model.symmetric:
            matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        kind = "cholesky" if model.symmetric else "lu"
        self._factors = Factorisation(matrix, kind, prefix, settings, factoring, reserved_mb)
        self.factored = None  # the coefficients of the matrix that is factored now

    @property
    def records(self) -> list[FactorRecord]:
        """One record a factorisation."""
        return self._factors.records

    @property
    def analyses(self) -> int:
        """Number of symbolic analyses so far."""
        return self._factors.analyses

    def release(self):
        """Free the factor, for another solver to have the memory."""
        self.factored = None
        self._factors.release()

    def close(self):
        self._factors.close()
        self.matrix.destroy()

    def _refine(self, matrix, back_substitute, load, solution, scale=None, steps=0):
        residual = refine(matrix, back_substitute, load, solution, scale, steps, self._factors.factoring.low_rank)
        self.records[-1].residual = max(self.records[-1].residual, residual)


class NearbyFactor(IterativeSolver):
    """Conjugate gradients with the factor of another point, for few columns: beside a basis that has all modes below
    both, A0^-1 A has its eigenvalues (lambda - omega^2) / (lambda - omega0^2) near 1."""

    advice = " with the factor of another point"

    def __init__(self, solver, back_substitute):
        super().__init__(solver.model, solver.rigid, NEARBY, 10 * NEARBY, MOST)
        self._records, self._back_substitute = solver.records, back_substitute
        self._norm = solver.model.K.norm(PETSc.NormType.INFINITY)

    def _preconditioner(self, room, columns):
        load, made = (room.owns(create_block(self.model.K, columns)) for _ in range(2))

        def precondition(r, z):
            with local_rows(load) as rows:
                rows[...] = r
            self._back_substitute(load, made)
            with local_rows(made) as rows:
                z[...] = rows

        return precondition

    def _note(self, columns, seconds, iterations, residual):
        record = self._records[-1]
        record.iterations = max(record.iterations, iterations)
        record.nearby_residual = max(record.nearby_residual, residual)


class ShiftedSolver(Solver):
    """Solves with A = K + damping * D + mass * M for one pair of real coefficients at a time.

    For the Laplace variable s: mass = s^2, damping = s (41, 47). For a free body right-hand sides are made
    self-equilibrated and solutions M-orthogonal to the rigid-body modes, and A = K is solved by inertia relief.
    `inertia`: prepare MUMPS so that negative_pivots is right on any number of ranks.
    """

    def __init__(self, model, rigid=None, prefix="shift_", inertia=False, factoring=None, reserved_mb=0.0):
        matrix = model.K.duplicate(copy=False)
        matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        super().__init__(model, matrix, rigid, prefix, {"icntl_13": 1} if inertia else None, factoring, reserved_mb)
        self._relief = False

    def estimate(self):
        """MB that a factor of A needs in all, and MB that the ranks have. Raises DoesNotFit."""
        self._begin_with(self.model.K)
        return self._factors.estimate()

    def expected(self, orderings) -> dict[int, dict]:
        """What a factor of K with each of the orderings of MUMPS (icntl_7) takes; see Factorisation.expected."""
        self._begin_with(self.model.K)
        return self._factors.expected(orderings)

    def _begin_with(self, mat):
        self.factored = None
        mat.copy(self.matrix, structure=SAME)
        self.matrix.stateIncrease()

    def solve_below(self, mass, right, solution, basis, squares):
        """Solve with K + mass M by the factor that there is for another mass; see IterativeSolver.solve_below."""
        self._nearby.solve_below(mass, right, solution, basis, squares)

    @cached_property
    def _nearby(self):  # which takes the norm of K
        return NearbyFactor(self, self._back_substitute)

    def set_solve_width(self, columns: int):
        """How many columns MUMPS solves for at a time with the present factor, for measurements."""
        self._factors.set_solve_width(columns)

    @property
    def negative_pivots(self) -> int:
        return self._factors.negative_pivots

    def factor(self, mass, damping=0.0):
        """Factor A = K + damping D + mass M, unless it is factored already. Raises SingularMatrix, also when s^2 is an
        undamped eigenvalue, or ComputationError.

        A = K of a free body (mass = damping = 0 with rigid-body modes): six rows and columns are held, which
        makes K regular; with self-equilibrated loads the held dofs take no force, so that which rows were
        taken does not matter after the projection (inertia relief).
        """
        if self.factored == (mass, damping):
            return
        model, matrix = self.model, self.matrix
        self._begin_with(model.K)
        if damping and model.D is not None:
            matrix.axpy(damping, model.D, structure=SAME)
        if mass:
            matrix.axpy(mass, model.M, structure=SAME)
        self._relief = self.rigid is not None and mass == 0 and damping == 0
        if self._relief:
            matrix.zeroRowsColumns(self.rigid.supports, diag=model.mean_diagonal_of_k)
        self._factors.factor(mass=str(mass), damping=str(damping), inertia_relief=self._relief)
        if not damping:
            self._check_pole(mass)
        self.factored = mass, damping

    def factor_mass(self):
        """Factor A = M, which is where s goes to infinity. Raises SingularMatrix or ComputationError."""
        if self.factored == (inf, 0.0):
            return
        self._begin_with(self.model.M)
        self._relief = False
        self._factors.factor(mass="inf", damping="0", inertia_relief=False)
        self.factored = inf, 0.0

    def solve(self, right: SLEPc.BV, solution: SLEPc.BV, steps=0):
        """solution = A^-1 right, another block, for all active columns at once, with the relative residual checked.

        `steps` of iterative refinement are made in any case, more while the residual is large.
        Raises ComputationError when the residual stays large.
        """
        with Owned(self.model.comm) as owned:
            load = right
            if self.rigid is not None:
                load = owned.owns(copy_of(right, self.model.K))
                self.rigid.equilibrate(load)
            self._back_substitute(load, solution)
            # with the true K where rows are held: the supports take no force
            matrix = self.model.K if self._relief else self.matrix
            self._refine(matrix, self._back_substitute, load, solution, column_norms(right), steps)

    def _back_substitute(self, load, solution):
        if not self._relief:
            self._factors.back_substitute(load, solution)
        else:
            held = copy_of(load, self.model.K)
            with local_rows(held) as rows:
                rows[self.rigid.supports - self.model.first_row] = 0.0
            self._factors.back_substitute(held, solution)
            held.destroy()
        if self.rigid is not None:
            self.rigid.project(solution)

    def _check_pole(self, mass):
        """Raise SingularMatrix if s^2 is an eigenvalue of (K, M) to working precision; for shifts without D.

        Inverse iteration from a random vector: ||x|| / ||A^-1 M x|| comes down to the distance of s^2 to the
        nearest eigenvalue. One solve shows that there is none close by; whether the loads excite the mode does
        not matter.
        """
        model = self.model
        scale = max(abs(mass), model.mean_eigenvalue * ROUND_OFF / NEAR_POLE)
        with Owned(model.comm) as owned:
            x, product = owned.owns(random_block(model.K, 1)), owned.owns(create_block(model.K, 1))
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


class ComplexSolver(Solver):
    """Solves with A(s) for one complex s at a time; blocks are pairs Re, Im of complex columns (see blocks.fold).

    For a free body solutions are those of the elastic part, x with R^T M x = 0 and A x - b in the span of M R.
    `form`: "native" or "real" (see complex_forms), by default what the build can.
    """

    def __init__(self, model, rigid=None, prefix="complex_", form=None, factoring=None, reserved_mb=0.0):
        form = form or ("native" if is_complex() else "real")
        self._form = NativeForm(model) if form == "native" else RealForm(model)
        super().__init__(model, self._form.matrix, rigid, prefix, factoring=factoring, reserved_mb=reserved_mb)
        self._accelerated = None

    def release(self):
        super().release()
        self._forget()

    def close(self):
        super().close()
        self._forget()

    def factor(self, s: complex, loss_factor: float = 0.0):
        """Factor A(s) = s^2 M + s D + (1 + i loss_factor) K. Raises SingularMatrix or ComputationError."""
        self.factor_sum(s * s, s, 1 + 1j * loss_factor)

    def factor_sum(self, mass: complex, damping: complex = 0.0, stiffness: complex = 1.0):
        """Factor mass M + damping D + stiffness K instead, unless it is factored already."""
        if self.factored == (mass, damping, stiffness):
            return
        self.factored = None
        self._form.fill(mass, damping, stiffness)
        self._factors.factor(mass=str(mass), damping=str(damping), inertia_relief=False)
        self._forget()
        if self.rigid is not None:
            # A^-1 M R, which is R / s^2 when D R = 0
            with Owned(self.model.comm) as owned:
                loads = owned.owns(as_pairs(self.rigid.MR, self.model.K))
                self._accelerated = create_block(self.model.K, loads.getSizes()[1])
                self._solve(loads, self._accelerated)
            self._held = self._momentum(self._accelerated)
        self.factored = mass, damping, stiffness

    def solve(self, right, solution):
        """solution = A^-1 right for all active columns at once, with the relative residual checked."""
        with Owned(self.model.comm) as owned:
            load = owned.owns(copy_of(right, self.model.K))
            if self.rigid is not None:
                self.rigid.equilibrate(load)
            self._solve(load, solution)
        if self.rigid is not None:
            share = np.linalg.solve(self._held, self._momentum(solution))
            add_product(solution, self._accelerated, unfold(share), alpha=-1.0)

    def _solve(self, load, solution):
        columns = load.getActiveColumns()[1] // 2
        with Owned(self.model.comm) as owned:
            b, x = (owned.owns(create_block(self.matrix, columns)) for _ in range(2))
            self._form.put(load, b)
            self._factors.back_substitute(b, x)
            self._refine(self.matrix, self._factors.back_substitute, b, x)
            self._form.get(x, solution)

    def _momentum(self, pairs):
        """R^T M x (count, columns) of complex columns."""
        gram = inner(self.rigid.MR, pairs)
        return gram[:, 0::2] + 1j * gram[:, 1::2]

    def _forget(self):
        if self._accelerated is not None:
            self._accelerated.destroy()
        self._accelerated = None
