"""(a, e) Reduction of 3D solids, 6 inputs, 4 points of order 1, against SciPy and PARDISO; memory per dof.

And of one of them with as many columns as make one point dear: order 11.
"""

import json
import sys
from pathlib import Path

from common import CHECK, POINTS, difference, finish, krylov, peer, reduce, solid, workspace

CASES = {"27k": (36, 15, 15), "112k": (60, 24, 24), "200k": (72, 30, 29), "360k": (90, 37, 34)}
HIGH = {"112k": ((3000.0,), 11)}


def main(names=None):
    rows = []
    names = names or CASES
    work = [(name, POINTS, 1) for name in names] + [(name, *HIGH[name]) for name in names if name in HIGH]
    for name, points, order in work:
        with workspace() as folder:
            folder = Path(folder)
            solid(folder, CASES[name])
            ours = reduce(folder, krylov(points, order))
            theirs = peer("pardiso_krylov.py", folder / "model.h5", order, json.dumps(points), json.dumps(CHECK))
        rows.append({
            "dofs": ours["dofs"], "points": len(points), "order": order,
            "hpcred, 2 ranks (s)": ours["seconds"],
            "PARDISO, 2 threads (s)": theirs["seconds"],
            "PARDISO / hpcred": theirs["seconds"] / ours["seconds"],
            "agreement": difference(ours["response"], theirs["response"]),
            "outside MUMPS": ours["outside_mumps"], "orthogonalisation": ours["orthogonalise"],
            "analyses": ours["analyses"], "GFlop/s": ours["factor_gflops"], "ordering": ours["ordering"],
            "kB/dof": ours["memory_mb"] * 1024 / ours["dofs"],
            "PARDISO kB/dof": theirs["memory_mb"] * 1024 / ours["dofs"],
        })  # fmt: skip
    finish("solids", rows)


if __name__ == "__main__":
    main(sys.argv[1:])
