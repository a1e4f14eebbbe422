"""Dofs without mass: reduced to the tolerance, and the same in time as in frequency."""

from dataclasses import replace

import numpy as np
import pytest
import random_models
import scipy.sparse
from fifty_digits import at_peaks, exact_response, with_other_last_digits

import hpcred
from hpcred import InputError
from hpcred.examples.solid import solid
from hpcred.linalg.pencil import massless_last, modes_of
from hpcred.reduction.irka import mirrored
from hpcred.reduction.result.massless import static_coordinates, with_mass

KINDS = ("chain-without-mass", "skew-without-mass", "beam-without-inertia", "rotor-without-inertia")
AT_FEW_VALUES = 4, 7  # seeds of random models with parameters that take little time
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
@pytest.mark.parametrize("seed", [3, pytest.param(11, marks=pytest.mark.slow)])
def test_random_models(kind, seed):
    """The claim against dense solves, over the band and around all poles."""
    require_right(random_models.random_case(kind, seed))


def test_round_off_of_m_is_no_mass():
    """Columns with x^T M x of round-off alone, which no norm shows, count as massless, since masses cancel in them."""
    require_right(random_models.random_case("skew-without-mass", 1043))


@pytest.mark.slow
@pytest.mark.parametrize("seed", AT_FEW_VALUES)
def test_random_models_with_parameters(seed):
    require_right(random_models.random_case("parameters-without-mass", seed))


@pytest.fixture(scope="module")
def parametric():
    """A spring, a dashpot and a mass of dofs without mass that depend on a parameter; and the full matrices."""
    M, K = chain()
    D, B, C = np.diag([3.0, 0.2, 0.0, 0.2, 0.0, 0.2]), unit(6, 0, 2, 3), np.eye(6)[[0, 2, 4, 5]]
    spring, dashpot, mass = np.outer(unit(6, 2) - unit(6, 5), unit(6, 2) - unit(6, 5)), *map(np.diag, np.eye(6)[[2, 4]])
    terms = [hpcred.Term("K", 60.0 * spring, "p"), hpcred.Term("D", dashpot, "p"), hpcred.Term("M", mass, "p")]

    def response(s, p):
        A = s * s * (M + p * mass) + s * (D + p * dashpot) + K + 60.0 * p * spring
        return C @ np.linalg.solve(A, B)

    with (
        hpcred.SecondOrderModel(M, D, K, B, C) as constant,
        hpcred.ParametricModel(constant, [hpcred.Parameter("p", (0.0, 1.5), 0.0)], terms) as model,
    ):
        search = hpcred.ParameterSearch(points=9)
        return replace(hpcred.reduce(model, tolerance=1e-8, band=BAND, parameter_search=search)), response


@pytest.mark.parametrize("p", [0.0, 0.4, 1.5])
def test_parameters_of_dofs_without_mass(parametric, p):
    """Claims over the ranges, models at values, and their states, against dense solves."""
    rom, response = parametric
    assert rom.record.accuracy.reached and static_coordinates(rom) == 3
    at = rom.at(p=p)
    assert static_coordinates(at) == (3 if p == 0 else 2) and np.allclose(np.diag(np.diag(at.K)), at.K, atol=1e-9)
    states = hpcred.state_space(at)
    for s in POINTS:
        assert np.allclose(rom.transfer_function(s, p=p), response(s, p), rtol=1e-7, atol=1e-10)
        assert np.allclose(at.transfer_function(s), response(s, p), rtol=1e-7, atol=1e-10)
        inside = np.linalg.solve(s * np.eye(len(states["A"])) - states["A"], states["B"])
        assert np.allclose(states["C"] @ inside + states["D"], response(s, p), rtol=1e-7, atol=1e-10)


def test_states_at_the_reference_of_parameters(parametric):
    """The model itself is that at the reference values."""
    rom, _ = parametric
    assert np.array_equal(rom.state_matrix(), rom.base.state_matrix())
    assert np.allclose(rom.poles(), rom.at().poles(), rtol=1e-6)


def test_parameters_are_fixed_in_an_fmu(parametric, tmp_path):
    """What follows forces at once would follow them otherwise at each value."""
    rom, _ = parametric
    remarks = rom.export(tmp_path / "x.fmu")["remarks"]
    assert any("the motion of coordinates without mass follows forces by the stiffness" in line for line in remarks)


def test_components_at_values_of_parameters():
    """Without a tolerance."""
    M, K = chain()
    B, spring = unit(6, 0, 1), np.diag(unit(6, 2)[:, 0])
    with (
        hpcred.SecondOrderModel(M, None, K, B) as constant,
        hpcred.ParametricModel(
            constant, [hpcred.Parameter("p", (0.0, 2.0))], [hpcred.Term("K", 80 * spring, "p")]
        ) as model,
    ):
        rom = hpcred.reduce(model, [hpcred.Krylov(1.0, 1)], parameter_points=[{"p": 0.5}, {"p": 2.0}])
    for p in (0.5, 2.0):
        s = 2j * np.pi
        H = B.T @ np.linalg.solve(s * s * M + K + 80 * p * spring, B)
        assert np.allclose(rom.transfer_function(s, p=p), H, rtol=1e-9)
    assert not rom.record.warnings


def test_stiff_motions_of_a_mesh_have_their_mass():
    """However far above the band they are: nothing of a block of steel is without mass."""
    with solid((4, 2, 2)) as model, hpcred.reduce(model, tolerance=1e-3, band=(0.0, 0.01)) as rom:
        assert np.array_equal(np.round(rom.M, 9), np.eye(rom.size)) and not rom.record.warnings
        assert rom.frequencies[-1] > 1e5


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
    Ca = np.zeros_like(rom.C)
    Ca[0, 0] = 1e-3  # an acceleration beside displacements
    rom = replace(rom, Ca=Ca)
    made = with_mass(rom)
    for s in POINTS:
        H = rom.transfer_function(s)
        assert np.allclose(made.reduced.transfer_function(s) + made.feedthrough, H, rtol=1e-8, atol=1e-12)


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


@pytest.mark.parametrize("rows", [(0, 3), (2,)])
def test_a_caughey_series_has_no_value_without_mass(rows):
    """A basis of components had an error of more than 1 without a word, and full solves lost the static deflection
    beside 0 Hz; what the sentence names works."""
    M, K = chain()
    series = hpcred.Caughey((0.1, 1e-2, 1e-7))
    for B, C in ((unit(6, *rows), None), (unit(6, 1), unit(6, *rows).T)):
        for function, asked in ((hpcred.reduce, {"tolerance": 1e-6, "band": BAND}),
                                (hpcred.reduce, {"basis": [hpcred.Krylov(1.0, 1)]}),
                                (hpcred.frequency_response, {"frequencies": [0.0, 1e-6]})):  # fmt: skip
            with (
                hpcred.SecondOrderModel(M, None, K, B, C) as model,
                pytest.raises(InputError, match="'caughey' with 3 terms and forces or outputs on dofs without mass"),
            ):
                function(model, damping=series, **asked)
    for damping in (hpcred.Rayleigh(0.1, 1e-2), hpcred.Structural(0.05), hpcred.ModalDamping(0.02)):
        assert reduced(M, K, unit(6, *rows), damping=damping, tolerance=1e-6).record.accuracy.reached


TWO_SIDED = {"projection": "two_sided", "allow_unstable": True}


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("loaded, measured", [((0, 3), (2, 5)), ((4, 3), (0, 4)), ((0,), (2,))])
def test_two_sided_projections(loaded, measured, comm):
    """Interpolation at the point, and the same as states, with dashpots on dofs without mass."""
    M, K = chain(8)
    D, B, C = np.diag([3.0, 0.2, 0.0, 0.2, 1.0, 0.2, 0.0, 0.2]), unit(8, *loaded), np.eye(8)[list(measured)]
    basis = [hpcred.SecondOrderKrylov(frequency=1.0, order=1)]
    with (
        hpcred.SecondOrderModel(M, D, K, B, C, comm=comm) as model,
        hpcred.reduce(model, basis, damping=hpcred.GivenDamping(), **TWO_SIDED) as rom,
    ):
        assert not any("M is singular" in line for line in rom.record.warnings)
        found = hpcred.state_space(rom)
        count = static_coordinates(rom)
        moving = rom.size - count
        assert np.allclose(rom.M, np.diag([1.0] * moving + [0.0] * count), atol=1e-11)
        step = 1e-4
        for s in (2j * np.pi, 2j * np.pi * (1 + step)):  # values and first derivatives of both sides
            H = C @ np.linalg.solve(s * s * M + s * D + K, B)
            size = np.abs(H).max()
            assert np.abs(rom.transfer_function(s) - H).max() < 1e-10 * size
            inside = np.linalg.solve(s * np.eye(len(found["A"])) - found["A"], found["B"])
            assert np.abs(found["C"] @ inside + found["D"] - H).max() < 1e-9 * size
        assert len(loaded) == 1 or count == 2


def test_two_sided_projections_without_dampers():
    """All of what loads and outputs reach: exact at any frequency."""
    M, K = chain(8)
    B, C = unit(8, 0, 3), np.eye(8)[[2, 5]]
    with hpcred.SecondOrderModel(M, None, K, B, C) as model:
        rom = replace(hpcred.reduce(model, [hpcred.Krylov(1.0, 2)], **TWO_SIDED))
    for s in POINTS:
        assert np.allclose(rom.transfer_function(s), C @ np.linalg.solve(s * s * M + K, B), rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("rows, C, size", [((0, 3), None, 8), ((0,), np.eye(12)[[4]], 6)])
def test_irka(rows, C, size):
    """It interpolates at its mirrored poles, with forces and dashpots on dofs without mass."""
    M, K = chain(12)
    D, B = np.diag(np.tile([3.0, 0.4], 6)), unit(12, *rows)
    with hpcred.SecondOrderModel(M, D, K, B, C) as model:
        rom = replace(hpcred.IRKA(size=size, band=BAND, turns=200).reduce(model))
    assert not rom.record.warnings
    measured = B.T if C is None else C
    points, inputs, outputs = mirrored(rom, size // 2)
    for s, b, c in zip(points, inputs, outputs, strict=True):
        H, found = measured @ np.linalg.solve(s * s * M + s * D + K, B), rom.transfer_function(s)
        assert np.abs((H - found) @ b).max() < 1e-4 * np.abs(H).max()
        assert C is None or np.abs(c @ (H - found)).max() < 1e-4 * np.abs(H).max()


def test_viscoelastic_parts_on_dofs_without_mass():
    """As responses and as states."""
    M, K = chain()
    B, time, Kv = unit(6, 2, 3), 0.2, 30.0 * np.outer(unit(6, 2) - unit(6, 4), unit(6, 2) - unit(6, 4))
    law = hpcred.laws.Maxwell(factors=(1.0,), times=(time,))
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


def slender(count, damper):
    """K, M and D of a clamped beam without rotational inertia, with one dashpot (N s/m); forces act on two places."""
    h, rng = 1.0 / count, np.random.default_rng(1)
    k = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                  [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]]) / h**3  # fmt: skip
    K = np.zeros((2 * count + 2,) * 2)
    for e in range(count):
        K[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += k * rng.uniform(0.9, 1.1)
    K = K[2:, 2:]
    M, D = np.diag(np.tile([h, 0.0], count)), np.zeros_like(K)
    D[count - count % 2, count - count % 2] = damper
    return K, M, D, np.array([count - count % 2, 2 * count - 2])


@pytest.mark.parametrize("count, damper, warned", [(60, 3e-6, True), (60, 1.0, False), (6, 3e-6, False)])
def test_peaks_sharper_than_the_last_digits_of_K(count, damper, warned):
    """Right for K as stored, against 50 digits; what other last digits would do is said, with what helps."""
    K, M, D, rows = slender(count, damper)
    with hpcred.SecondOrderModel(M, D, K, unit(len(K), *rows)) as model:
        rom = hpcred.reduce(model, tolerance=1e-4, band=(0.0, 8.0))
    said = [line for line in rom.record.warnings if "last digits of K, where stiff parts cancel, move its" in line]
    assert rom.record.accuracy.reached and bool(said) == warned
    f = at_peaks(rom, 2)
    exact = np.array([exact_response(K, M, D, rows, at) for at in f])
    found = np.array([rom.transfer_function(2j * np.pi * at) for at in f])
    assert hpcred.relative_error(exact, found).max() < 1e-4
    other = with_other_last_digits(K)
    moved = hpcred.relative_error(exact, np.array([exact_response(other, M, D, rows, at) for at in f])).max()
    assert moved > 1e-3 if warned else moved < 1e-6


def test_a_check_beside_a_peak_that_the_last_digits_of_K_decide(tmp_path):
    """Against a full model with other last digits of K: the same of the result in memory and from its file, also
    without the basis."""
    K, M, D, rows = slender(60, 3e-6)
    B = unit(len(K), *rows)
    with hpcred.SecondOrderModel(M, D, K, B) as model, hpcred.SecondOrderModel(M, D, 1.001 * K, B) as softer:
        rom = hpcred.reduce(model, tolerance=1e-4, band=(0.0, 8.0))
        rom.save(tmp_path / "result.h5", basis=False)
        read = hpcred.read_result(tmp_path / "result.h5").reduced
        with hpcred.SecondOrderModel(M, D, with_other_last_digits(K), B) as other:
            found = hpcred.check_reduced(rom, other, 3, seed=1)
            assert hpcred.check_reduced(read, other, 3, seed=1).sentence == found.sentence
        assert max(found.measured) > found.bound and found.passed and max(found.digits) < 1.0
        assert "where the last digits of K decide" in found.sentence and "ABOVE" not in found.sentence
        for item in (rom, read):
            assert not hpcred.check_reduced(item, softer, 3, seed=1).passed


@pytest.mark.parametrize("measured, digits, passed, words", [
    (5e-5, 3.0, True, "largest error 0.005 %"), (5e-3, 8e-3, True, "where the last digits of K decide"),
    (0.5, 3.0, False, "NOT KNOWN at 1, where the last digits of the matrix K change the response by 100 % or more"),
    (0.2, np.inf, False, "NOT KNOWN at 1"), (0.2, 0.05, False, "ABOVE at 1"), (np.nan, np.inf, False, "ABOVE at 1"),
    (5.0, 0.2, False, "ABOVE at 1 of them, largest error"),
])  # fmt: skip
def test_no_model_is_good_since_the_digits_of_K_say_nothing(measured, digits, passed, words):
    check = hpcred.analysis.Check(seed=1, bound=1e-4, frequencies=(2.0,), estimated=(1e-5,), measured=(measured,),
                                  digits=(digits,))  # fmt: skip
    assert check.passed == passed and words in check.sentence


def test_a_free_motion_below_the_band_has_no_peak_to_warn_of():
    """Of a chain whose null motion round-off moves to 0.0008 Hz."""
    K = 1e8 * (2 * np.eye(40) - np.eye(40, k=1) - np.eye(40, k=-1))
    K[0, 0] = K[-1, -1] = 1e8
    with hpcred.SecondOrderModel(np.eye(40), 1e-7 * K, K, unit(40, 3)) as model:
        rom = hpcred.reduce(model, tolerance=1e-4, band=(1.0, 800.0))
    assert rom.record.accuracy.reached and not any("resonance at" in line for line in rom.record.warnings)
