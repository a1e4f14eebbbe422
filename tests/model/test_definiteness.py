"""K and M that are not those of a body: of the other sign, or indefinite, against dense eigenvalues."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse
from helpers import dense_model

import hpcred
from hpcred.linalg.eigensolver import lowest_modes
from hpcred.model.definiteness import _signs, check_definite, growing, warnings_of_definiteness, zero_of
from hpcred.model.second_order_model import SecondOrderModel
from hpcred.parallel.petsc import is_complex

pytestmark = [pytest.mark.mpi, pytest.mark.filterwarnings("error")]

COMMANDS = {
    "modes": lambda model: hpcred.natural_modes(model, 4),
    "tolerance": lambda model: hpcred.reduce(model, tolerance=1e-3, band=(0.0, 0.1)),
    "band": lambda model: hpcred.reduce(model, [hpcred.Modes(band=(0.0, 0.1))]),
    "response": lambda model: hpcred.full_response(model, [0.01, 0.1]),
    "solves": lambda model: hpcred.frequency_response(model, [0.01, 0.1]),
    "counts": lambda model: hpcred.inspect(model, [0.1]),
}


def chain(size):
    """Springs of 1 N/m between the ground and masses of 1 kg in a row, held at both ends."""
    return scipy.sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(size, size)).tolil()


def model_of(comm, K, M):
    return SecondOrderModel.from_scipy(K, M, comm=comm).with_inputs([1, 2])


def test_quotients_are_the_ends_of_the_spectrum(comm):
    """Of a matrix with as many rows as there are steps, in units of its own in each row."""
    A = np.random.default_rng(1).standard_normal((24, 24))
    A, units = A + A.T + 4 * np.eye(24), 10.0 ** np.linspace(-4, 4, 24)
    scale = 1 / np.sqrt(np.abs(np.diag(A)))
    expected = np.linalg.eigvalsh(A * np.outer(scale, scale))
    with model_of(comm, A * np.outer(units, units), np.eye(24)) as model:
        assert model.extreme_quotients("K") == pytest.approx((expected[0], expected[-1]), rel=1e-8)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_stiffness_of_the_other_sign_is_asked_about(comm, command):
    with model_of(comm, -chain(40), scipy.sparse.eye(40)) as model:
        with pytest.raises(hpcred.InputError, match="K is negative definite, -K?"):
            COMMANDS[command](model)
        assert any("-K?" in sentence for sentence in hpcred.inspect(model)["warnings"])


@pytest.mark.parametrize("command", COMMANDS)
def test_an_indefinite_mass_is_refused(comm, command):
    """One pair of dofs among forty, and a mass between dofs of which one has none: all had ended in errors of SLEPc."""
    for diagonal, beside in ((1.0, 1.5), (0.0, 1.0)):
        M = scipy.sparse.eye(40).tolil()
        M[7, 7], M[7, 30], M[30, 7] = diagonal, beside, beside
        with model_of(comm, chain(40), M) as model:
            with pytest.raises(hpcred.InputError, match="M is indefinite"):
                COMMANDS[command](model)
            assert any("M is indefinite" in sentence for sentence in hpcred.inspect(model)["warnings"])


def test_a_mass_of_the_other_sign_is_asked_about(comm):
    with pytest.raises(hpcred.InputError, match="-M?"):
        model_of(comm, chain(40), -scipy.sparse.eye(40))


def test_the_eigensolver_says_what_it_is(comm):
    """Where nobody asked before: SLEPc's error of an indefinite inner product."""
    M = scipy.sparse.eye(40).tolil()
    M[7, 30] = M[30, 7] = 3.0
    with model_of(comm, chain(40), M) as model, pytest.raises(hpcred.ComputationError, match="is M positive"):
        lowest_modes(model.K, model.M, 3, 40, lambda x, y: x.copy(y))


def buckled():
    """A chain on soft springs of which those in the middle push: one eigenvalue a little below zero."""
    K = chain(400)
    K[200, 200] -= 0.012
    values = np.linalg.eigvalsh(K.toarray())
    assert -1e-4 < values[0] < -1e-7 and values[1] > 0
    return K, values


def test_a_soft_motion_that_grows_is_found(comm):
    """Too soft to be seen in a few products with K; modes had called it rigid."""
    K, values = buckled()
    with model_of(comm, K, scipy.sparse.eye(400)) as model:
        assert not warnings_of_definiteness(model)
        with pytest.raises(hpcred.InputError, match="1 negative eigenvalue") as error:
            hpcred.natural_modes(model, 4)
        assert f"-({np.sqrt(-values[0]) / 2 / np.pi:.4g} Hz)^2" in str(error.value)
        with hpcred.reduce(model, [hpcred.Modes(count=3)]) as rom:
            assert any("1 negative eigenvalue" in sentence for sentence in rom.record.warnings)
        if not is_complex():
            report = hpcred.inspect(model, [0.1])
            assert any("1 negative eigenvalue" in sentence for sentence in report["warnings"])


def test_poles_of_growing_motions_are_at_no_frequency(comm):
    """H of an indefinite K is what dense solves give; 0 Hz had been called a pole."""
    K = chain(30)
    K[10, 10] = -3.0
    with model_of(comm, K, scipy.sparse.eye(30)) as model:
        assert any("K is indefinite" in sentence for sentence in hpcred.inspect(model)["warnings"])
        found = hpcred.full_response(model, [0.0, 0.003, 0.006], tolerance=1e-8)
        exact = [np.linalg.inv(K.toarray() - (2 * np.pi * f) ** 2 * np.eye(30))[:2, :2] for f in found.frequencies]
        assert np.allclose(found.response, exact, rtol=1e-7)
        assert any("K is indefinite" in sentence for sentence in found.warnings)


@pytest.mark.parametrize("digits", [None, 10, 8])
def test_free_and_massless_bodies_are_not_warned_of(comm, linkage, digits):
    """Semidefinite matrices, and those whose digits were cut."""
    K, M, _ = dense_model(linkage)
    if digits:
        K, M = (np.vectorize(lambda value: float(f"{value:.{digits - 1}e}"))(mat) for mat in (K, M))
    M[4::6] = M[:, 4::6] = 0.0
    with SecondOrderModel.from_scipy(K, M, comm=comm) as model:
        assert warnings_of_definiteness(model) == []
        check_definite(model)


@pytest.mark.parametrize("digits", [None, 9])
def test_what_counts_as_a_negative_eigenvalue_is_a_share_of_the_others(comm, digits):
    """In any unit of force, and by the digits of K, of which an error in the last one moves eigenvalues by as much."""
    K = chain(40).toarray() * (1.0 + np.add.outer(np.arange(40), np.arange(40)) / 77)
    if digits:
        K = np.vectorize(lambda value: float(f"{value:.{digits - 1}e}"))(K)
    shares = []
    for unit in (1.0, 1e6):
        with model_of(comm, unit * K, np.eye(40)) as model:
            shares.append(zero_of(model) / (unit * np.trace(K) / 40))
            assert not growing(model, np.array([-0.9 * zero_of(model), unit]))
            assert "1 negative eigenvalue of" in growing(model, np.array([-1.1 * zero_of(model), unit]))
    assert shares[0] == pytest.approx(shares[1], rel=1e-6)
    low, high = (3e-8, 3e-7) if digits else (1e-12, 1e-8)
    assert low < shares[0] < high
    with model_of(comm, -K, np.eye(40)) as model:
        assert zero_of(model) == pytest.approx(shares[0] * np.trace(K) / 40, rel=1e-6)


@pytest.mark.parametrize(("key", "expected"), [("M", [0, 1]), ("K", [-1, 0])])
def test_of_an_unsymmetric_mass_no_sign_is_told(key, expected):
    """As of a term of a parameter; of K it is told, by its symmetric part."""
    asked = []
    model = SimpleNamespace(is_symmetric=asked.append, extreme_quotients=lambda key: (-1.0, 1e-17))
    assert list(_signs(model, key)) == expected and asked == ["M"] * (key == "M")
