"""`python -m hpcred` and the console script."""

import os
import sys

try:
    from .parallel import signals
except ModuleNotFoundError as error:
    sys.exit(f"hpcred: error: {error}")


def main():
    _open_what_is_closed()
    try:
        signals.hear()
        _alone()
        from .cli.main import run
        from .parallel.failures import leave

        status = run(sys.argv[1:])
    except (KeyboardInterrupt, Exception) as error:  # while modules are loaded
        signals.end(error)
    signals.no_longer()
    leave(status)


def _alone():
    """Skip MPI start-up work that only mpiexec runs need.

    That is a daemon, by which others could join it, and 0.2 s for the networks to other ranks. Ranks that this process
    starts or submits need their networks, and so the word for that is gone once MPI has read it.
    """
    os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")  # without effect on ranks of a launcher
    word = "OMPI_MCA_pml"
    if any(name in os.environ for name in (*signals.LAUNCHED, "SLURM_PROCID", word)):
        return
    os.environ[word] = "ob1"
    try:
        import mpi4py.MPI  # noqa: F401
    finally:
        del os.environ[word]


def _open_what_is_closed():
    """Have the standard streams that the caller closed lead nowhere.

    Else the next files to be opened, such as results, take their numbers, and what libraries print goes into them.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            stream = open(number, "w" if number else "r", encoding="utf-8", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)
    sys.stdout.reconfigure(errors="backslashreplace")  # for names that the locale has no letters for


if __name__ == "__main__":
    main()
