"""Lowest modes by SciPy's shift-invert ARPACK with MKL PARDISO: model.h5, count -> JSON."""

import json
import sys
import time

import numpy as np
from model import read, upper
from pypardiso import PyPardisoSolver
from scipy.sparse.linalg import LinearOperator, eigsh

path, count = sys.argv[1], int(sys.argv[2])
start = time.perf_counter()
K, M, B = read(path)
solver, Ku = PyPardisoSolver(mtype=-2), upper(K)
solver.set_phase(12)
solver._call_pardiso(Ku, np.zeros((len(B), 1)))
solver.set_phase(33)
inverse = LinearOperator(K.shape, lambda x: solver._call_pardiso(Ku, x.reshape(-1, 1)).ravel(), dtype=float)
values, _ = eigsh(K, count, M, sigma=0.0, OPinv=inverse)
seconds = time.perf_counter() - start
print(json.dumps({"seconds": seconds, "frequencies": (np.sqrt(np.sort(values)) / 2 / np.pi).tolist()}))
