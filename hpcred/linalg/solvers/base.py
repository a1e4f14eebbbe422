"""Define solvers: Solver for matrices of a model, Factorisation for the package below that factors.

A direct solver is added by a class that derives from Factorisation, and a line in PACKAGES of settings.py.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from ...parallel.failures import ComputationError, InputError
from ...parallel.petsc import PETSc, SLEPc, is_complex
from ..blocks import column_norms, dense, local_rows, packed, view_of
from ..conjugate_gradients import NotSolved
from ..known import EXACT, Source
from ..refinement import refinement_converges
from .settings import Factoring

MOST_NUMBERS = 2**31 - 1  # of a block in all rows, whose places PETSc's solves count by 32 bits
AT_REST = "0 Hz"
FAILED_ON_GPU, IN_HOST = "on the GPU ", "the host has the factor"  # beginnings of FactorRecord.package_because
MOVES_FREELY = (
    "the body, or a part of it as along the axis of a rotor, can move freely; take frame kind 'buckens' (inertia "
    "relief) for a free body, hold what moves ('tangent', 'chord', a soft spring), or take points and bands above 0 Hz"
)  # where K is singular


class SingularMatrix(ComputationError):
    """The matrix is singular to working precision; `distance` to singularity is relative, `point` names where, once
    that is known."""

    def __init__(self, distance=0.0):
        super().__init__(distance)
        self.distance, self.point = distance, ""

    def __str__(self):
        text = f"the matrix is singular to working precision (relative distance {self.distance:.1e})"
        if not self.point:
            return text
        pole = "it is an eigenfrequency of the undamped model; move it a little"
        away = MOVES_FREELY if self.point == AT_REST else pole
        return f"{self.point}: {text}; {away}"


class DoesNotFit(ComputationError):
    """A factor needs more memory than there is."""


@dataclass(kw_only=True)
class FactorRecord:
    """One factorisation: of K + damping D + mass M (texts of the two numbers), what it took, and what it was used for.

    Seconds, MB, counts of the `package`, 0 or None where it does not tell; `residual`: the largest relative residual of
    the solves, `nearby_residual` of those at other points, by conjugate gradients with this factor. Of kind "multigrid"
    (or "diagonal", for M) there is no factor: `levels` of the hierarchy, `factor_entries` in all of them, and
    `iterations` of conjugate gradients, the most that a column took; `expected_iterations`, predicted by a trial.
    `package_because`: why package = "auto" took this one, or that the memory of the host has a factor of a GPU.
    `source`: what values have for a source that the factor tells, None in files of earlier versions; `negative_pivots`
    of an approximate one are those of A, or None.
    """

    mass: str
    damping: str
    inertia_relief: bool
    kind: str
    package: str = "mumps"
    analysis_seconds: float = 0.0
    factor_seconds: float = 0.0
    ordering: str = "none"
    factor_entries: int = 0
    flops: float = 0.0
    memory_mb_estimated_total: int = 0
    memory_mb_estimated_max_rank: int = 0
    memory_mb_used_max_rank: int = 0
    memory_mb_used_total: int = 0
    negative_pivots: int | None = None
    null_pivots: int | None = None
    workspace_retries: int = 0
    columns_solved: int = 0
    solve_seconds: float = 0.0
    residual: float = 0.0
    nearby_residual: float = 0.0
    precision: str = "double"
    package_because: str = ""
    levels: int = 0
    iterations: int = 0
    expected_iterations: int = 0
    source: Source | None = None

    @property
    def direct(self) -> bool:
        """Whether there was a factor."""
        return self.kind in ("LDL^T", "LU")

    @property
    def in_host(self) -> bool:
        """Whether the memory of the host has this factor of a GPU."""
        return self.package_because.startswith(IN_HOST)

    @property
    def gpu_failed(self) -> bool:
        """Whether it was made in place of one on a GPU, which failed or is too small."""
        return self.package_because.startswith(FAILED_ON_GPU)


class Solver(ABC):
    """Solves blocks with one matrix A = K + damping D + mass M of a model at a time.

    `factored`: the coefficients of the A that solve() is with, or None. `rigid`: the rigid-body modes
    (model.RigidBodyModes) of a free body, or None; its loads are made self-equilibrated, and solutions M-orthogonal to
    the modes. `records`: a FactorRecord for each A, in which its solves are counted; `analyses`: symbolic ones so far.
    Invariant: a solution has a small true residual, or solve() raises. All methods are collective. Owns PETSc objects:
    call close().
    """

    records: list[FactorRecord]
    factored: tuple | None = None
    analyses = 0

    @abstractmethod
    def factor(self, mass, damping=0.0):
        """Have solves be with A = K + damping D + mass M, or with M if the mass is infinite, unless they are.

        Raises SingularMatrix, DoesNotFit, another ComputationError, or InputError where the solver is not for A.
        """

    @abstractmethod
    def solve(self, right: SLEPc.BV, solution: SLEPc.BV, steps: int = 0):
        """solution = A^-1 right, another block, for all active columns at once, after `steps` of refinement or more.

        Raises ComputationError when the residual stays large.
        """

    @property
    def inertia(self) -> int | None:
        """Number of negative eigenvalues of A, or None where it is not known."""
        return None

    def solve_below(self, mass, right, solution, basis, stiffness, rough=0.0):
        """Solve with K + mass M, mass < 0, by what was made for another mass, beside a basis.

        `rough`: how much may be left, of the residual of the load (IterativeSolves), or of the energy (NearbyFactor).

        Raises NotSolved, as here, where the solver cannot.
        """
        raise NotSolved("this solver solves where it factors")

    def estimate(self) -> tuple[float, float] | None:
        """MB that a factor of A needs in all, and MB that the ranks, or a GPU, have; None where it is not known. Raises
        DoesNotFit."""
        return None

    def side_by_side(self) -> int | None:
        """How many GPUs there are, each for one factor at a time; None for factors of which memory alone limits how
        many there can be."""
        return None

    def known(self) -> tuple[str, float | None]:
        """What is known of the factor that is being made: see parallel.progress.Stage. Local."""
        return "", None

    @abstractmethod
    def release(self):
        """Free what was made for A, for another solver to have the memory."""

    @abstractmethod
    def close(self):
        """Free everything."""


class Factorisation(ABC):
    """The factors of `matrix`, whose values may change but not its pattern, by a package: LDL^T if it is `symmetric`
    and the package uses that, else LU.

    `prefix`: of the PETSc options; `reserved_mb`: what of the memory of a rank is for other things to come; `inertia`
    and `null_pivots`: whether these will be asked for. `records` has one FactorRecord a factorisation. A package has
    `_factor`, `_solve` and release(), and what it does otherwise of the rest. All methods are collective but check().
    Owns the factors, not the matrix: call close().
    """

    name = ""  # in PACKAGES
    uses_symmetry = True
    tells_inertia = False  # of real symmetric matrices
    has_single = False  # precision
    analyses = 0  # symbolic ones so far
    because = ""  # why "auto" took this package

    def __init__(self, matrix: PETSc.Mat, symmetric: bool, prefix: str, factoring: Factoring | None = None,
                 reserved_mb: float = 0.0, inertia: bool = False, null_pivots: bool = False):  # fmt: skip
        self.check_build(matrix.comm.tompi4py())
        self.matrix, self.factoring, self.prefix = matrix, factoring or Factoring(), prefix
        self.kind = "LDL^T" if symmetric and self.uses_symmetry else "LU"
        self.source = self.source_of(self.factoring, prefix)
        self._asked_inertia = inertia
        self.records: list[FactorRecord] = []

    @classmethod
    def source_of(cls, factoring: Factoring, prefix: str) -> Source:
        """Return the source of values that factors with these settings, and the PETSc options of a prefix, tell."""
        return EXACT

    @classmethod
    def check(cls, factoring: Factoring):
        """Refuse settings that the package has nothing for. Raises InputError."""
        for key in ("out_of_core", "low_rank", "memory_mb"):
            if getattr(factoring, key) is not None:
                raise InputError(f"{key}: solver.package '{cls.name}' does not have it; leave it out, or take 'mumps'")
        if factoring.single and not cls.has_single:
            raise InputError(
                f"solver.precision: solver.package '{cls.name}' has no 'single'; leave it out, or take 'mumps'"
            )

    @classmethod
    def check_build(cls, comm):
        """Refuse a PETSc, or a number of ranks, that the package is not for. Raises InputError. Collective."""
        return

    @classmethod
    def counts(cls) -> bool:
        """Whether negative eigenvalues of symmetric matrices are counted."""
        return cls.tells_inertia and not is_complex()

    @classmethod
    def slicing(cls, factoring: Factoring, comm) -> dict | None:
        """Options, without prefix, of factors for SLEPc's spectrum slicing; None where the package is not for that.
        Collective."""
        return None

    def approximate(self) -> str | None:
        """See Factoring."""
        return self.factoring.approximate()

    @abstractmethod
    def _factor(self) -> dict:
        """Factor the values that the matrix has now; what FactorRecord shall have of it. Raises SingularMatrix,
        DoesNotFit or ComputationError, after which the next call begins anew."""

    @abstractmethod
    def _solve(self, right: PETSc.Mat, solution: PETSc.Mat):
        """solution = A^-1 right for dense matrices in the rows of A, without gaps between columns."""

    # as of a Solver: nothing is known
    estimate, side_by_side, known = Solver.estimate, Solver.side_by_side, Solver.known

    @abstractmethod
    def release(self):
        """Free the factor; the next one needs a new analysis."""

    def close(self):
        """Free everything."""
        self.release()

    @property
    def inertia(self) -> int | None:
        """Number of negative eigenvalues by Sylvester's law, or None; on several ranks, and of approximate factors, if
        it was to be asked for."""
        return self.records[-1].negative_pivots if self.factoring.counts() and self.kind == "LDL^T" else None

    def factor(self, **labels):
        """Factor the values that the matrix has now; `labels` (mass, damping, inertia_relief) go to the record.

        Raises SingularMatrix, DoesNotFit or ComputationError.
        """
        # the state of a parallel matrix does not follow MatAXPY, and setUp looks at new values only when told
        self.matrix.stateIncrease()
        start = time.perf_counter()
        facts = {"analysis_seconds": 0.0, "package_because": self.because, **self._factor()}
        seconds = round(time.perf_counter() - start - facts["analysis_seconds"], 4)
        self.records.append(
            FactorRecord(**labels, kind=self.kind, package=self.name, factor_seconds=seconds,
                         precision=self.factoring.solver.precision, source=self.source, **facts)
        )  # fmt: skip
        if self.source != EXACT:
            self._confirm_inertia()

    def _confirm_inertia(self):
        """Forget the negative pivots of an approximate factor that may not be those of A."""
        asked = self._asked_inertia and self.inertia is not None
        if not (asked and refinement_converges(self.matrix, self.back_substitute)):
            self.records[-1].negative_pivots = self.records[-1].null_pivots = None

    def back_substitute(self, load: SLEPc.BV, solution: SLEPc.BV):
        """solution = A^-1 load, all active columns at once, unchecked."""
        first, last = load.getActiveColumns()
        most = max(1, MOST_NUMBERS // self.matrix.getSize()[0])
        if last - first > most:
            whole = view_of(load), view_of(solution)
            for low in range(0, last - first, most):
                self._back_substitute(*(view.between(low, min(low + most, last - first)) for view in whole))
            for block in whole:
                block.bv.setActiveColumns(block.first, block.stop)
        else:
            self._back_substitute(load, solution)

    def _back_substitute(self, load, solution):
        """The same for columns that fit one call of PETSc."""
        start = time.perf_counter()
        if self.factoring.single:  # columns of about length 1, whose numbers are not too small for it
            scale = np.exp2(np.frexp(column_norms(load))[1])  # exact, so that the load is what it was
            _scale(1 / scale, load)
        with dense(load) as b, dense(solution) as x, packed(b) as right, packed(x) as result:
            self._solve(right, result)
            columns = x.getSize()[1]
        if self.factoring.single:
            _scale(scale, load, solution)
        record = self.records[-1]
        record.columns_solved += columns
        record.solve_seconds = round(record.solve_seconds + time.perf_counter() - start, 4)


def _scale(factors, *blocks):
    """Multiply the columns of blocks."""
    for block in blocks:
        with local_rows(block) as rows:
            rows *= factors
