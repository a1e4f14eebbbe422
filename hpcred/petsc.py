"""PETSc, SLEPc and MPI of the build that `runtime.start` chose; started with the defaults if nobody did."""

from . import runtime

SCALAR = runtime.start()

from mpi4py import MPI  # noqa: E402
from petsc4py import PETSc  # noqa: E402
from slepc4py import SLEPc  # noqa: E402

SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN

__all__ = ["MPI", "PETSc", "SAME", "SCALAR", "SLEPc"]
