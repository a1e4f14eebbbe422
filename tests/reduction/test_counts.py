"""What is counted of the modes of the band, up to where, and by what: against all modes of small models."""

import json

import numpy as np
import pytest
import scipy.linalg
from adaptive_models import chain, unit
from helpers import few_on_ranks

import hpcred
from hpcred import Adaptive, Factoring, PointStore, Rayleigh
from hpcred.linalg.known import EXACT, ModeCount, Source
from hpcred.linalg.solvers.auto import Auto
from hpcred.linalg.solvers.mumps import Mumps
from hpcred.parallel.petsc import is_complex
from hpcred.reduction.search import search
from hpcred.reduction.search.expansion import Expansion

SIZE = 30
ROUGH = Source(kind="approximate factor", accuracy=5e-3)
needs_counts = pytest.mark.skipif(is_complex(), reason="a complex build counts nothing")


def frequencies_of(K):
    return np.sqrt(np.linalg.eigvalsh(K)) / (2 * np.pi)


def beside(hidden):
    """A chain that a load moves, oscillators of these frequencies (Hz) that none does, and more above 30 Hz; B and all
    frequencies."""
    K, _ = chain(SIZE, k=4e4)
    others = np.concatenate([hidden, np.linspace(90.0, 400.0, 150)])
    both = scipy.linalg.block_diag(K, np.diag((2 * np.pi * others) ** 2))
    return both, unit(len(both), 3), np.sort(np.concatenate([frequencies_of(K), others]))


def reduced(comm, hidden, band, tolerance=1e-4, **more):
    """The accuracy of a reduction, and how many modes lie below a frequency."""
    K, B, f = beside(hidden)
    given = {key: more.pop(key, None) for key in ("store", "factoring", "groups")}
    adaptive = Adaptive(tolerance=tolerance, band=band, **more)
    with (
        hpcred.SecondOrderModel.from_scipy(K, np.eye(len(K)), inputs=B, comm=comm) as model,
        hpcred.reduce(model, damping=Rayleigh(2.0, 1e-5), adaptive=adaptive, **given) as rom,
    ):
        return rom.record, lambda limit: int((f < limit).sum())


@pytest.mark.mpi
@needs_counts
@pytest.mark.parametrize("hidden", few_on_ranks([5, 1, 70]))
def test_hidden_modes_are_found_whatever_their_number(comm, hidden):
    """The search ended at 60 columns, with dozens of modes missing, and nothing told of it."""
    record, below = reduced(comm, np.linspace(3.0, 29.0, hidden), (0.0, 30.0))
    accuracy = record.accuracy
    assert accuracy.reached and accuracy.missing_modes == 0
    assert accuracy.counted == ModeCount(modes=below(30.0), below=30.0) and accuracy.counted.source == EXACT
    assert accuracy.modes_in_words == f"{below(30.0)} modes below 30 Hz (exact factor), none missing"


@needs_counts
def test_modes_that_only_a_proof_without_a_factor_shows(comm, monkeypatch):
    """Beside a basis that lacks soft modes the matrix is indefinite, so that they are looked for by the factor of the
    point above."""
    seen = Expansion.missing_modes

    def late(self, among=None):
        return seen(self, among) if any(point.factor_of for point in self.points) else 0

    monkeypatch.setattr(Expansion, "missing_modes", late)
    monkeypatch.setattr(search, "doubtful_modes", lambda *_: None)
    accuracy = reduced(comm, [1.0, 2.0, 3.0], (0.0, 30.0))[0].accuracy
    assert any(point.factor_of for point in accuracy.points)
    assert accuracy.reached and accuracy.missing_modes == 0


@needs_counts
def test_modes_that_are_not_found_are_said_and_the_tolerance_is_not_reached(comm):
    record, below = reduced(comm, np.linspace(3.0, 29.0, 70), (0.0, 30.0), columns=90)
    accuracy = record.accuracy
    assert not accuracy.reached and 0 < accuracy.missing_modes < 70
    lack = f"{accuracy.missing_modes} modes of the band"
    assert accuracy.stopped == f"since {lack} are missing with 90 columns" and f"{lack} not found" in accuracy.unproven
    warning = record.warnings[0]
    assert "NOT REACHED: largest error about" in warning and " % or more (" in warning and lack in warning
    assert accuracy.modes_in_words.endswith(f"{accuracy.missing_modes} missing") and accuracy.counted.modes == below(30)


@needs_counts
@pytest.mark.parametrize("points", [(0.92,), (0.5, 0.97), (0.3,), ()])
def test_modes_are_counted_up_to_the_end_of_the_band(comm, points):
    """A point at 0.92 of the band counted as its end, so that a mode at 0.95 was never counted."""
    high = 30.0
    record, below = reduced(comm, [0.95 * high, 0.99 * high], (0.0, high), points=tuple(high * part for part in points))
    accuracy = record.accuracy
    assert accuracy.reached and accuracy.missing_modes == 0
    assert accuracy.counted == ModeCount(modes=below(high), below=high)


@needs_counts
@pytest.mark.parametrize("more", [0.0, 1e-12, 1e-9])
def test_a_band_that_ends_at_an_eigenfrequency_is_counted_beyond_it(comm, more):
    """The point moves out of the band, so that a mode just below its end is counted."""
    end = float(frequencies_of(chain(SIZE, k=4e4)[0])[7]) * (1 + more)
    record, below = reduced(comm, [0.9995 * end, 0.9999 * end], (0.0, end))
    counted = record.accuracy.counted
    assert record.accuracy.reached and record.accuracy.missing_modes == 0
    assert end < counted.below < 1.02 * end and counted.modes == below(counted.below)


@pytest.mark.mpi(ranks=(2,))
def test_groups_that_count_nothing_look_for_modes_where_they_had_a_factor(comm, monkeypatch):
    """The band ends at an eigenfrequency, off which the last point was moved."""
    monkeypatch.setattr(Mumps, "tells_inertia", False)
    looks = iter([True])
    monkeypatch.setattr(search, "doubtful_modes", lambda projections, band: (
        np.eye(projections.basis.size)[:, :1] if next(looks, False) else None))  # fmt: skip
    end = float(frequencies_of(chain(SIZE, k=4e4)[0])[7])
    accuracy = reduced(comm, [], (0.0, end), groups=comm.size)[0].accuracy
    assert accuracy.reached and not next(looks, False)


@needs_counts
def test_of_a_band_above_zero_only_its_own_modes_are_looked_for(comm):
    """Dozens below it need not be in the basis."""
    record, below = reduced(comm, [*np.linspace(3.0, 19.0, 80), 24.0, 27.0], (20.0, 30.0), columns=80)
    accuracy = record.accuracy
    assert accuracy.reached and accuracy.missing_modes == 0 and accuracy.uncompressed_size < below(30.0)
    lowest = min(accuracy.points, key=lambda point: point.frequency)
    assert lowest.frequency <= 20.0 and lowest.modes_below == below(lowest.frequency)


def test_without_a_count_none_is_claimed(comm, monkeypatch):
    monkeypatch.setattr(Mumps, "tells_inertia", False)
    accuracy = reduced(comm, [], (0.0, 30.0))[0].accuracy
    assert accuracy.reached and len(accuracy.proofs) > 1
    assert accuracy.missing_modes is None and accuracy.counted is None
    assert accuracy.modes_in_words == "modes not counted"
    assert "a second verification replaces the count" in accuracy.measured


def has_source(patch, source):
    for package in (Mumps, Auto):
        patch.setattr(package, "source_of", lambda *_: source)


class TestStores:
    """A count from an approximate factor was kept, and served runs with full ones."""

    @staticmethod
    def accuracy(comm, folder):
        return reduced(comm, [9.5], (0.0, 10.0), tolerance=1e-2, store=PointStore(folder, comm))[0].accuracy

    @needs_counts
    @pytest.mark.parametrize("source", [None, ROUGH])
    def test_a_weaker_count_serves_no_full_factor(self, comm, tmp_path, monkeypatch, source):
        expected = self.accuracy(comm, tmp_path / "none")
        with monkeypatch.context() as patch:
            if source is None:  # of an earlier version
                patch.setattr("hpcred.reduction.search.point_solver.asdict", lambda _: None)
            else:
                has_source(patch, source)
            patch.setattr("hpcred.linalg.solvers.base.Factorisation.inertia", property(lambda _: 2))
            patch.setattr("hpcred.linalg.solvers.base.refinement_converges", lambda *_: True)
            assert self.accuracy(comm, tmp_path / "store").counted.modes == 2
            if source:
                assert self.accuracy(comm, tmp_path / "store").points[0].from_store
        found = self.accuracy(comm, tmp_path / "store")
        assert found.counted == expected.counted and not found.points[0].from_store
        assert self.accuracy(comm, tmp_path / "store").points[0].from_store
        with monkeypatch.context() as patch:  # a stronger count serves a weaker claim
            has_source(patch, ROUGH)
            again = self.accuracy(comm, tmp_path / "store")
        assert again.points[0].from_store and again.counted == expected.counted

    @needs_counts
    def test_modes_that_nothing_counted_serve_no_sliced_band(self, comm, tmp_path, monkeypatch):
        """Modes of a band by a Krylov sequence and those by slicing had one key."""
        K, B, f = beside([5.0, 5.0])
        basis, store, served = [hpcred.Modes(band=(0.0, 30.0))], PointStore(tmp_path / "store"), []
        with hpcred.SecondOrderModel.from_scipy(K, np.eye(len(K)), inputs=B, comm=comm) as model:
            for slicing in (False, False, True, True, False):
                with monkeypatch.context() as patch:
                    if not slicing:
                        patch.setattr(Mumps, "slicing", lambda *_: None)
                    with hpcred.reduce(model, basis, store=store) as rom:
                        served.append(rom.record.components[0].from_store)
                assert np.allclose(rom.frequencies, f[f < 30], rtol=1e-7)
        assert served == [False, True, False, True, True]


@needs_counts
def test_factors_that_are_too_rough_to_count_need_a_second_proof(comm, monkeypatch):
    has_source(monkeypatch, ROUGH)
    monkeypatch.setattr("hpcred.linalg.solvers.base.refinement_converges", lambda *_: False)
    accuracy = reduced(comm, [], (0.0, 30.0))[0].accuracy
    assert accuracy.reached and len(accuracy.proofs) > 1 and accuracy.counted is None
    assert "a second verification replaces the count" in accuracy.measured
    with hpcred.solid((3, 2, 2), inputs=1, comm=comm) as model:
        report = hpcred.inspect(model, [1e4], band_top=1e4, factoring=Factoring())
    assert report["elastic_modes_below_hz"] == [[1e4, None], [2e4, None]] and "size_hint" not in report
    assert any(text.startswith("modes are not counted: factors are too rough") for text in report["warnings"])


def test_low_rank_factors_count_right_or_not_at_all(hpcred, tmp_path):
    """In a program of its own, since MUMPS must be without Scotch there."""
    script = """
import json, numpy as np, hpcred
from hpcred.linalg.solvers.shifted import ShiftedSolver
model, found = hpcred.solid((12, 6, 6), size=(1.0, 0.3, 0.3)), []
for low_rank in (None, 1e-6, 9e-3):
    solver = ShiftedSolver(model, inertia=True, factoring=hpcred.Factoring(low_rank=low_rank))
    found.append([solver.factor(-(2 * np.pi * f) ** 2) or solver.inertia for f in (3000.0, 6000.0, 9000.0)])
print(json.dumps(found))
"""
    run = hpcred(program=("-c", script), HPCRED_SCOTCH="0", HPCRED_SCALAR="real")
    if "with Scotch crashes there" in run.stderr:
        pytest.skip("the MUMPS of this PETSc cannot do it")
    assert run.returncode == 0, run.stderr
    full, fine, *others = json.loads(run.stdout)
    assert None not in full and fine == full
    assert all(count in (None, true) for counts in others for count, true in zip(counts, full, strict=True))


def test_results_keep_counts(tmp_path):
    with hpcred.solid((4, 2, 2), inputs=1) as model, hpcred.reduce(model, tolerance=1e-3, band=(0.0, 20000.0)) as rom:
        accuracy = rom.record.accuracy
        hpcred.write_result(tmp_path / "result.h5", rom)
    found = hpcred.read_result(tmp_path / "result.h5").reduced.record.accuracy
    assert found.counted == accuracy.counted and (accuracy.counted is None) == is_complex()
    assert [point.source for point in found.points] == [point.source for point in accuracy.points]


def test_counts_of_a_model_with_parameters_are_those_at_the_visited_values(comm):
    K, B, _ = beside([12.0])
    soft = np.zeros_like(K)
    soft[SIZE, SIZE] = K[SIZE, SIZE]
    with (
        hpcred.SecondOrderModel.from_scipy(K - soft, np.eye(len(K)), inputs=B, comm=comm) as constant,
        hpcred.ParametricModel(
            constant, [hpcred.Parameter("k", (0.5, 2.0), 1.0)], [hpcred.Term("K", soft, "k")]
        ) as model,
        hpcred.reduce(model, tolerance=1e-3, band=(0.0, 30.0), damping=Rayleigh(2.0, 1e-5),
                      parameter_search=hpcred.ParameterSearch(points=5)) as rom,
    ):
        accuracy = rom.record.accuracy
        elsewhere = rom.at(k=0.7).record.accuracy
    assert accuracy.reached and elsewhere.reached and elsewhere.counted is None and elsewhere.missing_modes is None
    if is_complex():
        assert accuracy.counted is None
        return
    true = int((frequencies_of(K) < accuracy.counted.below).sum())
    assert accuracy.counted.below >= 30.0 and accuracy.counted.modes == true and accuracy.missing_modes == 0
    assert accuracy.modes_in_words.endswith(f", none missing at any of {len(accuracy.parameters.points)} values")
