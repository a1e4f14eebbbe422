"""SOR-IRKA or bitangential Hermite interpolation by pyMOR: a framed model.h5 and a reference -> size, seconds, error.

usage: pymor_size.py model.h5 reference.npz irka|interpolation order

The reference has frequencies (Hz), response (S, r, p), and alpha, beta, eta of the damping that is measured with.
"""

import json
import sys
import time

import numpy as np
from model import read
from pymor.algorithms.to_matrix import to_matrix
from pymor.core.logger import set_log_levels
from pymor.models.iosys import SecondOrderModel
from pymor.reductors.interpolation import SOBHIReductor
from pymor.reductors.sor_irka import SORIRKAReductor

set_log_levels({"pymor": "ERROR"})
path, reference, method, order = sys.argv[1], np.load(sys.argv[2]), sys.argv[3], int(sys.argv[4])
f, full = reference["frequencies"], reference["response"]
alpha, beta, eta = (float(reference[key]) for key in ("alpha", "beta", "eta"))
start = time.perf_counter()
K, M, B = read(path)
# a loss factor has no E: a damping of the same size in mid-band, for the iteration only
E = alpha * M + (beta or eta / (np.pi * f[-1])) * K
fom = SecondOrderModel.from_matrices(M.tocsc(), E.tocsc(), K.tocsc(), B, B.T)
if method == "irka":
    rom = SORIRKAReductor(fom).reduce(order, maxit=30)
else:
    points = (np.arange(order) + 0.5) * f[-1] / order
    directions = np.tile(np.eye(B.shape[1]), (order, 1))
    rom = SOBHIReductor(fom).reduce(2j * np.pi * np.repeat(points, B.shape[1]), directions, directions)
seconds = time.perf_counter() - start
M, E, K, B, C = (to_matrix(item, format="dense") for item in (rom.M, rom.E, rom.K, rom.B, rom.Cp))
found = []
for s in 2j * np.pi * f:
    A = s * s * M + (1 + 1j * eta) * K + (s * E if not eta else 0)
    found.append(C @ np.linalg.solve(A, B))
drive = np.abs(np.einsum("fii->fi", full))  # the measure by directions
g = np.sqrt(np.maximum(drive, np.median(drive, axis=0)))
eps = (np.abs(np.array(found) - full) / (g[:, :, None] * g[:, None, :])).max(axis=(1, 2))
print(json.dumps({"size": rom.order, "seconds": seconds, "eps": float(eps.max())}))
