"""What the measure of errors promises: no units, each direction by itself, a bound at zeros; and one of one's own."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pytest
from adaptive_models import Case, chain, fresh, reduced_response, tied_chains, unit, up_to
from helpers import few_on_ranks
from pydantic import TypeAdapter

import hpcred
from hpcred.analysis.error import errors_of
from hpcred.analysis.frequency_response import response_and_drive
from hpcred.reduction.result.accuracy import Accuracy, in_percent
from hpcred.reduction.result.directions import directions_table
from hpcred.reduction.result.measure import (
    FEELS_NOTHING,
    NO_INPUT,
    PAPER,
    Directions,
    UnknownMeasure,
    directions,
    drive_points,
)
from hpcred.reduction.result.reduced_model import as_measured

pytestmark = pytest.mark.mpi

BAND = (0.0, 2000.0)
EYES = ("BIG_EYE", "SMALL_EYE")


@pytest.fixture
def rod(comm):
    """A free rod with all directions of two bearings: in bending a thousand times softer than along its axis, and in
    rad / (N m) softer than in m / N."""
    bearings = [hpcred.Interface(name=name, nodes=hpcred.Nodes(set=name)) for name in EYES]
    with (
        hpcred.crank(dofs=600, comm=comm) as free,
        free.with_interfaces(bearings) as jointed,
        jointed.with_inputs([(name, "all") for name in EYES]) as loaded,
    ):
        yield loaded


@pytest.fixture
def random():
    return np.random.default_rng(7)


def responses(random, outputs=None):
    """Frequencies (F,), H (F, r, p) and the drive points (F, p) of a random symmetric body, and a wrong H."""
    f, eigenvalues, B = np.linspace(0.0, 3.0, 61), np.array([1.0, 5.0, 9.0, 40.0]), random.standard_normal((4, 3))
    C = B if outputs is None else random.standard_normal((4, outputs))
    states = B / (eigenvalues * (1 + 0.01j) - f[:, None] ** 2)[:, :, None]
    H = C.T @ states
    return f, H, np.einsum("mp,fmp->fp", B, states), H * (1 + 0.1 * random.standard_normal(H.shape)), drive_points(B, C)


@pytest.mark.parametrize("outputs", [None, 1, 5])
def test_units_of_inputs_and_outputs_change_no_error(random, outputs):
    f, H, drive, wrong, of = responses(random, outputs)
    known = directions(f, H, drive, of).eps(H - wrong, H, drive)
    b = 10.0 ** random.integers(-9, 9, H.shape[2])
    c = b if outputs is None else 10.0 ** random.integers(-9, 9, H.shape[1])
    scaled = [item * c[:, None] * b for item in (H, wrong)]
    found = directions(f, scaled[0], drive * b**2, of).eps(scaled[0] - scaled[1], scaled[0], drive * b**2)
    assert np.allclose(known, found, rtol=1e-12)


def test_each_drive_point_and_the_largest_response_of_each_other_output_counts_by_itself(random):
    f, H, drive, _, of = responses(random)
    measure = directions(f, H, drive, of)
    size = np.abs(np.einsum("fii->fi", H))
    floor = np.minimum(np.median(size, axis=0), size[0])
    assert np.allclose(measure.inputs, floor)
    wrong = H * 0.97
    each = measure.each(H - wrong, H, drive)
    own = np.einsum("fii->fi", each)
    assert np.allclose(own[size >= floor], 0.03)
    assert np.allclose(own, 0.03 * size / np.maximum(size, floor))  # bounded at zeros
    f, H, drive, _, of = responses(random, 5)
    measure = directions(f, H, drive, of)
    assert measure.drive == (NO_INPUT,) * 5
    most = measure.each(0.03 * H, H, drive).max(axis=2)
    assert (most <= 0.03 * (1 + 1e-12)).all() and (np.isclose(most, 0.03).mean(axis=0) > 0.4).all()


def test_an_error_where_nothing_moves_is_infinite_and_none_is_zero(random):
    f, H, drive, _, _ = responses(random)
    H[:, 1], H[:, :, 1], drive[:, 1] = 0.0, 0.0, 0.0
    measure = directions(f, H, drive, (np.arange(3), np.ones(3)))
    nothing = np.zeros_like(H)
    assert measure.eps(nothing, H, drive).max() == 0
    E = nothing.copy()
    E[3, 1, 1] = 1e-20
    assert np.flatnonzero(np.isinf(measure.eps(E, H, drive))).tolist() == [3]
    zero, one = np.zeros((1, 1, 1)), np.ones((1, 1, 1))
    assert PAPER.eps(zero, zero, None) == 0 and PAPER.eps(one, zero, None) == np.inf
    assert PAPER.eps(one, 2 * one, None) == pytest.approx(0.5)


@pytest.mark.parametrize(("error", "tolerance", "said"), [
    (0.00123, 1e-2, "0.12 %"), (5.28e-7, 1e-4, "0.000053 %"), (3e-11, 1e-4, "3.0e-09 %"), (3.2e-8, 1e-7, "3.2e-08"),
    (1.004e-4, 1e-4, "0.01004 %"), (0.0, 1e-4, "0 %"), (np.inf, 1e-4, "not known"),
])  # fmt: skip
def test_errors_are_in_percent_but_far_below_one(error, tolerance, said):
    assert in_percent(error, tolerance) == said


def test_an_output_without_drive_point_has_the_largest_response_to_inputs_of_one_size():
    """A force of 1 N, and one of 100 N that moves twice as much."""
    by = Directions(inputs=(1.0, 1e4), outputs=(1.0,), drive=(NO_INPUT,))
    first = np.array([[1e-3, 2e-3]]), np.array([[1.0, 2.0]])
    (found,) = directions_table(by, [5.0], np.array([[4e-3]]), np.array([[1]]), first, ["u"], ["one", "hundred"])
    assert (found.input, found.static, found.static_error, found.worst_input) == ("one", 1.0, 1e-3, "hundred")


def test_an_output_that_feels_nothing_is_left_out(random):
    f, H, drive, wrong, of = responses(random, 2)
    H[:, 1] *= 1e-17
    measure = directions(f, H, drive, of, silent=[1])
    assert measure.silent == (1,) and measure.drive[1] == FEELS_NOTHING
    assert measure.each(H - wrong, H, drive)[:, 1].max() == 0


def test_drive_points_are_parallel_loads(random):
    B = random.standard_normal((6, 3)) * [1e-8, 1.0, 1e8]
    C = np.stack([B[:, 2] * -1e-3, B[:, 0], B[:, 0] + 1e-8 * B[:, 1], np.zeros(6)], axis=1)
    which, ratio = drive_points(B, C)
    assert which.tolist() == [2, 0, NO_INPUT, NO_INPUT]
    assert np.allclose(ratio[:2], [1e-3, 1.0])
    assert drive_points(B, B)[0].tolist() == [0, 1, 2]


@pytest.mark.costly
def test_the_tolerance_holds_for_every_direction_and_the_paper_says_what_it_hides(rod):
    """In the norm of the paper 1e-2 leaves nothing right along the axis, which is a warning."""
    sizes = []
    for measure in ("paper", "directions"):
        with hpcred.reduce(rod, frame=hpcred.Buckens(), tolerance=1e-2, band=BAND, measure=measure) as rom:
            accuracy, warnings = rom.record.accuracy, rom.record.warnings
            check = hpcred.check_reduced(rom, rod, 6, seed=5)
            sizes.append(rom.size)
            H = hpcred.frequency_response(rod, [0.0], hpcred.Buckens())[0]
            static = np.abs(1 - np.diag(hpcred.frequency_response(rom, [0.0])[0]) / np.diag(H))
        assert accuracy.reached and accuracy.measure.kind == measure and check.passed
        assert np.allclose(check.estimated, check.measured, rtol=0.1, atol=1e-6)
        known = {item.output: item for item in accuracy.directions}
        errors = [known[name].static_error for name in rod.input_names]
        assert np.allclose(errors, static, rtol=0.01, atol=1e-6)
        assert [item.largest for item in accuracy.directions] == sorted(item.largest for item in known.values())[::-1]
        told = [item for item in warnings if item.startswith("measure: eps is that of the paper (55)")]
        if measure == "paper":
            assert static.max() > 0.5 and len(told) == 1
            beyond = accuracy.beyond
            assert f"{len(beyond)} of 12 outputs are off by more than 0.01: {beyond[0].output}" in told[0]
        else:
            assert static.max() < 1e-2 and not told and not accuracy.beyond
    assert sizes[0] < sizes[1]


@pytest.mark.parametrize("units", few_on_ranks(["of inputs", "mm-t-s"]))
@pytest.mark.costly
def test_other_units_give_the_same_body(rod, comm, units):
    random, found = np.random.default_rng(4), []
    for factor in (np.ones(12), 10.0 ** random.integers(-6, 7, 12) if units == "of inputs" else None):
        if factor is None:  # forces and lengths: K in N/mm, M in t, moments in N mm
            turns = np.array([name.rpartition(":")[2].startswith("r") for name in rod.input_names])
            B = rod.B.getDenseArray().real * np.where(turns, 1e3, 1.0)
            with rod.with_input_columns(B, rod.input_names) as model:
                model.K.scale(1e-3)
                model.M.scale(1e-3)
                with hpcred.reduce(model, frame=hpcred.Buckens(), tolerance=1e-3, band=BAND) as rom:
                    found.append((rom.frequencies, rom.record.accuracy))
                model.K.scale(1e3)
                model.M.scale(1e3)
            continue
        B = rod.B.getDenseArray().real * factor
        with (
            rod.with_input_columns(B, rod.input_names) as other,
            hpcred.reduce(other, frame=hpcred.Buckens(), tolerance=1e-3, band=BAND) as rom,
        ):
            found.append((rom.frequencies, rom.record.accuracy))
    (frequencies, accuracy), (others, other) = found
    assert np.allclose(frequencies, others, rtol=1e-6)
    assert other.largest == pytest.approx(accuracy.largest, rel=1e-5)
    assert [item.output for item in other.directions[:3]] == [item.output for item in accuracy.directions[:3]]


@pytest.mark.costly
def test_static_deflections_are_exact_where_that_is_asked_for(rod):
    H = hpcred.frequency_response(rod, [0.0], hpcred.Buckens())[0]
    for static, least, most in (("tolerance", 1e-6, 1e-2), ("exact", 0.0, 1e-10)):
        with hpcred.reduce(rod, frame=hpcred.Buckens(), tolerance=1e-2, band=BAND, static=static) as rom:
            error = np.abs(1 - np.diag(hpcred.frequency_response(rom, [0.0])[0]) / np.diag(H)).max()
            assert rom.record.accuracy.reached and least <= error < most
    with pytest.raises(hpcred.InputError, match="^adaptive.size: found 5, expected at least 12, by which"):
        asked = hpcred.Adaptive(tolerance=1e-2, band=BAND, static="exact", size=5)
        hpcred.reduce(rod, frame=hpcred.Buckens(), adaptive=asked)


@dataclass(frozen=True, kw_only=True)
class OfThePeak(hpcred.reduction.Measure):
    """Errors relative to the largest response of the band."""

    kind: Literal["of the peak"] = "of the peak"
    peak: float = 0.0

    def over(self, frequencies, H, drive, drive_of, silent=()):
        return OfThePeak(peak=float(np.abs(H).max()))

    def scales(self, H, drive):
        return np.full(H.shape[:2], self.peak), np.ones(H.shape[::2])


@pytest.mark.mpi
@pytest.mark.costly
def test_a_measure_of_ones_own_is_one_argument(rod, comm, tmp_path):
    """It is reduced to, checked, written, read, evaluated and reported; where its class is not known, kept."""
    folder = comm.bcast(tmp_path)
    path = folder / "result.h5"
    with hpcred.reduce(rod, frame=hpcred.Buckens(), tolerance=1e-3, band=BAND, measure=OfThePeak()) as rom:
        accuracy, check = rom.record.accuracy, hpcred.check_reduced(rom, rod, 6, seed=5)
        rom.save(path)
        hpcred.write_model(folder / "rod.h5", rod)
        damping = hpcred.Structural(accuracy.loss_factor)
        f = np.linspace(*BAND, 200)[1:]
        H = hpcred.frequency_response(rod, f, hpcred.Buckens(), damping)
        error = np.abs(H - hpcred.frequency_response(as_measured(rom, accuracy), f)).max() / accuracy.measure.peak
        with hpcred.reduce(rod, frame=hpcred.Buckens(), tolerance=1e-3, band=BAND) as other:
            assert rom.size < other.size
    assert accuracy.reached and check.passed and 1e-6 < error < 1e-3 and accuracy.measure.peak > np.abs(H).max() / 2
    found = hpcred.read_result(path, comm).reduced.record.accuracy
    assert found.measure == accuracy.measure and hpcred.relative_error(H, H, found.measure).max() == 0
    evaluated = hpcred.evaluate(path, folder / "rod.h5", points=11, comm=comm)
    assert evaluated["measure"] == "of the peak" and evaluated["eps_max"] < 1e-2
    table = TypeAdapter(Accuracy).dump_python(found) | {"measure": {"kind": "elsewhere", "peak": 2.0}}
    unknown = TypeAdapter(Accuracy).validate_python(table)
    assert unknown.measure == UnknownMeasure("elsewhere", {"peak": 2.0}) and "largest error" in unknown.sentence
    assert TypeAdapter(Accuracy).dump_python(unknown)["measure"] == table["measure"]
    with pytest.raises(hpcred.InputError, match="measure: found the kind 'elsewhere', whose class is not known here"):
        hpcred.relative_error(H, H, unknown.measure)


@pytest.mark.mpi
@pytest.mark.costly
def test_a_gyroscopic_response_has_an_error_that_is_no_round_off(comm):
    """H is not symmetric there, though outputs are inputs: their difference passed for round-off."""
    K, M = chain(24)
    skew = np.triu(np.random.default_rng(1).uniform(-100.0, 100.0, K.shape), 1)
    case = Case("gyroscopic", K, M, unit(24, 3, 11, 18), up_to(K, M, 4), D=skew - skew.T + 1e-5 * K,
                damping=hpcred.GivenDamping())  # fmt: skip
    with case.model(comm) as model, hpcred.reduce(model, damping=case.damping, tolerance=1e-4, band=case.band) as rom:
        accuracy = rom.record.accuracy
        frequencies = fresh(case, rom)
        found = reduced_response(rom, case.damping_model(), frequencies, given=True)
    assert accuracy.reached and accuracy.noise < 1e-7
    H, drive = case.truth_and_drive(frequencies)
    assert accuracy.measure.eps(H - found, H, drive).max() < 1e-4


def test_a_full_response_is_measured_by_directions(rod):
    damping, frequencies = hpcred.Structural(0.01), [20.0, 777.0]
    adaptive = hpcred.Adaptive(tolerance=1e-4, band=BAND)
    found = hpcred.full_response(rod, frequencies, hpcred.Buckens(), damping, adaptive=adaptive, check=2)
    exact = hpcred.frequency_response(rod, frequencies, hpcred.Buckens(), damping)
    assert found.accuracy.measure.kind == "directions" and found.check.passed
    drive = np.einsum("fii->fi", exact)
    assert hpcred.relative_error(exact, found.response, found.accuracy.measure, drive=drive).max() < 1e-4


def test_an_input_that_moves_nothing_is_no_obstacle(comm):
    """Its column is zero; round-off over nothing had been an infinite error."""
    B = np.hstack([unit(20, 3), np.zeros((20, 1)), unit(20, 11)])
    case = Case("idle", *chain(20), B, up_to(*chain(20), 5))
    with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-4, band=case.band) as rom:
        accuracy = rom.record.accuracy
    assert accuracy.reached and accuracy.largest > 1e-6


@pytest.mark.costly
def test_inputs_in_unusual_units_have_the_same_error(comm):
    """Their model is reduced with other factors, in which the measure is kept."""
    K, M = chain(20)
    for Ct in (None, unit(20, 7, 3)):
        found = []
        for factor in (1.0, 2.0**200):
            case = Case("far", K, M, unit(20, 3, 11) * factor, up_to(K, M, 5), Ct=None if Ct is None else Ct / factor)
            with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-3, band=case.band) as rom:
                check = hpcred.check_reduced(rom, model, 2, seed=1)
            assert check.passed and np.allclose(check.estimated, check.measured, rtol=0.2, atol=1e-8)
            found.append((rom.size, rom.record.accuracy))
        (size, one), (other, far) = found
        assert size == other and far.largest == pytest.approx(one.largest, rel=1e-6)
        scale = factor**2 if Ct is None else 1.0
        known = {item.output: item.static * scale for item in one.directions}
        assert {item.output: item.static for item in far.directions} == pytest.approx(known)


def test_results_beside_each_other_leave_out_what_feels_nothing(comm):
    """Of two chains without a tie: an output on the other one had an infinite error where floors were made anew."""
    K, M = tied_chains(0.0)
    case = Case("apart", K, M, unit(80, 5), (0.0, 8.0), Ct=unit(80, 30, 47))
    with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-4, band=case.band) as rom:
        f = np.linspace(*case.band, 21)
        measured = as_measured(rom, rom.record.accuracy)
        damping = hpcred.Structural(rom.record.accuracy.loss_factor)
        full, drive = response_and_drive(model, f, None, damping)
        found = hpcred.frequency_response(measured, f)
        for anew in (False, True):
            errors = errors_of(measured, f, full, found, drive, anew=anew)
            assert errors.eps.max() < 1e-3 and errors.measure.silent == (1,)
            assert [item.largest < 1e-3 for item in errors.directions if item.output == rom.output_names[0]] == [True]
        with pytest.raises(hpcred.InputError, match="^measure: found 'papr', expected 'directions' or 'paper'"):
            errors_of(measured, f, full, found, drive, "papr")


@pytest.mark.costly
def test_sizes_hold_with_exact_statics_and_nothing_of_them_is_dropped(rod):
    given = {"tolerance": 1e-6, "band": BAND, "static": "exact"}
    asked = hpcred.Adaptive(**given, size=16)
    with hpcred.reduce(rod, frame=hpcred.Buckens(), adaptive=asked) as rom:
        assert rom.size == 16 and rom.record.accuracy.stopped == "with 16 coordinates"
    with pytest.raises(hpcred.InputError, match="^drop_above: found it beside static = 'exact'"):
        hpcred.reduce(rod, frame=hpcred.Buckens(), drop_above=1e4, **given)


def test_loads_of_all_sizes_are_no_drive_points_of_their_sum(comm):
    """An output of the places of two inputs is none of them, however large the second one is."""
    C, B = unit(20, 5) + unit(20, 17), unit(20, 5, 17)
    found = []
    for factor in (1.0, 1e10):
        case = Case("sum", *chain(20), B * [1.0, factor], up_to(*chain(20), 5), Ct=C)
        with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-4, band=case.band) as rom:
            found.append((rom.size, rom.record.accuracy))
    assert all(accuracy.measure.drive == (NO_INPUT,) for _, accuracy in found)
    assert found[0][0] == found[1][0] and found[0][1].largest == pytest.approx(found[1][1].largest, rel=1e-6)
