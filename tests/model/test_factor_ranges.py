"""Poles of factors in the ranges of their parameters are found whatever the scale of what is divided by."""

import pytest

from hpcred.model.parameters.expressions import Expression
from hpcred.model.parameters.factor_ranges import possible_pole

ROOT = 2**0.5  # whose square is no float: x^2 - 2 is 4e-16 at the least


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("1/(1e12*x^2 - 2e12)", 0.0, 2.0),
        ("1/(1e-12*x^2 - 2e-12)", 0.0, 2.0),
        ("1/(x^2 - 2)", ROOT - 1e-11, 10.0),  # nearly all of the range on one side of the zero
        ("1/(2 - x^2)", ROOT - 1e-11, 10.0),
        ("1/(x^2 - 2)", 0.0, ROOT + 1e-11),
    ],
)
def test_zeros_of_any_scale(text, low, high):
    found = possible_pole(Expression(text), {"x": (low, high)})
    assert found and found["x"] == pytest.approx(ROOT, abs=1e-5)


def test_the_largest_number_is_no_pole():
    """1e30, but for round-off; more is one."""
    assert possible_pole(Expression("1e30*x"), {"x": (0.0, 1.0)}) is None
    assert possible_pole(Expression("1.01e30*x"), {"x": (0.0, 1.0)})


@pytest.mark.parametrize("text", ["1/(x^2 - 2)", "1/(2 - x^2)"])
def test_no_zero_in_the_range_is_no_pole(text):
    assert possible_pole(Expression(text), {"x": (ROOT + 1e-6, 10.0)}) is None


@pytest.mark.parametrize(("text", "low", "high"), [
    ("1/(0.99995 - sin(x))", 1.5, 1.6), ("1/(0.99995 + sin(x))", -1.6, -1.5), ("1/(0.99995 + cos(x))", 3.1, 3.2),
    ("1/(0.99995 - cos(x))", 6.2, 6.4), ("1/(0.99995 - sin(x))", 7.8, 7.9),
])  # fmt: skip
def test_extremes_of_waves_inside_of_a_range(text, low, high):
    """Beyond what both ends have."""
    found = possible_pole(Expression(text), {"x": (low, high)})
    assert found and low < found["x"] < high
    assert possible_pole(Expression(text.replace("0.99995", "1.00005")), {"x": (low, high)}) is None
