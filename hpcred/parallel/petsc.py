"""PETSc and SLEPc of the build that `startup.start` chose, loaded when the first of their names is used.

Modules may import these two at their top: nothing is loaded until then, so that a job can be read, and the build chosen
by what it asks for, before PETSc is there.
"""

from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING

from mpi4py import MPI

from . import startup

SAME = True  # petsc4py's word for PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class _Later:
    """A module that is imported, after the start of hpcred, when one of its names is asked for."""

    def __init__(self, name):
        self._name = name

    def __getattr__(self, name):
        startup.start()
        return getattr(import_module(self._name), name)


if TYPE_CHECKING:
    from petsc4py import PETSc
    from slepc4py import SLEPc
else:
    PETSc, SLEPc = _Later("petsc4py.PETSc"), _Later("slepc4py.SLEPc")


def is_complex() -> bool:
    """Whether the scalars of PETSc are complex."""
    return startup.start() == "complex"


def free_dropped(comm):
    """Free the distributed objects that Python has dropped on all ranks, which petsc4py only puts aside. Collective."""
    PETSc.garbage_cleanup(comm)


@contextmanager
def petsc_errors():
    """Raise PETSc.Error for what newer petsc4py calls a SystemError, where PETSc had called Python in between."""
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, PETSc.Error):
            raise error.__cause__ from None
        raise


__all__ = ["MPI", "PETSc", "SAME", "SLEPc", "free_dropped", "is_complex", "petsc_errors"]
