"""Start up: import the build of PETSc that fits, with its options and the rule for failures.

`start` is called by a command or workflow that knows what it needs, or else by the first use of PETSc.
"""

import ctypes
import glob
import importlib.util
import mmap
import os
import re
import resource
import sys
import time

import numpy as np
from mpi4py import MPI

from ..parallel import how_to_install
from . import failures
from .failures import InputError

# in the environment of a rank: how many there are, and its number; the first that is there counts, since the ranks of
# others inherit those of srun
SIZES = {
    "OMPI_COMM_WORLD_SIZE": ("OMPI_COMM_WORLD_RANK", "the mpiexec of Open MPI"),
    "PMI_SIZE": ("PMI_RANK", "the mpiexec of MPICH or Intel MPI"),
    "SLURM_STEP_NUM_TASKS": ("SLURM_PROCID", "srun"),
}

BLAS_BUFFER = 2**27  # bytes, as OpenBLAS takes at most for one thread
BEYOND_SMALL = 256  # rows of a product that has no kernel of its own without the buffer

with_scotch = False  # whether Debian's MUMPS with Scotch was loaded in place of the one without

ranks_on_node, rank_on_node = 1, 0  # once MPI is started

_NOT_ASKED = object()
_insisted = _NOT_ASKED  # "real", "complex" or None, once it was asked
_petsc_args = ()
_scalar = None  # "real" or "complex" once PETSc is imported
_held: list = []  # an object of PETSc that stays
_mpi_started = False


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
    """Whether this machine offers both builds and nobody has chosen one."""
    return not _chosen() and len(debian_builds()) == 2


def _chosen():
    """Whether the environment, or the program before it came here, has settled which petsc4py there is."""
    if os.environ.get("PETSC_DIR") or "petsc4py" in sys.modules:
        return True
    spec = importlib.util.find_spec("petsc4py")
    if spec is None:
        return False
    # with Debian's development files comes a link to its default build, which Python then finds: nobody's choice
    folder = os.path.dirname(os.path.dirname(os.path.realpath(spec.origin)))
    return folder not in map(os.path.realpath, sum(debian_builds().values(), []))


def insist(scalar: str | None = None, petsc_args=()):
    """What the user of a command wants of PETSc, whatever a workflow prefers: see start. Raises InputError."""
    global _insisted, _petsc_args
    scalar = scalar or os.environ.get("HPCRED_SCALAR") or None
    if scalar not in (None, "real", "complex"):
        raise InputError(f"--scalar: found '{scalar}', expected 'real' or 'complex'")
    _insisted, _petsc_args = scalar, tuple(petsc_args)


def start(scalar: str | None = None, petsc_args=(), *, preferred: str = "real", low_rank: bool = False) -> str:
    """Import PETSc and SLEPc. Only the first call loads. Collective.

    A PETSC_DIR in the environment, a petsc4py that is loaded, or one that Python finds by itself outside of Debian's
    builds, leaves no choice of a build.

    Parameters
    ----------
    scalar : {"real", "complex"}, optional
        Insists on one build, as does the environment variable HPCRED_SCALAR.
    petsc_args : sequence of str
        PETSc options as on a command line.
    preferred : {"real", "complex"}
        Taken where there is a choice.
    low_rank : bool
        Block low-rank factors will be asked for.

    Returns
    -------
    str
        The scalar type taken, "real" or "complex".

    Raises
    ------
    InputError
        If the build is not to be had.
    """
    global _scalar
    if scalar or petsc_args or _insisted is _NOT_ASKED:
        insist(scalar, petsc_args)
    if _scalar is None:
        if not _chosen():
            sys.path[:0] = _choose(debian_builds(), preferred)
            if not low_rank:
                _load_scotch()
        start_mpi()
        _import_wheel()
        try:
            import petsc4py
        except ModuleNotFoundError as error:
            places = ", ".join(f"{key}={os.environ[key]}" for key in ("PETSC_DIR", "PETSC_ARCH") if key in os.environ)
            raise InputError(
                f"found no petsc4py for {places}; install it for this PETSc (docs/install.md), or leave these out of "
                "the environment"
            ) from error

        options = ["hpcred", *_options(), "-no_signal_handler"]  # signals are for Python
        petsc4py.init(options)
        import slepc4py

        slepc4py.init(options)
        from petsc4py import PETSc

        _scalar = "complex" if PETSc.ScalarType().dtype.kind == "c" else "real"
        # With the last object on a rank PETSc frees its duplicate of the communicator, and makes another with the next
        # object: ranks of which one still had an object would wait for each other for ever.
        _held.append(PETSc.Vec().create(PETSc.COMM_WORLD))
    if _insisted and _insisted != _scalar:
        raise InputError(
            f"--scalar {_insisted}: the PETSc of this environment is {_scalar}; "
            f"leave the option out or set PETSC_DIR and SLEPC_DIR to a {_insisted} build"
        )
    return _scalar


def _import_wheel():
    """Import the wheel of PETSc from PyPI, where it is installed, before petsc4py: it sees to it that MPI comes first,
    and refuses a petsc4py of another PETSc. Raises InputError."""
    if importlib.util.find_spec("dolfinx_solver") is None:
        return
    try:
        importlib.import_module("dolfinx_solver")
    except ImportError as error:
        raise InputError(str(error)) from error


def _options() -> list[str]:
    """The PETSc options of the user: the home folder, PETSC_OPTIONS, then the command line, which has the last word.

    PETSc by itself would also take a petscrc of the working folder, which may be another user's, and load the libraries
    that it names. To skip that one is to skip the one at home, too, which is therefore named here.
    """
    home, skip = os.path.expandvars("$HOME/.petscrc"), "-skip_petscrc"
    environment = os.environ.get("PETSC_OPTIONS", "").split()
    if skip in (*environment, *_petsc_args) or not MPI.COMM_WORLD.bcast(os.path.isfile(home)):
        return [skip, *_petsc_args]
    return [skip, "-options_file", home, *environment, *_petsc_args]  # again, lest the home folder replaces it


def _choose(builds, preferred):
    """The folders of the build that is insisted on, or preferred, or there."""
    if _insisted and _insisted not in builds:
        raise InputError(
            f"--scalar {_insisted}: no {_insisted} build of PETSc and SLEPc found "
            f"(found: {', '.join(builds) or 'none'}); install it or set PETSC_DIR and SLEPC_DIR"
        )
    if not builds:
        raise InputError(f"found no petsc4py; {how_to_install()}")
    return builds[_insisted or (preferred if preferred in builds else next(iter(builds)))]


def started() -> bool:
    """Whether PETSc is loaded."""
    return _scalar is not None


def unused_options() -> list[str]:
    """PETSc options of the user, such as "-mod_eps_tol 1e-9", that nothing has asked for until now."""
    from petsc4py import PETSc

    library = ctypes.CDLL(PETSc.__file__)
    count = np.zeros(1, PETSc.IntType)
    names, values = (ctypes.POINTER(ctypes.c_char_p)() for _ in range(2))
    pointers = count.ctypes.data_as(ctypes.c_void_p), ctypes.byref(names), ctypes.byref(values)
    library.PetscOptionsLeftGet(None, *pointers)
    unused = [f"-{names[i].decode()} {(values[i] or b'').decode()}".rstrip() for i in range(int(count[0]))]
    library.PetscOptionsLeftRestore(None, *pointers)
    return unused


def _load_scotch():
    """Put Debian's MUMPS with Scotch, where installed, in place of the one without that Debian's PETSc is linked to.

    The nested dissection of Scotch needs about half the operations of PORD for large solids. Both have the same
    version and interface, and symbols that are loaded globally before PETSc are the ones that PETSc finds.
    HPCRED_SCOTCH=0 leaves the linked one.
    """
    global with_scotch
    if os.environ.get("HPCRED_SCOTCH") == "0":
        return
    for plain in glob.glob("/usr/lib/*/libdmumps-*.so"):
        libraries = [plain.replace("/libdmumps-", f"/lib{kind}mumps_ptscotch-") for kind in "dz"]
        if all(map(os.path.exists, libraries)):
            try:
                for name in libraries:
                    ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
            except OSError:
                return
            with_scotch = True


def _refuse_singletons():
    """Raise InputError where a launcher started several ranks that do not find each other: each of them would do the
    whole job, into the same files."""
    library = MPI.Get_library_version().partition(",")[0].split(" v")[0].strip("\x00\n ") or "this MPI"
    name = next((name for name in SIZES if os.environ.get(name, "").isdigit()), None)
    if MPI.COMM_WORLD.size > 1 or name is None or int(os.environ[name]) < 2:
        return
    ranks, (number, launcher) = os.environ[name], SIZES[name]
    if os.environ.get(number, "0") != "0":
        time.sleep(failures.GRACE)  # a launcher ends the others as soon as one fails, and the first one says why
        os._exit(InputError.exit_status)
    how = f"`srun --mpi=pmix` (`srun --mpi=list` shows what there is) or `mpiexec -n {ranks}`"
    raise InputError(
        f"{launcher} started {ranks} ranks, and {library}, which mpi4py uses, finds one: take "
        f"{how if launcher == 'srun' else f'the mpiexec of {library}'}; for {ranks} jobs of one rank take "
        f"{name} out of the environment"
    )


def _take_blas_buffer():
    """Have the BLAS take its buffer where addresses are limited (ulimit -v), or raise MemoryError: OpenBLAS asks again
    for ever for one that it is refused, in whatever product comes first."""
    if resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY:
        return
    try:
        mmap.mmap(-1, BLAS_BUFFER).close()
    except OSError as error:
        raise MemoryError(f"{BLAS_BUFFER >> 20} MiB for the BLAS") from error
    square = np.ones((BEYOND_SMALL, BEYOND_SMALL))
    square @ square


def start_mpi():
    """See to it that an exception on one rank ends the job on all; returns the communicator of the job. Collective."""
    global _mpi_started, ranks_on_node, rank_on_node
    if not _mpi_started:
        _refuse_singletons()
        failures.watched(MPI.COMM_WORLD)
        _take_blas_buffer()
        node = MPI.COMM_WORLD.Split_type(MPI.COMM_TYPE_SHARED)
        ranks_on_node, rank_on_node = node.size, node.rank
        node.Free()
        sys.excepthook = failures.excepthook
        _mpi_started = True
    return MPI.COMM_WORLD
