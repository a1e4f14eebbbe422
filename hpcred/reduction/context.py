"""What an ingredient of a basis may use: the framed model, the solver, the loads, and a place for its report."""

from copy import copy
from dataclasses import dataclass, field

import numpy as np

from ..linalg.blocks import apply, create_block, from_dense, inner, turn
from ..linalg.complex_solver import DampedSolver
from ..linalg.factorisation import SolverOptions
from ..linalg.solvers import ShiftedSolver
from ..parallel.petsc import PETSc

DEPENDENT = 1e-14  # eigenvalue of the Gram matrix of unit columns below which loads count as dependent


@dataclass
class Context:
    """Given to `extend(basis, context)` of every ingredient. Call close(); collective."""

    framed: object
    progress: object
    tolerance: float
    options: SolverOptions = SolverOptions()
    report: list = field(default_factory=list)
    _solver: ShiftedSolver | None = None
    _damped_solver: DampedSolver | None = None
    _loads: object = None
    _shared: object = None
    _transposed: object = None
    _added: list = field(default_factory=list)
    _added_analyses: int = 0

    def __post_init__(self):
        self.model, self.rigid = self.framed.model, self.framed.rigid

    @property
    def solver(self) -> ShiftedSolver:
        """The one solver of the run; only one of the two has a factor at a time."""
        if self._shared is not None:
            return self._shared.solver
        if self._solver is None:
            self._solver = ShiftedSolver(self.model, self.rigid, options=self.options)
        if self._damped_solver is not None:
            self._damped_solver.release()
        return self._solver

    @property
    def damped_solver(self) -> DampedSolver:
        """The one solver of the run for complex A(s)."""
        if self._shared is not None:
            return self._shared.damped_solver
        if self._damped_solver is None:
            self._damped_solver = DampedSolver(self.model, self.rigid, options=self.options)
        if self._solver is not None:
            self._solver.release()
        return self._damped_solver

    @property
    def records(self) -> list[dict]:
        """The factorisations of the run."""
        return self._added + [record for solver in self._solvers() for record in solver.records]

    @property
    def analyses(self) -> int:
        """The symbolic analyses of the run: one as long as real and complex points do not alternate."""
        return self._added_analyses + sum(solver.analyses for solver in self._solvers())

    def _solvers(self):
        return [solver for solver in (self._solver, self._damped_solver) if solver is not None]

    @property
    def loads(self):
        """The independent columns of B, self-equilibrated for a free body, as a block; owned by the context."""
        if self._loads is None:
            self._loads = from_dense(self.model.B)
            if self.rigid is not None:
                self.rigid.equilibrate(self._loads)
            gram = inner(self._loads, self._loads)
            size = np.sqrt(np.diag(gram))
            scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
            values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
            kept = values > DEPENDENT
            if not kept.all():
                turn(self._loads, scale[:, None] * vectors[:, kept])
                self._loads.setActiveColumns(0, int(kept.sum()))
                self.note("inputs", columns=len(kept), kept=int(kept.sum()))
        return self._loads

    def times_mass(self, block):
        """M block as a new block."""
        first, last = block.getActiveColumns()
        product = create_block(self.model.M, last - first)
        apply(self.model.M, block, product)
        return product

    def note(self, where: str, columns: int, kept: int, **more):
        """Record how many of the columns offered were new; shown by the command line, kept in the result."""
        self.report.append({"where": where, "columns": columns, "kept": kept, **more})
        dropped = f", {columns - kept} dependent dropped" if columns > kept else ""
        self.progress.say(f"{where}: {kept} new vectors{dropped}")

    def on_group(self, framed):
        """A context for a copy of the framed model on a group of ranks."""
        return Context(framed, self.progress, self.tolerance, self.options)

    def add(self, records, analyses, report):
        """Take over what was recorded on a group of ranks."""
        self._added += records
        self._added_analyses += analyses
        self.report += report

    def dual(self):
        """The context of the output Krylov subspaces (33): C^T in place of B, transposed matrices. Collective.

        Symmetric matrices share the solvers, and so the factors of a point that was used right before.
        """
        framed = copy(self.framed)
        framed.model = copy(self.model)
        framed.model.B, framed.model.Ct = self.model.Ct, None
        other = Context(framed, self.progress, self.tolerance, self.options, self.report)
        if self.model.symmetric:
            other._shared = self
        else:
            other._transposed = framed.model.D = PETSc.Mat()
            self.model.D.transpose(other._transposed)
        return other

    def release(self):
        """Free the factors."""
        for solver in self._solvers():
            solver.release()

    def close(self):
        for solver in self._solvers():
            solver.close()
        if self._transposed is not None:
            self._transposed.destroy()
        if self._loads is not None:
            self._loads.destroy()
