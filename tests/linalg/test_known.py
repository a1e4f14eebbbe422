"""Values and their sources: which serves which claim, and what the pivots of approximate factors count."""

import numpy as np
import pytest

import hpcred
from hpcred import Factoring, LinearSolver
from hpcred.linalg.known import EXACT, Source
from hpcred.linalg.solvers import settings
from hpcred.linalg.solvers.base import Factorisation
from hpcred.linalg.solvers.mumps import Mumps
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.parallel.petsc import PETSc, is_complex

ROUGH, FINE = (Source(kind="approximate factor", accuracy=value) for value in (5e-3, 1e-8))
ORDER = [EXACT, FINE, ROUGH, *(Source(kind=kind) for kind in ("Krylov", "declared", "estimated"))]


@pytest.mark.parametrize("claim", ORDER)
def test_a_source_serves_no_stronger_claim(claim):
    assert [source.serves(claim) for source in ORDER] == [k <= ORDER.index(claim) for k in range(len(ORDER))]


class Rough(Factorisation):
    """A package whose factors are those of a symmetric matrix nearby."""

    name = "rough"
    tells_inertia = True
    error = 0.0  # relative to the norm

    @classmethod
    def source_of(cls, factoring, prefix):
        return Source(kind="approximate factor", accuracy=cls.error)

    def _factor(self):
        size = self.matrix.getSize()[0]
        values = self.matrix.getValues(range(size), range(size))
        noise = np.random.default_rng(size).standard_normal((size, size))
        noise = (noise + noise.T) * self.error * np.linalg.norm(values, 2) / np.linalg.norm(noise + noise.T, 2)
        self._inverse = np.linalg.inv(values + noise)
        self.pivots = int((np.linalg.eigvalsh(values + noise) < 0).sum())
        return {"negative_pivots": self.pivots}

    def _solve(self, right, solution):
        solution.getDenseArray()[...] = self._inverse @ right.getDenseArray()
        solution.assemble()

    def release(self):
        self._inverse = None


@pytest.mark.skipif(is_complex(), reason="a complex build counts nothing")
def test_pivots_of_approximate_factors_count_modes_or_nothing(monkeypatch):
    """At 20 shifts and 4 accuracies: what is counted is right, also where the factor's own pivots are wrong."""
    monkeypatch.setitem(settings.PACKAGES, "rough", Rough)
    n, rng = 60, np.random.default_rng(3)
    values = np.sort(rng.uniform(1.0, 100.0, n)) ** 2
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    shifts = rng.uniform(1.0, 100.0, 20) ** 2
    counted, wrong = [], 0
    with hpcred.SecondOrderModel.from_scipy(Q * values @ Q.T, np.eye(n), inputs=np.ones((n, 1))) as model:
        for Rough.error in (1e-6, 1e-2, 0.1, 0.5):
            factoring = Factoring(solver=LinearSolver(package="rough"))
            solver = ShiftedSolver(model, inertia=True, factoring=factoring)
            known = 0
            for shift in shifts:
                solver.factor(-shift)
                true = int((values < shift).sum())
                assert solver.inertia in (None, true) and solver.records[-1].negative_pivots == solver.inertia
                known += solver.inertia is not None
                wrong += solver.factors.pivots != true
            counted.append(known)
            solver.close()
    assert wrong > 15 and counted[0] == 20 and counted[-1] < 10 and counted == sorted(counted, reverse=True)


@pytest.mark.parametrize(
    "low_rank, options, source",
    [
        (None, {}, EXACT), (1e-8, {}, FINE), (None, {"mat_mumps_icntl_35": 2, "mat_mumps_cntl_7": 5e-3}, ROUGH),
        (1e-8, {"mat_mumps_cntl_7": 5e-3}, ROUGH), (1e-8, {"mat_mumps_icntl_35": 0}, EXACT),
        (None, {"pc_precision": "single"}, Source(kind="approximate factor", accuracy=2.0**-23)),
    ],
)  # fmt: skip
def test_options_of_users_make_factors_approximate_too(low_rank, options, source):
    given = PETSc.Options("known_")
    for key, value in options.items():
        given[key] = value
    try:
        assert Mumps.source_of(Factoring(low_rank=low_rank), "known_") == source
    finally:
        for key in options:
            given.delValue(key)
