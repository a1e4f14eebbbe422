"""Random and harmonic loads and shocks of small models against closed forms, Lyapunov equations and dense sums."""

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import hpcred
from hpcred import ReducedModel
from hpcred.analysis import half_sine, harmonic_response, random_response, shock_spectrum, time_response


def oscillator(f=20.0, ratio=0.05, mass=2.0):
    """A mass on a base, whose input is the acceleration of the base: relative displacement, absolute acceleration."""
    w = 2 * np.pi * f
    M, D, K = (np.array([[mass * value]]) for value in (1.0, 2 * ratio * w, w * w))
    return ReducedModel(
        M, D, K, B=np.array([[-mass]]), C=np.array([[1.0], [0.0]]), Ca=np.array([[0.0], [1.0]]),
        Cv=None, frequencies=np.array([f]), input_names=("base:z",), output_names=("1:z", "absolute acceleration 1:z"),
        feedthrough=np.array([[0.0], [1.0]]),
    )  # fmt: skip


def chain(n=5, p=2, seed=1):
    """Masses in a row with damping that is not proportional, and p forces."""
    random = np.random.default_rng(seed)
    K = 4e4 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    D = np.diag(random.uniform(1.0, 3.0, n))
    B = random.normal(size=(n, p))
    return ReducedModel(np.eye(n), D, K, B, C=np.eye(n)[:2], Cv=np.vstack([np.zeros(n), np.eye(n)[4]]),
                        frequencies=np.sqrt(np.linalg.eigvalsh(K)) / 2 / np.pi, input_names=("a", "b")[:p],
                        output_names=("1:x", "mixed"))  # fmt: skip


@pytest.mark.parametrize("ratio", [0.05, 1e-3, 1e-6])
def test_white_noise_sdof(ratio):
    """Over a wide band the mean square of the relative displacement is G / (64 pi^3 f^3 ratio), whatever the damping;
    Miles' equation, (pi / 2) f Q G, has the absolute acceleration but for 4 ratio^2."""
    f, G = 20.0, 3.0
    found = random_response(oscillator(f, ratio), [1e-3, 1e7], np.full((2, 1), G)).rms ** 2
    np.testing.assert_allclose(found[0], G / (64 * np.pi**3 * f**3 * ratio), rtol=1e-4)
    narrow = random_response(oscillator(f, ratio), [1e-3, 1e4], np.full((2, 1), G)).rms ** 2
    # the tail above 1e4 Hz, (2 ratio f)^2 / f_max, is not in it
    miles = np.pi / 2 * f / (2 * ratio) * G * (1 + 4 * ratio**2)
    assert abs(narrow[1] / miles - 1) < 1e-3


def test_lyapunov():
    """Flat correlated inputs over a wide band: the covariance of the Lyapunov equation."""
    model = chain()
    G = np.array([[2.0, 0.6 + 0.3j], [0.6 - 0.3j, 1.0]]).real
    found = random_response(model, [0.0, 1e6], np.array([G, G])).rms ** 2
    space = hpcred.state_space(model)
    # E[x x^T] of white noise whose two-sided density is G / 2 over Hz
    P = scipy.linalg.solve_continuous_lyapunov(space["A"], -space["B"] @ G @ space["B"].T / 2)
    np.testing.assert_allclose(found, np.diag(space["C"] @ P @ space["C"].T), rtol=2e-5)


def test_cross_spectra_and_sums():
    """A density that is a sum of loads in a known phase is the response to the load of this phase; between the
    frequencies of the table it is straight in logarithms, and against a fine grid."""
    model, phase = chain(), np.exp(0.7j)
    u = np.array([1.0, 2.0 * phase])
    G = np.outer(u.conj(), u) + 1e-17j * np.eye(2)  # round-off, as of processors that multiply and add at once
    f, levels = np.array([5.0, 20.0, 60.0]), np.array([1.0, 4.0, 0.5])
    found = random_response(model, f, levels[:, None, None] * G)
    fine = np.linspace(5.0, 60.0, 200_001)
    level = np.exp(np.interp(np.log(fine), np.log(f), np.log(levels)))
    H = model.transfer_function(2j * np.pi * fine) @ u
    exact = scipy.integrate.trapezoid(np.abs(H) ** 2 * level[:, None], fine, axis=0)
    np.testing.assert_allclose(found.rms**2, exact, rtol=1e-6)
    at = np.searchsorted(found.frequencies, 20.0)
    np.testing.assert_allclose(found.psd[at], 4 * np.abs(model.transfer_function(40j * np.pi) @ u) ** 2, rtol=1e-9)


def test_displacement_of_a_base():
    """The density of a displacement of a base is that of its acceleration over omega^4; harmonic amplitudes too."""
    model, f = oscillator(), np.geomspace(1.0, 100.0, 400)
    by_acceleration = random_response(model, f, np.ones((400, 1)))
    by_displacement = random_response(model, f, (2 * np.pi * f[:, None]) ** -4, orders=[2])
    np.testing.assert_allclose(by_displacement.rms, by_acceleration.rms, rtol=1e-5)
    y = harmonic_response(model, [10.0], [[2j]], orders=[1])
    np.testing.assert_allclose(y[0], model.transfer_function(20j * np.pi)[:, 0] * 2j * 20j * np.pi)


def test_stresses():
    """Components and von Mises stresses, whose mean square is that of the quadratic form."""
    model, random = chain(p=2), np.random.default_rng(3)
    stress = hpcred.body.StressModes(np.array([7]), random.normal(size=(5, 1, 6)), "made up")
    found = random_response(model, [1.0, 50.0], np.ones((2, 2)), stress=stress)
    assert found.names[2:] == ("7:xx", "7:yy", "7:zz", "7:xy", "7:yz", "7:zx", "7:mises")
    at = np.searchsorted(found.frequencies, 50.0)
    X = model.states(2j * np.pi * 50.0)
    S = np.einsum("ma,mp->ap", stress.stress[:, 0], X)
    np.testing.assert_allclose(found.psd[at, 2:8], (np.abs(S) ** 2).sum(axis=1), rtol=1e-9)
    xx, yy, zz, xy, yz, zx = S
    square = ((np.abs(xx - yy) ** 2 + np.abs(yy - zz) ** 2 + np.abs(zz - xx) ** 2) / 2
              + 3 * (np.abs(xy) ** 2 + np.abs(yz) ** 2 + np.abs(zx) ** 2)).sum()  # fmt: skip
    np.testing.assert_allclose(found.psd[at, 8], square, rtol=1e-9)


@pytest.mark.parametrize(
    ("over", "density", "more", "message"),
    [
        ([1.0, 50.0], np.array([[1.0, -1.0]] * 2), {}, "below 0"),
        ([50.0, 1.0], np.ones((2, 2)), {}, "do not ascend"),
        ([1.0, 50.0], np.ones((2, 2)), {"band": (0.5, 20.0)}, "expected frequencies over the band 0.5 to 20 Hz"),
        ([1.0, 50.0], np.array([[[1.0, 2.0], [2.0, 1.0]]] * 2), {}, "positive semidefinite"),
        ([1.0, 50.0], np.ones((3, 2)), {}, "expected \\(N, p\\)"),
    ],
)
def test_refused(over, density, more, message):
    with pytest.raises(hpcred.InputError, match=message):
        random_response(chain(), over, density, **more)


def test_undamped():
    with pytest.raises(hpcred.InputError, match="the resonance at 20 Hz has none"):
        random_response(oscillator(ratio=0.0), [1.0, 50.0], np.ones((2, 1)))


def test_shock_of_a_half_sine():
    """Without damping: the closed form during and after a half sine; 1.77 at the peak near f T = 0.8, 1 for stiff ones;
    a long period has the impulse, 2 w T / pi."""
    T, f = 0.011, np.array([1.0, 72.0, 150.0, 5000.0])
    found = shock_spectrum(*half_sine(50.0, T, 4000), f, damping=0.0).maximax / 50.0
    w, p = 2 * np.pi * f, np.pi / T
    t = np.linspace(0.0, T, 200_001)
    inside = [(o / (o * o - p * p) * (o * np.sin(p * t) - p * np.sin(o * t))).max() for o in w]
    after = np.abs(2 * p * w * np.cos(w * T / 2) / (p * p - w * w))
    np.testing.assert_allclose(found, np.maximum(inside, after), rtol=2e-3)
    assert found[0] == pytest.approx(4 * f[0] * T, rel=1e-3)
    assert 1.76 < found[1] < 1.775
    assert found[3] == pytest.approx(1.0, abs=2e-2)


def test_shock_against_integration():
    """A damped oscillator under a history with unequal steps: the response of its own model over time."""
    random = np.random.default_rng(5)
    t = np.cumsum(random.uniform(1e-4, 2e-3, 60))
    a = random.normal(size=60)
    a[[0, -1]] = 0.0
    found = shock_spectrum(t, a, [20.0], damping=0.05)
    fine = np.linspace(t[0], t[-1] + 0.2, 40_001)
    y = time_response(oscillator(20.0, 0.05), fine, np.interp(fine, t, a, right=0.0)[:, None])[:, 1]
    np.testing.assert_allclose([found.positive[0], found.negative[0]], [y.max(), y.min()], rtol=3e-3)
    assert shock_spectrum(t, a, [20.0], q=10.0).maximax == found.maximax


def test_responses_over_time_are_exact_under_loads_that_are_straight_between_instants():
    """In steps of half a period as in steps a tenth as long."""
    coarse = np.linspace(0.0, 0.5, 21)
    load = np.random.default_rng(6).normal(size=21)
    fine = np.linspace(0.0, 0.5, 201)
    y, other = (time_response(oscillator(), t, np.interp(t, coarse, load)[:, None]) for t in (coarse, fine))
    assert np.abs(y - other[::10]).max() < 1e-10 * np.abs(y).max()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0, 0.0], [1.0, 1.0], [10.0]), "do not ascend"), (([0.0, 1.0], [1.0], [10.0]), "two or more"),
        (([0.0, 1.0], [1.0, 1.0], [0.0]), "not positive"),
    ],
)  # fmt: skip
def test_shock_refused(arguments, message):
    with pytest.raises(hpcred.InputError, match=message):
        shock_spectrum(*arguments)
    with pytest.raises(hpcred.InputError, match="beside a damping ratio"):
        shock_spectrum([0.0, 1.0], [0.0, 1.0], [3.0], q=10.0, damping=0.1)


def test_time_response_of_too_many_instants():
    """Nothing is begun that would take for ever."""
    many = np.broadcast_to(0.0, (10_000_001, 2))
    with pytest.raises(hpcred.InputError, match="equal steps of 1 s are needed, expected at most 10000000;"):
        time_response(chain(), np.arange(len(many)), many)
