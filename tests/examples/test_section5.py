"""Tables 1 and 2 of the paper."""

import numpy as np
import pytest

import hpcred
from hpcred import Krylov, Modes, StaticCorrection
from hpcred.examples import linkage as example
from hpcred.examples import section5
from hpcred.examples.section5 import MIMO, SISO, compare

pytestmark = pytest.mark.mpi


def test_table_1(linkage):
    frequencies = np.linspace(0.1, 300, 601)
    full = hpcred.frequency_response(linkage, frequencies, example.FRAME, example.DAMPING)
    krylov = [Krylov(10, 1), Krylov(150, 5), Krylov(240, 3), Krylov(300, 1)]
    for basis, low, high in (
        (krylov, 0.0, 1e-8),
        ([Modes(count=13), StaticCorrection()], 8.7e-2, 9.1e-2),
        ([Modes(count=14)], 8.2, 8.6),
    ):
        with hpcred.reduce(linkage, basis, example.FRAME, example.DAMPING, deflation_tolerance=1e-13) as rom:
            assert rom.size == 14
            errors = hpcred.relative_error(full, hpcred.frequency_response(rom, frequencies), "paper")
            assert low <= hpcred.analysis.error_integral(frequencies, errors) <= high


@pytest.mark.mpi
@pytest.mark.costly
def test_tables_of_the_paper(comm, monkeypatch):
    monkeypatch.setattr(section5, "FREQUENCIES", np.linspace(0.1, 300, 601))  # a fifth of those of `hpcred paper`
    with hpcred.linkage(comm) as model:
        siso = compare(model, SISO, numbers=(2,))
        mimo = compare(model, MIMO, numbers=(1, 2)) if comm.size == 1 else []
    assert siso[0]["size"] == 14 and siso[0]["Q"] < 1e-8
    for result, q in zip(mimo, (2.03e-3, 8.5e-4), strict=False):
        assert result["size"] == 21
        assert result["Q"] == pytest.approx(q, rel=0.02)
