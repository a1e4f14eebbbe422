"""(d) How the time of hpcred grows with dofs, inputs, ranks and groups; "multigrid": cubes without a factor.

usage: python benchmarks/growth.py [multigrid]
"""

import sys
from pathlib import Path

import numpy as np
from common import POINTS, difference, finish, krylov, reduce, solid, workspace

CELLS = (60, 24, 24)  # 112k dofs
CUBES = (24, 33, 50)  # cells an edge: 45k, 114k and 390k dofs
MULTIGRID = '[solver]\nkind = "multigrid"\n' + krylov((0.0,), order=3)
rows = []


def run(what, value, cells=CELLS, inputs=6, basis=None, ranks=2, options=()):
    with workspace() as folder:
        folder = Path(folder)
        solid(folder, cells, inputs)
        found = reduce(folder, basis or krylov(POINTS[:2]), ranks, options)
    kept = {key: found[key] for key in ("dofs", "seconds", "size", "iterations")}
    rows.append({"varied": what, "value": value, **kept, "GB": found["memory_mb"] / 1024})
    return found


def exponent(found, key):
    """The slope of a quantity over the dofs, both logarithmic."""
    return float(np.polyfit(*(np.log([item[name] for item in found]) for name in ("dofs", key)), 1)[0])


def multigrid():
    cubes = [run("cube", edge, (edge,) * 3, basis=MULTIGRID) for edge in CUBES]
    finish("growth-multigrid", [
        *rows, {"varied": "exponent of seconds", "value": exponent(cubes, "seconds")},
        {"varied": "exponent of memory", "value": exponent(cubes, "memory_mb")},
    ])  # fmt: skip


def main():
    blocks = {"27k": (36, 15, 15), "112k": CELLS, "200k": (72, 30, 29)}
    sizes = [run("dofs", name, cells) for name, cells in blocks.items()]
    usual = sizes[1]
    inputs, rank = run("inputs", 96, inputs=96), run("ranks", 1, ranks=1)
    groups = run("groups", 2, options=("--groups", "2"))
    finish("growth", [
        *rows, {"varied": "exponent of dofs", "value": exponent(sizes, "seconds")},
        {"varied": "96 inputs / 6 inputs", "value": inputs["seconds"] / usual["seconds"]},
        {"varied": "1 rank / 2 ranks", "value": rank["seconds"] / usual["seconds"],
         "agreement": difference(rank["response"], usual["response"])},
        {"varied": "1 group / 2 groups", "value": usual["seconds"] / groups["seconds"],
         "agreement": difference(usual["response"], groups["response"])},
    ])  # fmt: skip


multigrid() if sys.argv[1:] == ["multigrid"] else main()
