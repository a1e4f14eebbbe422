"""Factor by what PETSc reaches through its PC: its own Cholesky and LU, SuperLU_DIST, and (see mumps.py) MUMPS."""

from ...parallel.failures import ComputationError, InputError
from ...parallel.petsc import PETSc, without_gil
from .base import DoesNotFit, Factorisation, SingularMatrix

ZERO_PIVOT, NO_MEMORY = (71, 81), 55  # error codes of PETSc


class PetscFactorisation(Factorisation):
    """Factors of which `name` is PETSc's factor solver type."""

    def __init__(self, matrix, symmetric, prefix, *arguments, **options):
        super().__init__(matrix, symmetric, prefix, *arguments, **options)
        symbolic, kind = ("CholFctrSym", "cholesky") if self.kind == "LDL^T" else ("LUFactorSym", "lu")
        PETSc.Log.begin()
        self._event = PETSc.Log.Event("Mat" + symbolic)
        self._ksp = PETSc.KSP().create(matrix.comm)
        self._ksp.setOptionsPrefix(prefix)
        self._ksp.setType("preonly")
        self._ksp.setErrorIfNotConverged(True)
        self._ksp.getPC().setType(kind)
        self._ksp.getPC().setFactorSolverType(self.name)
        self._ksp.setFromOptions()

    @classmethod
    def check_build(cls, comm):
        if not PETSc.Sys.hasExternalPackage(cls.name):
            raise InputError(
                f"solver.package: this PETSc was built without '{cls.name}'; take another package, or another PETSc"
            )

    def release(self):
        self._ksp.getPC().reset()

    def close(self):
        self._ksp.destroy()

    def _set_up(self):
        self._ksp.setOperators(self.matrix)
        without_gil("KSPSetUp", self._ksp)
        return self._ksp.getPC().getFactorMatrix()

    def _factor(self):
        before = self._event.getPerfInfo()
        facts = self._made()
        after = self._event.getPerfInfo()
        self.analyses += after["count"] - before["count"]
        return {"analysis_seconds": round(after["time"] - before["time"], 4), **facts}

    def _made(self) -> dict:
        """Factor; what FactorRecord shall have of it, but for the analysis."""
        try:
            factor = self._set_up()
        except PETSc.Error as error:
            self.release()
            if error.ierr in ZERO_PIVOT:
                raise SingularMatrix() from None
            if error.ierr == NO_MEMORY:
                raise DoesNotFit(
                    f"the factorisation does not fit; {self.name} asked for more memory than there is"
                ) from error
            raise ComputationError(f"{self.name} failed to factor: {str(error).splitlines()[-1]}") from error
        return self._told(factor)

    def _told(self, factor) -> dict:
        """What the package tells of a factor."""
        return {"ordering": "other", "factor_entries": int(factor.getInfo()["nz_used"])}

    def _solve(self, right, solution):
        without_gil("MatMatSolve", self._ksp.getPC().getFactorMatrix(), right, solution)


class PetscOwn(PetscFactorisation):
    """PETSc's own Cholesky and LU: one rank, small models; in every PETSc. Its LDL^T is without pivoting."""

    name = "petsc"
    tells_inertia = True

    @classmethod
    def check_build(cls, comm):
        if comm.size > 1:
            raise InputError(
                f"solver.package: 'petsc' factors on one rank, found {comm.size} ranks (of a run, or of a group); take "
                "'mumps' or 'superlu_dist'"
            )

    def _told(self, factor):
        facts = super()._told(factor)
        if self.counts() and self.kind == "LDL^T":
            facts["negative_pivots"], facts["null_pivots"], _ = factor.getInertia()
        return facts


class SuperluDist(PetscFactorisation):
    """SuperLU_DIST: LU with static pivoting, whose pivots do not tell the inertia."""

    name = "superlu_dist"
    uses_symmetry = False
    _width = 0  # columns of the last solve

    def _solve(self, right, solution):
        if right.getSize()[1] != self._width:
            # on several ranks it writes past arrays made for fewer columns, unless a single vector came in between
            b, x = self.matrix.createVecLeft(), self.matrix.createVecRight()
            self._ksp.getPC().getFactorMatrix().solve(b, x)
            self._width = right.getSize()[1]
        super()._solve(right, solution)
