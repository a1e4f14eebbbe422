"""Larger cases, against a second method or each other: `make test-slow`."""

import json

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
from helpers import columns_of

import hpcred
from hpcred import GivenDamping, Krylov, Modes, SecondOrderKrylov

pytestmark = pytest.mark.slow


def test_discrete_dampers_need_second_order_krylov():
    """21,660 dofs with two strong dampers: at equal size, orders of magnitude between the methods."""
    with hpcred.solid((20, 18, 18), inputs=2) as model:
        model.D = model.K.duplicate(copy=True)
        model.D.scale(1e-8)
        for row in (model.size - 2, model.size - 3 * 19 * 19 + 1):
            model.D.setValue(row, row, 2e6, addv=True)
        model.D.assemble()
        frequencies = np.linspace(200, 6000, 7)
        full = hpcred.frequency_response(model, frequencies, damping=GivenDamping())
        errors = {}
        for name, basis in (
            ("second order", [SecondOrderKrylov(2000.0, order=2), SecondOrderKrylov(4500.0, order=2)]),
            ("proportional", [Krylov(2000.0, 5), Krylov(4500.0, 5)]),
        ):
            with hpcred.reduce(model, basis, damping=GivenDamping()) as rom:
                assert rom.size == 24
                errors[name] = hpcred.relative_error(full, hpcred.frequency_response(rom, frequencies)).max()
    assert errors["second order"] < 1e-2 * errors["proportional"]


def test_a_million_dofs(hpcred, tmp_path):
    """The plate of the README on two ranks, and the full response at its points."""
    (tmp_path / "job.toml").write_text(
        'model = "model.h5"\n'
        + "".join(f'[[basis]]\nkind = "krylov"\nfrequency = {f}\norder = 1\n' for f in (10.0, 60.0))
    )
    assert hpcred("example", "solid", "--cells", 420, 400, 1, "-o", "model.h5", ranks=2).returncode == 0
    run = hpcred("reduce", "job.toml", "--json", "run.json", ranks=2, timeout=900)
    assert run.returncode == 0, run.stderr
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["size"] > 1_000_000 and record["reduced_size"] == 24 and record["symbolic_analyses"] == 1
    assert record["orthonormality_defect"] < 1e-12
    run = hpcred("evaluate", "result.h5", "--full", "model.h5", "--frequencies", "10,60", "--json", "eps.json", ranks=2,
                 timeout=900)  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert max(json.loads((tmp_path / "eps.json").read_text())["eps"]) < 1e-5


def test_a_solid_against_scipy():
    """K^-1 B, a shifted solve and the lowest modes of 27,000 dofs by SuperLU and ARPACK."""
    with hpcred.solid((24, 18, 18), inputs=3) as model:
        mats = [scipy.sparse.csr_matrix(m.getValuesCSR()[::-1], shape=m.getSize()) for m in (model.K, model.M)]
        B = columns_of(model.B)
        frequencies = [0.0, 1500.0]
        full = hpcred.frequency_response(model, frequencies)
        for f, H in zip(frequencies, full, strict=True):
            A = (mats[0] - (2 * np.pi * f) ** 2 * mats[1]).tocsc()
            expected = B.T @ scipy.sparse.linalg.splu(A, options={"SymmetricMode": True}, diag_pivot_thresh=0.0).solve(
                B
            )
            assert np.abs(H - expected).max() < 1e-7 * np.abs(expected).max()
        values = scipy.sparse.linalg.eigsh(mats[0], 6, mats[1], sigma=0.0, return_eigenvectors=False)
        with hpcred.reduce(model, [Modes(count=6)]) as rom:
            assert np.allclose(rom.frequencies, np.sort(np.sqrt(values)) / (2 * np.pi), rtol=1e-8)
