"""Choose how matrices are factored and blocks are solved for: what job files, Python and results share."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator

from ...parallel.declared import as_declared
from ...parallel.failures import InputError
from ...parallel.memory import available_mb
from ...parallel.ranges import Range
from ..known import Source

# Direct solvers by name: a class that derives from base.Factorisation, or where it is; a program may add its own
PACKAGES: dict[str, str | type] = {
    "auto": "hpcred.linalg.solvers.auto:Auto",
    "mumps": "hpcred.linalg.solvers.mumps:Mumps",
    "cudss": "hpcred.linalg.solvers.cudss:Cudss",
    "superlu_dist": "hpcred.linalg.solvers.petsc:SuperluDist",
    "petsc": "hpcred.linalg.solvers.petsc:PetscOwn",
}


def _of_today(kind):
    """Return a kind; raises InputError for one of earlier versions, whose default it was."""
    if kind == "auto":
        raise InputError("solver.kind: found 'auto'; it is now kind 'direct' with unfit = 'multigrid'")
    return kind


@dataclass(frozen=True, kw_only=True)
class LinearSolver:
    """How blocks are solved for at the points of a reduction.

    Parameters
    ----------
    kind : {"direct", "multigrid"}
        By factors, or by conjugate gradients with algebraic multigrid, which takes a tenth of the memory and real
        points only (0 Hz, decays).
    unfit : {"refuse", "multigrid"}
        What happens where a factor does not fit into memory: "refuse" ends the run, "multigrid" goes on by multigrid
        from that real point on.
    package : str
        What makes factors: "mumps"; "cudss", on a GPU of NVIDIA; "auto", cuDSS where there is a GPU, nvmath-python
        imports and the factor fits, else MUMPS; "superlu_dist"; or "petsc" (one rank). Refused beside "multigrid".
    precision : {"double", "single"}
        Of the factors; "single" takes half the memory (cuDSS, and MUMPS with PETSc 3.25 or later). Solutions are
        refined to the residual of full factors, and the run fails if that is not reached. Refused beside "multigrid".
    residual : float
        Of multigrid: the relative residual that solutions are refined to, as far as round-off lets them.
    iterations : int
        Of multigrid: at most so many per column, also of those that a trial expects.
    threshold : float
        Of multigrid: the share of the diagonal below which entries do not count in coarsening; 0 for bodies with very
        different element sizes.
    sweeps : int
        Of multigrid: Chebyshev sweeps of the smoother; more for thin bodies.
    """

    kind: Annotated[Literal["direct", "multigrid"], BeforeValidator(_of_today)] = "direct"
    unfit: Literal["refuse", "multigrid"] = "refuse"
    package: str = "auto"
    precision: Literal["double", "single"] = "double"
    residual: Annotated[float, Range(1e-16, 1e-10)] = 1e-12
    iterations: Annotated[int, Range(1, 1e6)] = 500
    threshold: Annotated[float, Range(-1.0, 0.5)] = 0.02
    sweeps: Annotated[int, Range(1, 20)] = 2

    def __post_init__(self):
        _of_today(self.kind)
        as_declared(self, "solver.")
        if self.package not in PACKAGES:
            *names, last = map(repr, PACKAGES)
            raise InputError(f"solver.package: found '{self.package[:40]}', expected {', '.join(names)} or {last}")
        for key, value in (("package", self.package), ("precision", self.precision)):
            if self.kind == "multigrid" and value != getattr(LinearSolver, key):
                raise InputError(
                    f"solver.{key}: found '{value}' beside solver.kind = 'multigrid', which makes no factors; leave "
                    f"{key} out, or take kind 'direct'"
                )


@dataclass(frozen=True, kw_only=True)
class Factoring:
    """How matrices are factored, wherever it is done.

    The first three keys take MUMPS.

    Parameters
    ----------
    out_of_core : str, optional
        A folder for the factors, on a fast local disk, instead of memory; it is made with the first one.
    low_rank : float, optional
        Relative accuracy of block low-rank factors, such as 1e-8 (Amestoy et al., ACM TOMS 45(1), 2019). Solutions are
        refined to the residual of full factors, and the run fails if that is not reached; modes are counted where
        refinement with them converges.
    memory_mb : float, optional
        What a rank may take for a factor; by default what the machine and the batch system leave.
    solver : LinearSolver
        The package that makes factors, and what a reduction does without a factor, or where one does not fit.
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
        self.package.check(self)
        if self.out_of_core is not None:
            there = Path(self.out_of_core).absolute()
            there = next(folder for folder in (there, *there.parents) if os.path.exists(folder))
            self._require_folder(there)

    def _require_folder(self, there):
        if not (os.path.isdir(there) and os.access(there, os.W_OK | os.X_OK)):
            raise InputError(f"out_of_core: the folder {self.out_of_core} cannot be made or written; name another")

    def make_folder(self) -> None:
        """Make the folder for factors, on each node, whose own disk it may be on. Local. Raises InputError."""
        if self.out_of_core is not None:
            with suppress(OSError):
                os.makedirs(self.out_of_core, exist_ok=True)
            self._require_folder(self.out_of_core)

    @property
    def package(self) -> type:
        """The class of the direct solver, which derives from base.Factorisation."""
        package = PACKAGES[self.solver.package]
        if isinstance(package, str):
            module, _, name = package.partition(":")
            package = getattr(import_module(module), name)
        return package

    @property
    def single(self) -> bool:
        """Whether factors are in single precision."""
        return self.solver.precision == "single"

    def counts(self) -> bool:
        """Whether factors may count negative eigenvalues of symmetric matrices, which single precision does not."""
        return self.package.counts() and not self.single

    def source(self, prefix: str) -> Source:
        """The source of values that factors tell which have a `prefix` of PETSc options, such as ``shift_``."""
        return self.package.source_of(self, prefix)

    def exact(self) -> Factoring:
        """The same with full factors in double precision."""
        return replace(self, low_rank=None, solver=replace(self.solver, precision="double"))

    def approximate(self) -> str | None:
        """The key that makes factors approximate, and what to do where solutions stay so; None for full factors."""
        if self.low_rank is not None:
            return f"low_rank: {{}}; take less than {self.low_rank:g}, or leave it out"
        return "solver.precision: {}; 'single' is not enough for this matrix, take 'double'" if self.single else None

    def limit_mb(self, comm) -> int:
        """MB that a rank may take for factors. Collective."""
        return max(int(self.memory_mb or available_mb(comm)), 1)
