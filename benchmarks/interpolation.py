"""(b) Two points of order 0, 6 inputs, against pyMOR's bitangential Hermite interpolation of second-order models."""

import json
from pathlib import Path

from common import CHECK, difference, finish, krylov, peer, reduce, solid, workspace

POINTS = (100.0, 3000.0)
with workspace() as folder:
    folder = Path(folder)
    solid(folder, (27, 11, 11))
    ours = reduce(folder, krylov(POINTS, order=0))
    theirs = peer("pymor_interpolation.py", folder / "model.h5", json.dumps(POINTS), json.dumps(CHECK))
row = {
    "dofs": ours["dofs"], "hpcred, 2 ranks (s)": ours["seconds"], "pyMOR, 2 threads (s)": theirs["seconds"],
    "pyMOR / hpcred": theirs["seconds"] / ours["seconds"], "size": ours["size"], "size of pyMOR": theirs["size"],
    "agreement": difference(ours["response"], theirs["response"]),
}  # fmt: skip
finish("interpolation", [row])
