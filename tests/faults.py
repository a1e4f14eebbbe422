"""A program for mpiexec: a command line of hpcred with a fault in one function on rank 1, or a record of the calls.

python faults.py TASK ARGUMENT...; TASK: `record=FILE` writes a line `function count` for each function of hpcred that
rank 1 calls; `fault=FUNCTION,CALL,ERROR` raises ERROR when rank 1 calls FUNCTION for the CALL-th time.
"""

import collections
import inspect
import os
import sys
from pathlib import Path

import hpcred.__main__
import hpcred.cli.main  # so that the fault is not while modules are loaded
from hpcred.parallel import failures

ROOT = str(Path(hpcred.__file__).parent) + os.sep
ERRORS = {
    "MemoryError": MemoryError,
    "KeyboardInterrupt": KeyboardInterrupt,
    "OSError": lambda: OSError(5, "Input/output error"),
    "PETSc.Error": lambda: (
        sys.modules["petsc4py.PETSc"].Error(76) if "petsc4py.PETSc" in sys.modules else SystemError()
    ),
}


def name_of(code):
    """Module and name of a function of hpcred; None for other code, and for the first, which no other stands above."""
    if not code.co_filename.startswith(ROOT) or code.co_name.startswith("<"):
        return None
    if not code.co_flags & inspect.CO_OPTIMIZED:  # the body of a class
        return None
    module = code.co_filename[len(ROOT) : -3].replace(os.sep, ".")
    if module == "__main__":
        return None
    return f"{module}.{getattr(code, 'co_qualname', code.co_name)}".replace(".<locals>", "")


def main(task, arguments):
    word, _, rest = task.partition("=")
    calls = collections.Counter()
    if os.environ["OMPI_COMM_WORLD_RANK"] == "1":
        function, call, kind = rest.split(",") if word == "fault" else (None, 0, None)

        def watch(frame, event, _):
            if event == "call" and (name := name_of(frame.f_code)):
                calls[name] += 1
                if name == function and calls[name] == int(call):
                    sys.setprofile(None)
                    raise ERRORS[kind]()

        sys.setprofile(watch)
    failures.GRACE = float(os.environ.get("FAULTS_GRACE", failures.GRACE))
    sys.argv[1:] = arguments
    try:
        hpcred.__main__.main()
    finally:
        sys.setprofile(None)
        if word == "record" and calls:
            Path(rest).write_text("".join(f"{name} {count}\n" for name, count in calls.items()))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
