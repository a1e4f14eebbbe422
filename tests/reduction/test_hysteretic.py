"""A law in a module of its own goes everywhere: responses, tolerance, files, jobs, exports that hold it, refusals."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from viscoelastic_models import Sandwich, sandwich

import hpcred
from hpcred import InputError
from hpcred.files.model_file import read_model, write_model
from hpcred.files.result_file import read_result
from hpcred.model.laws.hysteretic import Hysteretic
from hpcred.settings.declared_terms import viscoelastic_of

BAND = (0.0, 600.0)
FRESH = np.sort(np.random.default_rng(5).uniform(1.0, 600.0, 40))
LAW = Hysteretic(frequencies=[0.0, 100.0, 300.0, 600.0], loss_factors=[0.02, 0.05, 0.2, 0.1])


class Plate(Sandwich):
    """The sandwich with a core of K_v (1 + i eta(f)), written out."""

    def stiffness(self, s):
        eta = np.interp(abs(s) / 2 / np.pi, LAW.frequencies, LAW.loss_factors) if s else 0.0
        return self.K + (1 + 1j * eta) * self.parts[0][0]


def plate(n=20, **more):
    return Plate(**vars(sandwich((LAW,), n, **more)))


def test_reductions_reach_the_tolerance_against_truth(comm):
    case = plate(inputs=2)
    H, drive = case.truth(FRESH)
    with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-4, band=BAND) as rom:
        assert model.frequency_response(FRESH) == pytest.approx(H, rel=1e-7, abs=1e-9 * np.abs(H).max())
        accuracy = rom.record.accuracy
        assert accuracy.reached and "measured with the hysteretic parts" in accuracy.measured
        assert accuracy.measure.eps(H - hpcred.frequency_response(rom, FRESH), H, drive).max() <= 1e-4
        assert hpcred.check_reduced(rom, model, 3, seed=1).passed and not rom.unstable_poles().size
        assert hpcred.inspect(model)["hysteretic"] == [f"Kv1: {LAW!r}"]


def test_poles_are_those_of_the_loss_factor_at_their_frequency(comm):
    case = plate()
    with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-4, band=BAND) as rom:
        poles = rom.poles()
        poles = poles[(poles.imag > 0) & (poles.imag < 2 * np.pi * 500.0)]
        assert len(poles) > 3
        for pole in poles:
            values = np.linalg.svd(rom.operator.at(pole), compute_uv=False)
            assert values[-1] < 1e-6 * values[0]


def test_files_jobs_and_arrays_hold_it(comm, tmp_path):
    with plate().model(comm) as model:
        write_model(tmp_path / "plate.h5", model)
        with read_model(tmp_path / "plate.h5", comm) as again:
            assert again.added.terms["Kv1"].law == LAW and again.digests == model.digests
        with hpcred.reduce(model, tolerance=1e-3, band=BAND) as rom:
            rom.save(tmp_path / "plate-reduced.h5")
            read = read_result(tmp_path / "plate-reduced.h5").reduced
            assert read.viscoelastic[0].law == LAW and read.record.viscoelastic[0].law == LAW
            assert read.transfer_function(2j * np.pi * 90.0) == pytest.approx(rom.transfer_function(2j * np.pi * 90.0))
    given = "{file = 'Kv.mtx', law = {kind = 'hysteretic', frequencies = [0, 9], loss_factors = [0.1, 0.2]}}"
    assert viscoelastic_of([given])[0].law == Hysteretic((0.0, 9.0), (0.1, 0.2))
    assert json.loads(json.dumps(read.record.viscoelastic[0].law.loss_factors)) == list(LAW.loss_factors)


def test_what_needs_states_refuses_it(comm):
    with plate().model(comm) as model, hpcred.reduce(model, tolerance=1e-3, band=BAND) as rom:
        with pytest.raises(InputError, match="hysteretic: the law of Kv1 is a table of loss factors, which no finite"):
            rom.to_state_space()
        with pytest.raises(InputError, match="is a table of loss factors, .* in a Campbell diagram"):
            hpcred.campbell(SimpleNamespace(at=lambda omega: rom), values=[0.0, 1.0])
        with pytest.raises(InputError, match="'two_sided' has no place for the hysteretic parts of sandwich"):
            hpcred.reduce(model.with_outputs([1]), hpcred.Krylov(frequency=10.0), projection="two_sided")


@pytest.mark.parametrize("frequencies, factors, message", [
    ((1.0, 2.0), (0.1,), "found 2 frequencies and 1 loss_factors"), ((2.0, 1.0), (0.1, 0.1), "frequencies that ascend"),
    ((0.0, 1.0), (0.1, -0.1), "law.loss_factors: found -0.1"), ((), (), "found 0 frequencies"),
])  # fmt: skip
def test_tables_that_are_none(frequencies, factors, message):
    with pytest.raises(InputError, match=message):
        Hysteretic(frequencies, factors)


def test_the_table_between_and_beyond_its_frequencies():
    f = np.array([0.0, 50.0, 200.0, 450.0, 900.0])
    expected = np.array([0.0, 0.035, 0.125, 0.15, 0.1])  # nothing at rest
    assert LAW.coefficient(2j * np.pi * f) == pytest.approx(1j * expected)
    assert LAW.coefficient(-2j * np.pi * f) == pytest.approx(-1j * expected)
    s, step = 2j * np.pi * f[1:], 1e-4j
    assert LAW.slope(s) == pytest.approx((LAW.coefficient(s + step) - LAW.coefficient(s - step)) / (2 * step), abs=1e-9)
    assert LAW.in_units(1e-3).coefficient(1e-3 * s) == pytest.approx(LAW.coefficient(s), rel=1e-12)


def test_terms_of_a_file_serve_another_model(comm, tmp_path):
    case = plate()
    with case.model(comm) as model:
        write_model(tmp_path / "plate.h5", model)
        with (
            read_model(tmp_path / "plate.h5", comm) as read,
            hpcred.SecondOrderModel.from_scipy(case.K, case.M, None, comm, inputs=case.B) as elastic,
            elastic.with_viscoelastic(read.viscoelastic) as again,
        ):
            assert again.frequency_response(FRESH[:3]) == pytest.approx(model.frequency_response(FRESH[:3]), rel=1e-9)
