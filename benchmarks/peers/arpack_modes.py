"""Modes by SciPy's shift-invert ARPACK with MKL PARDISO: model.h5, count or band in Hz, checks -> JSON.

A count is that of the lowest modes. A band ("6000Hz") takes as many as inertia counts below its end, as a program does
that is asked for a frequency. `checks`: frequencies of the response of the modes, in Hz.
"""

import json
import sys
import time

import numpy as np
from model import read, upper
from pypardiso import PyPardisoSolver
from scipy.sparse.linalg import LinearOperator, eigsh

path, asked, checks = sys.argv[1], sys.argv[2], json.loads(sys.argv[3]) if len(sys.argv) > 3 else []
start = time.perf_counter()
K, M, B = read(path)
solver = PyPardisoSolver(mtype=-2)


def factored(A, phase):
    solver.set_phase(phase)
    solver._call_pardiso(A, np.zeros((len(B), 1)))
    return A


analysed = 12
if asked.endswith("Hz"):
    factored(upper(K - (2 * np.pi * float(asked[:-2])) ** 2 * M), analysed)
    count, analysed = int(solver.iparm[22]), 22
else:
    count = int(asked)
Ku = factored(upper(K), analysed)
solver.set_phase(33)
inverse = LinearOperator(K.shape, lambda x: solver._call_pardiso(Ku, x.reshape(-1, 1)).ravel(), dtype=float)
values, V = eigsh(K, count, M, sigma=0.0, OPinv=inverse)
seconds = time.perf_counter() - start
b = V.T @ B
response = [(b.T @ (b / (values - (2 * np.pi * f) ** 2)[:, None])).tolist() for f in checks]
frequencies = (np.sqrt(np.sort(values)) / 2 / np.pi).tolist()
print(json.dumps({"seconds": seconds, "count": count, "frequencies": frequencies, "response": response}))
