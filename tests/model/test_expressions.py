"""Factors of terms: their values, and what is no formula."""

import math

import numpy as np
import pytest

from hpcred import InputError
from hpcred.model.parameters.expressions import LONGEST, Expression, in_c

VALUES = {"omega": 3.0, "e": -0.5, "a_1": 2.0}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("omega", 3.0),
        ("-omega^2", -9.0),
        ("-omega**2", -9.0),
        ("(-omega)^2", 9.0),
        ("2^-1", 0.5),
        ("2^3^2", 512.0),  # from the right, as Python's
        ("1 + 0.2*e", 0.9),
        (" 1e-3*omega/a_1 - +e ", 0.5015),
        ("sqrt(omega^2 + 16)*cos(pi/3)", 2.5),
        ("exp(log(omega)) + sin(pi/2) + tan(0) + abs(e)", 4.5),
        ("7", 7.0),
        ("2.*a_1 + .5e+1 - 5.e-1 + 0.0e-999", 8.5),
    ],
)
def test_values(text, value):
    assert Expression(text).at(VALUES) == pytest.approx(value, rel=1e-15)


def test_against_numpy_at_random_values():
    rng = np.random.default_rng(2)
    text = "(x - 2*y)^2/(1 + z^2) - exp(-x*y)*sin(3*z) + abs(x - z)^1.5"
    for x, y, z in rng.normal(size=(50, 3)):
        expected = (x - 2 * y) ** 2 / (1 + z**2) - np.exp(-x * y) * np.sin(3 * z) + np.abs(x - z) ** 1.5
        assert Expression(text).at({"x": x, "y": y, "z": z}) == pytest.approx(expected, rel=1e-14, abs=1e-14)


def test_names():
    assert Expression("2*pi*omega + sqrt(e*e) - omega").names == {"omega", "e"}
    assert Expression("2*pi").names == set()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "^expression: found an empty text, expected numbers, parameters"),
        ("  ", "found an empty text"),
        ("1 +", "^expression '1 .': found .*syntax.* at letter"),
        ("2*omega # rad/s", "found '#' at letter 9"),
        ("omega.real", "found what is no part of a formula at letter 1"),
        ("__import__", "found '__import__', expected letters, digits and _, a letter first"),
        ("lambda", "^expression 'lambda': found .*syntax"),
        ("sqrt", "found what is no part of a formula at letter 1"),
        ("2 + f(omega)", r"found a function that is not known at letter 5; expected .*, sqrt, exp, log, sin"),
        ("omega^2 + omega^3 + f(1)", "not known at letter 21"),  # a place in the text, not in Python's
        ("sqrt()", "found 0 arguments of sqrt in place of one at letter 1"),
        ("omega if e else 1", "found what is no part of a formula at letter 1"),
        ("omega // 2", "found what is no part of a formula"),
        ("True", "found what is no part of a formula"),
        ("omega[0]", r"found '\[' at letter 6"),
        ("'a'", 'found "\'" at letter 1'),
        ("e\n+1", r"found '\\n' at letter 2"),
        ("Ω", "found 'Ω' at letter 1"),
        ("(" * 300 + "e" + ")" * 300, f"found 601 letters, expected at most {LONGEST}"),
        ("(" * 240 + "e" + ")" * 240, "found"),
        ("9" * 450, "found '9{40}', a number beyond those of double precision, at letter 1"),
        ("omega/1e400", "found '1e400', a number beyond those of double precision, at letter 7"),
        ("omega + 0*(1e400^-1)", "found '1e400', a number beyond"),
        ("omega*1e-400", "found '1e-400', a number beyond"),
        ("0x10*omega", "found '0x10', which is no decimal number, at letter 1"),
        ("omega + 1_000*e", "found '1_000', which is no decimal number, at letter 9"),
        ("1e1_0*omega", "found '1e1_0', which is no decimal number"),
        ("0b1*omega", "found '0b1', which is no decimal number"),
        ("2omega", "found '2omega', which is no decimal number"),
        ("2j", "found '2j', which is no decimal number"),
    ],
)
def test_what_is_no_formula_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        Expression(text).at({"e": 1.0, "omega": 1.0})


@pytest.mark.parametrize(
    "text",
    ["1/(omega - 3)", "log(e)", "e^0.5", "sqrt(e)", "exp(1000*omega)", "0^-1", "10^400", "omega/(1e300*1e300)",
     "exp(-1e300*1e300)"],
)  # fmt: skip
def test_values_that_are_no_finite_numbers_are_refused(text):
    with pytest.raises(InputError, match="^expression '.*': found no finite number at "):
        Expression(text).at(VALUES)


def test_the_message_names_the_values():
    with pytest.raises(InputError, match=r"'sqrt\(e\)\*omega': found no finite number at e = -0.5, omega = 3$"):
        Expression("sqrt(e)*omega").at(VALUES)


def test_expressions_in_c():
    found = in_c(Expression("-omega^2/3 + abs(e - pi)*sqrt(a_1)"), {"omega": "p[0]", "e": "p[1]", "a_1": "p[2]"})
    assert found == "(((-pow(p[0], 2.0)) / 3.0) + (fabs((p[1] - 3.141592653589793)) * sqrt(p[2])))"


def test_many_signs_are_no_matter():
    assert Expression("-" * (LONGEST - 1) + "e").at({"e": math.pi}) == -math.pi
