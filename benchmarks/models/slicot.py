"""Models of the SLICOT benchmarks for model reduction: x' = A x + B u, y = C x of structures, in second-order form.

Y. Chahlaoui and P. Van Dooren, A collection of benchmark examples for model reduction of linear time invariant
dynamical systems, SLICOT Working Note 2002-2. Their files have the Hankel singular values of each system, `hsv`.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy.io
import scipy.linalg
import scipy.sparse

import hpcred

from .published import Arrays, Published, variables

WHERE = "slicot.org, Benchmarks for Model Reduction"


def second_order(path) -> Arrays:
    """M = I, D, K, B and C, Cv from the A = [0 I; -K -D], B = [0; B] and C = [C Cv] of a file."""
    A, B, C = (scipy.sparse.csr_matrix(found).toarray() for found in variables(path, "A", "B", "C"))
    n = len(A) // 2
    if A.shape != (2 * n, 2 * n) or A[:n, :n].any() or (A[:n, n:] != np.eye(n)).any() or B[:n].any():
        raise hpcred.InputError(f"{path}: A and B are not [0 I; -K -D] and [0; B], those of positions and velocities")
    if C.shape[1] != 2 * n or not C.any():
        found = f"{C.shape[1]} columns with {np.count_nonzero(C)} numbers"
        raise hpcred.InputError(f"{path}: C has {found}, expected {2 * n} columns, not all of them zero")
    more = scipy.io.loadmat(path, variable_names=["D", "E"])
    if "E" in more or ("D" in more and scipy.sparse.csr_matrix(more["D"]).nnz):
        raise hpcred.InputError(f"{path}: found D or E, expected x' = A x + B u, y = C x, without them")
    sparse = scipy.sparse.csr_matrix
    positions, velocities = (rows if rows.any() else None for rows in (C[:, :n], C[:, n:]))
    return Arrays(M=sparse(np.eye(n)), D=sparse(-A[n:, n:]), K=sparse(-A[n:, :n]), B=B[n:], C=positions, Cv=velocities)


def published_hankel_values(path) -> np.ndarray:
    """Hankel singular values as the file has them, (2 n,), the largest first."""
    (found,) = variables(path, "hsv")
    return np.sort(scipy.sparse.csr_matrix(found).toarray().ravel())[::-1]


def hankel_values(M, D, K, B, C=None, Cv=None) -> np.ndarray:
    """Hankel singular values of a small stable model, (2 n,), the largest first, by dense Lyapunov equations."""
    n, M = len(K), np.asarray(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    inputs = np.vstack([np.zeros_like(B), np.linalg.solve(M, B)])
    none = np.zeros((n, len(C if C is not None else Cv)))
    outputs = np.hstack([none.T if C is None else C, none.T if Cv is None else Cv])
    # by square roots, since eigenvalues of the product of the Gramians lose half of the digits of the small ones
    left, right = (
        _root(scipy.linalg.solve_continuous_lyapunov(a, -b @ b.T)) for a, b in ((A, inputs), (A.T, outputs.T))
    )
    return np.linalg.svd(right.T @ left, compute_uv=False)


def _root(gramian):
    """L with L L^T = a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh((gramian + gramian.T) / 2)
    return vectors * np.sqrt(np.maximum(values, 0.0))


_station = partial(Published, licence="none stated", where=WHERE, read=second_order)
MODELS = (
    _station(name="iss", what="International Space Station, stage 1R: velocities under forces", n=135,
             file="iss_hylaa.mat", source="SLICOT, as in stanleybak/hylaa a774f8e", band=(0.0, 12.0)),
    _station(name="iss12a", what="International Space Station, stage 12A", n=706, file="iss12a.mat", source="SLICOT",
             band=(0.0, 12.0)),
    _station(name="building", what="Los Angeles University Hospital: eight floors of three motions", n=24,
             file="build.mat", source="SLICOT", band=(0.0, 20.0)),
)  # fmt: skip
