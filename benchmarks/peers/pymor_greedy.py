"""The greedy basis of pyMOR for a spinning shaft over frequencies and speeds: a folder of matrices -> size, seconds.

usage: pymor_greedy.py folder tolerance

The folder has M, D, G, K, N (.npz, SciPy) of s^2 M + s (D + omega G) + K + omega^2 N, and reference.npz with B, the
ends `band` (Hz) and `fastest` (rad/s), fresh pairs `frequencies`, `speeds`, and their responses `full`. Snapshots are
taken where the true error of the state is largest among 60 frequencies, 17 speeds and all inputs (a strong greedy). The
size is the smallest number of complex vectors whose error is below the tolerance at the fresh pairs.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
import scipy.sparse
from pymor.algorithms.greedy import rb_greedy
from pymor.core.logger import set_log_levels
from pymor.models.basic import StationaryModel
from pymor.operators.constructions import LincombOperator, VectorOperator
from pymor.operators.numpy import NumpyMatrixOperator
from pymor.parameters.functionals import GenericParameterFunctional
from pymor.reductors.basic import StationaryRBReductor

MOST, FREQUENCIES, SPEEDS = 90, 60, 17
set_log_levels({"pymor": "ERROR"})
folder, tolerance = Path(sys.argv[1]), float(sys.argv[2])
parts = {key: scipy.sparse.load_npz(folder / f"{key}.npz").tocsc().astype(complex) for key in "MDGKN"}
reference = np.load(folder / "reference.npz")
B, full = reference["B"], reference["full"]
known = {"f": 1, "omega": 1, "column": 1}
factors = {
    "M": lambda f, omega: (2j * np.pi * f) ** 2, "D": lambda f, omega: 2j * np.pi * f,
    "G": lambda f, omega: 2j * np.pi * f * omega, "K": lambda f, omega: 1.0, "N": lambda f, omega: omega**2,
}  # fmt: skip


def functional(factor):
    return GenericParameterFunctional(lambda mu: factor(mu["f"][0], mu["omega"][0]), known)


start = time.perf_counter()
operators = [NumpyMatrixOperator(parts[key]) for key in parts]
space = operators[0].source
columns = [VectorOperator(space.from_numpy(B[:, [k]])) for k in range(B.shape[1])]
chosen = [GenericParameterFunctional(lambda mu, k=k: float(mu["column"][0] == k), known) for k in range(B.shape[1])]
model = StationaryModel(LincombOperator(operators, [functional(factors[key]) for key in parts]),
                        LincombOperator(columns, chosen))  # fmt: skip
model.enable_caching("memory")
training = [
    model.parameters.parse({"f": [f], "omega": [omega], "column": [k]})
    for f in np.linspace(*reference["band"], FREQUENCIES) for omega in np.linspace(0, reference["fastest"], SPEEDS)
    for k in range(B.shape[1])
]  # fmt: skip
reductor = StationaryRBReductor(model)
rb_greedy(model, reductor, training, use_error_estimator=False, max_extensions=MOST, atol=0.0, rtol=1e-12)
V = np.asarray(reductor.bases["RB"].to_numpy())
V = V if V.shape[0] == len(B) else V.T
seconds = time.perf_counter() - start

drive = np.abs(np.einsum("sii->si", full))
g = np.sqrt(np.maximum(drive, np.median(drive, axis=0)))  # the measure by directions


def error(size):
    left = V[:, :size].conj().T
    small = {key: left @ (mat @ V[:, :size]) for key, mat in parts.items()}
    found = np.array([
        B.T @ V[:, :size] @ np.linalg.solve(sum(factors[key](f, omega) * small[key] for key in small), left @ B)
        for f, omega in zip(reference["frequencies"], reference["speeds"], strict=True)
    ])  # fmt: skip
    return float((np.abs(found - full) / (g[:, :, None] * g[:, None, :])).max())


sizes = np.arange(1, V.shape[1] + 1)
size = next((int(n) for n in sizes if error(n) <= tolerance), None)
print(json.dumps({"dofs": len(B), "seconds": seconds, "size": size, "true": error(size or V.shape[1]),
                  "factorisations": len(training) // B.shape[1]}))  # fmt: skip
