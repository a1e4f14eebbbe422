"""Compare the machine with its full bodies: all nodes, joined by the same bushings, without any reduction."""

from pathlib import Path

import numpy as np
import tomllib
from scipy.sparse import block_diag, csr_array, diags
from scipy.sparse.linalg import splu

import hpcred

machine = tomllib.loads(Path("machine.toml").read_text())
names, K, M, G = [], [], [], []
for body in machine["body"]:
    # matrices, and G: the six motions of each interface, in the axes of the machine
    job = hpcred.settings.read_job(f"{body['name']}.toml")
    model = hpcred.read_model(f"{body['name']}_model.h5").with_interfaces(job.interface)
    parts = [csr_array(A.getValuesCSR()[::-1], shape=A.getSize()) for A in (model.K, model.M, model.Gt)]
    turn = hpcred.assembly.Turn(**body["turn"]).matrix if "turn" in body else np.eye(3)
    turn = block_diag([turn] * 2 * len(model.interfaces))
    names += [f"{body['name']}.{item.name}" for item in model.interfaces]
    for found, part in zip((K, M, G), (parts[0], parts[1], turn @ parts[2].T), strict=True):
        found.append(part)
K, M, G = (block_diag(item, format="csr") for item in (K, M, G))


def motion(name):
    """The rows (6, n) of an interface; none of the ground."""
    return G[6 * names.index(name) : 6 * names.index(name) + 6] if name != "ground" else 0 * G[:6]


bushings = []
for joint in machine["joint"]:
    g = motion(joint["bodies"][0]) - motion(joint["bodies"][1])
    k, d = (np.array([*joint[key], 0, 0, 0][:6]) for key in ("stiffness", "damping"))
    bushings.append([g.T @ diags(value) @ g for value in (k, d)])
springs, dampers = (sum(item) for item in zip(*bushings, strict=True))

reduced = hpcred.read_result("machine.h5").reduced
accuracy = reduced.record.accuracy
tool, names = motion("spindle.tool")[:3].T.toarray(), [f"spindle.tool:{d}" for d in "xyz"]
rows, columns = ([own.index(name) for name in names] for own in (reduced.output_names, reduced.input_names))
print(f"{K.shape[0]} dofs against {reduced.size} coordinates; at the tool")
for f in (5.0, accuracy.worst, 120.0, 400.0):
    s = 2j * np.pi * f
    A = ((1 + 5e-6 * s) * K + s**2 * M + springs + s * dampers).tocsc()
    H = tool.T @ splu(A, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(tool.astype(complex))
    size, error = (np.linalg.norm(part, 2) for part in (H, H - reduced.transfer_function(s)[np.ix_(rows, columns)]))
    estimate = np.interp(f, accuracy.frequencies, accuracy.eps)
    print(f"{f:5.1f} Hz: |H| {size:.4e} m/N, error {error / size:.1e}, estimated {estimate:.1e}")
