"""Dofs without mass: reduced to the tolerance, and the same in time as in frequency."""

from dataclasses import replace

import numpy as np
import pytest
import random_models
import scipy.sparse

import hpcred
from hpcred import InputError
from hpcred.linalg.pencil import massless_last, modes_of
from hpcred.reduction.massless import static_coordinates, with_mass

KINDS = ("chain-without-mass", "skew-without-mass", "beam-without-inertia", "rotor-without-inertia")
BAND = (0.0, 2.0)


def chain(n=6):
    """M, K of a chain whose every other dof has no mass."""
    K = 100.0 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    return np.diag(np.arange(n) % 2.0), K


def unit(n, *rows):
    return np.eye(n)[:, list(rows)]


def reduced(M, K, B, D=None, C=None, tolerance=1e-9, damping=None, comm=None, **more):
    """The reduced model to a tolerance, without its basis."""
    where = {} if comm is None else {"comm": comm}
    more |= {"damping": damping, "tolerance": tolerance, "band": BAND}
    with hpcred.SecondOrderModel(M, D, K, B, C, **where) as model, hpcred.reduce(model, **more) as rom:
        return replace(rom)


@pytest.fixture(scope="module")
def damped():
    """All that there is: forces, dashpots and outputs with and without mass; and the response of the full model."""
    M, K = chain()
    D = np.diag([3.0, 0.2, 0.0, 0.2, 0.0, 0.2])
    B, C = unit(6, 0, 2, 3), np.eye(6)[[0, 2, 4, 5]]

    def response(s):
        return C @ np.linalg.solve(s * s * M + s * D + K, B)

    return reduced(M, K, B, D, C), response


def require_right(case):
    """The tolerance is reached, and holds against dense solves."""
    with case.reduced() as rom:
        assert rom.record.accuracy.reached
        assert case.largest_error(rom, np.random.default_rng(5))[0] <= 1.02 * case.tolerance


POINTS = 2j * np.pi * np.array([0.01, 0.3, 1.1, 1.9])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [3, 11])
def test_random_models(kind, seed):
    """The claim against dense solves, over the band and around all poles."""
    require_right(random_models.random_case(kind, seed))


def test_round_off_of_m_is_no_mass():
    """Columns with x^T M x of round-off alone, which no norm shows, count as massless by their frequency."""
    require_right(random_models.random_case("skew-without-mass", 1043))


def test_dashpots_on_dofs_without_mass_that_no_load_acts_on():
    """A basis orthonormal in M claimed 7e-6 where 1.7e-3 was true."""
    rng = np.random.default_rng(2)
    n = 12
    M, K = np.diag(rng.uniform(0.005, 0.02, n)), random_models.springs(rng, n, 3)
    M[[2, 6, 9], [2, 6, 9]] = 0.0
    D = random_models.dashpots(rng, n, 5, [2, 6, 9], 30.0)
    for tolerance in (1e-2, 1e-3, 1e-5):
        require_right(random_models.Case(K, M, D, unit(n, 1), None, (0.0, 60.0), tolerance))


def test_form_of_the_reduced_model(damped):
    rom, response = damped
    count = static_coordinates(rom)
    moving = rom.size - count
    assert np.allclose(rom.M, np.diag([1.0] * moving + [0.0] * count), atol=1e-12)
    assert np.abs(rom.K - np.diag(np.diag(rom.K))).max() == 0.0 and np.isfinite(rom.frequencies).all()
    of_static = rom.D[moving:, moving:]
    assert count == 3 and (np.diag(of_static) > 0).sum() == 1  # one dashpot, two static deflections
    assert not rom.D[moving + 1 :].any() and not rom.D[:, moving + 1 :].any()
    for s in POINTS:
        assert np.allclose(rom.transfer_function(s), response(s), rtol=1e-8, atol=1e-12)


def test_state_space(damped):
    """One state a dashpot, and the deflections that follow the forces in D."""
    rom, response = damped
    found = hpcred.state_space(rom)
    A, B, C, D, E, EA, EB = (found[key] for key in ("A", "B", "C", "D", "E", "EA", "EB"))
    moving = rom.size - static_coordinates(rom)
    assert A.shape == (2 * moving + 1,) * 2 and np.abs(D).max() > 1e-3 * np.abs(response(0.1j)).max()
    for s in POINTS:
        assert np.allclose(C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D, response(s), rtol=1e-8, atol=1e-12)
        assert np.allclose(C @ np.linalg.solve(s * E - EA, EB) + D, response(s), rtol=1e-8, atol=1e-12)
        second = s * s * found["mass"] + s * found["damping"] + found["stiffness"]
        whole = found["output_matrix"] @ np.linalg.solve(second, found["input_matrix"])
        assert np.allclose(whole, response(s), rtol=1e-8, atol=1e-12)
        rates = found["C_velocity"] @ np.linalg.solve(s * np.eye(len(A)) - A, B)
        shown = [f"velocity of {name}" in found["velocity_names"] for name in rom.output_names]
        assert np.allclose(rates, s * response(s)[shown], rtol=1e-8, atol=1e-11)
    assert (rom.poles().real < 0).all() and len(rom.poles()) == len(A) and not len(rom.unstable_poles())


def test_integrals_of_dampers(damped):
    """Of second order with a regular M, as an FMU has it."""
    rom, response = damped
    made = with_mass(rom)
    assert made.integrals == 1 and np.linalg.cond(made.reduced.M) < 1e6
    for s in POINTS:
        assert np.allclose(made.reduced.transfer_function(s) + made.feedthrough, response(s), rtol=1e-8, atol=1e-12)


def test_result_file_and_full_model(damped, tmp_path):
    rom, response = damped
    M, K = chain()
    B, C = unit(6, 0, 2, 3), np.eye(6)[[0, 2, 4, 5]]
    D = np.diag([3.0, 0.2, 0.0, 0.2, 0.0, 0.2])
    with hpcred.SecondOrderModel(M, D, K, B, C) as model:
        with hpcred.reduce(model, tolerance=1e-9, band=BAND) as made:
            made.save(tmp_path / "r.h5")
            assert hpcred.check_reduced(made, model, 2, seed=1).passed
        full = hpcred.full_response(model, np.abs(POINTS) / 2 / np.pi, tolerance=1e-8, band=BAND)
    back = hpcred.read_result(tmp_path / "r.h5").reduced
    for k, s in enumerate(POINTS):
        assert np.allclose(back.transfer_function(s), response(s), rtol=1e-8, atol=1e-12)
        assert np.allclose(full.response[k], response(s), rtol=1e-7, atol=1e-11)


@pytest.mark.parametrize("damping", [hpcred.Rayleigh(0.1, 1e-2), hpcred.Structural(0.05), hpcred.ModalDamping(0.02),
                                     hpcred.Caughey((0.1, 1e-2, 1e-7))])  # fmt: skip
def test_other_damping(damping):
    """Static deflections of forces, with the damping that the kind gives them."""
    M, K = chain()
    B = unit(6, 1, 3)
    rom = reduced(M, K, B, damping=damping, tolerance=1e-6)
    assert rom.record.accuracy.reached
    if isinstance(damping, hpcred.Rayleigh):
        s = 3j
        H = B.T @ np.linalg.solve(s * s * M + s * (0.1 * M + 1e-2 * K) + K, B)
        assert np.allclose(rom.transfer_function(s), H, rtol=1e-5)


def test_viscoelastic_parts_on_dofs_without_mass():
    """As responses and as states."""
    M, K = chain()
    B, time, Kv = unit(6, 2, 3), 0.2, 30.0 * np.outer(unit(6, 2) - unit(6, 4), unit(6, 2) - unit(6, 4))
    law = hpcred.Maxwell(factors=(1.0,), times=(time,))
    with hpcred.SecondOrderModel(M, None, K, B) as elastic:
        model = elastic.with_viscoelastic([hpcred.Viscoelastic(Kv, law)])
        rom = hpcred.reduce(model, tolerance=1e-9, band=BAND)
        found = hpcred.state_space(rom)
    assert static_coordinates(rom)
    for s in POINTS:
        H = B.T @ np.linalg.solve(s * s * M + K + s * time / (1 + s * time) * Kv, B)
        assert np.allclose(rom.transfer_function(s), H, rtol=1e-8)
        states = np.linalg.solve(s * np.eye(len(found["A"])) - found["A"], found["B"])
        assert np.allclose(found["C"] @ states + found["D"], H, rtol=1e-8)


@pytest.mark.parametrize("turned", [False, True])
def test_full_response_of_directions_without_mass(turned):
    """Also where M has a full diagonal, and is singular."""
    M, K = chain()
    c = np.sqrt(0.5)
    Q = np.kron(np.eye(3), [[c, -c], [c, c]]) if turned else np.eye(6)
    M, K, B = Q.T @ M @ Q, Q.T @ K @ Q, Q.T @ unit(6, 0, 1)
    M, K = (M + M.T) / 2, (K + K.T) / 2
    with hpcred.SecondOrderModel(M, None, K, B) as model:
        given = {"damping": hpcred.Structural(0.02), "tolerance": 1e-6, "band": BAND}
        full = hpcred.full_response(model, [0.5, 1.5], **given)
    for f, H in zip([0.5, 1.5], full.response, strict=True):
        A = (1 + 0.02j) * K - (2 * np.pi * f) ** 2 * M
        assert np.allclose(H, B.T @ np.linalg.solve(A, B), rtol=1e-5)


def test_rates_of_static_deflections_have_no_state_space(damped):
    rom, _ = damped
    static = np.zeros_like(rom.C)
    static[0, -1] = 1.0
    with pytest.raises(InputError, match="velocities or accelerations of static deflections, which follow the rates"):
        hpcred.state_space(replace(rom, Cv=static))


@pytest.mark.mpi(ranks=(1, 2))
def test_components_of_ones_own(comm):
    """Krylov blocks and modes keep what has no mass, without a tolerance."""
    M, K = chain()
    B = unit(6, 0, 1)
    model = hpcred.SecondOrderModel(M, None, K, B, comm=comm)
    with model, hpcred.reduce(model, [hpcred.Modes(count=2), hpcred.Krylov(1.0, 1)]) as rom:
        s = 2j * np.pi
        H = B.T @ np.linalg.solve(s * s * M + K, B)
        assert static_coordinates(rom) == 1 and np.allclose(rom.transfer_function(s), H, rtol=1e-9)
        assert not rom.record.warnings


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_the_same_on_any_number_of_ranks(comm):
    M, K = chain(8)
    D, B = np.diag([2.0, 0.1, 0, 0.1, 1.0, 0.1, 0, 0.1]), unit(8, 0, 3)
    rom = reduced(M, K, B, D, comm=comm)
    s = 5j
    assert rom.record.accuracy.reached
    assert np.allclose(rom.transfer_function(s), B.T @ np.linalg.solve(s * s * M + s * D + K, B), rtol=1e-8)


def test_small_pencils():
    rng = np.random.default_rng(0)
    X = rng.standard_normal((5, 5))
    M, K = X @ np.diag([1.0, 2.0, 3.0, 0.0, 0.0]) @ X.T, X @ np.diag([4.0, 2.0, 12.0, 5.0, 1.0]) @ X.T
    squares, Y, count = massless_last(K, M, 0.5)
    assert count == 2 and np.allclose(squares[:3], [1.0, 4.0, 4.0])
    assert np.allclose(Y.T @ M @ Y, np.diag([1.0, 1.0, 1.0, 0.0, 0.0]), atol=1e-10)
    assert np.allclose(Y.T @ K @ Y, np.diag([1.0, 4.0, 4.0, 4.0, 4.0]), atol=1e-9)
    assert np.allclose(modes_of(K, M)[0][:3], [1.0, 4.0, 4.0])


def lumped(linkage, only=None):
    """The linkage with masses at its nodes, or at one of them alone: rotations have no inertia."""
    K, M = (scipy.sparse.csr_matrix(mat.getValuesCSR()[::-1]).toarray() for mat in (linkage.K, linkage.M))
    masses = np.zeros(len(M))
    for axis in range(3):
        rows = np.flatnonzero(linkage.dofs.direction == axis)
        masses[rows] = M[np.ix_(rows, rows)].sum(axis=1)
    if only is not None:
        masses = np.zeros(len(M))
        masses[6 * only : 6 * only + 6] = [1.0, 1.0, 1.0, 0.01, 0.01, 0.01]
    return hpcred.SecondOrderModel.from_scipy(K, np.diag(masses), dofs=linkage.dofs)


def test_a_floating_frame_has_no_place_for_them(linkage, tmp_path):
    model = lumped(linkage, only=6).with_inputs([(1, "x"), (20, "z")])
    with model, hpcred.reduce(model, tolerance=1e-3, band=(0.0, 100.0), frame=hpcred.Buckens()) as rom:
        assert static_coordinates(rom) == rom.size
        with pytest.raises(InputError, match="coordinates without mass, .* for which a SID file has no place; reduce"):
            rom.export(tmp_path / "x.SID_FEM")
        found = rom.export(tmp_path / "x.npz")
        assert found["coordinates"] == rom.size


def test_interface_coordinates(linkage):
    """A superelement that moves and turns at nodes without inertia, of a free body with lumped masses."""
    ends = [hpcred.Interface(name=name, node=node, nodes=(number,), kind="rigid") for name, node, number in
            (("one", 901, 1), ("two", 902, 20))]  # fmt: skip
    with lumped(linkage) as free, free.with_interfaces(ends) as jointed:
        model = jointed.with_inputs([("one", "all"), ("two", "all")])
        rom = hpcred.reduce(model, frame=hpcred.Buckens(), tolerance=1e-5, band=(0.0, 300.0), coordinates="interface")
        assert rom.record.accuracy.reached
        f = np.array([20.0, 170.0])
        eta = 1e-3
        full = hpcred.frequency_response(model, f, None, hpcred.Structural(eta))
        found = replace(rom, loss_factor=eta).frequency_response(f)
    assert hpcred.relative_error(full, found).max() < 1e-5
    assert np.allclose(rom.B[:12], np.eye(12), atol=1e-9)
