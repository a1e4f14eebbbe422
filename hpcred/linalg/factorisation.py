"""One matrix and its MUMPS factors through KSP/PC: symbolic analysis once, numeric factorisation at will."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..parallel import startup
from ..parallel.declared import as_declared
from ..parallel.failures import ComputationError, InputError
from ..parallel.memory import MB, available_mb
from ..parallel.petsc import PETSc, SLEPc
from ..parallel.ranges import within
from .blocks import dense, packed
from .options import temporary_options

MORE_ROOM = (-8, -9, -14, -15, -17, -20)  # INFOG(1): a workspace was too small
NO_FILE = -90  # out of core
LONGEST_FOLDER = 255  # bytes of a name that MUMPS takes; it cuts longer ones, and writes elsewhere or fails
OUT_OF_MEMORY = (-7, -13, -19)
SOLVE_WIDTH = 96  # columns that MUMPS solves for at a time; wider ones take memory (`hpcred bench` compares widths)
ANALYSIS = {"icntl_23": 1}  # a limit of 1 MB, at which all but tiny matrices are only analysed
CHOOSE_ABOVE = 10_000  # rows from which on an ordering is worth a second analysis
ORDERINGS = {0: "AMD", 2: "AMF", 3: "SCOTCH", 4: "PORD", 5: "METIS", 6: "QAMD"}


@dataclass(frozen=True, kw_only=True)
class LinearSolver:
    """How blocks are solved for at the points of a reduction.

    `kind`: "direct", by factors; "multigrid", by conjugate gradients with algebraic multigrid, which takes a tenth of
    the memory and real points only (0 Hz, decays); "auto": by factors, and by multigrid from the first real point on
    whose factor does not fit. Of multigrid: `residual`, the relative one that solutions are refined to, as far as
    round-off lets them; at most so many `iterations`; `threshold`, the share of the diagonal below which entries do
    not count in coarsening; `sweeps` of the smoother.
    """

    kind: Literal["auto", "direct", "multigrid"] = "auto"
    residual: float = 1e-12
    iterations: int = 500
    threshold: float = 0.02
    sweeps: int = 2

    def __post_init__(self):
        as_declared(self, "solver.")
        if self.kind not in ("auto", "direct", "multigrid"):
            raise InputError(f"solver.kind: found '{self.kind[:40]}', expected 'auto', 'direct' or 'multigrid'")
        within("solver.residual", self.residual, (1e-16, 1e-10, ""))
        within("solver.iterations", self.iterations, (1, 1e6, ""))
        within("solver.threshold", self.threshold, (-1.0, 0.5, ""))
        within("solver.sweeps", self.sweeps, (1, 20, ""))


@dataclass(frozen=True, kw_only=True)
class Factoring:
    """How matrices are factored, wherever it is done.

    `out_of_core`: a folder for the factors, on a fast local disk, instead of memory. `low_rank`: relative accuracy of
    block low rank factors, such as 1e-8 (Amestoy et al., ACM TOMS 45(1), 2019); solutions are refined to the residual
    of full factors, and the run fails if that is not reached. `memory_mb`: what a rank may take for a factor, by
    default what the machine and the batch system leave. `solver`: what a reduction does where
    there shall be no factor, or where it does not fit.
    """

    out_of_core: str | None = None
    low_rank: float | None = None
    memory_mb: float | None = None
    solver: LinearSolver = LinearSolver()

    def __post_init__(self):
        as_declared(self)
        if self.low_rank is not None and not 1e-16 <= self.low_rank < 1e-2:
            raise InputError(f"low_rank: found {self.low_rank:g}, expected a number from 0 to 0.01, such as 1e-8")
        if self.memory_mb is not None and not 1 <= self.memory_mb < 1e12:
            raise InputError(f"memory_mb: found {self.memory_mb:g}, expected MB of a rank, more than 0")
        if self.out_of_core is not None and not os.access(self.out_of_core, os.W_OK | os.X_OK):
            raise InputError(f"out_of_core: the folder {self.out_of_core} cannot be written; create it or name another")
        if self.out_of_core is not None and len(os.fsencode(self.out_of_core)) > LONGEST_FOLDER:
            raise InputError(
                f"out_of_core: the name of the folder has {len(os.fsencode(self.out_of_core))} bytes, MUMPS takes "
                f"{LONGEST_FOLDER}; name another: {self.out_of_core}"
            )

    def mumps(self) -> dict:
        """The controls of MUMPS, once PETSc is loaded. Raises InputError where MUMPS cannot do it."""
        found = {}
        if self.out_of_core is not None:
            found |= {"icntl_22": 1, "ooc_tmpdir": self.out_of_core}
        if self.low_rank is not None:
            startup.check_low_rank()
            found |= {"icntl_35": 2, "cntl_7": self.low_rank}
        return found

    def limit_mb(self, comm) -> int:
        """MB that a rank may take for factors. Collective."""
        return max(int(self.memory_mb or available_mb(comm)), 1)


class SingularMatrix(ComputationError):
    """The matrix is singular to working precision; `distance` to singularity is relative."""

    def __init__(self, distance=0.0):
        super().__init__(distance)
        self.distance = distance

    def __str__(self):
        return f"the matrix is singular to working precision (relative distance {self.distance:.1e})"


class DoesNotFit(ComputationError):
    """A factor needs more memory than there is."""


@dataclass(kw_only=True)
class FactorRecord:
    """One factorisation: of K + damping D + mass M (texts of the two numbers), what it took, and what it was used for.

    Seconds, MB, counts of MUMPS; `residual`: the largest relative residual of the solves, `nearby_residual` of those at
    other points, by conjugate gradients with this factor. Of kind "multigrid" (or
    "diagonal", for M) there is no factor: `levels` of the hierarchy, `factor_entries` in all of them, and `iterations`
    of conjugate gradients, the most that a column took.
    """

    mass: str
    damping: str
    inertia_relief: bool
    kind: str
    analysis_seconds: float
    factor_seconds: float
    ordering: str
    factor_entries: int
    flops: float
    memory_mb_estimated_total: int
    memory_mb_estimated_max_rank: int
    memory_mb_used_max_rank: int
    memory_mb_used_total: int
    negative_pivots: int
    null_pivots: int
    workspace_retries: int
    columns_solved: int = 0
    solve_seconds: float = 0.0
    residual: float = 0.0
    nearby_residual: float = 0.0
    levels: int = 0
    iterations: int = 0

    @property
    def direct(self) -> bool:
        """Whether there was a factor."""
        return self.kind in ("LDL^T", "LU")


class Factorisation:
    """LDL^T ("cholesky") or LU ("lu") of `matrix`, whose values may change but not its pattern.

    `prefix`: of the PETSc options; `settings`: MUMPS controls such as {"icntl_13": 1}, which users' own options
    override; `reserved_mb`: what of the memory of a rank is for other things to come. `records` has one FactorRecord a
    factorisation. All methods are collective. Owns the solver, not the matrix: call close().
    """

    def __init__(self, matrix: PETSc.Mat, kind: str, prefix: str, settings=None, factoring: Factoring | None = None,
                 reserved_mb: float = 0.0):  # fmt: skip
        self.matrix, self.factoring = matrix, factoring or Factoring()
        self.records: list[FactorRecord] = []
        self.analyses = 0  # symbolic ones so far
        self._kind, self._prefix, self._chosen = kind, prefix, False
        self._settings = {
            "icntl_7": startup.ordering, "icntl_14": 40, "icntl_27": SOLVE_WIDTH, **self.factoring.mumps(),
            **(settings or {}),
        }  # fmt: skip
        # before the first factor takes its part
        self._limit = max(self.factoring.limit_mb(matrix.comm.tompi4py()) - int(reserved_mb), 1)
        PETSc.Log.begin()
        self._event = PETSc.Log.Event("MatCholFctrSym" if kind == "cholesky" else "MatLUFactorSym")
        self._ksp = PETSc.KSP().create(matrix.comm)
        self._ksp.setOptionsPrefix(prefix)
        self._ksp.setType("preonly")
        self._ksp.getPC().setType(kind)
        self._ksp.getPC().setFactorSolverType("mumps")
        self._ksp.setFromOptions()

    def close(self):
        self._ksp.destroy()

    def release(self):
        """Free the factor; the next one needs a new analysis."""
        self._ksp.getPC().reset()

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues by Sylvester's law; on several ranks it needs icntl_13 = 1."""
        return self.records[-1].negative_pivots

    def expected(self, orderings) -> dict[int, dict]:
        """What a factor with each of the orderings (icntl_7) takes, as MUMPS estimates by analyses alone: `flops`,
        `entries`, `mb` in all and `mb_max_rank`."""
        found = {}
        for ordering in orderings:
            mumps = self._set_up(ANALYSIS | {"icntl_7": ordering})
            found[ordering] = {
                "flops": mumps.getMumpsRinfog(1), "entries": _entries(mumps.getMumpsInfog(20)),
                "mb": mumps.getMumpsInfog(17), "mb_max_rank": mumps.getMumpsInfog(16),
            }  # fmt: skip
            self.release()
        return found

    def _choose_ordering(self):
        """Once, where MUMPS has several nested dissections and the user chose none: that of the fewest operations."""
        if self._chosen:
            return
        self._chosen = True
        theirs = PETSc.Options(self._prefix).hasName("mat_mumps_icntl_7")
        there = startup.orderings()
        if len(there) > 1 and not theirs and self.matrix.getSize()[0] >= CHOOSE_ABOVE:
            found = self.expected(there)
            flops = {key: item["flops"] for key, item in found.items() if item["flops"] > 0}  # 0: it failed
            self._settings["icntl_7"] = min(flops, key=flops.get, default=self._settings["icntl_7"])

    def estimate(self):
        """MB that a factor needs in all, as MUMPS estimates, and MB that the ranks have; by an analysis alone.

        Raises DoesNotFit.
        """
        self._choose_ordering()
        mumps = self._set_up(ANALYSIS)
        on_disk = self.factoring.out_of_core is not None
        total, largest = (mumps.getMumpsInfog(i) for i in ((27, 26) if on_disk else (17, 16)))
        message = self._does_not_fit(mumps)
        self.release()
        if largest > self._limit:
            raise DoesNotFit(message)
        return total, self._limit * self.matrix.comm.size

    def _does_not_fit(self, mumps):
        rank, total, on_disk = (mumps.getMumpsInfog(i) for i in (16, 17, 26))
        return (
            f"the factorisation does not fit: it needs about {rank} MB on one rank and {total} MB in all, and a rank "
            f"has {self._limit} MB; take more ranks on more nodes, fewer groups, or keep factors on a disk "
            f"(out_of_core: about {on_disk} MB a rank); real points, 0 Hz or decays, need no factor with "
            "solver.kind = 'multigrid'"
        )

    def factor(self, **labels):
        """Factor the values that the matrix has now; `labels` (mass, damping, inertia_relief) go to the record.

        A failed factor cannot be used again: the solver is reset, and given more workspace when that was the
        reason. Raises SingularMatrix, or ComputationError with MUMPS' code.
        """
        # the state of a parallel matrix does not follow MatAXPY, and setUp looks at new values only when told
        self.matrix.stateIncrease()
        before, start = self._event.getPerfInfo(), time.perf_counter()
        mumps, retries = self._factor_with_room()
        after = self._event.getPerfInfo()
        analysis = after["time"] - before["time"]
        self.analyses += after["count"] - before["count"]
        self.records.append(
            FactorRecord(
                **labels,
                kind="LDL^T" if self._kind == "cholesky" else "LU",
                analysis_seconds=round(analysis, 4),
                factor_seconds=round(time.perf_counter() - start - analysis, 4),
                ordering=ORDERINGS.get(mumps.getMumpsInfog(7), "other"),
                factor_entries=_entries(mumps.getMumpsInfog(29)),
                flops=mumps.getMumpsRinfog(3),
                memory_mb_estimated_total=mumps.getMumpsInfog(17),
                memory_mb_estimated_max_rank=mumps.getMumpsInfog(16),
                memory_mb_used_max_rank=mumps.getMumpsInfog(21),
                memory_mb_used_total=mumps.getMumpsInfog(22),
                negative_pivots=mumps.getMumpsInfog(12),
                null_pivots=mumps.getMumpsInfog(28),
                workspace_retries=retries,
            )
        )

    def _set_up(self, forced, **more):
        """What MUMPS makes by the settings and `more`, which users' options override, and by what is `forced`."""
        with temporary_options(self._prefix + "mat_mumps_", self._settings | more, forced):
            self._ksp.setOperators(self.matrix)
            self._ksp.setUp()
        return self._ksp.getPC().getFactorMatrix()

    def _factor_with_room(self):
        """The factor of MUMPS, and how often its workspace had to be enlarged."""
        self._choose_ordering()
        # MUMPS compares its estimate with this limit after the analysis; then it asks the system for all of it at once
        limit = 0 if self._is_small() else self._limit
        room = PETSc.Options(self._prefix).getInt("mat_mumps_icntl_14", self._settings["icntl_14"])
        for retries in range(5):
            more = {"icntl_14": max(room, 25) * 2**retries} if retries else {}
            mumps = self._set_up(more, icntl_23=limit)
            code, detail = mumps.getMumpsInfog(1), mumps.getMumpsInfog(2)
            if code >= 0:
                return mumps, retries
            message = self._does_not_fit(mumps)
            self._ksp.getPC().reset()
            if code == -10:
                raise SingularMatrix()
            if code in OUT_OF_MEMORY:
                raise DoesNotFit(message)
            if code == NO_FILE:
                raise ComputationError(f"out_of_core: MUMPS cannot write factors to {self.factoring.out_of_core}; "
                                       "make room there, or name another folder")  # fmt: skip
            if code not in MORE_ROOM:
                raise ComputationError(f"MUMPS failed to factor: INFOG(1) = {code}, INFOG(2) = {detail}")
        raise ComputationError(f"MUMPS wants ever more workspace: INFOG(1) = {code}, INFOG(2) = {detail}")

    def _is_small(self):
        """Whether a factor would fit even if it had ten times the entries that nested dissection of a solid gives."""
        rows = self.matrix.getSize()[0]
        entries = min(rows * rows, 3 * self.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] * rows ** (1 / 3))
        return entries * np.dtype(PETSc.ScalarType).itemsize <= self._limit * MB

    def set_solve_width(self, columns: int):
        """How many columns MUMPS solves for at a time with the present factor, for measurements."""
        self._ksp.getPC().getFactorMatrix().setMumpsIcntl(27, columns)

    def back_substitute(self, load: SLEPc.BV, solution: SLEPc.BV):
        """solution = A^-1 load, all active columns in one call of MUMPS, unchecked."""
        start = time.perf_counter()
        with dense(load) as b, dense(solution) as x, packed(b) as right, packed(x) as result:
            self._ksp.getPC().getFactorMatrix().matSolve(right, result)
            columns = x.getSize()[1]
        record = self.records[-1]
        record.columns_solved += columns
        record.solve_seconds = round(record.solve_seconds + time.perf_counter() - start, 4)


def _entries(count):
    """A count of MUMPS, which is negative and in millions where it is too large."""
    return count if count >= 0 else -count * 10**6
