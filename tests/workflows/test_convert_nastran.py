"""Exports of Nastran from the shell."""

import numpy as np
import pytest
import scipy.linalg
from conftest import DATA
from helpers import to_dense

from hpcred import read_model
from hpcred.cli.main import run

FREQUENCIES = [21.14057, 21.35569, 128.7332, 129.7476]  # that Nastran itself gives


@pytest.mark.mpi(build="real")
@pytest.mark.costly
def test_convert_needs_no_option(comm, folder, capsys):
    """The file with its companions, on ranks; what info then says, and what a dense eigensolver makes of it. The input
    file leads to the same."""
    source = DATA / "nastran" / "test_1" / "test_case.pch1"
    assert run(["convert", str(source), str(folder / "model.h5")]) == 0
    assert run(["info", str(folder / "model.h5")]) == 0 and "1188" in comm.bcast(capsys.readouterr().out)
    assert run(["convert", str(source.with_suffix(".bdf")), str(folder / "other.h5")]) == 0
    with read_model(folder / "model.h5", comm) as model, read_model(folder / "other.h5", comm) as other:
        K, M = to_dense(model.K), to_dense(model.M)
        assert np.array_equal(K, to_dense(other.K)) and np.array_equal(M, to_dense(other.M))
        assert np.array_equal(model.dofs.position, other.dofs.position)
        assert model.dofs.node.tolist() == other.dofs.node.tolist()
    values = scipy.linalg.eigvalsh(K, M)
    assert np.abs(values[:2]).max() < 1e-3 * values[2]
    assert np.sqrt(values[2:6]) / (2 * np.pi) == pytest.approx(FREQUENCIES, rel=1e-6)
