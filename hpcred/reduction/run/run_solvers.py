"""Hold the solvers of a run: one factor at a time is made when it is asked for, or multigrid takes its place."""

from __future__ import annotations

from ...linalg.known import Source
from ...linalg.solvers.base import DoesNotFit, FactorRecord, SingularMatrix, Solver
from ...linalg.solvers.complex import ComplexSolver
from ...linalg.solvers.multigrid import MultigridSolver, TooSlow, not_definite
from ...linalg.solvers.shifted import ShiftedSolver
from ...model.node_blocks import NodeBlocks
from ...parallel.failures import InputError

REAL = "shift_"  # prefix of the PETSc options of factors at real points


def refusal(error: DoesNotFit) -> DoesNotFit:
    """Return the error with the way that reductions have besides those of all factors."""
    return DoesNotFit(f"{error}; with solver.unfit = 'multigrid' real points, 0 Hz or decays, are solved by multigrid")


class RunSolvers:
    """Solvers for A(s) of a framed model, of which one has a factor at a time. Call close(); collective.

    `inertia`: whether negative pivots are counted on any number of ranks. `reserved_mb()`: memory that a rank keeps for
    columns; collective. `remark(sentence)` has the result say something.
    """

    def __init__(self, framed, progress, factoring, inertia: bool, reserved_mb, remark):
        self.model, self.rigid = framed.model, framed.rigid
        self._progress, self._factoring, self._inertia = progress, factoring, inertia
        self._reserved_mb, self._remark = reserved_mb, remark
        self._real: Solver | None = None
        self._complex: ComplexSolver | None = None
        self._records_before: list[FactorRecord] = []  # of factors that were given up
        self._analyses_before = 0

    def real(self) -> Solver:
        """Return the solver of real points, and free the factor of a complex one."""
        if self._real is None and self._factoring.solver.kind == "multigrid":
            self._take_multigrid()
        if self._real is None:
            self._real = ShiftedSolver(self.model, self.rigid, REAL, inertia=self._inertia, **self._memory())
        if self._complex is not None:
            self._complex.release()
        return self._real

    def complex(self) -> ComplexSolver:
        """Return the solver of complex A(s), and free the factor of a real point. Raises InputError with multigrid."""
        if self._factoring.solver.kind == "multigrid":
            raise InputError(not_definite("a complex point"))
        if self._complex is None:
            self._complex = ComplexSolver(self.model, self.rigid, **self._memory())
        if self._real is not None:
            self._real.release()
        return self._complex

    def _memory(self):
        return {"factoring": self._factoring, "reserved_mb": self._reserved_mb()}

    def factored(self, mass: float, name: str, damping: float = 0.0, may_give_up: bool = True) -> Solver:
        """Return the solver with the factor of K + damping D + mass M, or of M (mass = inf), made unless it is there.

        Raises SingularMatrix. Where the factor does not fit, solver.unfit is "multigrid" and the matrix is positive
        definite, the run goes on by multigrid, if it `may_give_up` factors and few iterations are expected; else
        DoesNotFit, with advice on that only where it may, or TooSlow is raised.
        """
        if self.real().factored != (mass, damping):
            with self._progress.stage("factor", name, lambda: self._real.known()):
                try:
                    self.real().factor(mass, damping)
                except SingularMatrix as error:
                    error.point = name
                    raise
                except DoesNotFit as error:
                    if not may_give_up:
                        raise
                    if mass < 0 or not self.give_up_factors(error):
                        raise refusal(error) from error
                    try:
                        self.real().factor(mass, damping)
                    except TooSlow as slow:
                        raise TooSlow(f"{str(error).partition(';')[0]}; in its place, {slow}") from error
        return self.real()

    def give_up_factors(self, error: DoesNotFit) -> bool:
        """Continue with multigrid if the settings allow it; return whether they do. Collective.

        Raises DoesNotFit where the model does not allow what they would.
        """
        model = self.model
        if self._factoring.solver.unfit != "multigrid":
            return False
        if model.dofs is None or not model.symmetric:
            lacks = "node coordinates (convert it with --nodes)" if model.dofs is None else "symmetric matrices"
            raise DoesNotFit(f"{error}; {model.name} lacks {lacks}, which multigrid needs in place of it") from error
        if self._real is not None:
            self._records_before += self._real.records
            self._analyses_before += self._real.analyses
            self._real.close()
        self._take_multigrid()
        self._remark(f"{str(error).partition(';')[0]}: solved by conjugate gradients with multigrid instead")
        return True

    @property
    def multigrid(self) -> bool:
        """Whether solves are by multigrid, which serves real points alone."""
        return self._factoring.solver.kind == "multigrid" or isinstance(self._real, MultigridSolver)

    @property
    def counts(self) -> bool:
        """Whether factors at real points tell how many modes lie below: an LU of an unsymmetric model does not."""
        return self.model.symmetric and not self.multigrid and self._factoring.counts()

    @property
    def source(self) -> Source:
        """The source of what factors at real points tell."""
        return self._factoring.source(REAL)

    def _take_multigrid(self):
        blocks = NodeBlocks(self.model)
        self._real = MultigridSolver(self.model, self.rigid, blocks, self._factoring.solver)

    @property
    def records(self) -> list[FactorRecord]:
        """All factorisations."""
        return self._records_before + [record for solver in self._there() for record in solver.records]

    @property
    def analyses(self) -> int:
        """All symbolic analyses: one as long as real and complex points do not alternate."""
        return self._analyses_before + sum(solver.analyses for solver in self._there())

    def _there(self):
        return [solver for solver in (self._real, self._complex) if solver is not None]

    def release(self):
        """Free the factors."""
        for solver in self._there():
            solver.release()

    def close(self):
        for solver in self._there():
            solver.close()
