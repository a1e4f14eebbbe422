"""What a search over parameters makes of points, numbers and small matrices, beside what follows by hand."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from hpcred import InputError, Parameter
from hpcred.reduction.parametric import compression, greedy, reduced, singular, zeros
from hpcred.reduction.parametric.affine import AffineForm, AffineProjections
from hpcred.reduction.parametric.training import (
    digits_for,
    distances,
    fresh_points,
    halfway,
    low_discrepancy,
    place_of,
    point_at,
    points_around,
    training_points,
)
from hpcred.reduction.result.measure import STATIC
from hpcred.reduction.search.silent_outputs import QUIET, UNIT
from hpcred.reduction.small.error_estimate import UNIFORM
from hpcred.reduction.small.pseudo_modal import InputsOutputs, Proportional, PseudoModal


def line(low, high):
    return [Parameter("p", (low, high))]


@pytest.mark.parametrize(
    "ends, middle",
    [((0.5, 10.0), 5.0**0.5), ((0.1, 2.5), 0.5), ((2.0, 30.0), 16.0), ((-1.0, 30.0), 14.5), ((0.0, 30.0), 15.0)],
)
def test_places_are_logarithms_where_ends_are_20_times_apart(ends, middle):
    """Half of the way, there and back; one that is a third of the way from an end is at two thirds from the other."""
    assert point_at(line(*ends), [0.5])[0] == pytest.approx(middle, rel=1e-5)
    assert place_of(line(*ends), (middle,)) == pytest.approx([0.5], rel=1e-9)
    assert halfway(line(*ends), (middle,), ends[1:])[0] == point_at(line(*ends), [0.75])[0]
    assert distances(line(*ends), [ends[:1], (middle,)], [(middle,), ends[1:], ends[1:]]) == pytest.approx([0.5, 0.0])


def test_digits_of_values():
    """Six, more where points are close, twelve at most; ends are exact."""
    assert point_at(line(0.0, 1.0), [1 / 3]) == (0.333333,) and point_at(line(0.0, 1 / 3), [1.0]) == (1 / 3,)
    assert [digits_for(step) for step in (0.1, 1e-3, 1e-5, 1e-30)] == [6, 6, 8, 12]
    assert points_around(line(0.0, 3.0), (1.0,), 1e-7) == [(1.0000003,), (0.9999997,)]


def test_numbers_of_training_points():
    """33 for one parameter, a grid of 9 x 9 for two, at least their ends; fresh points follow those before."""
    one, two = line(0.0, 1.0), [Parameter(name, (0.0, 1.0)) for name in "ab"]
    assert len(training_points(one)) == 33 and len(set(training_points(two))) == 81
    assert set(training_points(two, 9)) == {(a, b) for a in (0.0, 0.5, 1.0) for b in (0.0, 0.5, 1.0)}
    assert training_points(one, 2) == [(0.0,), (1.0,)] and len(training_points(two, 2)) == 4
    assert fresh_points(two, 3, 2) == [point_at(two, place) for place in low_discrepancy(2, 5)[3:]]


def test_which_points_miss_a_goal():
    """Those 2 % above it that no compression has begun with, the worst first."""
    points = [(0.0,), (1.0,), (2.0,), (3.0,), (4.0,)]
    errors = np.array([1.01, 1.03, 7.0, 2.0, 9.0])
    assert compression._over(errors, 1.0, points, [(4.0,)]) == [2, 3, 1]


def test_starts_of_a_search_for_larger_errors():
    """No more than eight, two first steps apart; half of the largest error counts."""
    points = [(float(k),) for k in range(12)]
    errors = np.linspace(1.0, 0.5, 12)
    assert compression._worst_apart(line(0.0, 4.0), points, errors) == points[: compression.STARTS]
    assert compression._worst_apart(line(0.0, 1.0), [(0.0,), (0.2,), (0.399,), (1.0,)], errors[[0, 1, 2, 11]]) == [
        (0.0,), (0.2,), (1.0,)]  # fmt: skip


def test_a_peak_close_to_another_point_is_climbed_in_smaller_steps(monkeypatch):
    """Its nearest neighbour is a hundredth away: the steps are of half of that as well, and of the first step."""
    form = SimpleNamespace(parametric=SimpleNamespace(parameters=line(0.0, 1.0)))
    inside = SimpleNamespace(args=[SimpleNamespace(form=form)])
    seen = []

    def errors(_, points, band):
        seen.append([point[0] for point in points])
        return np.zeros(len(points)), np.ones(len(points))

    monkeypatch.setattr(compression, "_errors", errors)
    more, found, where = compression._look_around(inside, [(0.5,), (0.504,)], np.array([1.0, 0.1]), (0.0, 1.0))
    expected = [[0.5 + sign * step / 2**k for step in (0.1, 0.002) for sign in (1, -1)] for k in range(4)]
    assert np.allclose(seen, expected, rtol=1e-6) and len(more) == len(found) == len(where) == 16
    # half of the distance to this one is no less than the last of the first steps
    seen.clear()
    compression._look_around(inside, [(0.5,), (0.52,)], np.array([1.0, 0.1]), (0.0, 1.0))
    assert np.allclose(seen, [line[:2] for line in expected], rtol=1e-6)


def test_the_largest_errors_are_looked_at_closely(monkeypatch):
    """Those within CLOSE of the largest, LOOKED_AT of them, get what finer frequencies show."""
    count = compression.LOOKED_AT
    close = np.linspace(compression.CLOSE, 1.0, count + 2)[np.random.default_rng(4).permutation(count + 2)]
    small = np.array([0.9 * compression.CLOSE, 1e-3])

    def pair_at(_, point):  # whose error is largest at the frequency of its number
        return SimpleNamespace(outer=point, inner=None, noise=lambda S: np.array([1e-3 * point, 0.0]))

    def largest_error(pair, look, _):
        S, curve = look(pair)
        return curve.max(), S[curve.argmax()]

    monkeypatch.setattr(compression, "grid", lambda models, *_: models[0])
    monkeypatch.setattr(compression, "largest_error", largest_error)
    monkeypatch.setattr(compression, "largest", lambda pair, point, least, rounds: (
        np.array([point, 0.0]), np.array([10.0 + point, least])))  # fmt: skip
    form = SimpleNamespace(parametric=SimpleNamespace(comm=MPI.COMM_SELF))
    inside = partial(pair_at, SimpleNamespace(form=form))
    for errors, most in ((np.append(close, small), count), (np.array([0.9, 1e-3, 1.0, 0.4]), 2)):
        before, worst, points = errors.copy(), np.zeros(len(errors)), list(range(1, len(errors) + 1))
        noise = compression._look_closely(inside, points, None, errors, worst)
        looked = np.sort(np.argsort(-before, kind="stable")[:most])
        np.testing.assert_allclose(errors[looked], 11.0 + looked)
        np.testing.assert_allclose(worst[looked], 1.0 + looked)
        left = np.delete(np.arange(len(errors)), looked)
        assert (errors[left] == before[left]).all() and not worst[left].any()
        assert noise == pytest.approx(1e-3 * (1 + looked.max()))


def test_independent_columns_span_what_the_first_of_them_span():
    """One that differs from those before by less than a thousandth is left out, whatever its size."""
    e = np.eye(4)
    columns = np.column_stack([5 * e[0], e[0] + 0.9e-3 * e[1], 1e-9 * (e[0] + 2e-3 * e[2]), e[0] + e[3]])
    found = greedy._independent(columns)
    assert np.abs(np.abs(found) - e[:, [0, 2, 3]]).max() < 1e-12


def test_what_is_known_of_quiet_columns_at_several_points():
    """Silent is what is so at all points; the largest limit counts, and the round-off of the quietest that is not."""
    known = AffineProjections.__new__(AffineProjections)
    known.silent, known.quiet, known.round_off, known._limits, known._made = None, False, 0.0, {}, {(1.0,): {}}
    known.note_quiet({0: (1e-12, 1e-10), 1: (1e-12, 2e-10)})
    assert not known._made  # models with other limits
    known._made[1.0,] = {}
    assert known.silent == {0, 1} and not known.quiet and known.round_off == 0.0
    assert known.limits == {0: QUIET, 1: QUIET}
    known.note_quiet({0: (3e-11, 3e-11), 1: (1e-8, 1e-10)})
    known.note_quiet({0: (0.0, 1e-11), 1: (1e-6, 1e-10)})
    assert known.silent == {0} and known.quiet and known.round_off == UNIT / 1e-8
    assert known.limits == {0: QUIET, 1: 2e-10} and not known._made
    known._made[1.0,] = {}
    known.note_quiet({0: (0.0, 1e-11), 1: (1e-6, 1e-10)})
    assert known._made


def test_pseudo_modes_are_those_of_the_symmetric_part():
    rng = np.random.default_rng(3)
    K, U = rng.normal(size=(5, 5)) + 9 * np.eye(5), np.linalg.qr(rng.normal(size=(4, 3)))[0]
    projections = SimpleNamespace(at=lambda _: SimpleNamespace(K=K))
    X = greedy.Greedy._pseudo_modes(SimpleNamespace(projections=projections, reference=None), U)
    small = X.T @ (K + K.T)[:4, :4] @ X
    assert np.allclose(small, np.diag(np.diag(small))) and np.allclose(X.T @ X, np.eye(3))


def test_modes_have_unit_masses_and_their_largest_entry_is_positive():
    rng = np.random.default_rng(5)
    M, K = (part @ part.T + np.eye(6) for part in rng.normal(size=(2, 6, 6)))
    for mass in (M, np.diag([1.0, 2.0, 3.0, 0.0, 0.0, 4.0])):
        modes = reduced._modes({"M": mass, "K": K}, {}, SimpleNamespace(M=mass, K=K))
        X = modes.X
        assert np.allclose(X.T @ K @ X, np.diag(modes.stiffnesses))
        assert np.allclose(X.T @ mass @ X, np.diag(modes.masses))
        assert (X[np.abs(X).argmax(axis=0), np.arange(6)] > 0).all()


def test_mass_by_its_pivots():
    M = np.diag([1.0, 4.0, 1e-12])
    assert np.allclose(singular.factor_of_mass(M, {}), np.sqrt(M))
    assert np.allclose(singular.factor_of_mass(1e-40 * np.eye(2), {}), 1e-20 * np.eye(2))
    tiny = np.diag([1.0, 1e-14])
    assert np.allclose(singular.factor_of_mass(tiny, {}, np.diag(tiny)), np.sqrt(tiny))  # in units of its own
    for M in (tiny, -np.eye(2), np.ones((2, 2))):
        with pytest.raises(InputError, match="at p = 2: the reduced mass matrix is not positive definite"):
            singular.factor_of_mass(M, {"p": 2.0})
    unsymmetric = np.array([[2.0, 1.0], [0.0, 2.0]])
    L = singular.factor_of_mass(unsymmetric, {})
    assert np.allclose(L @ L.T, (unsymmetric + unsymmetric.T) / 2)


def resisting(K, B, C=None, symmetric=True):
    """Models at a point whose basis is the unit one."""
    C = B if C is None else C
    return SimpleNamespace(K=K, L=np.eye(len(K)), io=SimpleNamespace(inputs=B, outputs=C), symmetric=symmetric,
                           size_of_k=np.linalg.norm(K))  # fmt: skip


def test_motions_without_stiffness():
    e = np.eye(3)
    assert [singular._yielding(resisting(np.diag(d), e)) for d in ([1.0, 2, 3], [1, 0, -1], [1, 1e-15, 2])] == [0, 2, 1]
    stiff = [np.diag([1e9, 1.0, least]) for least in (5e-6, 1e-3)]  # round-off is relative to the sizes of all parts
    assert [singular._yielding(resisting(K, e)) for K in stiff] == [1, 0]
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # without an eigenvalue below zero
    assert singular._yielding(resisting(turned, e, symmetric=False)) == 0
    assert singular._yielding(resisting(np.diag([1.0, 1.0, -1.0]) @ turned, e, symmetric=False)) == 1
    assert singular._yielding(resisting(np.diag([1.0, 1e-15, 1.0]), e, symmetric=False)) == 1


def test_responses_are_infinite_where_inputs_push_and_outputs_see_the_motion():
    """Of an unsymmetric K the motion and the forces that it resists differ: K = |a><b|, which sees b and feels a."""
    e = np.eye(2)
    K = np.outer(e[0], e[1])  # moves along e0 without force, and has no force along e1
    pushed, seen, other = e[:, 1:], e[:, :1], np.zeros((2, 1))
    for inputs, outputs, infinite in ((pushed, seen, True), (seen, seen, False), (pushed, pushed, False),
                                      (other, seen, False), (1e-9 * pushed + seen, seen, False),
                                      (1e-7 * pushed + seen, seen, True), (1e-12 * pushed, 1e12 * seen, True)):
        assert singular._is_infinite(resisting(K, inputs, outputs)) == infinite


def test_where_stiffness_is_lost_between_points():
    """Springs 0.3 - p and 1.7 - p: both are named, the first where nothing pushes the other."""

    def projections(B):
        return SimpleNamespace(
            at=lambda point: resisting(np.diag([0.3 - point[0], 1.7 - point[0], 1.0]), B),
            form=SimpleNamespace(parametric=SimpleNamespace(comm=MPI.COMM_SELF, parameters=line(0.0, 2.0), name="two"),
                                 values=lambda point: {"p": point[0]}),
        )  # fmt: skip

    points = training_points(line(0.0, 2.0), 5)
    for column, at in ((0, "0.3"), (1, "1.7")):
        with pytest.raises(InputError, match=f"two: K is singular, but for round-off, near p = {at},"):
            singular.check_static(projections(np.eye(3)[:, [column]]), points, (0.0, 1.0))
    singular.check_static(projections(np.eye(3)[:, [2]]), points, (0.0, 1.0))
    singular.check_static(projections(np.eye(3)), points, (0.1, 1.0))


def test_the_way_to_a_zero_of_responses():
    """Of (p - 1/3) v over frequencies with other v: where it is, how fast responses change, and points beside it."""
    projections = SimpleNamespace(form=SimpleNamespace(parametric=SimpleNamespace(parameters=line(0.0, 2.0))))
    v = np.array([[1.0 + 1.0j, 0.0], [3.0, 4.0j], [0.0, 9.0]])
    way = zeros._Way(projections, (0.0,), (2.0,), lambda point: (point[0] - 1 / 3) * v)
    assert way.zero == pytest.approx(1 / 6, abs=1e-7) and way.change == pytest.approx(2 * 5)
    assert way.slope == pytest.approx(10, rel=1e-6)
    beside = np.sort([point[0] for point in way.points(np.array([0.0, 0.01, 0.5, 0.9]))])
    assert beside == pytest.approx([1 / 3 - 0.02, 1 / 3, 1 / 3, 1 / 3 + 0.02, 4 / 3], abs=1e-5)
    close = [abs(point[0] - 1 / 3) for point in way.points(np.array([1e-8, 0.5])) if point[0] < 1]
    assert close == pytest.approx([2e-8, 2e-8], rel=0.3)
    still = np.vstack([v, np.zeros((1, 2))])  # a frequency at which nothing responds
    way = zeros._Way(projections, (0.0,), (2.0,), lambda point: (point[0] - 1 / 3) * still)
    assert way.zero == pytest.approx(1 / 6)
    back = zeros._Way(projections, (2.0,), (0.5,), lambda point: (1 / 3 - point[0]) * v)
    assert back.zero is None and [back.at(t) for t in (0.0, 0.5, 1.0)] == [(2.0,), (1.25,), (0.5,)]
    for low, high in ((1.0, 2.0), (0.0, 0.2)):
        assert zeros._Way(projections, (low,), (high,), lambda point: (point[0] - 1 / 3) * v).zero is None


def test_points_on_both_sides_of_a_zero_are_the_nearest():
    """At most frequencies the values point the other way; zeros are on neither side."""
    places = np.array([[0.0], [0.4], [0.5], [0.9], [1.0]])
    v = np.array([[1.0, 2.0], [3.0j, 0.0], [5.0, 1.0]])
    values = np.array([s * v for s in (1.0, 2.0, -1.0, -0.5, 0.0)])
    values[1, 0] *= -1  # one of three frequencies says otherwise
    assert zeros._opposite(places, values) == zeros._opposite(places, 1e-6 * values) == [(1, 2)]
    assert zeros._opposite(places[:2], np.array([[[1.0, 0.0]], [[0.6, 0.8]]])) == []
    assert zeros._median(np.array([[1.0, -3.0], [2.0j, 0.0], [0.0, 7.0]])) == 3.0
    few = zeros._few(np.ones((2, zeros.FEW))), zeros._few(np.vstack([np.ones(9), 2 * np.ones(9)]))
    assert few[0].shape == few[1].shape == (2, 8) and (few[0] == 1).all() and np.array_equal(2 * few[1][0], few[1][1])


BAND = (0.0, 60.0)


def two_modes(outputs, loads=1.0):
    """A damped model of modes at 16 and 48 Hz, of two inputs and some outputs (r, 2) on its modes; `loads`: units of
    what its loads are made of."""
    units = np.array([1.0, loads, 1.0])
    L = np.array([[1.0, 0.5, 0.2], [1.0, -0.3, 0.7]])
    back = np.linalg.lstsq(L, np.asarray(outputs, dtype=float).T, rcond=None)[0]
    io = InputsOutputs(np.eye(3)[:, :2] / units[:, None], back / units[:, None])
    return PseudoModal(np.array([1e4, 9e4]), L * units, np.eye(2), io, Proportional(2.0, 1e-4))


def by_hand(outputs, f):
    """Responses of the model (S, r, 2), and those where its inputs act (S, 2)."""
    s, squares, B = 2j * np.pi * np.asarray(f)[:, None], np.array([1e4, 9e4]), np.array([[1.0, 0.5], [1.0, -0.3]])
    states = B / (squares + s**2 + s * (2.0 + 1e-4 * squares))[:, :, None]
    return np.einsum("rm,smp->srp", np.asarray(outputs, dtype=float), states), np.einsum("mp,smp->sp", B, states)


def test_responses_over_those_where_inputs_act():
    """Of each output over the roots of the drive-point responses, then these; an input that is nothing counts as 0."""
    outputs, f = [[1.0, 2.0], [0.0, -1.0], [3.0, 0.0]], np.array([0.0, 7.0, 31.0])
    H, drive = by_hand(outputs, f)
    found = zeros._responses(two_modes(outputs), f)
    expected = [*(H / np.sqrt(np.abs(drive))[:, None]).transpose(1, 0, 2), drive[:, :1], drive[:, 1:]]
    assert [item.shape for item in found] == [(3, 2)] * 3 + [(3, 1)] * 2
    assert all(np.allclose(one, other, rtol=1e-9, atol=0) for one, other in zip(found, expected, strict=True))
    model = two_modes(outputs)
    half = replace(model, io=model.io._replace(inputs=model.io.inputs * [1.0, 0.0]))
    assert np.array_equal(zeros._responses(half, f)[0][:, 1], [0.0] * 3) and zeros._responses(half, f)[0][:, 0].all()
    same = replace(model, io=InputsOutputs(model.io.inputs, model.io.inputs))
    assert [item.shape for item in zeros._responses(same, f)] == [(3, 1)] * 2


def test_responses_over_a_band():
    """Those of outputs as above; of inputs those at all loads, over the sizes of these, which have no unit then."""
    outputs, f = [[1.0, 2.0]], np.linspace(*BAND, zeros.COARSE)
    at = [SimpleNamespace(at=lambda _, loads=loads: SimpleNamespace(model=lambda: two_modes(outputs, loads)))
          for loads in (1.0, 1e6)]  # fmt: skip
    (output, *inputs), other = (zeros._over_band(projections, BAND, (0.0,)) for projections in at)
    H, drive = by_hand(outputs, f)
    assert np.allclose(output, H[:, 0] / np.sqrt(np.abs(drive)), rtol=1e-9)
    L = np.array([[1.0, 0.5, 0.2], [1.0, -0.3, 0.7]])
    size = np.sqrt((L**2 / (np.array([1e4, 9e4]) + (2 * np.pi * BAND[1]) ** 2)[:, None]).sum(axis=0))
    moved = by_hand(L.T, f)[0] / size[:, None]
    assert all(np.allclose(inputs[i], moved[:, :, i], rtol=1e-9) for i in range(2))
    assert all(np.allclose(one, two, rtol=1e-9) for one, two in zip((output, *inputs), other, strict=True))


def test_poles_and_negative_eigenvalues_in_a_band():
    """Infinite responses count as 0, and an unstable mode by the size of its eigenvalue."""
    f, model = np.linspace(*BAND, zeros.COARSE), two_modes([[1.0, 2.0]])
    for first in ((2 * np.pi * f[20]) ** 2, -1e6):
        other = replace(model, eigenvalues=np.array([first, 9e4]), damping=Proportional())
        projections = SimpleNamespace(at=lambda _, other=other: SimpleNamespace(model=lambda: other))
        with np.errstate(divide="ignore", invalid="ignore"):
            found = zeros._over_band(projections, BAND, (0.0,))
        assert all(np.isfinite(each).all() and each.any() for each in found)
        if first > 0:
            assert not any(each[20].any() for each in found)
            with np.errstate(divide="ignore", invalid="ignore"):
                assert not any(each.any() for each in zeros._responses(other, f[[20]]))


def family(outputs):
    """Models over p from 0 to 1 of outputs (r, 2) that depend on it."""
    parametric = SimpleNamespace(parameters=line(0.0, 1.0), comm=MPI.COMM_SELF)
    return SimpleNamespace(form=SimpleNamespace(parametric=parametric), at=lambda point: SimpleNamespace(
        model=lambda: two_modes(outputs(point[0]))))  # fmt: skip


def test_points_beside_a_zero_of_a_static_response():
    """Where it is so much of the median over the band, on both sides; none without a zero, or a response."""
    still = np.array([[1e4, -9e4]])  # whose static response to (1, 1) is zero
    along = np.array([[1.0, 0.0]])
    model = family(lambda p: 2e4 * (p**2 - 0.16) * along + still)

    def response(p, f):
        H, drive = by_hand(2e4 * (p**2 - 0.16) * along + still, f)
        return np.abs(H[:, 0, :1] / np.sqrt(np.abs(drive[:, :1])))

    one = SimpleNamespace(form=model.form, at=lambda point: SimpleNamespace(model=lambda: one_input(model, point)))
    found = zeros._beside(one, BAND, (0.0,), (1.0,), 0)
    median = np.median(response(0.4, np.linspace(*BAND, UNIFORM)))
    shares = [response(p, [0.0])[0, 0] / (STATIC * median) for (p,) in found]
    assert np.sort(shares) == pytest.approx(np.repeat(np.sort(zeros.BESIDE), 2), rel=3e-2)
    assert sum(p < 0.4 for (p,) in found) == 3
    assert zeros._beside(one, BAND, (0.5,), (1.0,), 0) == []
    small = family(lambda p: 1e-6 * (2e4 * (p**2 - 0.16) * along + still))
    few = SimpleNamespace(form=model.form, at=lambda point: SimpleNamespace(model=lambda: one_input(small, point)))
    assert np.array(zeros._beside(few, BAND, (0.0,), (1.0,), 0)) == pytest.approx(np.array(found), abs=1e-9)
    ways = zeros.beside_zeros(one, [(0.0,), (1.0,)], BAND)
    assert set(found) <= set(ways) and not set(found) & set(zeros.beside_zeros(one, [(0.0,), (1.0,)], (5.0, 60.0)))


def one_input(model, point):
    full = model.at(point).model()
    return replace(full, io=full.io._replace(inputs=full.io.inputs[:, :1]))


def test_points_around_a_zero_of_most_responses():
    """Half widths of the range in which the rest is more than what depends on p; none where points see the range."""
    points = {}
    large = family(lambda p: 1e6 * (p - 0.4) * np.array([[1.0, 0.5]]))
    assert zeros._around(large, BAND, (0.5,), (1.0,), 0) == []
    for rest in (0.01, 2.0):
        model = family(lambda p, rest=rest: (p - 0.4) * np.array([[1.0, 0.5]]) + rest * np.array([[0.3, -1.0]]))
        one = SimpleNamespace(form=model.form, at=lambda point, model=model: SimpleNamespace(
            model=lambda: one_input(model, point)))  # fmt: skip
        points[rest] = zeros._around(one, BAND, (0.0,), (1.0,), 0)
    f = np.linspace(*BAND, zeros.COARSE)
    (H, drive), (change, _) = by_hand([[0.003, -0.01]], f), by_hand([[1.0, 0.5]], f)
    size = np.sqrt(np.abs(drive[:, 0]))
    along = (change[:, 0, 0].conj() * H[:, 0, 0]).real / np.abs(change[:, 0, 0]) ** 2
    zero = 0.4 - np.median(along)  # where the part along what depends on p is zero
    at_zero = (zero - 0.4) * change + H
    width = np.median(np.abs(at_zero[:, 0, 0]) / size) / np.median(np.abs(change[:, 0, 0]) / size)
    expected = np.unique(np.concatenate([zero - width * np.array(zeros.AROUND), zero + width * np.array(zeros.AROUND)]))
    assert np.unique([p for (p,) in points[0.01]]) == pytest.approx(expected, abs=1e-5)
    assert points[2.0] == [] and min(abs(p - zero) for (p,) in points[0.01]) < 1e-5


def test_points_at_which_poles_cross_the_ends_of_the_band():
    """The first mode, at 100 sqrt(1 + 3 p) rad/s, crosses one at p = 0.3: a point at which it is still inside."""
    mode = SimpleNamespace(form=family(None).form, at=lambda point: SimpleNamespace(model=lambda: replace(
        two_modes([[1.0, 0.0]]), eigenvalues=np.array([1e4 * (1 + 3 * point[0]), 9e4]), damping=Proportional())))
    end, points = 100 * 1.9**0.5 / (2 * np.pi), [(0.0,), (1.0,)]
    ((below,),) = compression.at_ends_of_band(mode, points, (0.0, end))
    ((above,),) = compression.at_ends_of_band(mode, points, (end, 100.0))
    assert below <= 0.3 <= above and (below, above) == pytest.approx((0.3, 0.3), abs=5e-3)
    assert compression.at_ends_of_band(mode, points, (0.0, 100.0)) == []


@pytest.mark.parametrize("band, undamped", [((0.0, 20.0), True), ((15.0, 16.0), True), ((20.0, 40.0), False),
                                            ((60.0, 99.0), False), ((0.0, 12.0), False)])  # fmt: skip
def test_modes_without_damping_in_the_band_get_a_loss_factor(band, undamped):
    """Those at 16 and 48 Hz, or a tenth beside the band; twice the damping ratio that is asked for."""
    given, model = [], replace(two_modes([[1.0, 0.0]]), damping=Proportional())
    search = SimpleNamespace(
        comm=MPI.COMM_SELF, points=[(0.0,), (1.0,)], goal=SimpleNamespace(band=band, zeta0=0.01),
        projections=SimpleNamespace(damping=Proportional(), at=lambda _: SimpleNamespace(model=lambda: model)),
        first=SimpleNamespace(projections=SimpleNamespace(is_damped=True, add_loss_factor=given.append)),
    )  # fmt: skip
    greedy.Greedy._look_at_damping(search)
    assert given == [0.02] * undamped and search.projections.damping.eta == 0.02 * undamped


def test_factors_of_loads_and_outputs_at_a_point():
    """B_0 + p B_1 and C_0 + p^2 C_1 by their independent columns."""
    form = AffineForm.__new__(AffineForm)
    form.parametric = SimpleNamespace(
        model=SimpleNamespace(rates=None),
        parameters=line(-2.0, 2.0),
        factors=lambda values: [values["p"], values["p"] ** 2],
    )
    B, C = np.array([[1.0], [0.0]]), np.array([[0.0], [4.0]])
    form.inputs, form.outputs = [(0, B), (1, C)], [(0, -C), (2, C)]
    io = form.io(form.theta((-2.0,)))
    assert np.array_equal(io.inputs, B - 2 * C) and np.array_equal(io.outputs, 3 * C)
    assert form.has_responses((2.0,)) and not form.has_responses((1.0,))
    form.outputs = None
    assert np.array_equal(form.io(form.theta((1.5,))).outputs, B + 1.5 * C) and form.has_responses((1.0,))
