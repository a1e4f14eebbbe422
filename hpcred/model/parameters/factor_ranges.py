"""Find values of the parameters, in their ranges, at which the factor of a term has no finite value.

Points of a grid come first. Then interval arithmetic bounds the factor over boxes that cover the ranges, and boxes over
which it proves nothing are halved: a pole between points cannot hide (Moore, Kearfott and Cloud, Introduction to
Interval Analysis, 2009, chapters 5 and 6).
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np

from ...parallel.failures import InputError
from ...parallel.ranges import ANYTHING
from .expressions import Expression, value_of

ALONG = {1: 65, 2: 17, 3: 7, 4: 5, 5: 3, 6: 3}  # points along each axis for so many parameters, the middle among them
HALVINGS = 40  # of each range, after which a box over which nothing is proven counts as one with a pole
BATCH = 256  # boxes that are bounded at once
BOXES = 200_000  # that are bounded in all
SLACK = 1e-9  # of the largest number allowed, by which a bound may be larger
EDGE = 1e-12  # of the upper bound: a lower one of a root's argument below zero that is round-off
ULPS = 4  # by which the functions of NumPy may be off


def without_value(expression: Expression, ranges: Mapping[str, tuple[float, float]]) -> dict[str, float] | None:
    """Return values of the parameters of an expression at which it has no finite value, None where none are found."""
    names = sorted(expression.names)
    for place in _places([ranges[name] for name in names]):
        values = dict(zip(names, place, strict=True))
        if not _has_value(expression, values):
            return values
    return None


def possible_pole(expression: Expression, ranges: Mapping[str, tuple[float, float]]) -> dict[str, float] | None:
    """Return values of the parameters near which a pole of an expression cannot be excluded, None where it has none in
    the ranges."""
    names = sorted(expression.names)
    if not names:
        return None
    bounds = _bounding(expression.tree, names)
    low, high = np.array([ranges[name] for name in names]).T
    pending, bounded = [(np.array([[low], [high]]).transpose(0, 2, 1), np.zeros(1, dtype=int))], 0
    while pending:
        # boxes (2, k, N): lower and upper ends along the k axes; the last ones first, which are the smallest
        boxes, depth = pending.pop()
        if boxes.shape[2] > BATCH:
            pending.append((boxes[:, :, BATCH:], depth[BATCH:]))
            boxes, depth = boxes[:, :, :BATCH], depth[:BATCH]
        bounded += len(depth)
        range_ = bounds(dict(zip(names, boxes.transpose(1, 0, 2), strict=True)))
        largest = np.maximum(np.abs(range_.low), np.abs(range_.high))
        left = np.flatnonzero(~(range_.sure & (largest <= (1 + SLACK) * ANYTHING[1])))
        if not len(left):
            continue
        boxes, depth = boxes[:, :, left], depth[left]
        if depth[0] >= HALVINGS * len(names) or bounded > BOXES:
            middle = boxes[:, :, 0].mean(axis=0)
            return {name: _rounded(*of) for name, *of in zip(names, middle.tolist(), low, high, strict=True)}
        pending.append(_halved(boxes, depth))
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
    places = [middle, *zip(*ranges, strict=True)]
    for k, ends in enumerate(ranges):
        places += [(*middle[:k], end, *middle[k + 1 :]) for end in ends]
    return places


def _halved(boxes, depth):
    """Return both halves of boxes (2, k, N), each along the axis whose turn it is at its depth (N,)."""
    each, axis = np.arange(len(depth)), depth % boxes.shape[1]
    middle = boxes[:, axis, each].mean(axis=0)
    lower, upper = boxes.copy(), boxes.copy()
    lower[1, axis, each] = upper[0, axis, each] = middle
    return np.concatenate([lower, upper], axis=2), np.tile(depth + 1, 2)


def _rounded(value, low, high) -> float:
    """Return a value with six digits of the width of its range."""
    return round(value, 6 - math.floor(math.log10(high - low)))


class _Interval(NamedTuple):
    """Bounds (N,) of a part of an expression over boxes, and whether it surely has a finite value in all of a box."""

    low: np.ndarray
    high: np.ndarray
    sure: np.ndarray


def _bounding(node: ast.expr, names) -> Callable[[dict], _Interval]:
    """Return a function that bounds a part of an expression over boxes, which are {name: (2, N)}."""
    if not any(isinstance(inner, ast.Name) and inner.id in names for inner in ast.walk(node)):
        return _constant(node, names[0])
    match node:
        case ast.Name():
            return lambda boxes: _Interval(*boxes[node.id], np.ones_like(boxes[node.id][0], dtype=bool))
        case ast.UnaryOp():
            operand = _bounding(node.operand, names)
            return operand if isinstance(node.op, ast.UAdd) else lambda boxes: _negative(operand(boxes))
        case ast.Call():
            function, argument = FUNCTIONS[node.func.id], _bounding(node.args[0], names)
            return lambda boxes: function(argument(boxes))
        # x / tan(y) has a value where the tangent has none
        case ast.BinOp(op=ast.Div(), right=ast.Call(func=ast.Name(id="tan"))):
            left, angle = _bounding(node.left, names), _bounding(node.right.args[0], names)
            return lambda boxes: _quotient(_product(left(boxes), _cosine(angle(boxes))), _sine(angle(boxes)))
        case ast.BinOp(op=ast.Mult()) if ast.dump(node.left) == ast.dump(node.right):
            base = _bounding(node.left, names)
            return lambda boxes: _whole_power(base(boxes), 2.0)
    operation, left, right = OPERATORS[type(node.op)], _bounding(node.left, names), _bounding(node.right, names)
    return lambda boxes: operation(left(boxes), right(boxes))


def _constant(node, name):
    """Bound a part without parameters by the value that formulas have for it; `name`: of any parameter."""
    try:
        value = value_of(node, {})
    except (ArithmeticError, ValueError):
        value = math.nan
    return lambda boxes: _Interval(
        *np.full_like(boxes[name], value), np.full_like(boxes[name][0], math.isfinite(value), dtype=bool)
    )


def _negative(a):
    return _Interval(-a.high, -a.low, a.sure)


def _outward(low, high, *bounds, ulps=1) -> _Interval:
    """Return bounds for which the round-off of `ulps` units is allowed; the other `bounds` have to be sure too."""
    low, high = low - ulps * np.spacing(np.abs(low)), high + ulps * np.spacing(np.abs(high))
    sure = np.isfinite(low) & np.isfinite(high)
    for bound in bounds:
        sure &= bound.sure
    return _Interval(np.where(sure, low, 0.0), np.where(sure, high, 1.0), sure)


def _sum(a, b):
    return _outward(a.low + b.low, a.high + b.high, a, b)


def _difference(a, b):
    return _outward(a.low - b.high, a.high - b.low, a, b)


def _product(a, b):
    return _outward(*_extremes(a, b, np.multiply), a, b)


def _quotient(a, b):
    apart = (b.low > 0) | (b.high < 0)
    ends = [np.where(apart, end, 1.0) for end in (b.low, b.high)]
    return _outward(*_extremes(a, _Interval(*ends, apart), np.divide), a, b._replace(sure=b.sure & apart))


def _extremes(a, b, function):
    """Return the least and the largest value at the four corners."""
    corners = [function(x, y) for x in (a.low, a.high) for y in (b.low, b.high)]
    return np.min(corners, axis=0), np.max(corners, axis=0)


def _power(a, b):
    """Return a^b: of whole exponents for any base, of others for bases that are not negative."""
    exponent = b.low[0]
    if (b.low == exponent).all() and (b.high == exponent).all() and exponent == round(exponent):
        return _whole_power(a, exponent)
    base = _not_negative(a)
    sure = base.sure & ((base.low > 0) | (b.low >= 0))
    base = _Interval(np.where(sure, base.low, 1.0), np.where(sure, base.high, 1.0), sure)
    return _outward(*_extremes(base, b, np.power), base, b, ulps=ULPS)


def _whole_power(a, exponent):
    if exponent < 0:
        one = np.ones_like(a.low)
        return _quotient(_Interval(one, one, a.sure), _whole_power(a, -exponent))
    ends = np.sort([a.low**exponent, a.high**exponent], axis=0)
    across = (a.low < 0) & (a.high > 0) & (exponent % 2 == 0) & (exponent > 0)
    power = _outward(*ends, a, ulps=ULPS)
    even = exponent % 2 == 0  # which is never negative, whatever round-off
    return power._replace(low=np.where(across, 0.0, np.maximum(power.low, 0.0) if even else power.low))


def _not_negative(a):
    """Return the part of an interval that is not negative; not sure where another part is more than round-off."""
    return _Interval(np.maximum(a.low, 0.0), np.maximum(a.high, 0.0), a.sure & (a.low >= -EDGE * a.high))


def _root(a):
    a = _not_negative(a)
    root = _outward(np.sqrt(a.low), np.sqrt(a.high), a)
    return root._replace(low=np.maximum(root.low, 0.0))


def _exponential(a):
    return _outward(np.exp(a.low), np.exp(a.high), a, ulps=ULPS)


def _logarithm(a):
    sure = a.sure & (a.low > 0)
    low, high = (np.log(np.where(sure, end, 1.0)) for end in (a.low, a.high))
    return _outward(low, high, a._replace(sure=sure), ulps=ULPS)


def _has_multiple(a, offset, period):
    """Test whether there is offset + k period, k whole, in the intervals, or close to their ends."""
    close = 1e-15 * np.maximum(np.abs(a.low), np.abs(a.high))
    return np.floor((a.high + close - offset) / period) >= np.ceil((a.low - close - offset) / period)


def _sine(a):
    ends = np.sort([np.sin(a.low), np.sin(a.high)], axis=0)
    sine = _outward(*ends, a, ulps=ULPS)
    low = np.where(_has_multiple(a, -math.pi / 2, 2 * math.pi), -1.0, np.maximum(sine.low, -1.0))
    high = np.where(_has_multiple(a, math.pi / 2, 2 * math.pi), 1.0, np.minimum(sine.high, 1.0))
    return _Interval(low, high, sine.sure)


def _cosine(a):
    ends = np.sort([np.cos(a.low), np.cos(a.high)], axis=0)
    cosine = _outward(*ends, a, ulps=ULPS)
    low = np.where(_has_multiple(a, math.pi, 2 * math.pi), -1.0, np.maximum(cosine.low, -1.0))
    high = np.where(_has_multiple(a, 0.0, 2 * math.pi), 1.0, np.minimum(cosine.high, 1.0))
    return _Interval(low, high, cosine.sure)


def _tangent(a):
    a = a._replace(sure=a.sure & ~_has_multiple(a, math.pi / 2, math.pi))
    return _outward(np.tan(a.low), np.tan(a.high), a, ulps=ULPS)


def _magnitude(a):
    ends = np.sort([np.abs(a.low), np.abs(a.high)], axis=0)
    return _Interval(np.where((a.low < 0) & (a.high > 0), 0.0, ends[0]), ends[1], a.sure)


OPERATORS = {ast.Add: _sum, ast.Sub: _difference, ast.Mult: _product, ast.Div: _quotient, ast.Pow: _power}
FUNCTIONS = {"sqrt": _root, "exp": _exponential, "log": _logarithm, "sin": _sine, "cos": _cosine, "tan": _tangent,
             "abs": _magnitude}  # fmt: skip
