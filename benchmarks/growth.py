"""(d) How the time of hpcred grows with dofs, inputs, ranks and points."""

from pathlib import Path

import numpy as np
from common import POINTS, difference, finish, krylov, reduce, solid, workspace

CELLS = (60, 24, 24)  # 112k dofs
rows = []


def run(what, value, cells=CELLS, inputs=6, points=POINTS[:2], ranks=2, options=()):
    with workspace() as folder:
        folder = Path(folder)
        solid(folder, cells, inputs)
        found = reduce(folder, krylov(points), ranks, options)
    rows.append({"varied": what, "value": value, "dofs": found["dofs"], "seconds": found["seconds"],
                 "size": found["size"], "GB": found["memory_mb"] / 1024})  # fmt: skip
    return found


sizes = [run("dofs", name, cells) for name, cells in (("27k", (36, 15, 15)), ("112k", CELLS), ("200k", (72, 30, 29)))]
slope = np.polyfit(np.log([item["dofs"] for item in sizes]), np.log([item["seconds"] for item in sizes]), 1)[0]
inputs = [run("inputs", count, inputs=count) for count in (1, 6, 24, 96)]
ranks = [run("ranks", count, ranks=count) for count in (1, 2)]
for count in (1, 2, 4):
    run("points", count, points=POINTS[:count])
one = run("groups", 1)
two = run("groups", 2, options=("--groups", "2"))
finish("growth", [
    *rows, {"varied": "exponent of dofs", "value": float(slope)},
    {"varied": "96 inputs / 6 inputs", "value": inputs[3]["seconds"] / inputs[1]["seconds"]},
    {"varied": "1 rank / 2 ranks", "value": ranks[0]["seconds"] / ranks[1]["seconds"],
     "agreement": difference(ranks[0]["response"], ranks[1]["response"])},
    {"varied": "1 group / 2 groups", "value": one["seconds"] / two["seconds"],
     "agreement": difference(one["response"], two["response"])},
])  # fmt: skip
