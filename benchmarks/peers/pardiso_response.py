"""Exact responses by SciPy and MKL PARDISO, a factor for each frequency: model.h5, frequencies -> JSON."""

import json
import sys
import time

import numpy as np
from model import read, upper
from pypardiso import PyPardisoSolver

path, frequencies = sys.argv[1], json.loads(sys.argv[2])
start = time.perf_counter()
K, M, B = read(path)
solver, found = PyPardisoSolver(mtype=-2), []
for f in frequencies:
    A = upper(K - (2 * np.pi * f) ** 2 * M)
    solver.set_phase(22 if found else 12)
    solver._call_pardiso(A, np.zeros((len(B), 1)))
    solver.set_phase(33)
    found.append((B.T @ solver._call_pardiso(A, np.asfortranarray(B))).tolist())
print(json.dumps({"seconds": time.perf_counter() - start, "response": found}))
