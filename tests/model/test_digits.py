"""The digits of K: a slender beam whose entries are rounded, against the frequencies of the entries before."""

from contextlib import closing

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from helpers import block_from, few_on_ranks

import hpcred
from hpcred.linalg.blocks import create_block, local_rows
from hpcred.model.digits import _errors_of_eigenvalues, digits_of, warnings_of_digits

pytestmark = pytest.mark.mpi(ranks=(1, 3))


def beam(count, even=False):
    """K and M of a clamped beam of Euler and Bernoulli, of elements that are alike or not."""
    h, rng = 1.0 / count, np.random.default_rng(3)
    k = 1.37 / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                                [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]])  # fmt: skip
    m = 2.7 * h * np.diag([0.5, h * h / 24, 0.5, h * h / 24])
    K, M = np.zeros((2 * count + 2,) * 2), np.zeros((2 * count + 2,) * 2)
    for e in range(count):
        part = slice(2 * e, 2 * e + 4)
        K[part, part] += k * (1.0 if even else rng.uniform(0.9, 1.1))
        M[part, part] += m
    return K[2:, 2:], M[2:, 2:]


def of(comm, K, M):
    return hpcred.SecondOrderModel.from_scipy(scipy.sparse.csr_matrix(K), scipy.sparse.csr_matrix(M), comm=comm)


def rounded(A, digits):
    return np.vectorize(lambda value: float(f"{value:.{digits - 1}e}"))(A)


def error_of(K, M, digits):
    """Of the lowest frequency, relative, by rounding."""
    exact, found = (scipy.linalg.eigvalsh(A, M, subset_by_index=(0, 0))[0] for A in (K, rounded(K, digits)))
    return abs(found / exact - 1) / 2


@pytest.mark.parametrize("digits", few_on_ranks([10, 9, 12, 14]))
@pytest.mark.costly
def test_what_the_digits_leave_is_said(comm, digits):
    """Never less than a fifth of what rounding does, nor more than thirty times."""
    K, M = beam(80)
    error = error_of(K, M, digits)
    with of(comm, rounded(K, digits), M) as model, model.with_inputs([1]) as model:
        assert digits_of(model.K) == digits and digits_of(model.M) is None
        assert hpcred.inspect(model)["sentences"][-1].startswith(f"K has {digits} digits; ") == (digits < 13)
        with closing(hpcred.natural_modes(model, 3)) as found, hpcred.reduce(model, [hpcred.Modes(count=3)]) as rom:
            said = [line for line in rom.record.warnings if "digits" in line]
            assert list(found.warnings) == said
            f = found.frequencies[0] * np.array([0.5, 0.9])
            assert [line for line in hpcred.full_response(model, f).warnings if "digits" in line] == said
        with model.with_outputs([3]) as both:
            two_sided = {"projection": "two_sided", "allow_unstable": True}
            with hpcred.reduce(both, [hpcred.Modes(count=3)], **two_sided) as rom:
                assert [line for line in rom.record.warnings if "digits" in line] == said
        if digits == 14:
            assert error < 1e-6 and not said
            return
        (sentence,) = said
        assert f"K has {digits} digits" in sentence
        assert error / 5 < float(sentence.split("up to about ")[1].split()[0]) < 30 * error
    with of(comm, 1e3 * rounded(K, digits), M) as other:  # as in other units
        assert digits_of(other.K) == digits


def test_entries_with_all_digits_are_not_warned_of(comm):
    K, M = beam(80)
    for A in (K, np.round(K), rounded(K, 6), np.diag(np.arange(1.0, 161.0))):
        with of(comm, A, M) as model:
            assert digits_of(model.K) is None
    K, M = beam(20, even=True)  # few values
    with of(comm, rounded(K, 9), M) as model:
        assert digits_of(model.K) is None


def test_twelve_modes_are_looked_at(comm):
    """Of which one has a frequency far below those of elements; squares of Inf do not count."""
    K, M = beam(80)
    with of(comm, rounded(K, 9), M) as model:
        block = create_block(model.K, 13)
        with local_rows(block) as rows:
            rows[...] = 1.0
        for place, found in ((0, 1), (11, 1), (12, 0)):
            eigenvalues = np.full(13, np.inf)
            eigenvalues[place] = 1e-3
            assert len(warnings_of_digits(model, model.K, eigenvalues, block)) == found
        block.destroy()


def test_errors_of_eigenvalues_follow_the_diagonal_that_is_rounded(comm):
    """In proportion to what random last digits of the diagonal do to them."""
    rng = np.random.default_rng(8)
    K = np.diag([1.0, 30.0, 2.0, 500.0, 7.0, 90.0]) + 0.3 * np.ones((6, 6))
    eigenvalues, X = np.linalg.eigh(K)
    noise = 1e-6 * rng.uniform(-1, 1, (4000, 6))
    true = np.linalg.eigvalsh(K + noise[:, :, None] * np.diag(np.diag(K))) - eigenvalues
    with hpcred.SecondOrderModel.from_scipy(K, np.eye(6), comm=comm) as model:
        errors = _errors_of_eigenvalues(model.K, 5, block_from(model.K, X), 7)
    ratios = errors / true.std(axis=0)[:5]
    assert ratios == pytest.approx(ratios[0], rel=0.05)
