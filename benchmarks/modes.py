"""(c) The 30 lowest modes against SciPy's shift-invert ARPACK with PARDISO."""

from pathlib import Path

import numpy as np
from common import finish, peer, reduce, solid, workspace

rows = []
for cells in ((36, 15, 15), (60, 24, 24)):
    with workspace() as folder:
        folder = Path(folder)
        solid(folder, cells)
        ours = reduce(folder, '[[basis]]\nkind = "modes"\ncount = 30\n')
        theirs = peer("arpack_modes.py", folder / "model.h5", 30)
    a, b = np.array(ours["frequencies"]), np.array(theirs["frequencies"])
    rows.append({
        "dofs": ours["dofs"], "hpcred, 2 ranks (s)": ours["seconds"], "ARPACK + PARDISO (s)": theirs["seconds"],
        "ARPACK / hpcred": theirs["seconds"] / ours["seconds"], "agreement": float(np.abs(a / b - 1).max()),
    })  # fmt: skip
finish("modes", rows)
