"""The automatic reduction against dense truth: what is said of the error, its limits, ranks, frames and damping."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from adaptive_models import (
    Case,
    chain,
    estimated_and_true,
    fresh,
    hard_cases,
    massless_along,
    pair,
    random_case,
    tied_chains,
    unit,
    up_to,
)
from helpers import dense_model, few_on_ranks, to_dense

import hpcred
from hpcred import (
    Buckens,
    Caughey,
    GivenDamping,
    InputError,
    Krylov,
    ModalDamping,
    Modes,
    NoDamping,
    Rayleigh,
    Structural,
)
from hpcred.examples.linkage import FRAME, LOAD
from hpcred.fe.dofs import Dofs
from hpcred.model.second_order_model import SecondOrderModel
from hpcred.parallel.petsc import is_complex
from hpcred.reduction.search.goal import Adaptive
from hpcred.reduction.small.damping import measured_damping
from hpcred.reduction.small.pseudo_modal import Proportional

BAND = (0.0, 30000.0)  # of the clamped block with 144 dofs: three modes
CASES = hard_cases()
# whose reduction takes a second or more, or whose dense truth is no better than 1e-9
LONG = ("30 inputs", "30 inputs, Rayleigh", "90 modes", "localised modes", "other outputs, D", "gyroscopic D",
        "25 masses, 40 dashpots, one input", "double modes, one input", "25 masses, 40 dashpots", "other outputs",
        "double modes")
STIFF = "stiffness jump"


def agree(estimated, true):
    return ((estimated <= 2 * true) & (true <= 2 * estimated)).all()


def checked(case, tolerance, comm, groups=1, **limits):
    """Reduce a case, and hold what is said of the error against dense solves; returns the accuracy and the size."""
    adaptive = Adaptive(tolerance=tolerance, band=case.band, **limits)
    given = {"frame": case.frame, "damping": case.damping, "adaptive": adaptive, "groups": groups}
    with case.model(comm) as model, hpcred.reduce(model, **given) as rom:
        accuracy = rom.record.accuracy
        frequencies = np.append(fresh(case, rom), accuracy.worst)
        estimated, true = estimated_and_true(case, rom, frequencies)
        size = rom.size
    clear = true > 10 * accuracy.noise
    assert agree(estimated[clear], true[clear])
    if accuracy.reached:
        assert true.max() <= tolerance
        assert accuracy.largest + accuracy.noise <= tolerance
    else:
        assert accuracy.stopped in accuracy.sentence and accuracy.sentence.startswith("NOT REACHED")
        assert true.max() <= 1.05 * accuracy.largest + 3 * accuracy.noise
    if clear[-1]:
        assert 0.5 <= accuracy.largest / true.max() <= 3
    assert len(accuracy.points) <= 4 and len(accuracy.proofs) == len(accuracy.points) - groups + (groups > 1)
    # what was said at a point before it was factored; without inertia a proof may be what finds a mode
    for proof in accuracy.proofs[-1:] if is_complex() else accuracy.proofs:
        # far below the goal the round-off decides which column is the last one
        if proof.measured > max(10 * proof.uncertainty, 100 * accuracy.noise, 0.01 * tolerance):
            assert 0.5 <= proof.estimated / proof.measured <= 2
    return accuracy, size


@pytest.mark.parametrize("seed", [0, 2, 3, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, *range(4, 120)))])
def test_what_is_said_of_random_models_is_true(seed, comm):
    case, tolerance = random_case(seed)
    accuracy, _ = checked(case, tolerance, comm)
    assert accuracy.reached


@pytest.mark.parametrize("tolerance", [1e-3, pytest.param(1e-6, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name
                                  for name in CASES if name != STIFF])  # fmt: skip
def test_what_is_said_of_difficult_models_is_true(name, tolerance, comm):
    accuracy, _ = checked(CASES[name](), tolerance, comm)
    assert accuracy.reached or accuracy.stopped.startswith("limited by")
    assert accuracy.reached or name == "chains tied 1e-5, sensor beyond"  # whose response is 1e-5 of its parts
    assert accuracy.missing_modes == 0


@pytest.mark.parametrize("name", ["load near a node", "other outputs", "25 masses, weak dashpots",
                                  *(pytest.param(name, marks=pytest.mark.slow)
                                    for name in ("band above 0", "chains tied 1e-5"))])  # fmt: skip
def test_below_round_off_it_is_limited(name, comm):
    accuracy, _ = checked(CASES[name](), 1e-13, comm)
    assert not accuracy.reached and accuracy.stopped.startswith("limited by")
    assert " or more (tolerance 1e-13) over " in accuracy.sentence
    assert 1e-13 < accuracy.noise < 1e-9 and len(accuracy.points) <= 3


@pytest.mark.slow
def test_dofs_without_mass_are_kept_up_to_the_last_mode(comm):
    """Columns that are orthonormal in M have any round-off there, which grows from block to block until it hides all
    that is new: the response was wrong by orders and called proven. Those in M + tau^2 K see it."""
    K, M = chain(137)
    massless = [0, 4, 9, 14, 18, 27, 33, 36, 37, 44, 45, 60, 82, 102, 106, 108, 112, 120, 130, 132]
    M[massless, massless] = 0.0
    B = np.zeros((137, 3))
    B[[8, 53, 92], range(3)], B[[76, 121, 24], range(3)] = 1.0, (1.0, -1.0, 1.0)
    case = Case("without mass", K, M, B, (0.0, 56.9), damping=Rayleigh(0.0, 2e-7))
    accuracy, size = checked(case, 0.06, comm)
    assert accuracy.reached and size <= 137 - len(massless)
    case.B[44, 0] = 1.0  # a force at one of them takes a coordinate more than M has a rank for
    assert checked(case, 0.06, comm)[0].reached


@pytest.mark.parametrize("tolerance", [1e-2, 1e-6])
def test_lumped_masses(comm, tolerance):
    """All rotations without mass, as many programs lump: the random columns that look for hidden modes had brought
    round-off there that was larger than the response."""
    with hpcred.linkage(comm) as model:
        K, M, dofs = to_dense(model.K), to_dense(model.M), model.dofs
    lumped = np.zeros(len(M))
    for axis in range(3):
        rows = np.flatnonzero(dofs.direction == axis)
        lumped[rows] = M[np.ix_(rows, rows)].sum(axis=1)
    M = np.diag(lumped)
    with hpcred.SecondOrderModel.from_scipy(K, M, dofs=dofs, comm=comm) as model:
        model = model.with_inputs([LOAD])
        with hpcred.reduce(model, frame=FRAME, tolerance=tolerance, band=(0.0, 300.0)) as rom:
            accuracy = rom.record.accuracy
            measured = replace(rom, D=np.zeros_like(rom.K), loss_factor=accuracy.loss_factor)
            frequencies = np.linspace(1.0, 300.0, 31)
            reduced = hpcred.frequency_response(measured, frequencies)
        full = hpcred.frequency_response(model, frequencies, FRAME, Structural(accuracy.loss_factor))
    assert accuracy.reached and accuracy.noise < 1e-7
    assert hpcred.relative_error(full, reduced, accuracy.measure).max() <= accuracy.largest + accuracy.noise


def test_a_search_that_ended_at_its_first_point_says_so(comm):
    """Its estimate has no exact value behind it: here it is below the truth."""
    case = Case("short", *chain(40), unit(40, 3), up_to(*chain(40), 12))
    adaptive = Adaptive(tolerance=1e-6, band=case.band, columns=6)
    with case.model(comm) as model, hpcred.reduce(model, adaptive=adaptive) as rom:
        accuracy = rom.record.accuracy
    assert not accuracy.reached and not accuracy.proofs
    assert "not verified: the search ended before a second point" in accuracy.sentence
    assert is_complex() or "modes of the band not found" in accuracy.unproven


def test_modes_that_no_load_moves_are_found(comm):
    """Two equal chains: each mode is there twice, and only inertia tells of the second one."""
    K, M = tied_chains(1e-9)
    case = Case("tied", K, M, unit(80, 5), up_to(*chain(40), 12))
    if is_complex():
        pytest.skip("a complex build has no inertia")
    accuracy, _ = checked(case, 1e-4, comm)
    below = (case.frequencies < case.band[1]).sum()
    assert below == 26 and accuracy.points[0].modes_below == below
    assert accuracy.missing_modes == 0


def test_a_load_on_a_part_of_three_masses_exhausts_its_chain(comm):
    """Its fourth block has nothing left to solve for."""
    K, M = (scipy.linalg.block_diag(*parts) for parts in zip(chain(3), chain(9), strict=True))
    case = Case("decoupled", K, M, unit(12, 2), up_to(*chain(9), 6))
    accuracy, size = checked(case, 1e-6, comm)
    assert accuracy.reached and size <= 3


@pytest.mark.mpi
@pytest.mark.parametrize("name", few_on_ranks(["chains tied 1e-5", "other outputs", "25 masses, 40 dashpots"], 2))
def test_same_points_and_size_on_any_number_of_ranks_and_in_both_builds(name, comm):
    found = checked(CASES[name](), 1e-4, comm)
    accuracy, size = found
    points = [(round(point.frequency, 6), point.columns, point.modes_below) for point in accuracy.points]
    if is_complex():
        assert all(point[2] is None for point in points)
        assert "second verification" in accuracy.measured
        middle = sum(CASES[name]().band) / 2
        assert any(proof.frequency <= middle for proof in accuracy.proofs)
        return
    expected = EXPECTED[name]
    assert (size, len(points)) == expected, (size, points)


EXPECTED = {"chains tied 1e-5": (17, 2), "25 masses, 40 dashpots": (17, 2), "other outputs": (26, 2)}


@pytest.mark.mpi(ranks=(2, 3))
@pytest.mark.parametrize("name", ["load near a node", "other outputs", "band above 0", "chains tied 1e-8"])
def test_groups_of_ranks_take_several_points_at_once(name, comm):
    if is_complex():
        pytest.skip("the second proof, of which the groups make several, is tested above")
    accuracy, _ = checked(CASES[name](), 1e-4, comm, groups=comm.size)
    assert accuracy.reached and len(accuracy.points) == comm.size
    assert accuracy.points[-1].frequency > 0.99 * accuracy.band[1]
    assert all(point.modes_below is not None for point in accuracy.points)


@pytest.mark.mpi(ranks=(1,))
def test_complex_build_has_a_second_proof(solid):
    with hpcred.reduce(solid, tolerance=1e-4, band=(0, 30000)) as rom:
        accuracy = rom.record.accuracy
    assert accuracy.reached and (accuracy.points[0].modes_below is None) == is_complex()
    if is_complex():
        assert len(accuracy.proofs) == 2 and min(proof.frequency for proof in accuracy.proofs) < 15000


# the accuracy itself


def reduced(model, tolerance=1e-4, band=BAND, basis=(), frame=None, damping=None, **more):
    limits = {key: more.pop(key) for key in list(more) if key in Adaptive.__dataclass_fields__}
    adaptive = Adaptive(tolerance=tolerance, band=band, **limits)
    return hpcred.reduce(model, basis, frame, damping, adaptive=adaptive, **more)


def block_case(model, damping=None):
    K, M, B = dense_model(model)
    return Case("block", K, M, B, BAND, damping=damping or NoDamping())


LAWS = [
    NoDamping(), Rayleigh(), Rayleigh(10.0, 1e-7), Caughey((10.0, 1e-7)), Caughey((10.0, 1e-7, 1e-17)),
    ModalDamping(ratio=0.02), ModalDamping(table=((0.0, 0.01), (20000.0, 0.03))), Structural(0.04), Structural(0.0),
]  # fmt: skip


@pytest.mark.parametrize("damping", LAWS, ids=repr)
def test_all_damping_laws(solid, damping):
    case = block_case(solid, damping)
    with reduced(solid, damping=damping) as rom:
        accuracy = rom.record.accuracy
        estimated, true = estimated_and_true(case, rom, np.append(fresh(case, rom), accuracy.worst))
    assert accuracy.reached and true.max() <= 1e-4
    clear = true > 10 * accuracy.noise
    assert clear.any() and agree(estimated[clear], true[clear])


def test_damping_that_is_measured_with():
    def measured(damping):
        return measured_damping(damping, 1e-3, (0.0, 100.0))[0]

    assert measured(NoDamping()) == measured(Rayleigh()) == Proportional(eta=2e-3)
    assert measured(Rayleigh(2.0, 1e-5)) == measured(Caughey((2.0, 1e-5))) == Proportional(2.0, 1e-5)
    assert measured(Structural(0.04)) == Proportional(eta=0.04)
    assert measured(ModalDamping(table=((0.0, 0.03), (50.0, 0.01)))).eta == pytest.approx(0.02)
    assert measured(Caughey((2.0, 1e-5, 1e-12))) == Proportional(2.0, 1e-5, higher=(1e-12,))
    assert measured(Rayleigh(0.0, 1e-13)) == Proportional(eta=2e-3)  # no damping to speak of
    assert measured(Rayleigh(1e-10, 1e-13)) == Proportional(eta=2e-3)  # a ratio of 3e-12 at least
    assert measured(Rayleigh(1e-3, 1e-8)) == Proportional(1e-3, 1e-8)  # of 3e-6


def test_the_curve_its_mean_and_its_largest_value_belong_together(solid):
    with reduced(solid) as rom:
        accuracy = rom.record.accuracy
        f, eps = np.array(accuracy.frequencies), np.array(accuracy.eps)
        assert (np.diff(f) > 0).all() and f[0] == BAND[0] and f[-1] == BAND[1]
        assert eps.max() <= accuracy.largest <= 1.2 * eps.max() + 3e-5
        assert accuracy.worst == f[eps.argmax()]
        assert accuracy.mean == pytest.approx(((eps[1:] + eps[:-1]) / 2 * np.diff(f)).sum() / (f[-1] - f[0]))
        assert accuracy.highest == pytest.approx(rom.frequencies.max())
        assert accuracy.uncompressed_size == sum(point.columns for point in accuracy.points) > rom.size
        assert "(tolerance 0.01 %) over 0 to 30000 Hz" in accuracy.sentence


def test_components_of_the_user_come_first(solid):
    with reduced(solid, basis=[Modes(count=4), Krylov(1000.0, 1)]) as rom, reduced(solid) as alone:
        accuracy = rom.record.accuracy
        assert "lowest modes" in rom.record.components[0].where
        assert accuracy.reached and accuracy.uncompressed_size == 10 + sum(point.columns for point in accuracy.points)
        assert accuracy.points[0].columns < alone.record.accuracy.points[0].columns
        case = block_case(solid)
        _, true = estimated_and_true(case, rom, fresh(case, rom))
        assert true.max() <= 1e-4
    # a basis that has it all already
    with reduced(solid, basis=[Krylov(20000.0, 20)]) as rom:
        assert rom.record.accuracy.reached and rom.record.accuracy.uncompressed_size < 80


@pytest.mark.parametrize("limits, why", [
    ({"tolerance": 1e-12, "factorisations": 2, "columns": 20}, "with 20 columns"),
    ({"tolerance": 1e-6, "size": 8}, "with 8 coordinates"),
    ({"tolerance": 1e-6, "seconds": 1e-4}, "after 0.0001 s"),
    ({"tolerance": 1e-6, "drop_above": 40000.0}, "without the pseudo-frequencies above 40000 Hz"),
])  # fmt: skip
def test_limits_end_with_a_model_that_says_so(solid, limits, why):
    case = block_case(solid)
    with reduced(solid, **limits) as rom:
        accuracy = rom.record.accuracy
        assert not accuracy.reached and accuracy.stopped.startswith(why)
        assert accuracy.sentence.startswith("NOT REACHED")
        assert rom.size >= 1 and np.isfinite(rom.K).all()
        if "size" in limits:
            assert rom.size == 8
        if len(accuracy.points) > 1:  # what is said of it is true all the same
            estimated, true = estimated_and_true(case, rom, np.append(fresh(case, rom), accuracy.worst))
            assert 0.5 <= accuracy.largest / true.max() <= 2
            assert agree(estimated, true)


def test_too_few_factorisations(comm):
    K, M = chain(80)
    case = Case("70 modes", K, M, unit(80, 3, 37), up_to(K, M, 70))
    adaptive = Adaptive(tolerance=1e-6, band=case.band, factorisations=2, columns=1000)
    from hpcred.reduction.search import judging as module

    with pytest.MonkeyPatch.context() as patch, case.model(comm) as model:
        patch.setattr(module, "COLUMNS", 12)
        patch.setattr(module, "AHEAD", 4)
        with hpcred.reduce(model, adaptive=adaptive) as rom:
            assert rom.record.accuracy.stopped == "after 2 factorisations"
        with hpcred.reduce(model, adaptive=replace(adaptive, factorisations=14)) as rom:
            assert rom.record.accuracy.reached and 3 <= len(rom.record.accuracy.points) <= 8
            _, true = estimated_and_true(case, rom, fresh(case, rom))
            assert true.max() <= 1e-6


def test_points_of_the_user_and_points_on_eigenfrequencies(solid):
    with hpcred.reduce(solid, [Modes(count=3)]) as rom:
        third = float(rom.frequencies[2])
    with reduced(solid, points=(5000.0,)) as rom:
        assert [point.frequency for point in rom.record.accuracy.points][:2] == [5000.0, 30000.0]
    with reduced(solid, points=(third,)) as rom:
        moved = rom.record.accuracy.points[0].frequency
        assert rom.record.accuracy.reached and 1e-4 < abs(moved / third - 1) < 0.01
    with reduced(solid, band=(0.0, third)) as rom:  # the first point at the end of the band
        assert rom.record.accuracy.reached
        assert 1e-4 < abs(rom.record.accuracy.points[0].frequency / third - 1) < 0.01


def test_refused():
    for wrong in ({"tolerance": 0.0}, {"tolerance": 2.0}, {"band": (5.0, 5.0)}, {"band": (-1.0, 5.0)},
                  {"factorisations": 1}, {"zeta0": 1.0}, {"columns": 0}, {"points": (-3.0,)}):  # fmt: skip
        with pytest.raises(InputError):
            Adaptive(**{"tolerance": 1e-4, "band": (0.0, 10.0), **wrong})


def test_loads_and_sensors_without_effect_are_refused(comm):
    K, M = chain(20)
    case = Case("chain", K, M, np.zeros((20, 1)), (0.0, 10.0))
    with case.model(comm) as model, pytest.raises(InputError, match="no input loads"):
        hpcred.reduce(model, tolerance=1e-3, band=case.band)
    case.B, case.Ct = unit(20, 3), np.zeros((20, 1))
    with case.model(comm) as model, pytest.raises(InputError, match="no output measures"):
        hpcred.reduce(model, tolerance=1e-3, band=case.band)
    case = Case("apart", *tied_chains(0.0), unit(80, 5), (0.0, 8.0), Ct=unit(80, 47))
    with case.model(comm) as model, pytest.raises(InputError, match="no output measures what the inputs move"):
        hpcred.reduce(model, tolerance=1e-3, band=case.band)


def free_truth(model, damping, frequencies):
    """The elastic response of a free body, by its modes."""
    K, M, B = dense_model(model)
    root = np.linalg.inv(np.linalg.cholesky(M)).T
    eigenvalues, vectors = np.linalg.eigh(root.T @ K @ root)
    shapes = (root @ vectors)[:, 6:].T @ B
    s = 2j * np.pi * np.asarray(frequencies)[:, None]
    factor = 1 / ((1 + 1j * damping.eta + s * damping.beta) * eigenvalues[6:] + s * s + s * damping.alpha)
    return np.einsum("ki,sk,kj->sij", shapes, factor, shapes)


@pytest.mark.parametrize("damping", [NoDamping(), Rayleigh(10.0, 1e-7)], ids=["undamped", "Rayleigh"])
def test_free_body_in_the_buckens_frame(comm, damping):
    band = (0.0, 60000.0)
    with hpcred.solid((4, 2, 3), inputs=3, clamped=False, comm=comm) as model:
        with reduced(model, band=band, frame=Buckens(), damping=damping) as rom:
            accuracy, damped = rom.record.accuracy, measured_damping(damping, 1e-3, band)[0]
            frequencies = np.append(np.random.default_rng(0).uniform(*band, 20), accuracy.worst)
            H = free_truth(model, damped, frequencies)
            s = 2j * np.pi * frequencies
            a, b = 1 + 1j * damped.eta + s * damped.beta, s * s + s * damped.alpha
            A = a[:, None, None] * rom.K + b[:, None, None] * rom.M
            Hr = rom.C @ np.linalg.solve(A, np.broadcast_to(rom.B.astype(complex), (len(s), *rom.B.shape)))
            true = np.linalg.norm(H - Hr, axis=(1, 2)) / np.linalg.norm(H, axis=(1, 2))
            assert accuracy.reached and true.max() <= 1e-4
            assert 0.5 <= accuracy.largest / true.max() <= 3
            if not is_complex():  # elastic modes only
                assert accuracy.points[0].modes_below == 3
        with pytest.raises(InputError, match="the body is free"):
            reduced(model, band=band)
        with reduced(model, band=(10000.0, 60000.0)) as rom:  # with its rigid-body modes
            assert rom.record.accuracy.reached and rom.record.accuracy.missing_modes == 0


def test_symmetric_load_on_a_free_chain_that_moves_no_rigid_body(comm):
    """Self-equilibrated loads: what is left of the rigid-body part is round-off and no load."""
    K, M = chain(30)
    K[0, 0] -= 1e4
    K[-1, -1] -= 1e4
    case = Case("free chain", K, M, pair(30, 4, 25)[:, None], (0.5, 10.0))
    assert checked(case, 1e-5, comm)[0].reached


def test_forces_on_dofs_without_mass_where_the_basis_has_all_modes(comm):
    """A basis orthonormal in M had no room for the static deflection of that dof."""
    K, M = chain(14)
    M[-1, -1] = 0.0
    band = 0.0, 1 / (2 * np.pi * np.sqrt(np.sort(scipy.linalg.eigvalsh(M, K))[-8]))
    for beside in (5, 12, 13):
        assert checked(Case("force beside it", K, M, unit(14, beside), band), 1e-4, comm)[0].reached


@pytest.mark.parametrize("t", [(0.0, 1.0), (0.6, 0.8)], ids=["axis", "skew"])
def test_loads_along_directions_without_mass(comm, t):
    """As of torsion of beams without inertia about their axes. M had been called indefinite where t is skew."""
    t, across = np.array(t), np.array([-t[1], t[0]])
    for load, tolerance in ((t, 1e-4), (across, 1e-4), (across + t, 1e-9)):
        assert checked(massless_along(t, load), tolerance, comm)[0].reached
    case = massless_along(t, across)
    case.B = np.hstack([case.B, massless_along(t, t).B])
    with case.model(comm) as model, hpcred.reduce(model, [Krylov(2.0, 2)]) as rom:
        assert not rom.record.warnings and rom.M[-1, -1] == 0.0
        s = 4j * np.pi
        H = case.B.T @ np.linalg.solve(s * s * case.M + case.K, case.B)
        assert np.abs(rom.transfer_function(s) - H).max() < 1e-10 * np.abs(H).max()


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("part, tolerance", few_on_ranks([(1e-5, 1e-7), (1e-2, 1e-3), (1e-2, 1e-7), (1e-5, 1e-3)]))
def test_small_parts_of_loads_along_directions_without_mass(comm, part, tolerance):
    """A small part of the load acts along directions without mass, whose deflection counts."""
    t, across = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    case = massless_along(t, across + part * t)
    with case.model(comm) as model, hpcred.reduce(model, tolerance=tolerance, band=case.band) as rom:
        accuracy = rom.record.accuracy
        true = estimated_and_true(case, rom, fresh(case, rom))[1].max()
    assert accuracy.reached and true <= accuracy.largest + 1.1 * accuracy.noise


def test_a_store_serves_models_with_directions_without_mass(comm, tmp_path):
    case = massless_along((0.6, 0.8), (0.6, 0.8))
    case.B = np.hstack([case.B, massless_along((0.6, 0.8), (-0.8, 0.6)).B])
    found = []
    for _ in range(2):
        store = hpcred.PointStore(tmp_path)
        with case.model(comm) as model, hpcred.reduce(model, [Krylov(2.0, 2)], store=store) as rom:
            found.append((rom.transfer_function(4j * np.pi), len(rom.record.factorisations)))
    assert found[1][1] == 0 and np.allclose(found[0][0], found[1][0], rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("seed, n, close", [(8, 20, 8), *(pytest.param(k, 40, 16, marks=pytest.mark.slow)
                                                          for k in (2, 5, 8))])  # fmt: skip
def test_modes_of_a_cluster_that_dashpots_leave_alone(comm, seed, n, close):
    """Dashpots damp all but two combinations of so many close modes: their sharp resonances lie between the undamped
    frequencies, where the error was twice the tolerance and more, and nobody looked."""
    rng = np.random.default_rng(seed)
    q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    omega = np.append(100 * (1 + 1e-3 * rng.standard_normal(close)), 10 ** rng.uniform(2.2, 4, n - close))
    X = rng.standard_normal((n, close - 2))
    K, M, D = (q * omega**2) @ q.T, np.eye(n), 30 * X @ X.T
    case = Case("cluster", (K + K.T) / 2, M, rng.standard_normal((n, 1 + seed % 4)), (1.6, 160.0), D=D,
                damping=GivenDamping())  # fmt: skip
    poles = np.linalg.eigvals(np.block([[np.zeros((n, n)), M], [-case.K, -D]]))
    sharp = poles[(poles.imag > 0) & (poles.imag < 1000) & (np.abs(poles.real) < 1e-3 * poles.imag)].imag / 2 / np.pi
    assert len(sharp) == 2
    asked = {"damping": GivenDamping(), "tolerance": 1e-3, "band": case.band}
    with case.model(comm) as model, hpcred.reduce(model, **asked) as rom:
        assert rom.record.accuracy.reached
        _, true = estimated_and_true(case, rom, np.outer([0.9999, 1.0, 1.0001], sharp).ravel())
        check = hpcred.check_reduced(rom, model, 1, seed=seed)
    assert true.max() <= 1e-3
    assert check.passed and any(np.abs(f / sharp - 1).min() < 3e-4 for f in check.frequencies)


@pytest.mark.mpi
@pytest.mark.costly
def test_a_band_beyond_all_that_the_mesh_follows_is_warned_of(comm):
    with hpcred.solid((2, 1, 1)) as model:
        top = float(hpcred.natural_modes(model, model.size).frequencies.max())
        for upper, doubted in ((20 * top, True), (top, False)):
            with hpcred.reduce(model, tolerance=0.5, band=(0.0, upper)) as rom:
                assert any(text.startswith("band: it ends at") for text in rom.record.warnings) == doubted


@pytest.mark.mpi
@pytest.mark.costly
def test_a_damping_matrix_that_is_not_asked_for_is_named(linkage):
    with linkage.shared() as plain, plain.with_damping_matrix(plain.K.copy()) as damped:
        for model, damping, said in ((damped, NoDamping(), True), (damped, None, False), (plain, None, False)):
            with hpcred.reduce(model, [Modes(count=7)], FRAME, damping) as rom:
                assert any("has a damping matrix, which kind = 'given' takes" in text
                           for text in rom.record.warnings) == said  # fmt: skip


def test_masses_at_one_node(comm, linkage):
    """A free body whose elastic motions move no mass, which is static, and a chain with one mass."""
    K, M, _ = dense_model(linkage)
    one = np.zeros_like(M)
    one[range(36, 42), range(36, 42)] = [1.0, 1.0, 1.0, 0.01, 0.01, 0.01]
    labels = [np.concatenate(comm.allgather(part)) for part in (linkage.dofs.node, linkage.dofs.direction)]
    dofs = Dofs(*labels, np.concatenate(comm.allgather(linkage.dofs.position)))
    free = SecondOrderModel.from_scipy(K, one, dofs=dofs, comm=comm).with_inputs([(1, "x"), (20, "z")])
    with free as model, hpcred.reduce(model, tolerance=1e-3, band=(0.0, 100.0), frame=Buckens()) as rom:
        assert rom.record.accuracy.reached and not rom.M.any()
        H = hpcred.frequency_response(model, [10.0], Buckens(), Structural(rom.record.accuracy.loss_factor))
        measured = replace(rom, loss_factor=rom.record.accuracy.loss_factor)
        assert np.abs(hpcred.frequency_response(measured, [10.0]) - H).max() < 1e-3 * np.abs(H).max()
    K, M = 2 * np.eye(9) - np.eye(9, k=1) - np.eye(9, k=-1), np.diag([0.0] * 4 + [1.0] + [0.0] * 4)
    for load, size in ((5, 1), (3, 2)):
        model = SecondOrderModel.from_scipy(K, M, comm=comm).with_inputs([load])
        with model, hpcred.reduce(model, tolerance=1e-9, band=(0.0, 0.1)) as rom:
            f = np.linspace(0.0, 0.09, 7)
            H = [np.linalg.inv(K - (2 * np.pi * x) ** 2 * M)[load - 1, load - 1] for x in f]
            assert rom.size == size and np.allclose(rom.transfer_function(2j * np.pi * f)[:, 0, 0], H, rtol=1e-9)


@pytest.mark.mpi
@pytest.mark.costly
def test_a_small_damped_model_is_taken_whole(comm):
    """Blocks would be dearer: the first point has all coordinates, and the model is compressed from the exact one."""
    K, M = chain(40)
    D = 0.05 * np.diag(np.random.default_rng(2).uniform(size=40)) + 1e-4 * K
    case = Case("damped", K, M, unit(40, 3, 22), up_to(K, M, 20), D=D, damping=GivenDamping())
    accuracy, size = checked(case, 1e-4, comm)
    assert accuracy.reached and accuracy.missing_modes in (0, None) and size < 40  # complex builds count none
    assert accuracy.uncompressed_size == accuracy.points[0].columns == 40
