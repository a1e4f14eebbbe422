"""A(s) = s^2 M + s D + K: factored by MUMPS through KSP/PC, one matrix and one symbolic analysis for all s.

Enters: the matrices of a model on one nonzero pattern; leaves: A(s)^-1 applied to blocks, checked.
"""

import time
from math import inf

import numpy as np

from ..errors import ComputationError
from ..petsc import SAME, PETSc, SLEPc
from .block import add_product, apply, copy_of, create_block, dense, inner, local_rows

NEAR_POLE = 1e-9  # relative distance in s^2 to an undamped eigenvalue below which A counts as singular
ROUND_OFF = 1e-13  # the same relative to the mean eigenvalue trace(K) / trace(M), for K alone
MORE_ROOM = (-8, -9, -14, -15, -17, -20)  # INFOG(1): a workspace was too small
OUT_OF_MEMORY = (-7, -13, -19)


class SingularShift(ComputationError):
    """A(s) is singular to working precision; `distance` is that of s^2 to the nearest pole, relative."""

    def __init__(self, distance):
        super().__init__(f"the matrix is singular to working precision (relative distance {distance:.1e})")
        self.distance = distance


class ShiftedSolver:
    """Solves with A = K + damping * D + mass * M for one pair of coefficients at a time.

    For the Laplace variable s: mass = s^2, damping = s (41, 47). Symmetric matrices take LDL^T, others LU.
    `rigid`: rigid-body modes (see model.rigid.RigidBodyModes) of a free body; right-hand sides are then made
    self-equilibrated and solutions M-orthogonal to them, and A = K is solved by inertia relief.
    `prefix`: of the PETSc options. `inertia`: prepare MUMPS so that negative_pivots() is right on any number of
    ranks. All methods are collective. Owns PETSc objects: call close().
    """

    def __init__(self, model, rigid=None, prefix="shift_", inertia=False, progress=None):
        self.model, self.rigid, self.progress = model, rigid, progress
        self.records = []  # one dict a factorisation, for the result file
        self._prefix = prefix
        self._matrix = model.K.duplicate(copy=False)
        self._matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        if model.symmetric:
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        self._kind = "cholesky" if model.symmetric else "lu"
        self._events = [PETSc.Log.Event(f"Mat{name}FctrSym") for name in ("Chol", "LU")]
        PETSc.Log.begin()
        # METIS (5) where MUMPS has it; it takes PORD by itself where not
        defaults = {"mat_mumps_icntl_7": 5, "mat_mumps_icntl_14": 40}
        if inertia:
            defaults |= {"mat_mumps_icntl_13": 1}
        self._defaults = defaults
        self._ksp = self._create_solver(defaults)
        self._relief = False
        self._coefficients = None

    def close(self):
        self._ksp.destroy()
        self._matrix.destroy()

    def _create_solver(self, settings):
        """A direct solver; MUMPS reads `settings` at its next analysis, users' own options win."""
        options = PETSc.Options(self._prefix)
        self._settings = {key: value for key, value in settings.items() if not options.hasName(key)}
        ksp = PETSc.KSP().create(self._matrix.comm)
        ksp.setOptionsPrefix(self._prefix)
        ksp.setType("preonly")
        pc = ksp.getPC()
        pc.setType(self._kind)
        pc.setFactorSolverType("mumps")
        ksp.setFromOptions()
        return ksp

    def factor(self, mass, damping=0.0):
        """Factor A = K + damping D + mass M. Raises ComputationError if MUMPS fails for good.

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
        matrix.stateIncrease()  # MatAXPY on MPIAIJ does not do it
        self._coefficients = mass, damping
        self._factor()

    def _factor(self):
        start, analysed = time.perf_counter(), self._analysis_seconds()
        retries, self._norm = 0, None
        room = PETSc.Options(self._prefix).getInt("mat_mumps_icntl_14", 40)
        while True:
            options = PETSc.Options(self._prefix)
            settings = dict(self._settings)
            if retries:
                settings["mat_mumps_icntl_14"] = 2**retries * max(room, 40)
            for key, value in settings.items():
                options[key] = value
            self._ksp.setOperators(self._matrix)
            self._ksp.setUp()
            for key in settings:
                options.delValue(key)
            if retries and "mat_mumps_icntl_14" not in self._settings:
                options["mat_mumps_icntl_14"] = room
            factor = self._ksp.getPC().getFactorMatrix()
            code, detail = factor.getMumpsInfog(1), factor.getMumpsInfog(2)
            if code >= 0:
                break
            self._ksp.getPC().reset()  # a failed factor is never reusable
            if code == -10:
                raise SingularShift(0.0)
            if code in OUT_OF_MEMORY:
                raise ComputationError(
                    f"MUMPS ran out of memory (INFOG(1) = {code}, INFOG(2) = {detail}); "
                    "use more ranks on more nodes, or out-of-core factors (-- -shift_mat_mumps_icntl_22 1)"
                )
            if code not in MORE_ROOM or retries == 4:
                raise ComputationError(f"MUMPS failed to factor: INFOG(1) = {code}, INFOG(2) = {detail}")
            retries += 1
        analysis = self._analysis_seconds() - analysed
        seconds = time.perf_counter() - start - analysis
        self.records.append(
            {
                "mass_coefficient": str(self._coefficients[0]),
                "damping_coefficient": str(self._coefficients[1]),
                "inertia_relief": self._relief,
                "kind": "LDL^T" if self._kind == "cholesky" else "LU",
                "analysis_seconds": round(analysis, 4),
                "factor_seconds": round(seconds, 4),
                "ordering": factor.getMumpsInfog(7),
                "factor_entries": _entries(factor.getMumpsInfog(29)),
                "flops": factor.getMumpsRinfog(3),
                "memory_mb_estimated_total": factor.getMumpsInfog(17),
                "memory_mb_used_max_rank": factor.getMumpsInfog(21),
                "memory_mb_used_total": factor.getMumpsInfog(22),
                "negative_pivots": factor.getMumpsInfog(12),
                "workspace_retries": retries,
                "columns_solved": 0,
                "solve_seconds": 0.0,
                "residual": 0.0,
            }
        )

    def _analysis_seconds(self):
        return sum(event.getPerfInfo()["time"] for event in self._events)

    @property
    def analyses(self) -> int:
        """Number of symbolic analyses in this process so far."""
        return sum(event.getPerfInfo()["count"] for event in self._events)

    def negative_pivots(self) -> int:
        """Number of negative eigenvalues of A by Sylvester's law; needs inertia=True and a real build."""
        return self._ksp.getPC().getFactorMatrix().getMumpsInfog(12)

    def solve(self, right: SLEPc.BV, solution: SLEPc.BV, check_pole=True):
        """solution = A^-1 right for all active columns at once, with the relative residual checked.

        Raises SingularShift when A is singular, ComputationError when the residual stays large.
        """
        load = copy_of(right, self.model.K)
        if self.rigid is not None:
            self.rigid.equilibrate(load)
        self._back_substitute(load, solution)
        if check_pole:
            self._check_pole(load, solution)
        residual = self._residual(load, solution)
        for _ in range(2):
            norm, backward = self._residual_norms(residual, load, solution)
            if norm <= 1e-10:
                break
            correction = create_block(self.model.K, residual.getSizes()[1])
            self._back_substitute(residual, correction)
            add_product(solution, correction, np.eye(residual.getSizes()[1]))
            correction.destroy()
            residual.destroy()
            residual = self._residual(load, solution)
        norm, backward = self._residual_norms(residual, load, solution)
        residual.destroy()
        load.destroy()
        record = self.records[-1]
        record["residual"] = max(record["residual"], norm)
        if not (norm < 1e-6 or backward < 1e-12):
            raise ComputationError(
                f"the solution has a relative residual of {norm:.1e} (backward error {backward:.1e}): "
                "the matrix is too ill-conditioned for MUMPS' defaults"
            )

    def _back_substitute(self, load, solution):
        """One MUMPS call for all columns; nothing of it survives a failed factor (checked in factor)."""
        start = time.perf_counter()
        factor = self._ksp.getPC().getFactorMatrix()
        if self._relief:
            load = copy_of(load, self.model.K)
            with local_rows(load) as rows:
                rows[self.rigid.supports - self.model.first_row] = 0.0
        with dense(load) as b, dense(solution) as x:
            factor.matSolve(b, x)
            columns = x.getSize()[1]
        if self._relief:
            load.destroy()
        if self.rigid is not None:
            self.rigid.project(solution)
        record = self.records[-1]
        record["columns_solved"] += columns
        record["solve_seconds"] = round(record["solve_seconds"] + time.perf_counter() - start, 4)

    def _residual(self, load, solution):
        """load - A solution, with the true K where rows are held."""
        residual = copy_of(load, self.model.K)
        product = create_block(self.model.K, residual.getSizes()[1])
        apply(self.model.K if self._relief else self._matrix, solution, product)
        add_product(residual, product, np.eye(residual.getSizes()[1]), alpha=-1.0)
        product.destroy()
        return residual

    def _residual_norms(self, residual, load, solution):
        """Largest ||r|| / ||b|| and ||r|| / (||A|| ||x|| + ||b||) over the columns."""
        r, b, x = (column_norms(block) for block in (residual, load, solution))
        if not (np.isfinite(r).all() and np.isfinite(x).all()):
            return inf, inf
        some = b > 0
        if not some.any():
            return 0.0, 0.0
        self._norm = self._norm or self._matrix.norm(PETSc.NormType.INFINITY)
        backward = r[some] / (self._norm * x[some] + b[some])
        return float((r[some] / b[some]).max()), float(backward.max())

    def _check_pole(self, load, solution):
        """Raise SingularShift if s^2 is an eigenvalue of (K, M) to working precision; only for D = 0.

        ||b|| / ||M x|| is an upper estimate of the distance; when it is small, inverse iteration decides.
        """
        mass, damping = self._coefficients
        if damping or np.imag(mass):
            return
        mean = self.model.mean_eigenvalue
        limit = max(NEAR_POLE * abs(mass), ROUND_OFF * mean)
        product = create_block(self.model.K, solution.getActiveColumns()[1])
        apply(self.model.M, solution, product)
        b, mx = column_norms(load), column_norms(product)
        some = b > 0
        if not np.isfinite(mx).all():
            raise SingularShift(0.0)
        if some.any() and (b[some] / np.maximum(mx[some], 1e-300)).min() < 1e4 * limit:
            distance = inf
            x = copy_of(solution, self.model.K)
            for _ in range(3):
                before = mass_norms(x, product)
                self._back_substitute(product, x)
                apply(self.model.M, x, product)
                after = mass_norms(x, product)
                ratio = before[some] / np.maximum(after[some], 1e-300)
                distance = min(distance, ratio.min() if np.isfinite(after).all() else 0.0)
            x.destroy()
            if distance < limit:
                raise SingularShift(distance / max(abs(mass), mean * ROUND_OFF / NEAR_POLE))
        product.destroy()


def column_norms(block) -> np.ndarray:
    """2-norms of the active columns (columns,)."""
    with local_rows(block) as rows:
        squares = (np.abs(rows) ** 2).sum(axis=0)
    return np.sqrt(block.comm.tompi4py().allreduce(squares))


def mass_norms(block, product) -> np.ndarray:
    """M-norms of the columns of a block, given product = M block."""
    return np.sqrt(np.abs(np.diag(inner(block, product))))


def _entries(infog29):
    return infog29 if infog29 >= 0 else -infog29 * 10**6  # MUMPS counts in millions when it is large
