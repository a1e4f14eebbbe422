"""How tests start jobs of their own: the environment of mpiexec, and whether there are two PETSc builds."""

import atexit
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from hpcred.parallel import startup

TWO_BUILDS = startup.can_choose() and not os.environ.get("HPCRED_SCALAR")  # asked before PETSc is loaded


def make_ranks_patient():
    """Have ranks that wait sleep, of all jobs that this process starts (patient_ranks.c), where a compiler has its
    headers and libraries can be loaded from the folder. Without these, tests take longer."""
    if "LD_PRELOAD" in os.environ or shutil.which("gcc") is None:
        return
    folder = tempfile.mkdtemp(prefix="hpcred-tests-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    library = f"{folder}/patient_ranks.so"
    source = Path(__file__).with_name("patient_ranks.c")
    if subprocess.run(["gcc", "-O2", "-shared", "-fPIC", source, "-o", library], capture_output=True).returncode:
        return
    if subprocess.run(["true"], env=os.environ | {"LD_PRELOAD": library}, capture_output=True).stderr:
        return  # of the loader, which goes on without it
    os.environ |= {"LD_PRELOAD": library, "OMPI_MCA_mpi_yield_when_idle": "1"}


def mpi_environment(**more):
    """Open MPI refuses root and more ranks than cores unless told, and looks for networks unless told not to.

    Ranks that wait give way (see make_ranks_patient): other tests have the cores too.
    """
    return {
        "OMPI_MCA_pml": "ob1",
        "OMPI_MCA_btl": "^tcp",
        "OMPI_MCA_mpi_yield_when_idle": "1",
        **os.environ,
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1",  # Open MPI 4
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",  # Open MPI 5
        **more,
    }
