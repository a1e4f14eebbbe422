"""Modes by SciPy's shift-invert ARPACK with MKL PARDISO: model.h5, count or band in Hz, checks -> JSON.

A count is that of the lowest modes. A band ("6000Hz") takes as many as inertia counts below its end, as a program does
that is asked for a frequency; the factor for that count is not in the seconds. `checks`: frequencies of the response of
the modes, in Hz.
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


def factored(A):
    solver = PyPardisoSolver(mtype=-2)
    solver.set_phase(12)
    solver._call_pardiso(A, np.zeros((len(B), 1)))
    return solver


counting = time.perf_counter()
if asked.endswith("Hz"):
    solver = factored(upper(K - (2 * np.pi * float(asked[:-2])) ** 2 * M))
    count = int(solver.iparm[22])  # negative pivots
    solver.free_memory(everything=True)
else:
    count = int(asked)
counting = time.perf_counter() - counting
Ku = upper(K)
solver = factored(Ku)
solver.set_phase(33)
inverse = LinearOperator(K.shape, lambda x: solver._call_pardiso(Ku, x.reshape(-1, 1)).ravel(), dtype=float)
values, V = eigsh(K, count, M, sigma=0.0, OPinv=inverse)
seconds = time.perf_counter() - start - counting
b = V.T @ B
response = [(b.T @ (b / (values - (2 * np.pi * f) ** 2)[:, None])).tolist() for f in checks]
frequencies = (np.sqrt(np.sort(values)) / 2 / np.pi).tolist()
print(json.dumps({"seconds": seconds, "count": count, "frequencies": frequencies, "response": response}))
