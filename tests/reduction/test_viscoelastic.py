"""Reductions of models with viscoelastic parts against dense truth: components, tolerance, states, poles, refusals."""

import numpy as np
import pytest
import scipy.linalg
from helpers import close
from scipy.optimize import linear_sum_assignment
from viscoelastic_models import MAXWELL, SPRINGPOT, ZENER, sandwich

import hpcred
from hpcred import InputError, Krylov, Modes, SecondOrderKrylov, Viscoelastic
from hpcred.laws import Maxwell
from hpcred.model.operator import Operator
from hpcred.reduction.result.maxwell_states import maxwell_states
from hpcred.reduction.result.oscillating_poles import oscillating_poles
from hpcred.reduction.small.error_estimate import upper_poles
from hpcred.reduction.small.pseudo_modal import diagonalised, difference

BAND = (0.0, 600.0)
FRESH = np.sort(np.random.default_rng(8).uniform(*BAND, 60))


def errors(case, rom, eta=0.0):
    """eps of a reduced model by its measure, and the estimate of its record, at fresh frequencies."""
    accuracy = rom.record.accuracy
    H, drive = case.truth(FRESH, eta)
    true = accuracy.measure.eps(H - hpcred.frequency_response(rom, FRESH), H, drive)
    estimated = np.exp(np.interp(FRESH, accuracy.frequencies, np.log(np.maximum(accuracy.eps, 1e-300))))
    return true, estimated


@pytest.mark.mpi
def test_any_number_of_ranks(comm):
    case = sandwich((ZENER, MAXWELL), n=12, inputs=2, damped=True)
    with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-3, band=BAND, groups="auto") as rom:
        true, estimated = errors(case, rom)
        assert true.max() <= 1e-3 and np.median(estimated / true) < 2
        assert hpcred.check_reduced(rom, model, 3, seed=1).passed


@pytest.mark.parametrize("laws, more", [
    ((ZENER,), {}), ((MAXWELL, ZENER), {"inputs": 2}), ((SPRINGPOT, MAXWELL, ZENER), {"outputs": 2, "damped": True}),
])  # fmt: skip
def test_tolerance_against_truth(comm, laws, more):
    case = sandwich(laws, n=16, **more)
    with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-4, band=BAND) as rom:
        accuracy = rom.record.accuracy
        assert accuracy.reached and "viscoelastic parts of the model" in accuracy.measured
        true, estimated = errors(case, rom)
        assert true.max() <= 1e-4
        assert ((true <= 2 * estimated) & (estimated <= 2 * true)).mean() > 0.9
        assert rom.size < len(case.K) and not rom.unstable_poles().size
        assert [item.law for item in rom.record.viscoelastic] == list(laws)
        check = hpcred.check_reduced(rom, model, 6, seed=1)
        assert check.passed and max(check.measured) > 0


@pytest.mark.mpi
@pytest.mark.costly
def test_full_response_to_a_tolerance(comm):
    case = sandwich((ZENER, MAXWELL), n=24)
    with case.model(comm) as model:
        found = hpcred.full_response(model, FRESH, tolerance=1e-8, band=BAND, check=3, seed=2)
        assert found.reached
        assert close(case.truth(FRESH)[0], found.response) < 1e-8


@pytest.mark.mpi
def test_components(comm):
    """Exact with a complete basis; second-order Krylov blocks match H and its derivative at their point."""
    case = sandwich((MAXWELL, ZENER), n=12)
    s, f = 2j * np.pi * 150.0, 150.0
    with case.model(comm) as model:
        with hpcred.reduce(model, Modes(count=12)) as rom:
            assert close(case.truth(FRESH)[0], rom.frequency_response(FRESH)) < 1e-10
            assert close(rom.transfer_function(s), case.truth([f])[0][0]) < 1e-10
        with hpcred.reduce(model, SecondOrderKrylov(frequency=f, order=1)) as rom:
            assert rom.size == 4

            def slope(transfer):
                step = 1e-4 * s
                return (transfer(s + step) - transfer(s - step)) / (2 * step)

            def full(at):
                return case.B.T @ np.linalg.solve(case.dynamic(at), case.B)

            assert close(full(s), rom.transfer_function(s)) < 1e-8
            assert close(slope(full), slope(rom.transfer_function)) < 1e-6
        with hpcred.reduce(model, Krylov(frequency=f, order=8)) as rom:
            assert rom.size == 9 and close(full(s), rom.transfer_function(s)) < 0.05


def test_damping_beside_it(comm):
    """A loss factor belongs to the static stiffness; modal ratios count besides."""
    case = sandwich(n=20)
    with case.model(comm) as model:
        with hpcred.reduce(model, tolerance=1e-4, band=BAND, damping=hpcred.Structural(0.05)) as rom:
            assert errors(case, rom, eta=0.05)[0].max() <= 1e-4
            assert rom.record.accuracy.measured.endswith("of the model and the loss factor 0.05")
        with hpcred.reduce(model, tolerance=1e-4, band=BAND, damping=hpcred.ModalDamping(ratio=0.02)) as rom:
            assert np.diag(rom.D).min() > 0 and hpcred.check_reduced(rom, model, 4, seed=1).passed


def test_modes_without_damping_are_measured_with_a_loss_factor(comm):
    """Viscoelastic parts of one chain leave those of the other undamped."""
    case = sandwich((ZENER, ZENER), n=20)
    half = len(case.K) // 2
    for matrix, _ in case.parts:
        matrix[:half] = matrix[:, :half] = 0.0
    case.parts = case.parts[1:]
    case.parts[0][0][half - 1, half - 1] = 0.0
    case.K[half, half] += 1e6
    with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-4, band=BAND) as rom:
        accuracy = rom.record.accuracy
        assert accuracy.loss_factor == 0.002
        assert "viscoelastic parts leave modes of the band without damping" in accuracy.measured
        assert hpcred.check_reduced(rom, model, 4, seed=1).passed


def modal(case):
    """Eigenvalues of the static stiffness, D and parts in modal coordinates."""
    values, X = scipy.linalg.eigh(case.stiffness(0.0), case.M)
    D = np.zeros_like(X) if case.D is None else X.T @ case.D @ X
    added = [Viscoelastic(X.T @ Kv @ X, law, "rubber") for Kv, law in case.parts]
    return values, X, D, Operator.of(added=added)


@pytest.mark.parametrize("damped", [False, True])
def test_poles_are_those_of_maxwell_states(damped):
    case = sandwich((MAXWELL,), damped=damped)
    values, X, D, parts = modal(case)
    states = maxwell_states(parts)
    exact = np.linalg.eigvals(states.state_matrix(np.eye(len(values)), D, np.diag(values)))
    exact = exact[exact.imag > 1e-3]
    found = oscillating_poles(values, D, parts)
    found = found[np.abs(found.real) < 0.3 * np.abs(found)]
    assert len(found) > 25
    assert (np.abs(found[:, None] - exact).min(axis=1) <= 1e-8 * np.abs(found)).mean() > 0.9
    sharp = exact[np.abs(exact.real) < 0.05 * np.abs(exact)]
    assert (np.abs(sharp[:, None] - found).min(axis=1) <= 1e-6 * np.abs(sharp)).all()


def test_poles_of_a_fractional_law_are_zeros_of_a():
    case = sandwich((ZENER, SPRINGPOT))
    values, _, D, parts = modal(case)
    found = oscillating_poles(values, D, parts)
    left = []
    for pole in found:
        A = case.dynamic(pole)
        left.append(np.linalg.svd(A)[1][-1] / np.linalg.norm(A))
    assert len(found) > 30 and max(left) <= 1e-12


@pytest.mark.parametrize(
    "static, matrix, factor, time",
    [((0.0, 100.0), (10.0, 0.0), 1.0, 100.0), ((1.0, 3.0), (1.0, 1.0), 400.0, 100.0),
     ((0.0, 0.0), (4.0, 50.0), 1.0, 1.0)],
)  # fmt: skip
def test_poles_outside_of_the_static_frequencies(static, matrix, factor, time):
    """Of masses that a Maxwell element alone holds, and of stiffening beyond the highest static one (Hz)."""
    values, Kv = ((2 * np.pi * np.array(item)) ** 2 for item in (static, matrix))
    law = hpcred.laws.Maxwell(factors=(factor,), times=(time,))
    exact = np.concatenate([np.roots([time, 1.0, time * (value + factor * k), value])
                            for value, k in zip(values, Kv, strict=True)])  # fmt: skip
    exact = exact[exact.imag > 1e-3 * np.abs(exact)]
    found = oscillating_poles(values, np.zeros((2, 2)), Operator.of(added=[Viscoelastic(np.diag(Kv), law)]))
    assert found == pytest.approx(exact[np.argsort(exact.imag)], rel=1e-7)


def test_a_springpot_alone_has_poles():
    added = Operator.of(added=[Viscoelastic(np.diag([1e8, 0.0]), ZENER)])
    found = oscillating_poles(np.zeros(2), np.zeros((2, 2)), added)
    assert len(found) == 1 and abs(found[0] ** 2 + 1e8 * ZENER.excess(found[0])) < 1e-9 * abs(found[0]) ** 2


def coupled(seed):
    """Eigenvalues, D and Maxwell parts of random models whose parts couple all modes, some nearly equal."""
    r = np.random.default_rng(seed)
    m = int(r.integers(2, 25))
    values = np.sort((2 * np.pi * 10 ** r.uniform(0.5, 3.5, m)) ** 2)
    if r.random() < 0.3:
        values[1::2] = values[: m // 2 * 2 : 2] * (1 + 10 ** r.uniform(-8, -1))
    parts, values = [], np.sort(values)
    for _ in range(int(r.integers(1, 4))):
        rank, k = int(r.integers(1, m + 1)), int(r.integers(1, 4))
        X = np.sqrt(values)[:, None] * np.linalg.qr(r.standard_normal((m, rank)))[0]
        law = Maxwell(10 ** r.uniform(-2, 0.7, k), 10 ** r.uniform(-5, 0, k))
        parts.append(Viscoelastic(10 ** r.uniform(-3, 1) * X @ X.T, law))
    Y = r.standard_normal((m, int(r.integers(1, m + 1))))
    return values, 10 ** r.uniform(-3, 0) * np.sqrt(np.median(values)) / m * Y @ Y.T * (r.random() < 0.5), parts


def test_no_pole_takes_the_place_of_another():
    """Of all that is found every one is a pole, and nothing is missing but of what is damped by more than 5 %."""
    missing = count = 0
    for seed in range(120):
        values, D, parts = coupled(seed)
        added = Operator.of(added=parts)
        exact = np.linalg.eigvals(maxwell_states(added).state_matrix(np.eye(len(values)), D, np.diag(values)))
        exact = exact[exact.imag > 1e-4 * np.abs(exact)]
        found = oscillating_poles(values, D, added)
        assert (np.abs(found[:, None] - exact).min(axis=1) <= 1e-6 * np.abs(found)).all()
        ratio = -exact.real / np.abs(exact)
        rows, columns = linear_sum_assignment(np.minimum(np.abs(exact[:, None] - found) / np.abs(exact)[:, None], 1e-3))
        lost = np.ones(len(exact), dtype=bool)
        lost[rows] = np.abs(exact[rows] - found[columns]) > 1e-6 * np.abs(exact[rows])
        assert not lost[ratio < 0.05].any()
        missing, count = missing + int(lost[ratio < 0.3].sum()), count + int((ratio < 0.3).sum())
    assert count > 1000 and missing <= 0.005 * count


def test_a_multiple_pole_is_found_as_often_as_it_is_there():
    values, law = np.full(3, 4e4), Maxwell([0.5], [1e-3])
    found = oscillating_poles(values, np.zeros((3, 3)), Operator.of(added=[Viscoelastic(2e4 * np.eye(3), law)]))
    roots = np.roots([1e-3, 1.0, 1e-3 * (4e4 + 1e4), 4e4])
    assert found == pytest.approx(np.full(3, roots[roots.imag.argmax()]), rel=1e-9)


@pytest.mark.parametrize("eta", [0.0, 0.1, 0.5])
def test_poles_beside_a_loss_factor_are_roots_of_cubics(eta):
    """(s^2 + d s + (1 + i eta) lambda)(1 + s t) + k g s t = 0 of each mode of diagonal matrices with a Maxwell element.
    """
    values, d, k = np.array([1e4, 9e4, 4e5, 2e6]), np.array([3.0, 0.0, 8.0, 20.0]), np.array([2e3, 1e4, 6e4, 1e5])
    g, t = 0.7, 2e-3
    exact = []
    for value, damping, stiffness in zip((1 + 1j * eta) * values, d, k, strict=True):
        roots = np.roots([t, 1 + damping * t, damping + (value + stiffness * g) * t, value])
        exact.append(roots[roots.imag.argmax()])
    added = Operator.of(added=[Viscoelastic(np.diag(k), Maxwell([g], [t]), "rubber")])
    found = oscillating_poles(values, np.diag(d), added, eta)
    assert found == pytest.approx(np.array(exact), rel=1e-10)


def test_no_poles_without_stiffness():
    added = Operator.of(added=[Viscoelastic(np.zeros((2, 2)), ZENER)])
    assert not len(oscillating_poles(np.zeros(2), np.zeros((2, 2)), added))


@pytest.mark.parametrize("outputs", [0, 2])
def test_differences_of_nested_models_are_exact(outputs):
    """H_Q - H_V without cancellation, with viscoelastic parts, against plain subtraction of the dense."""
    case = sandwich((ZENER, MAXWELL), n=20, outputs=outputs)
    values, X, _, parts = modal(case)
    L = X.T @ (case.B if not outputs else np.hstack([case.B, case.Ct]))
    outer = diagonalised(np.diag(values), L, added=parts)
    inner, embedding = outer.restricted(np.eye(20)[:, :8])
    f = np.array([10.0, 200.0, 900.0])
    plain = outer.response(f) - inner.response(f)
    assert close(plain, difference(inner, outer, embedding, f)) < 1e-9
    assert close(inner.response(f), inner.quick_response(f)) < 1e-11
    assert upper_poles(outer).imag.min() > 0


@pytest.mark.mpi
@pytest.mark.costly
def test_interface_coordinates_and_the_basis_turn_k_v(comm):
    """K_v = K in a part of the body: its projection is that of K, in either coordinates."""
    interface = hpcred.Interface(name="end", nodes=hpcred.Nodes(box=((0.035, -1, -1), (1, 1, 1))))
    with (
        hpcred.solid((2, 1, 2), size=(0.04, 0.02, 0.03), inputs=3, comm=comm) as solid,
        solid.with_viscoelastic([Viscoelastic(solid.K.copy(), MAXWELL)]) as model,
        model.with_interfaces([interface]) as body,
    ):
        for coordinates in ("modal", "interface"):
            with hpcred.reduce(body, tolerance=1e-3, band=(0.0, 20000.0), coordinates=coordinates) as rom:
                assert close(rom.K, (1 + MAXWELL.static) * rom.viscoelastic[0].matrix) < 1e-9
                full = body.frequency_response([900.0, 15000.0])
                assert hpcred.relative_error(full, rom.frequency_response([900.0, 15000.0])).max() < 2e-3


def test_what_has_no_place_for_it_is_refused(comm):
    case = sandwich(outputs=2)
    with case.model(comm) as model:
        with pytest.raises(InputError, match="'two_sided' has no place for the viscoelastic parts of sandwich"):
            hpcred.reduce(model, Krylov(frequency=10.0), projection="two_sided")
        with pytest.raises(InputError, match="sandwich: it has viscoelastic parts, and poles that are not"):
            hpcred.damped_modes(model, 2)
        with pytest.raises(InputError, match="irka: sandwich has viscoelastic parts"):
            hpcred.IRKA(size=4, band=(1.0, 100.0), damping=hpcred.Rayleigh(1.0)).reduce(model)
        with pytest.raises(InputError, match="beside which a Caughey series"):
            hpcred.reduce(model, Modes(count=3), damping=hpcred.Caughey([1.0, 1e-6, 1e-12]))
    case.D = np.triu(np.ones_like(case.K)) - np.tril(np.ones_like(case.K))
    with case.model(comm) as model, pytest.raises(InputError, match="the law of Kv1 is fractional, and M, D and K are"):
        hpcred.reduce(model, Modes(count=3))


def test_gyroscopic_forces_with_maxwell_elements(comm):
    case = sandwich((MAXWELL,), n=20)
    half = len(case.K) // 2
    G = np.zeros_like(case.K)
    G[np.arange(half), half + np.arange(half)] = 20.0
    case.D = G - G.T
    with case.model(comm) as model, hpcred.reduce(model, tolerance=1e-4, band=BAND) as rom:
        assert errors(case, rom)[0].max() <= 1e-4 and not rom.unstable_poles().size


def test_states_of_laws_that_have_none(comm):
    parts = [Viscoelastic(np.eye(2), ZENER, "core")]
    with pytest.raises(InputError, match="the law of core is fractional, which no finite number .* in an FMU"):
        maxwell_states(parts, "an FMU")
    none = maxwell_states([Viscoelastic(np.diag([1.0, 0.0]), Maxwell([1.0, 0.0], [1.0, 2.0]), "core")])
    assert none.L.tolist() == [[1.0], [0.0]] and none.times.tolist() == [1.0]
