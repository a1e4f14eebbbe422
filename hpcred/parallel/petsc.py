"""PETSc and SLEPc of the build that `startup.start` chose, loaded when the first of their names is used.

Modules may import these two at their top: nothing is loaded until then, so that a job can be read, and the build chosen
by what it asks for, before PETSc is there.
"""

import ctypes
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from mpi4py import MPI

from . import startup

PILE = 2**24  # bytes of blocks on a rank that may wait for being freed
SAME = True  # petsc4py's word for PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class _Later:
    """A module that is imported, after the start of hpcred, when one of its names is asked for."""

    def __init__(self, name):
        self._name = name

    def __getattr__(self, name):
        startup.start()
        found = getattr(import_module(self._name), name)
        setattr(self, name, found)  # asked for tens of thousands of times in a reduction: from now on without this call
        return found


if TYPE_CHECKING:
    from petsc4py import PETSc
    from slepc4py import SLEPc
else:
    PETSc, SLEPc = _Later("petsc4py.PETSc"), _Later("slepc4py.SLEPc")


def is_complex() -> bool:
    """Whether the scalars of PETSc are complex."""
    return startup.start() == "complex"


def free_dropped(comm):
    """Free the objects that Python has dropped on all ranks, which petsc4py only puts aside. Collective."""
    PETSc.garbage_cleanup(PETSc.COMM_SELF)
    PETSc.garbage_cleanup(comm)


def make_room(comm, size: int):
    """Free what Python has dropped, before `size` bytes are taken on a rank, the same number on all. Collective.

    Blocks and dense matrices do this (linalg.blocks), so that none of them, and no vector or matrix, has to be
    destroyed by hand. It happens once for PILE bytes, since it takes messages, and as much time as a small block does.
    """
    comm, keyval = comm.tompi4py(), _keyval_of_taken()
    taken = (comm.Get_attr(keyval) or 0) + max(size, PILE // 100)
    comm.Set_attr(keyval, taken % PILE)
    if taken >= PILE:
        free_dropped(comm)


@cache
def _keyval_of_taken() -> int:
    """The attribute of communicators that has the bytes taken since the last time."""
    return MPI.Comm.Create_keyval()


@contextmanager
def petsc_errors():
    """Raise PETSc.Error for what newer petsc4py calls a SystemError, where PETSc had called Python in between."""
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, PETSc.Error):
            raise error.__cause__ from None
        raise


def without_gil(name: str, *objects):
    """Call a function of PETSc or SLEPc that takes long on objects, such as KSPSetUp, and let other threads of Python
    run, which petsc4py does not. Raises PETSc.Error. Not for what calls Python back."""
    code = _function(name)(*(ctypes.c_void_p(object_.handle) for object_ in objects))
    if code:
        raise PETSc.Error(code)


@cache
def _function(name):
    """Return a function of the library that petsc4py or slepc4py has loaded."""
    module = SLEPc if name.startswith("EPS") else PETSc
    return getattr(ctypes.CDLL(module.__file__), name)


__all__ = ["MPI", "PETSc", "SAME", "SLEPc", "free_dropped", "is_complex", "make_room", "petsc_errors",
           "without_gil"]  # fmt: skip
