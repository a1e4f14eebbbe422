"""Models with circulatory forces, whose K is not symmetric, against dense solves and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from adaptive_models import chain, dashpots, unit
from helpers import block_with_ends, close, moments, with_columns
from parametric_models import AffineCase, fresh_pairs, random_circulatory
from rotor import HELD, shaft_with_internal_damping
from shared_data import shared

import hpcred
from hpcred import (
    Buckens,
    CraigBampton,
    GivenDamping,
    InputError,
    Krylov,
    ModalDamping,
    Modes,
    Parameter,
    SecondOrderModel,
)

FEW = {"parameter_search": hpcred.ParameterSearch(points=5)}


def friction(n=24, strength=300.0):
    """A damped chain of n masses with circulatory forces between some of them; B, C of other masses."""
    rng = np.random.default_rng(2)
    K, M = chain(n)
    N = np.zeros((n, n))
    for j, k in rng.choice(n, (6, 2), replace=False):
        N[j, k], N[k, j] = strength, -strength
    D = 1e-3 * K + 0.3 * M + dashpots(n, 3, rng)
    return K, N, M, D, unit(n, 3, 12), unit(n, 18)


def friction_model(comm, **more):
    K, N, M, D, B, C = friction()
    return SecondOrderModel.from_scipy(K + N, M, D, comm, inputs=B, outputs=C, circulatory=True, **more)


def poles_of(M, D, K):
    """Poles in the upper half-plane."""
    n, by_mass = len(M), np.linalg.solve(M, np.hstack([K, D]))
    poles = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-by_mass[:, :n], -by_mass[:, n:]]]))
    return poles[poles.imag > 0]


@pytest.mark.mpi
@pytest.mark.costly
def test_a_model_with_an_unsymmetric_stiffness_is_reduced_to_the_tolerance(comm):
    K, N, M, D, B, C = friction()
    f = np.linspace(0.0, 6.0, 61)
    s = 2j * np.pi * f
    dense = np.array([C.T @ np.linalg.solve(K + N + x * D + x * x * M, B + 0j) for x in s])
    with friction_model(comm) as model:
        assert close(model.frequency_response(f), dense) < 1e-12
        with hpcred.reduce(model, tolerance=1e-4, band=(0.0, 6.0)) as rom:
            assert rom.record.accuracy.reached and rom.size < len(K)
            assert np.abs(rom.frequency_response(f) - dense).max() <= 1e-4 * np.abs(dense).max()
            both, diagonal = rom.K + rom.K.T, 2 * np.diag(np.diag(rom.K))
            assert np.abs(both - diagonal).max() < 1e-12 * both.max() and np.abs(rom.K - rom.K.T).max() > 1.0
        found = hpcred.full_response(model, f, tolerance=1e-6, check=3)
        assert close(found.response, dense) < 1e-5 and found.accuracy.reached and found.check.passed
    unstable = poles_of(M, D, K + 20 * N)
    assert unstable.real.max() > 0
    with friction_model(comm) as model, SecondOrderModel.from_scipy(
        K + 20 * N, M, D, comm, inputs=B, circulatory=True
    ) as model, hpcred.reduce(model, tolerance=1e-7, band=(0.0, 10.0)) as rom:
        worst = unstable[unstable.real.argmax()]
        assert any(abs(complex(*pole) - worst) < 1e-4 * abs(worst) for pole in rom.record.unstable_poles)


@pytest.mark.mpi
def test_a_model_with_other_circulatory_forces_is_another_one(comm, folder):
    K, N, M, D, B, C = friction()
    with friction_model(comm) as model, hpcred.reduce(model, [Krylov(1.3, 1)], allow_unstable=True) as rom:
        rom.save(folder / "r.h5")
        for name, factor in (("same.h5", 1), ("turned.h5", -1), ("without.h5", 0)):
            with SecondOrderModel.from_scipy(
                K + factor * N, M, D, comm, inputs=B, outputs=C, circulatory=True
            ) as other:
                hpcred.write_model(folder / name, other)
    hpcred.evaluate(folder / "r.h5", folder / "same.h5", points=2, comm=comm)
    for name in ("turned.h5", "without.h5"):
        with pytest.raises(InputError, match=rf"{name}: its matrix K differs from what .*r.h5 was reduced from"):
            hpcred.evaluate(folder / "r.h5", folder / name, points=2, comm=comm)


def test_moments_are_those_of_the_unsymmetric_pencil(comm):
    K, N, M, _, B, C = friction()
    with SecondOrderModel.from_scipy(K + N, M, None, comm, inputs=B, circulatory=True) as given:
        basis, shift = Krylov(1.3, 1), -((2 * np.pi * 1.3) ** 2)
        both = unit(len(K), 18, 7)
        with with_columns(given, "output", both) as model:
            for projection, count in (("one_sided", 2), ("two_sided", 4)):
                with hpcred.reduce(model, [basis], projection=projection, allow_unstable=True) as rom:
                    full = moments(K + N, M, B, both.T, shift, count)
                    small = moments(rom.K, rom.M, rom.B, rom.C, shift, count)
                    assert max(close(a, b) for a, b in zip(full, small, strict=True)) < 1e-8


@pytest.mark.mpi
@pytest.mark.costly
def test_a_shaft_whose_damping_turns_with_it_is_stable_up_to_the_known_speed(comm):
    """Omega = omega_1 (1 + d_e / d_i) with d_e = alpha and d_i = beta omega_1^2 of the first mode."""
    external, internal = 20.0, 2e-5
    with shaft_with_internal_damping(comm, external, internal) as model:
        omega = 2 * np.pi * hpcred.natural_modes(model.model, 1, HELD).frequencies[0]
        band = (0.0, 3 * omega / 2 / np.pi)
        with hpcred.reduce(model, frame=HELD, tolerance=1e-6, band=band, **FEW) as rom:
            assert rom.record.accuracy.reached
            found = hpcred.campbell(rom, values=np.linspace(0, 3000, 7), axis="x")
            limit = omega * (1 + external / (internal * omega**2))
            assert 1000 < limit < 3000 and found.stability_limit == pytest.approx(limit, rel=1e-6)
            assert found.unstable_frequency == pytest.approx(omega / (2 * np.pi), rel=1e-6)
            assert not rom.at(omega=0.99 * limit).unstable_poles().size
            assert rom.at(omega=1.01 * limit).unstable_poles().size == 2


@pytest.mark.mpi
@pytest.mark.costly
def test_a_shaft_with_internal_damping_and_a_disk_over_its_speeds(comm):
    tolerance, rng = 1e-4, np.random.default_rng(3)
    with shaft_with_internal_damping(comm, polar=2e-3) as model, hpcred.reduce(
        model, frame=HELD, tolerance=tolerance, band=(0.0, 600.0), **FEW
    ) as rom:
        assert rom.record.accuracy.reached and rom.size < 20
        for speed in (0.0, 3000.0, *rng.uniform(0, 3000, 3)):
            f = np.append(rng.uniform(0, 600, 3), 600.0)
            with model.at(omega=speed) as there:
                H = there.frequency_response(f, frame=HELD)
            small = rom.at(omega=speed).frequency_response(f)
            eps = rom.record.accuracy.measure.eps(H - small, H, np.einsum("sii->si", H))
            assert eps.max() <= tolerance


def disk_brake():
    """The disk brake of NLEVP over its speed: friction damping that falls with it, gyroscopic forces that grow."""
    given = scipy.io.loadmat(shared("real/disk_brake100_omega4pi.mat"))
    M, D, K = (given[key].toarray() for key in "MDK")
    speed = 4 * np.pi  # where the file has it
    DS, DG = (D + D.T) / 2, (D - D.T) / 2
    terms = [("D", DS / 2 * speed, "1/omega"), ("D", DG / speed, "omega")]
    return AffineCase("disk brake", K, M, unit(len(K), 3, 50), (0.0, 0.012), [Parameter("omega", (9.0, 18.0))], terms,
                      D=DS / 2, damping=GivenDamping(), circulatory=True), (M, D, K)  # fmt: skip


@pytest.mark.slow
@pytest.mark.mpi
def test_the_disk_brake(comm):
    """Responses over the band and the speed, and poles of the reduced model at the speed of the file."""
    case, (M, D, K) = disk_brake()
    assert np.abs(K - K.T).max() > 1e-3 * np.abs(K).max()
    search = hpcred.ParameterSearch(points=5)
    with case.model(comm) as model, hpcred.reduce(
        model, tolerance=1e-3, band=case.band, parameter_search=search
    ) as rom:
        assert rom.record.accuracy.reached
        assert case.eps(rom, fresh_pairs(case, 12)).max() <= 1e-3
        exact, found = poles_of(M, D, K), rom.at(omega=4 * np.pi).poles()
        for pole in exact[(np.abs(exact) < 2 * np.pi * 0.01) & (np.abs(exact.real) < 0.3 * exact.imag)]:
            assert np.abs(found - pole).min() < 1e-3 * abs(pole)
        assert not np.allclose(rom.at(omega=9.0).poles(), rom.at(omega=18.0).poles())


@pytest.mark.parametrize("seed", [5])
def test_random_models(seed, comm):
    """Some of the hunt of benchmarks/parametric.py."""
    case, tolerance = random_circulatory(seed, 40)
    with case.model(comm) as model, hpcred.reduce(
        model, tolerance=tolerance, band=case.band, damping=case.damping, **FEW
    ) as rom:
        assert rom.record.accuracy.reached and case.eps(rom, fresh_pairs(case, 20)).max() <= tolerance


def test_a_basis_of_components_keeps_the_terms(comm):
    K, N, M, D, B, _ = friction()
    shift, terms = -((2 * np.pi * 1.3) ** 2), [("K", N, "a")]
    case = AffineCase("friction", K, M, B, (0.0, 5.0), [Parameter("a", (0.0, 4.0))], terms, D=D)
    with case.model(comm) as model, hpcred.reduce(
        model, [Krylov(1.3, 1)], damping=GivenDamping(), parameter_points=[{"a": 0.0}, {"a": 3.0}]
    ) as rom:
        for value in (0.0, 3.0):
            at, X, parts = rom.at(a=value), rom.turn({"a": value}), rom.matrices({"a": value})
            full, small = (moments(*item, shift, 2) for item in ((K + value * N, M, B, B.T), (at.K, at.M, at.B, at.C)))
            assert max(close(a, b) for a, b in zip(full, small, strict=True)) < 1e-8
            assert close(X.T @ parts["K"] @ X, at.K) < 1e-12 and np.array_equal(at.K, at.K.T) == (value == 0)
            assert close(at.transfer_function(9j), rom.transfer_function(9j, a=value)) < 1e-10


def test_what_does_not_go_with_it_is_refused(comm):
    K, N, M, D, B, _ = friction()
    with SecondOrderModel.from_scipy(K + N, M, D, comm, inputs=B, name="brake") as model:
        says = r"brake: matrix K is not symmetric: .*; of K that has circulatory forces say circulatory = true"
        for refuse in (lambda: hpcred.reduce(model, tolerance=1e-3, band=(0, 5)),
                       lambda: hpcred.full_response(model, [1.0, 2.0])):  # fmt: skip
            with pytest.raises(InputError, match=says):
                refuse()
        assert any("unless it is meant to be so (of K" in text for text in hpcred.inspect(model)["warnings"])
    asked = {"tolerance": 1e-3, "band": (0.0, 5.0)}
    with friction_model(comm, name="brake") as model:
        assert not [text for text in hpcred.inspect(model)["warnings"] if "symmetric" in text]
        for more, message in [
            ({**asked, "damping": ModalDamping(0.01)}, "found 'modal', which is made from eigenfrequencies"),
            ({**asked, "frame": Buckens()}, "the Buckens frame does not go with the unsymmetric K of brake"),
            ({"basis": Modes(count=3)}, "modes: K of brake is not symmetric, so that its modes are complex"),
        ]:
            with pytest.raises(InputError, match=message):
                hpcred.reduce(model, **more)
        with pytest.raises(InputError, match="brake: matrix K is not symmetric: .*, which hpcred.damped_modes finds"):
            hpcred.natural_modes(model, 2)
        law = hpcred.laws.Maxwell(factors=[0.5], times=[0.1])
        with (
            model.with_viscoelastic([hpcred.Viscoelastic(0.1 * K, law)]) as soft,
            pytest.raises(InputError, match="found viscoelastic parts beside an unsymmetric K"),
        ):
            hpcred.reduce(soft, **asked)
    with (
        SecondOrderModel.from_scipy(-K + N, M, D, comm, inputs=B, circulatory=True) as model,
        pytest.raises(InputError, match="K is negative definite"),
    ):
        hpcred.reduce(model, **asked)
    omega = [Parameter("omega", (0.0, 1.0))]
    with (
        SecondOrderModel.from_scipy(K, M, D, comm, inputs=B) as model,
        hpcred.ParametricModel(model, omega, [hpcred.Term("K", N, "omega")]) as turning,
    ):
        for more, message in [
            ({"frame": Buckens()}, "found the Buckens frame and an unsymmetric term of K"),
            ({"coordinates": "interface"}, "found interface coordinates and an unsymmetric term of K"),
            ({"damping": ModalDamping(0.01)}, "found 'modal', which is made from eigenfrequencies"),
        ]:
            with pytest.raises(InputError, match=message):
                hpcred.reduce(turning, **asked, **more)


def test_a_free_body_is_not_sent_to_the_buckens_frame(comm):
    omega = [Parameter("omega", (0.0, 1.0))]
    with block_with_ends(comm, cells=(2, 1, 1)) as model:
        n = model.size
        everywhere = 1e8 * np.kron(np.eye(n // 3), [[0, -1, 0], [1, 0, 0], [0, 0, 0]])
        few = np.zeros((n, n))
        few[3, 10], few[10, 3] = 1e5, -1e5
        for N, more, message in [
            (everywhere, {"basis": CraigBampton(count=2), "frame": Buckens()}, "the Buckens frame does not go with"),
            (few, {"tolerance": 1e-3, "band": (0.0, 500.0)}, "for the body is free[^;]*; hold the body, or give a"),
            (few, {"basis": CraigBampton(count=2)}, "K of .* is singular, so the body can move freely; hold it"),
        ]:  # fmt: skip
            with (
                hpcred.ParametricModel(model, omega, [hpcred.Term("K", N, "omega")]) as turning,
                turning.at(omega=1.0) as there, pytest.raises(InputError, match=message),
            ):  # fmt: skip
                hpcred.reduce(there, **more)


def seal(stiff, strength=2e3, n=20):
    """Two planes of a chain on bearings with a cross-coupled seal in the middle, and a stiff connection elsewhere."""
    K = 1e6 * (np.diag(np.full(n, 2.0)) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[0, 0] = K[-1, -1] = 1.1e6
    K = np.kron(np.eye(2), K)
    K[np.ix_([1, 2], [1, 2])] += stiff * np.array([[1, -1], [-1, 1]])
    N = np.zeros((2 * n, 2 * n))
    N[n // 2, n + n // 2], N[n + n // 2, n // 2] = strength, -strength
    return K, N, np.eye(2 * n), 0.1 * np.eye(2 * n), unit(2 * n, 3, n + 3)


@pytest.mark.mpi
def test_circulatory_forces_beside_a_stiff_connection_count(comm):
    """2 kN/m beside 1e14 N/m, by which no norm of K shows them: the model stays as unstable as it is."""
    K, N, M, D, B = seal(1e14)
    exact = poles_of(M, D, K + N)
    growing = exact[exact.real > 1e-3]
    assert len(growing) and np.abs(N).max() < 1e-10 * np.linalg.norm(K)
    with SecondOrderModel.from_scipy(K + N, M, D, comm, inputs=B, circulatory=True) as model:
        assert not model.is_symmetric("K") and model.is_symmetric("D") and model.is_symmetric("M")
        with hpcred.reduce(model, [Krylov(f, 2) for f in (8.0, 16.0)], allow_unstable=True) as rom:
            found = rom.unstable_poles()
            assert np.abs(found[:, None] - growing).min(axis=0).max() < 1e-4 * np.abs(growing).max()
    with SecondOrderModel.from_scipy(K, M, D, comm, inputs=B) as constant, hpcred.ParametricModel(
        constant, [Parameter("p", (0.0, 1.0))], [hpcred.Term("K", 1e-9 * N, "1e9*p")]
    ) as terms, terms.at(p=1.0) as there, terms.at(p=0.0) as without:
        assert not there.is_symmetric("K") and without.is_symmetric("K")


@pytest.mark.slow
def test_soft_bearings_over_parameters_are_not_limited_by_round_off(comm):
    """Frequencies 1e4 times below the highest: models of stiff columns had 200 times the round-off of the result."""
    K, N, M, D, B = seal(0.0, 1.0, 16)
    K = 1e3 * K
    K[np.ix_([0, 15], [0, 15])] = K[np.ix_([16, 31], [16, 31])] = np.diag(np.full(2, 1e9 + 8.0))
    asked = {"tolerance": 1e-2, "band": (2.0, 10.0), "damping": GivenDamping()}
    with SecondOrderModel.from_scipy(K, 1e-3 * M, 1e-4 * D, comm, inputs=B) as plain, hpcred.ParametricModel(
        plain, [Parameter("k", (0.01, 0.1))], [hpcred.Term("K", N, "k")]
    ) as model, hpcred.reduce(model, parameter_search=hpcred.ParameterSearch(points=5), **asked) as rom:
        assert rom.record.accuracy.reached and rom.record.accuracy.noise < 1e-3
        poles = rom.at(k=0.1).poles()
    exact = poles_of(1e-3 * M, 1e-4 * D, K + 0.1 * N)
    for pole in exact[(np.abs(exact) < 100) & (exact.imag > 0)]:
        assert np.abs(poles - pole).min() < 1e-5 * abs(pole)


def test_a_slow_growth_beside_high_frequencies_is_unstable():
    """0.02 1/s at 31 rad/s, in a model that goes up to 1e8 rad/s."""
    K = np.diag([1e3, 1e3, 1e12, 1e16])
    K[0, 1], K[1, 0] = 2.0, -2.0
    B = np.ones((4, 1))
    rom = hpcred.ReducedModel(
        M=np.eye(4), D=1e-2 * np.eye(4), K=K, B=B, C=B.T, frequencies=np.sqrt(np.diag(K)), input_names=("in",),
        output_names=("out",),
    )  # fmt: skip
    assert rom.unstable_poles().real == pytest.approx(1 / np.sqrt(1e3) - 5e-3, rel=1e-3)
    assert not replace(rom, K=np.diag(np.diag(K))).unstable_poles().size
