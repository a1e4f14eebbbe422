"""The script in examples/chrono: what Chrono's source makes of the matrices is the body."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from helpers import block_with_ends
from scipy.linalg import eigh

import hpcred
from hpcred.assembly import Turn
from hpcred.parallel.petsc import MPI

SCRIPT = Path(__file__).parents[2] / "examples" / "chrono" / "matrices.py"


def test_chrono_reduces_the_matrices_to_the_body(tmp_path, capsys):
    """The steps of ChModalAssembly::DoModalReduction, with a floating frame that is turned."""
    spec = importlib.util.spec_from_file_location("chrono_matrices", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    with (
        block_with_ends(MPI.COMM_WORLD) as model,
        hpcred.reduce(model, tolerance=1e-3, band=(0.0, 2e4), frame=hpcred.Buckens(), coordinates="interface") as rom,
    ):  # fmt: skip
        hpcred.write_result(tmp_path / "arm.h5", rom, model)
        known = np.sqrt(np.maximum(eigh(rom.K, rom.M, eigvals_only=True), 0))[6:]
    script.main(tmp_path / "arm.h5")
    first, *places = (tmp_path / "arm_nodes.txt").read_text().splitlines()
    n, modes, inside, count = map(int, first.split())
    assert len(places) == count == 2 and n == 6 * (count + inside) and modes == len(known) + 6 - 12
    M, K = np.zeros((2, n, n))
    for key, matrix in (("M", M), ("K", K)):
        rows = np.loadtxt(tmp_path / f"arm_{key}.txt")
        matrix[rows[:, 0].astype(int), rows[:, 1].astype(int)] = rows[:, 2]
    # ComputeLocalFullKMCqMatrices: three rows of six of every node, of internal ones too
    L = np.kron(np.eye(n // 6), np.block([[Turn(axis=(1.0, 2.0, 3.0), degrees=40.0).matrix, np.zeros((3, 3))],
                                          [np.zeros((3, 3)), np.eye(3)]]))  # fmt: skip
    M, K, b = L.T @ M @ L, L.T @ K @ L, 6 * count
    # PartitionLocalSystemMatrices and ApplyModeAccelerationTransformation
    V = eigh(K[b:, b:], M[b:, b:])[1][:, :modes]
    static = -np.linalg.solve(K[b:, b:], K[b:, :b])
    dynamic = -np.linalg.solve(K[b:, b:], M[b:, b:] @ V)
    Psi = np.block([[np.eye(b), np.zeros((b, modes))], [static, dynamic]])
    squares = eigh(Psi.T @ K @ Psi, Psi.T @ M @ Psi, eigvals_only=True)
    assert np.sqrt(squares[6:]) == pytest.approx(known, rel=1e-8)
