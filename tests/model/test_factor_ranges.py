"""Values without a finite factor are told from jumps by size, whatever the scale of what is divided by."""

import math

import pytest

from hpcred.model.expressions import Expression
from hpcred.model.factor_ranges import without_value

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
    found = without_value(Expression(text), {"x": (low, high)})
    assert found and found["x"] == pytest.approx(ROOT, abs=1e-6)


@pytest.mark.parametrize("sign", ["", "0 - "])
def test_what_jumps_from_one_infinity_to_the_other_has_no_zero(sign):
    """1/d + 0.3 jumps where d = 3 x - x^2 - 2.001 is zero, at a and b; 100 exp(-100 (x - b)^2) + (1/d + 0.3)^-2 has the
    limit 100 at b, more than at all points that are looked at, and is finite everywhere."""
    b = 1.5 + math.sqrt(1 - 4e-3) / 2
    text = f"100*exp(-100*(x - {b!r})^2) + ({sign}(1/(3*x - x^2 - 2.001) + 0.3))^-2"
    for beside in (-1e-7, 1e-7):
        assert Expression(text).at({"x": b + beside}) == pytest.approx(100.0)
    assert without_value(Expression(text), {"x": (0.0, 2.95)}) is None
