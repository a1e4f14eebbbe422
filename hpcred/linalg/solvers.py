"""A(s) = s^2 M + s D + K, one matrix and one symbolic analysis for all s, solved for blocks and checked."""

from __future__ import annotations

from math import inf

import numpy as np

from ..parallel.petsc import SAME, PETSc, SLEPc
from .blocks import apply, column_norms, copy_of, create_block, inner, local_rows
from .factorisation import Factorisation, SingularMatrix

NEAR_POLE = 1e-8  # relative distance in s^2 to an undamped eigenvalue below which A counts as singular
ROUND_OFF = 1e-13  # the same relative to the mean eigenvalue trace(K) / trace(M), for K alone


class ShiftedSolver:
    """Solves with A = K + damping * D + mass * M for one pair of coefficients at a time.

    For the Laplace variable s: mass = s^2, damping = s (41, 47). Symmetric matrices take LDL^T, others LU.
    `rigid`: rigid-body modes (model.rigid.RigidBodyModes) of a free body; right-hand sides are then made
    self-equilibrated and solutions M-orthogonal to them, and A = K is solved by inertia relief.
    `prefix`: of the PETSc options. `inertia`: prepare MUMPS so that negative_pivots is right on any number of
    ranks. `options`: mumps.SolverOptions. All methods are collective. Owns PETSc objects: call close().
    """

    def __init__(self, model, rigid=None, prefix="shift_", inertia=False, options=None):
        self.model, self.rigid = model, rigid
        self._matrix = model.K.duplicate(copy=False)
        self._matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        if model.symmetric:
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        kind = "cholesky" if model.symmetric else "lu"
        self._factors = Factorisation(self._matrix, kind, prefix, {"icntl_13": 1} if inertia else None, options)
        self._relief = False
        self._mass = self._damping = 0.0
        self._factored = None

    def estimate(self):
        """MB that a factor of A needs in all, and MB that the ranks have; ComputationError where it does not fit."""
        self._factored = None
        self.model.K.copy(self._matrix, structure=SAME)
        self._matrix.stateIncrease()
        return self._factors.estimate()

    def release(self):
        """Free the factor, for another solver to have the memory."""
        self._factored = None
        self._factors.release()

    def close(self):
        self._factors.close()
        self._matrix.destroy()

    @property
    def records(self) -> list[dict]:
        """One dict a factorisation, for the result file."""
        return self._factors.records

    @property
    def analyses(self) -> int:
        return self._factors.analyses

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
        if self._factored == (mass, damping):
            return
        self._factored = None
        model, matrix = self.model, self._matrix
        model.K.copy(matrix, structure=SAME)
        if damping and model.D is not None:
            matrix.axpy(damping, model.D, structure=SAME)
        if mass:
            matrix.axpy(mass, model.M, structure=SAME)
        self._relief = self.rigid is not None and mass == 0 and damping == 0
        if self._relief:
            matrix.zeroRowsColumns(self.rigid.supports, diag=model.mean_diagonal_of_k)
        self._mass, self._damping = mass, damping
        self._factors.factor(mass=str(mass), damping=str(damping), inertia_relief=self._relief)
        self._check_pole()
        self._factored = mass, damping

    def factor_mass(self):
        """Factor A = M, which is where s goes to infinity. Raises SingularMatrix or ComputationError."""
        if self._factored == (inf, 0.0):
            return
        self._factored = None
        self.model.M.copy(self._matrix, structure=SAME)
        self._relief, self._mass, self._damping = False, inf, 0.0
        self._factors.factor(mass="inf", damping="0", inertia_relief=False)
        self._factored = inf, 0.0

    def solve(self, right: SLEPc.BV, solution: SLEPc.BV, steps=0):
        """solution = A^-1 right for all active columns at once, with the relative residual checked.

        `steps` of iterative refinement are made in any case, more while the residual is large.
        Raises ComputationError when the residual stays large.
        """
        load = copy_of(right, self.model.K)
        if self.rigid is not None:
            self.rigid.equilibrate(load)
        self._back_substitute(load, solution)
        # with the true K where rows are held: the supports take no force
        matrix = self.model.K if self._relief else self._matrix
        self._factors.refine(load, solution, matrix, self._back_substitute, column_norms(right), steps)
        load.destroy()

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

    def _check_pole(self):
        """Raise SingularMatrix if s^2 is an eigenvalue of (K, M) to working precision; for real shifts without D.

        Inverse iteration from a random vector: ||x|| / ||A^-1 M x|| comes down to the distance of s^2 to the
        nearest eigenvalue. One solve shows that there is none close by; whether the loads excite the mode does
        not matter.
        """
        if self._damping or np.imag(self._mass):
            return
        model = self.model
        scale = max(abs(self._mass), model.mean_eigenvalue * ROUND_OFF / NEAR_POLE)
        x, product = create_block(model.K, 1), create_block(model.K, 1)
        with local_rows(x) as rows:
            rows[:, 0] = np.random.default_rng(model.comm.rank).standard_normal(len(rows))
        if self.rigid is not None:
            self.rigid.project(x)
        apply(model.M, x, product)
        close = True
        for step in range(4):
            before = _mass_norm(x, product)
            self._back_substitute(product, x)
            apply(model.M, x, product)
            after = _mass_norm(x, product)
            distance = before / after / scale if 0 < after < inf else 0.0
            # a random vector has about 1 / sqrt(n) of the mode in it
            close = distance < NEAR_POLE * (100 * model.size**0.5 if step == 0 else 1.0)
            if not close and (step == 0 or distance > 10 * NEAR_POLE):
                break
        x.destroy()
        product.destroy()
        if close:
            raise SingularMatrix(distance)


def _mass_norm(block, product):
    """M-norm of a column, given product = M block."""
    square = abs(inner(block, product)[0, 0])
    return square**0.5 if np.isfinite(square) else inf
