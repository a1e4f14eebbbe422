"""Start-up: the PETSc build, thread counts, options and the abort hook; before it nothing imports PETSc.

`start` is called once by the command line, or by the first import of a module that needs PETSc.
"""

import ctypes
import glob
import importlib.util
import os
import re
import sys
import time

from .failures import HpcredError, InputError

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

GRACE = 3.0  # seconds that a failed rank waits for the others to fail too

ordering = 5  # of MUMPS (icntl_7): METIS, or what it takes instead where it was built without

ranks_on_node = 1  # once MPI is started

_scalar = None  # "real" or "complex" once PETSc is imported
_comm = None  # private communicator of the abort hook


def debian_builds() -> dict[str, list[str]]:
    """Folders of petsc4py and slepc4py for "real" and "complex" where Debian's side-by-side builds exist."""
    builds = {}
    for scalar in ("real", "complex"):
        folders = []
        for library in ("petsc", "slepc"):
            pattern = f"/usr/lib/{library}dir/{library}*/*-{scalar}/lib/python3/dist-packages"

            def version(path):
                return [int(number) for number in re.findall(r"\d+", path)]

            folders += sorted(glob.glob(pattern), key=version)[-1:]
        if len(folders) == 2:
            builds[scalar] = folders
    return builds


def can_choose() -> bool:
    """Whether this machine offers both builds and the environment has not chosen one."""
    return not os.environ.get("PETSC_DIR") and not _installed() and len(debian_builds()) == 2


def _installed():
    return importlib.util.find_spec("petsc4py") is not None


def start(scalar: str | None = None, petsc_args=(), preferred: str = "real") -> str:
    """Import PETSc and SLEPc, and return the scalar type taken, "real" or "complex". Collective.

    `scalar` insists on one build (as does the environment variable HPCRED_SCALAR); `preferred` is taken where
    there is a choice. A PETSC_DIR in the environment, or a petsc4py that Python finds by itself, leaves none.
    `petsc_args` are PETSc options as on a command line. Raises InputError if the build is not to be had.
    """
    global _scalar
    scalar = scalar or os.environ.get("HPCRED_SCALAR") or None
    if scalar not in (None, "real", "complex"):
        raise InputError(f"--scalar: found '{scalar}', expected 'real' or 'complex'")
    if _scalar is None:
        if not os.environ.get("PETSC_DIR") and not _installed():
            builds = debian_builds()
            if scalar and scalar not in builds:
                raise InputError(
                    f"--scalar {scalar}: no {scalar} build of PETSc and SLEPc found "
                    f"(found: {', '.join(builds) or 'none'}); install it or set PETSC_DIR and SLEPC_DIR"
                )
            if not builds:
                raise InputError("no petsc4py found; install it (README.md, Installing) or set PETSC_DIR and SLEPC_DIR")
            wanted = scalar or (preferred if preferred in builds else next(iter(builds)))
            sys.path[:0] = builds[wanted]
            _load_scotch()
        start_mpi()
        import petsc4py

        petsc4py.init(["hpcred", *petsc_args])
        import slepc4py

        slepc4py.init(["hpcred", *petsc_args])
        from petsc4py import PETSc

        _scalar = "complex" if PETSc.ScalarType().dtype.kind == "c" else "real"
    if scalar and scalar != _scalar:
        raise InputError(
            f"--scalar {scalar}: the PETSc of this environment is {_scalar}; "
            f"leave the option out or set PETSC_DIR and SLEPC_DIR to a {scalar} build"
        )
    return _scalar


def _load_scotch():
    """Put Debian's MUMPS with Scotch, where installed, in place of the one without that Debian's PETSc is linked to.

    The nested dissection of Scotch needs about half the operations of PORD for large solids. Both have the same
    version and interface, and symbols that are loaded globally before PETSc are the ones that PETSc finds.
    HPCRED_SCOTCH=0 leaves the linked one.
    """
    global ordering
    if os.environ.get("HPCRED_SCOTCH") == "0":
        return
    for plain in glob.glob("/usr/lib/*/libdmumps-*.so"):
        with_scotch = [plain.replace("/libdmumps-", f"/lib{kind}mumps_ptscotch-") for kind in "dz"]
        if all(map(os.path.exists, with_scotch)):
            try:
                for name in with_scotch:
                    ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
            except OSError:
                return
            ordering = 3


def start_mpi():
    """Initialise MPI, and see to it that an exception on one rank ends the job on all; returns a communicator.

    Collective.
    """
    global _comm, ranks_on_node
    if _comm is None:
        from mpi4py import MPI

        _comm = MPI.COMM_WORLD.Dup()
        node = _comm.Split_type(MPI.COMM_TYPE_SHARED)
        ranks_on_node = node.size
        node.Free()
        sys.excepthook = _excepthook
    return _comm


def rank() -> int:
    """The number of this process in the job."""
    return _comm.rank if _comm is not None else 0


def fail(error: BaseException) -> int:
    """Report an error once and return the exit status; end the job if the other ranks did not fail as well.

    Called by every rank that failed, each for itself. When all ranks arrive here within GRACE seconds the error
    was common and rank 0 speaks; else this rank speaks and takes the whole job down, so that nobody hangs.
    """
    status = getattr(error, "exit_status", 1)
    common = not isinstance(error, KeyboardInterrupt) and _all_arrive()
    if not common or _comm is None or _comm.rank == 0:
        where = "" if common else f" (rank {_comm.rank})"
        if os.environ.get("HPCRED_TRACEBACK"):
            import traceback

            traceback.print_exception(error)
        if isinstance(error, HpcredError):
            print(f"hpcred: error{where}: {error}", file=sys.stderr)
        else:
            text = str(error).strip().splitlines()
            print(
                f"hpcred: internal error{where}: {type(error).__name__}: {text[0] if text else ''} "
                "(--traceback shows where)",
                file=sys.stderr,
            )
        sys.stderr.flush()
    if not common:
        _comm.Abort(status)
    return status


def _all_arrive():
    if _comm is None or _comm.size == 1:
        return True
    request = _comm.Ibarrier()
    deadline = time.monotonic() + GRACE
    while time.monotonic() < deadline:
        if request.Test():
            return True
        time.sleep(0.01)
    return False


def _excepthook(kind, error, trace):
    """For scripts that use hpcred as a library: Python's report, and no rank left hanging."""
    if _comm.size == 1 or isinstance(error, HpcredError):
        if _comm.size == 1:
            sys.__excepthook__(kind, error, trace)
        else:
            fail(error)
        return
    if not (common := _all_arrive()) or _comm.rank == 0:
        sys.__excepthook__(kind, error, trace)
        sys.stderr.flush()
    if not common:
        _comm.Abort(1)
