"""Strong scaling: the same reduction on 1, 2, 4, ... ranks, and on fewer ranks of several threads.

usage: python benchmarks/strong_scaling.py [--cases 112k:11 360k:3 cube69:1] [--ranks 1 2 4 8 16] [--threads 1 2]
       [--points HZ ...] [--groups G ...] [--pardiso]

Each case is a solid of solids.py or a cube of so many cells an edge, and the order of its points (by default 1).
`--threads 2` adds runs on half as many ranks of two threads each; `--groups` runs on all ranks in so many groups;
`--pardiso` adds SciPy + PARDISO on as many threads.
"""

import argparse
import json
import os
from pathlib import Path

from common import CHECK, difference, finish, krylov, peer, reduce, solid, workspace
from solids import CASES


def layouts(arguments):
    """Ranks, threads a rank and groups of every run."""
    yield from ((ranks, 1, 1) for ranks in arguments.ranks)
    most = max(arguments.ranks)
    yield from ((most // threads, threads, 1) for threads in arguments.threads if 1 < threads <= most)
    yield from ((most, 1, groups) for groups in arguments.groups if groups > 1)


def rows_of(case, arguments):
    name, _, order = case.partition(":")
    edge = name.removeprefix("cube")
    cells = (int(edge),) * 3 if edge != name else CASES[name]
    basis, first = krylov(arguments.points, int(order or 1)), None
    with workspace() as folder:
        folder = Path(folder)
        solid(folder, cells, ranks=max(arguments.ranks))
        for ranks, threads, groups in layouts(arguments):
            found = reduce(folder, basis, ranks, ("--groups", groups) if groups > 1 else (), threads)
            first = first or found
            yield {
                "case": case, "dofs": found["dofs"], "ranks": ranks, "threads": threads, "groups": groups,
                "seconds": found["seconds"], "speed-up": first["seconds"] / found["seconds"],
                **{key: found["stages"].get(key, 0.0) for key in STAGES},
                "GFlop/s": found["factor_gflops"],
                "outside MUMPS": found["outside_mumps"] if groups == 1 else None,  # groups are in MUMPS side by side
                "GB": found["memory_mb"] / 1024, "difference": difference(found["response"], first["response"]),
            }  # fmt: skip
        for cores in arguments.ranks if arguments.pardiso else ():
            theirs = peer("pardiso_krylov.py", folder / "model.h5", order or 1, json.dumps(arguments.points),
                          json.dumps(CHECK), threads=cores)  # fmt: skip
            yield {
                "case": f"{case}, PARDISO", "dofs": first["dofs"], "ranks": 1, "threads": cores, "groups": 1,
                "seconds": theirs["seconds"], "factor": theirs["factor_seconds"], "solve": theirs["solve_seconds"],
                "GB": theirs["memory_mb"] / 1024, "difference": difference(first["response"], theirs["response"]),
            }  # fmt: skip


STAGES = ("read", "factor", "solve", "orthogonalise", "project", "write", "other")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    powers = [2**i for i in range(64) if 2**i <= os.cpu_count()]
    parser.add_argument("--cases", nargs="+", default=["112k:11", "360k:3"])
    parser.add_argument("--ranks", nargs="+", type=int, default=powers)
    parser.add_argument("--threads", nargs="*", type=int, default=[2])
    parser.add_argument("--points", nargs="+", type=float, default=[3000.0])
    parser.add_argument("--groups", nargs="+", type=int, default=[])
    parser.add_argument("--pardiso", action="store_true")
    arguments = parser.parse_args()
    finish("strong-scaling", [row for case in arguments.cases for row in rows_of(case, arguments)])


main()
