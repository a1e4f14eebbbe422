"""Reduced flexible bodies by moment matching, in parallel.

The names of __init__.pyi are the public interface; the command line uses nothing else of hpcred. A name is imported
when it is first used, and PETSc when something is computed, so that `hpcred.start("complex")` can choose the build
before.
"""

import os
from contextlib import suppress

import lazy_loader

with suppress(ModuleNotFoundError):  # mpi4py is missing; the first use reports it
    from .parallel import kernels as _kernels

    _kernels.take_saved()

# One thread a rank: ranks are the parallelism, and threads of BLAS would share their cores. HDF5 has no use for
# file locks on parallel file systems. Both must be known before numpy and h5py are imported.
for _name, _value in {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "H5PY_ALWAYS_USE_MPI": "1",
    "HDF5_USE_FILE_LOCKING": "FALSE",
}.items():
    os.environ.setdefault(_name, _value)

_loaded, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name):
    try:
        return _loaded(name)
    except AttributeError:
        if name in __all__ or name.startswith("_"):
            raise
        from .parallel.declared import nearest

        raise AttributeError(f"hpcred has no '{name}'{nearest(name, __all__)}", name=name) from None
