"""(b) Two points of order 0, 6 inputs, against pyMOR: its reductor of second-order models, and block solves by hand.

The reductor goes direction by direction, with a complex LU factor of A(s) for each: 24 of them here, against two. By
hand, in pyMOR's operators, it is one real factor a point as well (SuperLU).
"""

import json
from pathlib import Path

from common import CHECK, difference, finish, krylov, peer, reduce, solid, workspace

POINTS = (100.0, 3000.0)
with workspace() as folder:
    folder = Path(folder)
    solid(folder, (27, 11, 11))
    ours = reduce(folder, krylov(POINTS, order=0))
    rows = []
    for name, script in (("SOBHIReductor", "pymor_interpolation.py"), ("block solves by hand", "pymor_block.py")):
        theirs = peer(script, folder / "model.h5", json.dumps(POINTS), json.dumps(CHECK))
        rows.append({
            "pyMOR": name, "dofs": ours["dofs"], "hpcred, 2 ranks (s)": ours["seconds"],
            "pyMOR, 2 threads (s)": theirs["seconds"], "pyMOR / hpcred": theirs["seconds"] / ours["seconds"],
            "size": ours["size"], "size of pyMOR": theirs["size"],
            "agreement": difference(ours["response"], theirs["response"]),
        })  # fmt: skip
finish("interpolation", rows)
