"""The lever under a constant pressure, by CalculiX with pressures on faces of elements, and by the reduced model."""

import re
from pathlib import Path

import calculix
import numpy as np

import hpcred

with hpcred.read_model("model.h5") as model:
    top = set(model.sets["TOP"].tolist())
lines = re.findall(r"^\d+(?:, \d+){10}$", Path("lever_mesh.inp").read_text(), re.M)
elements = [list(map(int, line.split(","))) for line in lines]
faces = {"P1": (1, 2, 3), "P2": (1, 4, 2), "P3": (2, 4, 3), "P4": (3, 4, 1)}
loads = [f"{e[0]}, {face}, 1e6" for e in elements for face, at in faces.items() if {e[k] for k in at} <= top]
step = ["*BOUNDARY", "BIG, 1, 3", "*STEP", "*STATIC", "*DLOAD", *loads, "*EL FILE", "S", "*END STEP", ""]
calculix.run("static", Path("lever.inp").read_text().partition("*STEP")[0] + "\n".join(step))

result = hpcred.read_result("lever.h5")
reduced = result.reduced
q = np.linalg.solve(reduced.K, reduced.B[:, reduced.input_names.index("pressure")])
calculix.compare("static", result, q)
