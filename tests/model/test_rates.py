"""Outputs of measured columns and their rates, beside sums written out for each output."""

import numpy as np
import pytest

from hpcred import InputError
from hpcred.model.outputs.rates import MIXED, Rates, check_names, combined, orders_of, packed_parts

S = np.array([0.0, 0.3j, 0.2 + 2.0j])
ORDERS = [0, 1, 2, MIXED, MIXED]  # of the outputs below


def made():
    """C, Cv, Ca (3, 5, 7) of a displacement, a velocity, an acceleration and two mixtures; columns and outputs."""
    rng = np.random.default_rng(2)
    parts = np.zeros((3, 5, 7))
    for order, row in ((0, 0), (1, 1), (2, 2), (0, 3), (1, 3), (2, 3), (1, 4), (2, 4)):
        parts[order, row] = rng.standard_normal(7)
    return parts, *packed_parts(parts, parts.any(axis=2))


def test_columns_are_those_of_the_lowest_order_and_then_the_others():
    parts, columns, rates = made()
    lowest = [parts[order, row] for row, order in enumerate((0, 1, 2, 0, 1))]
    assert np.array_equal(columns.T, [*lowest, parts[1, 3], parts[2, 3], parts[2, 4]])
    assert np.array_equal(rates.parts @ columns.T, parts)
    assert rates.rows_of_columns(8).tolist() == [0, 1, 2, 3, 4, 3, 3, 4] and Rates().rows_of_columns(2).tolist() == [
        0,
        1,
    ]
    assert rates.orders.tolist() == ORDERS and Rates().orders is None
    assert orders_of(np.zeros((3, 1, 2))).tolist() == [0]
    assert (rates.count(8), Rates().count(8)) == (5, 8)
    assert rates.outputs_of_only([0, 1, 4, 7]) == [0, 1, 4] and Rates().outputs_of_only([2, 0]) == [2, 0]
    late = np.zeros((3, 2, 9))
    late[0, 0, 0], late[0, 1, 0], late[1, 1, 8] = 1.0, 1.0, 1.0  # the last of more columns than outputs
    assert Rates(late).outputs_of_only([0]) == [0]
    empty = packed_parts(np.zeros((3, 2, 0)), parts.any(axis=2)[:, 1:3])[0]
    assert empty.shape == (0, 2)


def test_responses_of_outputs():
    """H of all, what errors are measured of, and the factors between both; a direct part makes an output a mixture."""
    parts, columns, rates = made()
    q = np.random.default_rng(3).standard_normal((3, 7, 2)) + 1j
    rows = columns.T @ q
    whole = np.array([sum(s**k * parts[k] for k in range(3)) @ x for s, x in zip(S, q, strict=True)])
    measured = np.array([
        [sum((s**k if order == MIXED else 1.0) * parts[k, row] for k in range(3)) @ x
         for row, order in enumerate(ORDERS)]
        for s, x in zip(S, q, strict=True)
    ])  # fmt: skip
    assert np.allclose(rates.at(S, rows), whole) and np.allclose(combined(parts, S) @ q, whole)
    assert np.allclose(rates.measured(S, rows), measured) and np.allclose(rates.responses(S, rows), measured)
    assert np.allclose(rates.with_factors(S, measured), whole)
    assert np.allclose(rates.transposed(S, rows.transpose(0, 2, 1)), measured.transpose(0, 2, 1))
    F = np.zeros((5, 2))
    F[1, 1] = 4.0
    direct = Rates(rates.parts, F)
    assert direct.orders.tolist() == [0, MIXED, 2, MIXED, MIXED]
    assert np.allclose(direct.at(S, rows), whole + F)
    mixed = measured.copy()
    mixed[:, 1] = whole[:, 1]
    assert np.allclose(direct.measured(S, rows), mixed) and np.allclose(direct.responses(S, rows), mixed + F)
    assert np.allclose(direct.with_factors(S, mixed), whole)
    for same in (Rates().at, Rates().measured, Rates().responses, Rates().with_factors, Rates().transposed):
        assert same(S, rows) is rows


def test_columns_that_pure_outputs_differentiate():
    parts, columns, rates = made()
    expected = [parts[0, 0], parts[1, 1], parts[2, 2], np.zeros(7), np.zeros(7)]
    assert np.allclose(rates.static(columns).T, expected) and Rates().static(columns) is columns
    assert {key: value.tolist() for key, value in rates.of(columns.T).items()} == dict(
        zip(("C", "Cv", "Ca"), parts.tolist(), strict=True)
    )
    assert Rates().of(parts)["C"] is parts


def test_units_of_time_of_mixtures():
    """In milliseconds d of c^T q + d^T q' is a thousandth, that of c^T q' + d^T q'' too; pure outputs stay."""
    rates = made()[2]
    factors = np.array([[1, 1, 1, 1, 1], [1, 1, 1, 1e-3, 1], [1, 1, 1, 1e-6, 1e-3]])
    found = Rates(rates.parts, np.ones((5, 2))).in_time(1e-3)
    assert np.allclose(found.parts, factors[:, :, None] * rates.parts, rtol=1e-12, atol=0) and (found.direct == 1).all()


def test_direct_parts_of_other_inputs():
    rates = Rates(np.ones((3, 2, 2)), np.array([[1.0, 2.0], [3.0, 0.0]]))
    assert rates.of_inputs("ab", "bca").direct.tolist() == [[2.0, 0.0, 1.0], [0.0, 0.0, 3.0]]
    assert rates.of_inputs("ab", "c").direct is None


@pytest.mark.parametrize("name, there, better", [
    ("velocity 20:z", [1, 0, 0], "name it '20:z', or by a word"),
    ("20:z", [0, 0, 1], "for a row of acceleration; name it 'acceleration 20:z', or by a word"),
    ("20:z", [1, 1, 0], "for a row of displacement and velocity; name it by a word"),
])  # fmt: skip
def test_names_of_other_quantities_are_refused(name, there, better):
    with pytest.raises(InputError, match=better):
        check_names([name], np.array(there, bool)[:, None], "C")
    check_names(["velocity 20:z", "of light", "20:z"], np.array([[0, 1, 0], [1, 1, 0], [0, 0, 0]], bool), "C")
