"""The operator of terms against its sum written out in NumPy: at(s), map, apply, projections, digests."""

import numpy as np
import pytest
from helpers import to_dense

import hpcred
from hpcred.model.operator import NOTHING, Law, Operator, Power, Term

S = np.array([0.3 + 2.0j, 1.7j, 40.0])
MAXWELL = hpcred.laws.Maxwell([0.5, 0.8], [1e-2, 3e-1], 1.0)
ZENER = hpcred.laws.Fractional(low=1.0, high=3.0, time=1e-2, exponent=0.6)


def matrices(size=5, seed=0):
    rng = np.random.default_rng(seed)
    return [rng.normal(size=(size, size)) for _ in range(5)]


def operator_of(M, D, K, one, other):
    return Operator.of(M, D, K, [Term(one, MAXWELL, "rubber"), Term(other, ZENER, "core")])


def written_out(s, M, D, K, one, other):
    return s * s * M + s * D + K + MAXWELL.excess(s) * one + ZENER.excess(s) * other


def test_the_operator_is_the_sum_of_its_terms():
    mats = matrices()
    operator, x = operator_of(*mats), np.random.default_rng(1).normal(size=(3, 5, 2))
    dense = np.array([written_out(s, *mats) for s in S])
    assert operator.at(S) == pytest.approx(dense, rel=1e-14)
    assert operator.at(S[0]) == pytest.approx(dense[0], rel=1e-14)
    assert operator.apply(S, x) == pytest.approx(dense @ x, rel=1e-13)
    assert operator.apply(S, x, transposed=True) == pytest.approx(dense.transpose(0, 2, 1) @ x, rel=1e-13)
    step = 1e-6 * np.abs(S)
    slopes = (operator.coefficients(S + step) - operator.coefficients(S - step)) / (2 * step)
    assert operator.slopes(S) == pytest.approx(slopes, rel=1e-7, abs=1e-8)


def test_terms_keep_their_laws_whatever_becomes_of_their_matrices():
    mats = matrices()
    operator, T = operator_of(*mats), np.random.default_rng(2).normal(size=(5, 3))
    projected = operator.projected(T)
    assert projected.at(S) == pytest.approx(T.T @ operator.at(S) @ T, rel=1e-12)
    symmetric = operator.map(lambda matrix: matrix + matrix.T).projected(T)
    assert all(np.array_equal(term.matrix, term.matrix.T) for term in symmetric)
    assert projected.with_matrices(operator.matrices).at(S) == pytest.approx(operator.at(S), rel=1e-15)
    without = operator.with_matrices({key: mat for key, mat in operator.matrices.items() if key != "D"})
    assert without.get("D") is None and without.at(S) == pytest.approx(operator.at(S) - S[:, None, None] * mats[1])
    assert operator.added.at(0.0) == pytest.approx(np.zeros((5, 5))) and operator.added.names == "rubber, core"
    milliseconds = operator.added.with_laws(lambda law: law.in_units(1e-3))
    assert milliseconds.at(S / 1e3) == pytest.approx(operator.added.at(S), rel=1e-13)
    assert not NOTHING and not Operator.of(*mats[:3]).added and len(operator.added) == 2


def test_digests_tell_laws_and_matrices_from_others():
    mats = matrices()
    operator = operator_of(*mats)
    found = operator.added.digest(lambda key: float(operator[key].sum()))
    assert found == operator_of(*mats).added.digest(lambda key: float(operator[key].sum()))
    stiffer = operator.added.with_laws(lambda law: law.in_units(2.0))
    assert found != stiffer.digest(lambda key: float(stiffer[key].sum()))
    larger = operator.added.map(lambda matrix: 2 * matrix)
    assert found != larger.digest(lambda key: float(larger[key].sum()))


def test_a_law_has_all_methods():
    with pytest.raises(TypeError, match="abstract"):
        Law()
    assert Power(2).coefficient(S) == pytest.approx(S**2) and Power(0).slope(S) == pytest.approx(0 * S)


@pytest.mark.mpi
def test_models_hold_one(comm):
    """PETSc matrices, on any number of ranks; what a model makes of it is what its operator is."""
    with hpcred.linkage(comm) as elastic:
        Kv = to_dense(elastic.K)
        with elastic.with_viscoelastic([hpcred.Viscoelastic(0.1 * Kv, MAXWELL, "rubber")]) as model:
            assert list(model.operator.terms) == [*elastic.operator.terms, "Kv1"]
            assert model.added.families.keys() == {"viscoelastic"}
            doubled = model.operator.map(lambda mat: 2.0 * mat)
            with model.with_fields(operator=doubled) as twice:
                assert to_dense(twice.K) == pytest.approx(2 * to_dense(model.K), rel=1e-14)
                assert to_dense(twice.added["Kv1"]) == pytest.approx(0.2 * Kv, rel=1e-14)
                assert twice.digests != model.digests
            with model.shared() as same:
                assert same.digests == model.digests
