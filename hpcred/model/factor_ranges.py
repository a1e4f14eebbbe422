"""Find values of the parameters, in their ranges, at which the factor of a term has no finite value.

Looked at are the ends, the middles and points between them, and the places where what the expression divides by, or
takes the logarithm of, changes its sign.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np

from ..parallel.failures import InputError
from ..parallel.ranges import ANYTHING
from .expressions import Expression

ALONG = {1: 65, 2: 17, 3: 7, 4: 5, 5: 3, 6: 3}  # points along each axis for so many parameters, the middle among them
HALVINGS = 60  # of the way between two signs
ZERO = 1e-6  # of the larger value at its two ends: what is not smaller there has a jump, and no zero


def without_value(expression: Expression, ranges: Mapping[str, tuple[float, float]]) -> dict[str, float] | None:
    """Return values of the parameters of an expression at which it has no finite value, None where none are found."""
    names = sorted(expression.names)
    points = [dict(zip(names, place, strict=True)) for place in _places([ranges[name] for name in names])]
    for values in points:
        if not _has_value(expression, values):
            return values
    for divisor in _divisors(expression.tree):
        if (values := _zero(expression, divisor, points)) is not None:
            return {name: _rounded(value, *ranges[name]) for name, value in values.items()}
    return None


def _has_value(expression, values) -> bool:
    try:
        return abs(expression.at(values)) <= ANYTHING[1]
    except InputError:
        return False


def _places(ranges) -> list[tuple[float, ...]]:
    """Return points of a grid; of many parameters the corners of low and high values of all, and the ends of each."""
    if not ranges:
        return [()]
    if count := ALONG.get(len(ranges)):
        return list(product(*(np.linspace(low, high, count).tolist() for low, high in ranges)))
    middle = tuple((low + high) / 2 for low, high in ranges)
    found = [middle, *zip(*ranges, strict=True)]
    for k, ends in enumerate(ranges):
        found += [(*middle[:k], end, *middle[k + 1 :]) for end in ends]
    return found


def _divisors(tree) -> Iterator[ast.expr]:
    """Yield the parts of an expression that have to differ from zero."""
    for node in ast.walk(tree):
        match node:
            case ast.BinOp(op=ast.Div()):
                yield from _factors(node.right)
            case ast.BinOp(op=ast.Pow(), right=ast.UnaryOp(op=ast.USub())):
                yield from _factors(node.left)
            case ast.Call(func=ast.Name(id="log")):
                yield from _factors(node.args[0])
            case ast.Call(func=ast.Name(id="tan")):
                yield ast.Call(ast.Name("cos"), node.args, [])


def _factors(node) -> Iterator[ast.expr]:
    """Yield the parts whose zeros are those of a part, whose own sign may not change there, as that of a square."""
    match node:
        case ast.BinOp(op=ast.Mult()):
            yield from _factors(node.left)
            yield from _factors(node.right)
        case ast.BinOp(op=ast.Div() | ast.Pow()):
            yield from _factors(node.left)
        case ast.UnaryOp():
            yield from _factors(node.operand)
        case ast.Call(func=ast.Name(id="abs" | "sqrt")):
            yield from _factors(node.args[0])
        case _:
            yield node


def _zero(expression, node, points) -> dict[str, float] | None:
    """Return values between two of the points at which a part of an expression is zero, and the whole is larger than at
    all points, or None."""
    found = [expression.value_of(node, values) for values in points]
    low, high = (points[int(k)] for k in (np.argmin(found), np.argmax(found)))
    if not min(found) < 0 < max(found):
        return None
    for _ in range(HALVINGS):
        middle = {name: (low[name] + high[name]) / 2 for name in low}
        try:
            value = expression.value_of(node, middle)
        except (ArithmeticError, ValueError):
            return middle
        low, high = (middle, high) if value < 0 else (low, middle)
    jumps = abs(value) > ZERO * max(-min(found), max(found))
    grows = not _has_value(expression, middle) or (
        abs(expression.at(middle)) > max(abs(expression.at(values)) for values in points)
    )  # which 1 / tan(x) does not where cos(x) is zero
    return middle if grows and not jumps else None


def _rounded(value, low, high) -> float:
    """Return a value with six digits of the width of its range."""
    return round(value, 6 - math.floor(math.log10(high - low)))
