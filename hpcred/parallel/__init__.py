"""MPI: start-up, the rule for failures, exchange between ranks, progress and memory."""

import platform
import sys


def how_to_install(python: tuple[int, int] = sys.version_info[:2], system: str | None = None) -> str:
    """What a user does who has no PETSc. `system`: "Linux x86_64"; by default the ones of this process.

    Where Python or the system is not what the wheel of the extra is for, pip installs hpcred without it and says
    nothing.
    """
    system = system or f"{platform.system()} {platform.machine()}"
    unsupported = [f"Python {'.'.join(map(str, python))}"] * (python < (3, 12)) + [system] * (system != "Linux x86_64")
    nothing = f", and nothing here, on {' and '.join(unsupported)}" if unsupported else ""
    newer = "; `uv venv --python 3.12` makes an environment with a newer Python" if python < (3, 12) else ""
    return (
        "hpcred needs petsc4py, slepc4py and mpi4py, made for one PETSc with MUMPS: `pip install 'hpcred[petsc]'` "
        f"brings them to Python 3.12 or later on Linux x86_64 with glibc 2.34 or later{nothing}{newer}; else `conda "
        "install -c conda-forge petsc4py slepc4py`, or Debian's python3-petsc4py and python3-slepc4py and an "
        "environment of `python3 -m venv --system-site-packages`, or those of a cluster; docs/install.md has more"
    )


try:
    import mpi4py  # noqa: F401
except ModuleNotFoundError:
    raise ModuleNotFoundError(f"found no mpi4py; {how_to_install()}", name="mpi4py") from None
