"""A factor on disk beside one in memory: memory of a rank, seconds, and what the answers differ by.

usage: python benchmarks/out_of_core.py [27k | 112k | 200k | 360k] [folder on a fast local disk]
"""

import sys
import tempfile
from pathlib import Path

from common import difference, finish, krylov, reduce, solid, workspace
from solids import CASES


def main(name="360k", disk=None):
    rows = []
    with workspace() as folder, tempfile.TemporaryDirectory(prefix="hpcred-factors-", dir=disk) as factors:
        folder = Path(folder)
        solid(folder, CASES[name])
        for kind, options in (("in core", ()), ("out of core", ("--out-of-core", factors))):
            found = reduce(folder, krylov((3000.0,), order=3), options=options)
            rows.append({"factor": kind, "dofs": found["dofs"], "seconds": found["seconds"],
                         "MB, both ranks": found["memory_mb"], "response": found["response"]})  # fmt: skip
    first, second = rows
    second["memory, of in core"] = second["MB, both ranks"] / first["MB, both ranks"]
    second["difference"] = difference(second.pop("response"), first.pop("response"))
    finish("out-of-core", rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
