"""Block rational Krylov by SciPy and MKL PARDISO (LDL^T, one analysis): model.h5, orders, points, checks -> JSON.

`orders`: one for all points, or a list.
"""

import json
import resource
import sys
import time

import numpy as np
from model import read, upper
from pypardiso import PyPardisoSolver

CHECK = json.loads(sys.argv[4])
path, orders, points = sys.argv[1], json.loads(sys.argv[2]), json.loads(sys.argv[3])
orders = orders if isinstance(orders, list) else [orders] * len(points)
start = time.perf_counter()
K, M, B = read(path)
Ku, Mu = upper(K), upper(M)
solver, V = PyPardisoSolver(mtype=-2), np.zeros((len(B), 0))
factor = solve = 0.0


def new_part(V, X):
    """The M-orthonormal part of X outside of V, without what is dependent but for round-off; twice is enough."""
    for _ in range(2):
        X = X - V @ (V.T @ (M @ X))
        gram = X.T @ (M @ X)
        scale = 1 / np.sqrt(np.diag(gram))
        values, turn = np.linalg.eigh(gram * np.outer(scale, scale))
        kept = values > 1e-14
        X = X @ (scale[:, None] * turn[:, kept] / np.sqrt(values[kept]))
    return X


for i, frequency in enumerate(points):
    A = Ku - (2 * np.pi * frequency) ** 2 * Mu
    begin = time.perf_counter()
    solver.set_phase(22 if i else 12)
    solver._call_pardiso(A, np.zeros((len(B), 1)))
    factor += time.perf_counter() - begin
    X = B
    for _ in range(orders[i] + 1):
        begin = time.perf_counter()
        solver.set_phase(33)
        X = solver._call_pardiso(A, np.asfortranarray(X))
        solve += time.perf_counter() - begin
        X = new_part(V, X)
        V = np.hstack([V, X])
        X = M @ X
k, m, b = V.T @ (K @ V), V.T @ (M @ V), V.T @ B
values, vectors = np.linalg.eigh(k)
seconds = time.perf_counter() - start
response = [(b.T @ np.linalg.solve(k - (2 * np.pi * f) ** 2 * m, b)).tolist() for f in CHECK]
print(json.dumps({
    "seconds": seconds, "factor_seconds": factor, "solve_seconds": solve, "response": response,
    "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
}))  # fmt: skip
