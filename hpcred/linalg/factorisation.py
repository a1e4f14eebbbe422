"""One matrix and its MUMPS factors through KSP/PC: symbolic analysis once, numeric factorisation at will."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from math import inf

import numpy as np

from ..parallel import startup as runtime
from ..parallel.failures import ComputationError, InputError
from ..parallel.memory import available_mb
from ..parallel.petsc import PETSc, SLEPc
from .blocks import add_product, apply, column_norms, copy_of, create_block, dense
from .options import temporary_options

MORE_ROOM = (-8, -9, -14, -15, -17, -20)  # INFOG(1): a workspace was too small
OUT_OF_MEMORY = (-7, -13, -19)
LOW_RANK_STEPS = 12  # of refinement at most, when the factor is approximate
REFINE_ABOVE = 1e-10  # relative residual above which a step of iterative refinement is made


@dataclass(frozen=True)
class SolverOptions:
    """How the factors are kept. `out_of_core`: a folder for them, on a fast local disk, instead of memory.

    `low_rank`: relative accuracy of block low rank factors, such as 1e-8 (Amestoy et al., ACM TOMS 45(1), 2019);
    solutions are refined to the residual of full factors, and the run fails if that is not reached.
    """

    out_of_core: str | None = None
    low_rank: float | None = None

    def __post_init__(self):
        if self.low_rank is not None and not 0 < self.low_rank < 1e-2:
            raise InputError(f"low_rank: found {self.low_rank:g}, expected a number from 0 to 0.01, such as 1e-8")
        if self.low_rank is not None and runtime.ordering == 3:
            # MUMPS 5.5 hands Scotch a graph that was not initialised when it groups the rows of a front
            raise InputError("low_rank: MUMPS with Scotch may crash there; set HPCRED_SCOTCH=0 in the environment")
        if self.out_of_core is not None and not os.access(self.out_of_core, os.W_OK | os.X_OK):
            raise InputError(f"out_of_core: the folder {self.out_of_core} cannot be written; create it or name another")

    def mumps(self) -> dict:
        """The controls of MUMPS."""
        found = {}
        if self.out_of_core is not None:
            found |= {"icntl_22": 1, "ooc_tmpdir": self.out_of_core}
        if self.low_rank is not None:
            found |= {"icntl_35": 2, "cntl_7": self.low_rank}
        return found


class SingularMatrix(ComputationError):
    """The matrix is singular to working precision; `distance` to singularity is relative."""

    def __init__(self, distance=0.0):
        super().__init__(f"the matrix is singular to working precision (relative distance {distance:.1e})")
        self.distance = distance


class Factorisation:
    """LDL^T ("cholesky") or LU ("lu") of `matrix`, whose values may change but not its pattern.

    `prefix`: of the PETSc options; `settings`: MUMPS controls such as {"icntl_13": 1}, which users' own options
    override; `options`: SolverOptions. `records` has one dict a factorisation. All methods are collective. Owns
    the solver, not the matrix: call close().
    """

    def __init__(self, matrix: PETSc.Mat, kind: str, prefix: str, settings=None, options=None):
        self.matrix, self.records = matrix, []
        self._kind, self._prefix, self._options = kind, prefix, options or SolverOptions()
        self._settings = {"icntl_7": runtime.ordering, "icntl_14": 40, **self._options.mumps(), **(settings or {})}
        self._norm = None
        # before the first factor takes its part
        self._limit = max(int(available_mb(matrix.comm.tompi4py())), 1)
        PETSc.Log.begin()
        self._event = PETSc.Log.Event("MatCholFctrSym" if kind == "cholesky" else "MatLUFactorSym")
        self._ksp = PETSc.KSP().create(matrix.comm)
        self._ksp.setOptionsPrefix(prefix)
        self._ksp.setType("preonly")
        self._ksp.getPC().setType(kind)
        self._ksp.getPC().setFactorSolverType("mumps")
        self._ksp.setFromOptions()
        self._analyses = 0

    def close(self):
        self._ksp.destroy()

    def release(self):
        """Free the factor; the next one needs a new analysis."""
        self._ksp.getPC().reset()

    @property
    def analyses(self) -> int:
        """Number of symbolic analyses so far."""
        return self._analyses

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues by Sylvester's law; on several ranks it needs icntl_13 = 1."""
        return self.records[-1]["negative_pivots"]

    def estimate(self):
        """MB that a factor needs in all, as MUMPS estimates, and MB that the ranks have; by an analysis alone.

        Raises ComputationError where it does not fit.
        """
        with temporary_options(self._prefix + "mat_mumps_", self._settings, {"icntl_23": 1}):
            self._ksp.setOperators(self.matrix)
            self._ksp.setUp()
        mumps = self._ksp.getPC().getFactorMatrix()
        on_disk = self._options.out_of_core is not None
        total, largest = (mumps.getMumpsInfog(i) for i in ((27, 26) if on_disk else (17, 16)))
        message = self._does_not_fit(mumps)
        self.release()
        if largest > self._limit:
            raise ComputationError(message)
        return total, self._limit * self.matrix.comm.size

    def _does_not_fit(self, mumps):
        rank, total, on_disk = (mumps.getMumpsInfog(i) for i in (16, 17, 26))
        return (
            f"the factorisation does not fit: it needs about {rank} MB on one rank and {total} MB in all, and a rank "
            f"has {self._limit} MB; take more ranks on more nodes, fewer groups, or --out-of-core DIR (about "
            f"{on_disk} MB a rank)"
        )

    def factor(self, **labels):
        """Factor the values that the matrix has now; `labels` go to the record.

        A failed factor cannot be used again: the solver is reset, and given more workspace when that was the
        reason. Raises SingularMatrix, or ComputationError with MUMPS' code.
        """
        # the state of a parallel matrix does not follow MatAXPY, and setUp looks at new values only when told
        self.matrix.stateIncrease()
        before, start = self._event.getPerfInfo(), time.perf_counter()
        # MUMPS compares its estimate with this limit after the analysis, before it takes the memory
        settings = {**self._settings, "icntl_23": self._limit}
        room = PETSc.Options(self._prefix).getInt("mat_mumps_icntl_14", self._settings["icntl_14"])
        for retries in range(5):
            more = {"icntl_14": max(room, 25) * 2**retries} if retries else {}
            with temporary_options(self._prefix + "mat_mumps_", settings, more):
                self._ksp.setOperators(self.matrix)
                self._ksp.setUp()
            mumps = self._ksp.getPC().getFactorMatrix()
            code, detail = mumps.getMumpsInfog(1), mumps.getMumpsInfog(2)
            if code >= 0:
                break
            message = self._does_not_fit(mumps)
            self._ksp.getPC().reset()
            if code == -10:
                raise SingularMatrix()
            if code in OUT_OF_MEMORY:
                raise ComputationError(message)
            if code not in MORE_ROOM:
                raise ComputationError(f"MUMPS failed to factor: INFOG(1) = {code}, INFOG(2) = {detail}")
        else:
            raise ComputationError(f"MUMPS wants ever more workspace: INFOG(1) = {code}, INFOG(2) = {detail}")
        after = self._event.getPerfInfo()
        analysis = after["time"] - before["time"]
        self._analyses += after["count"] - before["count"]
        self._norm = None
        entries = mumps.getMumpsInfog(29)
        self.records.append(
            {
                **labels,
                "kind": "LDL^T" if self._kind == "cholesky" else "LU",
                "analysis_seconds": round(analysis, 4),
                "factor_seconds": round(time.perf_counter() - start - analysis, 4),
                "ordering": ORDERINGS.get(mumps.getMumpsInfog(7), "other"),
                "factor_entries": entries if entries >= 0 else -entries * 10**6,
                "flops": mumps.getMumpsRinfog(3),
                "memory_mb_estimated_total": mumps.getMumpsInfog(17),
                "memory_mb_estimated_max_rank": mumps.getMumpsInfog(16),
                "memory_mb_used_max_rank": mumps.getMumpsInfog(21),
                "memory_mb_used_total": mumps.getMumpsInfog(22),
                "negative_pivots": mumps.getMumpsInfog(12),
                "null_pivots": mumps.getMumpsInfog(28),
                "workspace_retries": retries,
                "columns_solved": 0,
                "solve_seconds": 0.0,
                "residual": 0.0,
            }
        )

    def back_substitute(self, load: SLEPc.BV, solution: SLEPc.BV):
        """solution = A^-1 load, all active columns in one call of MUMPS, unchecked."""
        start = time.perf_counter()
        with dense(load) as b, dense(solution) as x:
            self._ksp.getPC().getFactorMatrix().matSolve(b, x)
            columns = x.getSize()[1]
        record = self.records[-1]
        record["columns_solved"] += columns
        record["solve_seconds"] = round(record["solve_seconds"] + time.perf_counter() - start, 4)

    def refine(self, load, solution, matrix, back_substitute, scale=None, steps=0):
        """Check the residual load - matrix solution, and improve the solution while it is large.

        `back_substitute(load, solution)` is the caller's; residuals are relative to `scale` (columns,), by
        default the norms of the load; `steps` of refinement are made in any case.
        Raises ComputationError when the residual stays large.
        """
        scale = column_norms(load) if scale is None else scale
        most = 2 if self._options.low_rank is None else LOW_RANK_STEPS
        before = inf
        for step in range(most + 1):
            residual = copy_of(load, matrix)
            columns = residual.getSizes()[1]
            product = create_block(matrix, columns)
            apply(matrix, solution, product)
            add_product(residual, product, np.eye(columns), alpha=-1.0)
            relative, backward = self._residual_norms(residual, scale, solution)
            small_or_stuck = relative <= REFINE_ABOVE or relative > before / 2
            enough = step == most or not relative < inf or (step >= steps and small_or_stuck)
            before = relative
            if not enough:
                back_substitute(residual, product)
                add_product(solution, product, np.eye(columns))
            product.destroy()
            residual.destroy()
            if enough:
                break
        self.records[-1]["residual"] = max(self.records[-1]["residual"], relative)
        if self._options.low_rank is not None and not (relative <= REFINE_ABOVE or backward < 1e-14):
            raise ComputationError(
                f"low_rank: the residual stays at {relative:.1e} after {most} steps of refinement; take less than "
                f"{self._options.low_rank:g}, or leave it out"
            )
        if not (relative < 1e-6 or backward < 1e-12):
            raise ComputationError(
                f"the solution has a relative residual of {relative:.1e} (backward error {backward:.1e}): "
                "the matrix is too ill-conditioned to be solved"
            )

    def _residual_norms(self, residual, b, solution):
        """Largest ||r|| / ||b|| and ||r|| / (||A|| ||x|| + ||b||) over the columns."""
        r, x = column_norms(residual), column_norms(solution)
        if not (np.isfinite(r).all() and np.isfinite(x).all()):
            return inf, inf
        if not (some := b > 0).any():
            return 0.0, 0.0
        self._norm = self._norm or self.matrix.norm(PETSc.NormType.INFINITY)
        backward = r[some] / (self._norm * x[some] + b[some])
        return float((r[some] / b[some]).max()), float(backward.max())


ORDERINGS = {0: "AMD", 2: "AMF", 3: "SCOTCH", 4: "PORD", 5: "METIS", 6: "QAMD"}
