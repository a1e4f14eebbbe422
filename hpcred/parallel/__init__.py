"""MPI: start-up, the rule for failures, exchange between ranks, progress and memory."""

INSTALL = (
    "hpcred needs petsc4py, slepc4py and mpi4py, made for one PETSc with MUMPS: `pip install 'hpcred[petsc]'` where "
    "Linux is on x86_64 with glibc 2.34 or later and Python is 3.12 or later; else `conda install -c conda-forge "
    "petsc4py slepc4py`, or Debian's python3-petsc4py and python3-slepc4py and an environment of `python3 -m venv "
    "--system-site-packages`, or those of a cluster; docs/install.md has more"
)

try:
    import mpi4py  # noqa: F401
except ModuleNotFoundError:
    raise ModuleNotFoundError(f"found no mpi4py; {INSTALL}", name="mpi4py") from None
