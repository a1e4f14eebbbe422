"""Outputs that are velocities, accelerations and mixtures, beside dense NumPy."""

import numpy as np
import pytest
from mpi4py import MPI

import hpcred
from tests import adaptive_models as am

pytestmark = pytest.mark.mpi


def case(seed, n=20):
    """A chain with Rayleigh damping as dense matrices, B (n, 2), and C, Cv, Ca (4, n): drive-point acceleration,
    velocity elsewhere, a mixed row of all three, displacement."""
    rng = np.random.default_rng(seed)
    K, M = am.chain(n, rng=rng, spread=0.5)
    B = np.zeros((n, 2))
    B[[n // 4, n - 1], [0, 1]] = 1.0
    C, Cv, Ca = np.zeros((3, 4, n))
    Ca[0, n - 1] = 1.0
    Cv[1, n // 2] = 1.0
    C[2, 3], Cv[2, 7], Ca[2, n // 3] = 100.0, 1.0, 0.02
    C[3, n // 4] = 1.0
    return M, 2.0 * M + 1e-5 * K, K, B, C, Cv, Ca


def dense(M, D, K, B, C, Cv, Ca, frequencies):
    s = 2j * np.pi * np.asarray(frequencies)[:, None, None]
    states = np.linalg.solve(s * s * M + s * D + K, np.broadcast_to(B + 0j, (len(s), *B.shape)))
    return (C + s * Cv + s * s * Ca) @ states


FREQUENCIES = np.linspace(0.5, 12.0, 60)


def model_of(given):
    M, D, K, B, C, Cv, Ca = given
    return hpcred.SecondOrderModel(M, D, K, B, C, Cv=Cv, Ca=Ca)


def close(found, expected, to):
    size = np.abs(expected).max(axis=(0, 2), keepdims=True)
    return (np.abs(found - expected) <= to * size).all()


@pytest.mark.mpi
@pytest.mark.costly
def test_responses_of_the_full_model_are_those_of_dense_matrices():
    given = case(1)
    with model_of(given) as model:
        assert close(hpcred.frequency_response(model, FREQUENCIES), dense(*given, FREQUENCIES), 1e-10)
        found = hpcred.full_response(model, FREQUENCIES, tolerance=1e-8)
        assert close(found.response, dense(*given, FREQUENCIES), 1e-7)


@pytest.mark.mpi
@pytest.mark.costly
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 4))])
def test_reduced_responses_hold_the_tolerance(seed):
    given = case(seed)
    with model_of(given) as model, hpcred.reduce(model, tolerance=1e-4, band=(0.0, 12.0)) as reduced:
        assert reduced.record.accuracy.reached
        assert reduced.size < model.size
        H, expected = reduced.frequency_response(FREQUENCIES), dense(*given, FREQUENCIES)
        assert close(H, expected, 1e-3)
        check = hpcred.check_reduced(reduced, model, 8, seed=3)
        assert check.passed, check.sentence


def test_a_mixture_whose_displacement_nothing_moves():
    """c^T q + d^T q' where c^T q is zero in every motion: it stays a mixture in estimates and checks."""
    K, M = np.diag([1.0, 4.0, 9.0, 1e4]), np.eye(4)
    K[0, 1] = K[1, 0] = -0.5
    C, Cv, B = np.zeros((1, 4)), np.zeros((1, 4)), np.eye(4)[:, :1]
    C[0, 3], Cv[0, 1] = 1.0, 1.0
    model = hpcred.SecondOrderModel(M, 1e-3 * K, K, B, C, Cv=Cv)
    reduced = hpcred.reduce(model, tolerance=1e-3, band=(0.01, 0.3))
    assert reduced.record.accuracy.reached and hpcred.check_reduced(reduced, model, 5, seed=1).passed


@pytest.mark.costly
def test_a_pure_derivative_has_the_error_of_its_displacement():
    M, D, K, B, *_ = case(2)
    rows = B.T
    found = []
    for given in ({"C": rows}, {"Cv": rows}, {"Ca": rows}):
        with hpcred.SecondOrderModel(M, D, K, B, **given) as model, hpcred.reduce(
            model, hpcred.Modes(count=6)
        ) as reduced:
            found.append(reduced.frequency_response(FREQUENCIES))
    s = 2j * np.pi * FREQUENCIES[:, None, None]
    assert close(found[1], s * found[0], 1e-12) and close(found[2], s * s * found[0], 1e-12)


def test_result_files_keep_them(tmp_path):
    path = MPI.COMM_WORLD.bcast(tmp_path) / "result.h5"
    with model_of(case(3)) as model, hpcred.reduce(model, tolerance=1e-3, band=(0.0, 8.0)) as reduced:
        reduced.save(path)
        again = hpcred.read_result(path).reduced
        assert (again.Cv == reduced.Cv).all() and (again.Ca == reduced.Ca).all()
        assert (again.frequency_response(FREQUENCIES) == reduced.frequency_response(FREQUENCIES)).all()


def test_model_files_keep_them(tmp_path):
    path = MPI.COMM_WORLD.bcast(tmp_path) / "model.h5"
    given = case(6)
    with model_of(given) as model:
        hpcred.write_model(path, model)
    with hpcred.read_model(path) as again:
        assert close(hpcred.frequency_response(again, FREQUENCIES), dense(*given, FREQUENCIES), 1e-10)


@pytest.mark.mpi
@pytest.mark.costly
def test_state_space_has_a_feed_through():
    with model_of(case(4)) as model, hpcred.reduce(model, tolerance=1e-3, band=(0.0, 8.0)) as reduced:
        found = hpcred.state_space(reduced)
        A, B, C, D = (found[key] for key in "ABCD")
        assert np.abs(D[0]).max() > 0 and not D[1].any()
        s = 2j * np.pi * 3.3
        assert np.allclose(C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D, reduced.transfer_function(s), rtol=1e-9)


@pytest.mark.parametrize("kind", ["displacements", "velocities", "others"])
def test_outputs_where_inputs_act_are_measured_as_one_with_them(comm, kind):
    """Velocities there have the states of the inputs; a mixed output, or one elsewhere, has others."""
    n = 12
    K, M = am.chain(n)
    B = am.unit(n, 3, 9) * [1.0, 1e-3]
    rows = B.T if kind != "others" else am.unit(n, 3, 8).T
    C, Cv = (rows, None) if kind == "displacements" else (None, rows)
    model = hpcred.SecondOrderModel(M, 0.5 * M + 1e-4 * K, K, B, C, Cv=Cv, comm=comm)
    with model, hpcred.reduce(model, tolerance=1e-4, band=(0.0, 12.0)) as rom:
        accuracy = rom.record.accuracy
        exact = dense(M, 0.5 * M + 1e-4 * K, K, B, *(np.zeros((2, n)) if rows is None else rows for rows in (C, Cv)),
                      np.zeros((2, n)), FREQUENCIES)  # fmt: skip
        assert accuracy.reached and (accuracy.measure.drive == (0, 1)) == (kind != "others")
        error = np.abs(rom.transfer_function(2j * np.pi * FREQUENCIES) - exact)
        # over drive points: 1 and 1e-3 are the sizes of the two loads
        scale = np.outer([1.0, 1e-3], [1.0, 1e-3]) if kind != "others" else np.array([[1.0, 1e-3]] * 2)
        assert (error / scale).max() < 2e-4 * (np.abs(exact) / scale).max()
