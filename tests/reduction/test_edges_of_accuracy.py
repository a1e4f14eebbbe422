"""Models on which the accuracy was once claimed wrongly, or refused though it could be reached; against dense truth."""

import numpy as np
import pytest
from adaptive_models import Case, chain, estimated_and_true, fresh, unit, up_to
from helpers import dense_model, few_on_ranks

import hpcred
from hpcred import Caughey, Factoring, GivenDamping, LinearSolver
from hpcred.examples.linkage import Rod, beam_element
from hpcred.parallel.petsc import is_complex

pytestmark = pytest.mark.mpi


def rod(nodes=9, length=0.1):
    """K, M of a clamped rod along x, six directions a node."""
    k, m = beam_element([0, 0, 0], [length, 0, 0], Rod())
    K, M = np.zeros((6 * nodes,) * 2), np.zeros((6 * nodes,) * 2)
    for e in range(nodes - 1):
        part = slice(6 * e, 6 * e + 12)
        K[part, part] += k
        M[part, part] += m
    return K[6:, 6:], M[6:, 6:]


def reached(case, tolerance, comm, **more):
    """Reduce a case; hold what is said against dense truth, and return the accuracy and the size."""
    with case.model(comm) as model, hpcred.reduce(model, damping=case.damping, tolerance=tolerance, band=case.band,
                                                  **more) as rom:  # fmt: skip
        accuracy, size = rom.record.accuracy, rom.size
        _, true = estimated_and_true(case, rom, fresh(case, rom))
    assert accuracy.reached and true.max() <= tolerance
    return accuracy, size


@pytest.mark.parametrize("zeros", few_on_ranks([True, False]))
def test_a_damping_matrix_of_nothing_is_measured_as_none(comm, zeros):
    K, M = chain(12)
    with Case("D", K, M, unit(12, 3, 9), (0.0, 20.0), D=0.0 * K if zeros else 1e-300 * K).model(comm) as model:
        with hpcred.reduce(model, damping=GivenDamping(), tolerance=1e-4, band=(0.0, 20.0)) as rom:
            accuracy = rom.record.accuracy
        check = hpcred.check_reduced(rom, model, 3, seed=1)
    assert accuracy.reached and accuracy.loss_factor == 0.002 and check.passed
    assert "the damping matrix leaves modes of the band without damping" in accuracy.measured


@pytest.mark.mpi
@pytest.mark.costly
def test_what_a_damping_matrix_leaves_undamped_has_a_loss_factor(comm):
    """Dashpots across a rod, forces across it and along: all coordinates were kept, and nothing was reached."""
    K, M = rod()
    n = len(K)
    D = np.zeros((n, n))
    D[n - 5, n - 5] = D[n - 4, n - 4] = 50.0
    with Case("D", K, M, unit(n, n - 6, n - 5), (0.0, 8000.0), D=D).model(comm) as model:
        with hpcred.reduce(model, damping=GivenDamping(), tolerance=1e-4, band=(0.0, 8000.0)) as rom:
            accuracy, size = rom.record.accuracy, rom.size
        check = hpcred.check_reduced(rom, model, 5, seed=2)
    assert accuracy.reached and accuracy.beside_damping and accuracy.loss_factor == 0.002 and size < n / 2
    assert check.passed and np.allclose(check.estimated, check.measured, rtol=0.2, atol=1e-7)


@pytest.mark.parametrize("inclined", few_on_ranks([2e-7, 1e-5, 1e-8]))
@pytest.mark.costly
def test_loads_that_differ_by_little_keep_their_difference(comm, inclined):
    K, M = rod()
    n = len(K)
    B, Ct = np.zeros((n, 2)), unit(n, n - 5, n - 29)
    B[n - 6], B[n - 5, 1] = 1.0, inclined
    reached(Case("inclined", K, M, B, (0.0, 1000.0), Ct=Ct), 1e-3, comm)


@pytest.mark.costly
def test_a_basis_of_full_rank_is_smoothed_where_m_is_singular(comm):
    K, M = chain(40)
    M[5, 5] = 0.0
    eigenvalues = np.linalg.eigvals(np.linalg.solve(K, M)).real
    top = 1.02 / np.sqrt(np.sort(eigenvalues)[-20]) / (2 * np.pi)
    with Case("massless", K, M, unit(40, 0), (0.0, top)).model(comm) as model:
        with hpcred.reduce(model, tolerance=1e-2, band=(0.0, top)) as rom:
            accuracy = rom.record.accuracy
        check = hpcred.check_reduced(rom, model, 5, seed=1)
    assert accuracy.reached and check.passed


@pytest.mark.parametrize("top", few_on_ranks([11.023475, 11.0235, 11.02348]))
def test_narrow_bands_without_a_count_of_modes_take_few_points(comm, top):
    K, M = chain(20)
    D = 1e-4 * K
    D[3, 9] += 1.0
    D[9, 3] -= 1.0
    case = Case("narrow", K, M, unit(20, 2, 15), (11.02346, top), D=D, damping=GivenDamping())
    accuracy, _ = reached(case, 1e-3, comm)
    assert len(accuracy.points) <= 4
    assert all(case.band[0] * 0.99 <= point.frequency <= case.band[1] * 1.01 for point in accuracy.points)


def test_a_long_series_is_measured_as_it_is(comm):
    K, M = chain(40)
    w = 2 * np.pi * up_to(K, M, 10)[1]
    case = Case("series", K, M, unit(40, 3, 22), up_to(K, M, 10), damping=Caughey((0.01 * w, 0.01 / w, 1e-3 / w**3)))
    accuracy, _ = reached(case, 1e-4, comm)
    assert accuracy.measured.startswith("measured with the damping of the model") and not accuracy.loss_factor


def test_multigrid_finds_modes_that_no_load_moves(comm):
    """A block of square section with one force at a corner: half of its modes are not loaded."""
    if is_complex() or comm.size > 1:
        pytest.skip("tested elsewhere on several ranks and in both builds; this takes many solves")
    with hpcred.solid((3, 3, 3), inputs=1, comm=comm) as model:
        K, M, B = dense_model(model)
        band = 0.0, 1.05 * float(Case("", K, M, B, (0.0, 1.0)).frequencies[8])
        factoring = Factoring(solver=LinearSolver(kind="multigrid"))
        with hpcred.reduce(model, tolerance=1e-2, band=band, factoring=factoring) as rom:
            assert rom.record.accuracy.reached and rom.record.accuracy.proofs
            _, true = estimated_and_true(Case("", K, M, B, band), rom, np.linspace(*band, 50))
    assert true.max() <= 1e-2


def test_resonances_sharper_than_any_grid_are_looked_at(comm):
    """Damping ratios of 1e-6, and the zero of a response right beside a pole."""
    K, M = chain(30)
    case = Case("sharp", K, M, unit(30, 7), up_to(K, M, 9), Ct=unit(30, 19), damping=hpcred.Structural(2e-6))
    with case.model(comm) as model, hpcred.reduce(model, damping=case.damping, tolerance=1e-2, band=case.band) as rom:
        accuracy = rom.record.accuracy
        f = np.concatenate([case.frequencies[:9], rom.frequencies[rom.frequencies < case.band[1]]])
        near = np.outer(f, 1 + 1e-6 * np.linspace(-5, 5, 41)).ravel()
        _, true = estimated_and_true(case, rom, near[near < case.band[1]])
    assert accuracy.reached and true.max() <= 1e-2
