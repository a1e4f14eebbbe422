"""Reduced flexible bodies by moment matching, in parallel.

The names of __init__.pyi are the public interface; the command line uses nothing else of hpcred. A name is imported
when it is first used, and PETSc when something is computed, so that `hpcred.start("complex")` can choose the build
before.
"""

import os

import lazy_loader

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

_loaded, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
_COMMANDS = {  # under the names of the command line, but `report`, which is a room of the package
    "bores": "bores_of_file",
    "collect": "collect_sweep",
    "demo": "run_demo",
    "evaluate": "evaluate_result",
    "example": "write_example",
    "export": "export_result",
    "info": "describe_file",
    "modes": "modes_of_file",
    "paper": "reproduce",
    "plan": "plan_file",
    "response": "response_file",
    "store": "list_store",
    "sweep": "run_sweep",
}


def __dir__():
    return sorted([*__all__, *_COMMANDS])


def __getattr__(name):
    if name.startswith("_"):
        raise AttributeError(f"hpcred has no '{name}'", name=name)
    if name not in __all__ and name not in _COMMANDS:
        from .parallel.declared import nearest

        raise AttributeError(f"hpcred has no '{name}'{nearest(name, __dir__())}", name=name)
    found = _loaded(_COMMANDS.get(name, name))
    if not isinstance(found, type):
        return found
    from .parallel.declared import with_spelled_fields

    return with_spelled_fields(found)
