"""Reduced flexible bodies by moment matching, in parallel.

The names of __init__.pyi and of the public modules that it lists are the public interface; the command line uses
nothing else of hpcred. A name is imported when it is first used, and PETSc when something is computed, so that
`hpcred.start("complex")` can choose the build before.
"""

import os
import sys

from .public_names import attached

# One thread a rank: ranks are the parallelism, and threads of BLAS would share their cores. A BLAS reads its number of
# threads when it is loaded, with numpy or SciPy; one that is loaded already has to be told.
if "numpy" in sys.modules and not any(f"{_name}_NUM_THREADS" in os.environ for _name in ("OPENBLAS", "OMP", "MKL")):
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, user_api="blas")
# HDF5 has no use for file locks on parallel file systems, and must know so before h5py is imported.
for _name, _value in {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "H5PY_ALWAYS_USE_MPI": "1",
    "HDF5_USE_FILE_LOCKING": "FALSE",
}.items():
    os.environ.setdefault(_name, _value)

_RENAMED = {
    "check": "inspect", "inspect_file": "info", "bores_of_file": "bores", "collect_sweep": "collect",
    "describe_file": "info", "evaluate_result": "evaluate", "export_result": "export", "list_store": "store",
    "modes_of_file": "modes", "plan_file": "plan", "reproduce": "paper", "response_file": "response",
    "run_demo": "demo", "run_sweep": "sweep", "write_example": "example",
}  # fmt: skip
__getattr__, __dir__, __all__ = attached(__name__, __file__, _RENAMED)
