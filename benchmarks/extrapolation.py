"""Factors of cubes by MUMPS' analyses alone, a power law through them, and what it says for 10^7 dofs.

usage: python benchmarks/extrapolation.py [edge ...]

An analysis gives entries, operations and memory of a factor without making it. The power law through all sizes but the
largest is set against the largest, and that through all is extended to 10^7 dofs.
"""

import json
import sys

import numpy as np
from common import finish, job, workspace

EDGES = (16, 23, 33, 47, 69)  # cells an edge: 14,739 to 1,014,300 dofs
TARGET = 1e7
QUANTITIES = {"flops": "operations", "entries": "entries", "mb": "MB in all", "mb_max_rank": "MB of a rank"}


def analyse(edge):
    """Entries, operations and memory of the factor of a cube, estimated; in a job of its own."""
    import hpcred
    from hpcred.linalg.solvers.mumps import Mumps, orderings

    hpcred.start()
    with hpcred.solid((edge,) * 3) as model:
        factors = Mumps(model.K, True, "shift_")
        found = factors.expected(orderings()[:1])
        factors.close()
        if model.comm.rank == 0:
            (expected,) = found.values()
            print(json.dumps({"dofs": model.size, **{name: expected[key] for key, name in QUANTITIES.items()}}))


def main(edges):
    with workspace() as folder:
        found = [job(2, folder, "--analyse", edge) for edge in edges]
    dofs = np.log([item["dofs"] for item in found])
    rows = [dict(item) for item in found]
    power, checked, expected = {}, {}, {}
    for key in QUANTITIES.values():
        values = np.log([item[key] for item in found])
        slope, offset = np.polyfit(dofs[:-1], values[:-1], 1)
        checked[key] = float(np.exp(slope * dofs[-1] + offset - values[-1]))
        slope, offset = np.polyfit(dofs, values, 1)
        power[key], expected[key] = f"{slope:.2f}", float(np.exp(slope * np.log(TARGET) + offset))
    rows += [{"dofs": "exponent", **power}, {"dofs": "power law / largest", **checked},
             {"dofs": "10^7 by the power law", **expected}]  # fmt: skip
    finish("extrapolation", rows)


if sys.argv[1:2] == ["--analyse"]:
    analyse(int(sys.argv[2]))
else:
    main(tuple(map(int, sys.argv[1:])) or EDGES)
