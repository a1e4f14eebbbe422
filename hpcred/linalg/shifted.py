"""A(s) = s^2 M + s D + K, one matrix and one symbolic analysis for all s, solved for blocks and checked."""

from math import inf

import numpy as np

from ..petsc import SAME, PETSc, SLEPc
from .block import apply, column_norms, copy_of, create_block, inner, local_rows
from .mumps import Factorisation, SingularMatrix

NEAR_POLE = 1e-9  # relative distance in s^2 to an undamped eigenvalue below which A counts as singular
ROUND_OFF = 1e-13  # the same relative to the mean eigenvalue trace(K) / trace(M), for K alone


class ShiftedSolver:
    """Solves with A = K + damping * D + mass * M for one pair of coefficients at a time.

    For the Laplace variable s: mass = s^2, damping = s (41, 47). Symmetric matrices take LDL^T, others LU.
    `rigid`: rigid-body modes (model.rigid.RigidBodyModes) of a free body; right-hand sides are then made
    self-equilibrated and solutions M-orthogonal to them, and A = K is solved by inertia relief.
    `prefix`: of the PETSc options. `inertia`: prepare MUMPS so that negative_pivots is right on any number of
    ranks. All methods are collective. Owns PETSc objects: call close().
    """

    def __init__(self, model, rigid=None, prefix="shift_", inertia=False):
        self.model, self.rigid = model, rigid
        self._matrix = model.K.duplicate(copy=False)
        self._matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        if model.symmetric:
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        kind = "cholesky" if model.symmetric else "lu"
        self._factors = Factorisation(self._matrix, kind, prefix, {"icntl_13": 1} if inertia else None)
        self._relief = False
        self._mass = self._damping = 0.0

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
        """Factor A = K + damping D + mass M. Raises SingularMatrix or ComputationError.

        A = K of a free body (mass = damping = 0 with rigid-body modes): six rows and columns are held, which
        makes K regular; with self-equilibrated loads the held dofs take no force, so that which rows were
        taken does not matter after the projection (inertia relief).
        """
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

    def solve(self, right: SLEPc.BV, solution: SLEPc.BV, check_pole=True):
        """solution = A^-1 right for all active columns at once, with the relative residual checked.

        Raises SingularMatrix when A is singular, ComputationError when the residual stays large.
        """
        load = copy_of(right, self.model.K)
        if self.rigid is not None:
            self.rigid.equilibrate(load)
        self._back_substitute(load, solution)
        if check_pole:
            self._check_pole(load, solution)
        # with the true K where rows are held: the supports take no force
        matrix = self.model.K if self._relief else self._matrix
        self._factors.refine(load, solution, matrix, self._back_substitute, column_norms(right))
        load.destroy()

    def solve_at(self, s: complex, right: SLEPc.BV, real: SLEPc.BV, imaginary: SLEPc.BV):
        """Factor A(s), and put the two parts of A(s)^-1 right into `real` and `imaginary`.

        Without damping s^2 must be real; with damping this needs a complex build.
        """
        damped = self.model.D is not None
        self.factor(s * s if damped else (s * s).real, s if damped else 0.0)
        self.solve(right, real)
        with local_rows(real) as x, local_rows(imaginary) as y:
            y[...] = x.imag
            if np.iscomplexobj(x):
                x.imag[...] = 0.0

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

    def _check_pole(self, load, solution):
        """Raise SingularMatrix if s^2 is an eigenvalue of (K, M) to working precision; only for D = 0.

        ||b|| / ||M x|| is an upper estimate of the distance; when it is small, inverse iteration decides.
        """
        if self._damping or np.imag(self._mass):
            return
        mean = self.model.mean_eigenvalue
        limit = max(NEAR_POLE * abs(self._mass), ROUND_OFF * mean)
        product = create_block(self.model.K, solution.getActiveColumns()[1])
        apply(self.model.M, solution, product)
        b, mx = column_norms(load), column_norms(product)
        some = b > 0
        distance = inf if np.isfinite(mx).all() else 0.0
        if distance and some.any() and (b[some] / np.maximum(mx[some], 1e-300)).min() < 1e4 * limit:
            x = copy_of(solution, self.model.K)
            for _ in range(3):
                before = _mass_norms(x, product)[some]
                self._back_substitute(product, x)
                apply(self.model.M, x, product)
                after = _mass_norms(x, product)[some]
                ratio = before / np.maximum(after, 1e-300)
                distance = min(distance, ratio.min() if np.isfinite(after).all() else 0.0)
            x.destroy()
        product.destroy()
        if distance < limit:
            raise SingularMatrix(distance / max(abs(self._mass), mean * ROUND_OFF / NEAR_POLE))


def _mass_norms(block, product):
    """M-norms of the columns of a block, given product = M block."""
    return np.sqrt(np.abs(np.diag(inner(block, product))))
