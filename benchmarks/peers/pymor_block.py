"""Block solves at points, written by hand in pyMOR's operators: model.h5, frequencies, checks -> JSON.

One factorisation a point with all inputs as right-hand sides, in real numbers, and a Gram-Schmidt process with M.
"""

import json
import sys
import time

import numpy as np
from model import read
from pymor.algorithms.gram_schmidt import gram_schmidt
from pymor.core.logger import set_log_levels
from pymor.operators.numpy import NumpyMatrixOperator

set_log_levels({"pymor": "WARNING"})
path, points, check = sys.argv[1], json.loads(sys.argv[2]), json.loads(sys.argv[3])
start = time.perf_counter()
stiffness, mass, inputs = read(path)
K, M = NumpyMatrixOperator(stiffness.tocsc()), NumpyMatrixOperator(mass.tocsc())
B = NumpyMatrixOperator(inputs).as_range_array()
V = K.source.empty()
for f in points:
    V.append((K - M * (2 * np.pi * f) ** 2).assemble().apply_inverse(B))
gram_schmidt(V, product=M, copy=False)
k, m, b = K.apply2(V, V), M.apply2(V, V), V.inner(B)
seconds = time.perf_counter() - start
response = [(b.T @ np.linalg.solve(k - (2 * np.pi * f) ** 2 * m, b)).tolist() for f in check]
print(json.dumps({"seconds": seconds, "response": response, "size": len(V)}))
