"""Evaluate the factors of terms: plain expressions of parameters, such as "1 + 0.2*e" or "-omega^2"."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from keyword import iskeyword

from ...parallel.declared import declared
from ...parallel.failures import InputError

FUNCTIONS = {"sqrt": math.sqrt, "exp": math.exp, "log": math.log, "sin": math.sin, "cos": math.cos, "tan": math.tan,
             "abs": abs}  # fmt: skip
CONSTANTS = {"pi": math.pi}
OPERATORS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
             ast.Pow: math.pow, ast.USub: operator.neg, ast.UAdd: operator.pos}  # fmt: skip
SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.USub: "-", ast.UAdd: "+"}
LONGEST = 500  # letters
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
STRANGE = re.compile(r"[^A-Za-z0-9_ .()*/^+-]")  # a comment, for one, would be read over
# what C and Python take for one number, and what is one in a formula: no 0x10, no 1_000
WRITTEN = re.compile(r"(?<![A-Za-z0-9_.])\.?[0-9](?:[eE][+-]|[A-Za-z0-9_.])*")
NUMBER = re.compile(r"([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
EXPECTED = f"expected numbers, parameters, + - * / ^, parentheses, pi, {', '.join(FUNCTIONS)}"


def check_name(key: str, name: str):
    """Raise InputError for a name that no parameter can have in an expression."""
    if not NAME.fullmatch(name) or iskeyword(name) or name in FUNCTIONS or name in CONSTANTS:
        raise InputError(
            f"{key}: found {name[:40]!r}, expected letters, digits and _, a letter first, and none of "
            f"{', '.join([*FUNCTIONS, *CONSTANTS])}, or of the words of Python, such as lambda"
        )


@dataclass(frozen=True)
class Expression:
    """A formula of parameters.

    Parameters
    ----------
    text : str
        Of numbers, names of parameters, + - * / ^ (or **), parentheses, pi, sqrt, exp, log, sin, cos, tan and abs; ^
        binds before a sign, as in -omega^2.

    Raises
    ------
    InputError
        For anything else, with the text and the place.
    """

    text: str

    def __post_init__(self):
        declared("expression", self.text, str)
        if len(self.text) > LONGEST:
            raise InputError(f"expression: found {len(self.text)} letters, expected at most {LONGEST}")
        self.names  # noqa: B018  (refused here)

    @cached_property
    def names(self) -> set[str]:
        """Names of the parameters in the expression."""
        try:
            return set(self._names_in(self.tree))
        except RecursionError:
            raise self._refused("too many levels", 0) from None

    @cached_property
    def tree(self) -> ast.expr:
        """The expression as Python parses it."""
        if match := STRANGE.search(self.text):
            raise self._refused(repr(match[0]), match.start())
        for match in WRITTEN.finditer(self.text):
            self._check_number(match[0], match.start())
        source = self.text.strip(" ").replace("^", "**")
        if not source:
            raise InputError(f"expression: found an empty text, {EXPECTED}")
        try:
            return ast.parse(source, mode="eval").body
        except SyntaxError as error:
            raise self._refused(error.msg, self._place((error.offset or 1) - 1)) from None
        except (ValueError, MemoryError, RecursionError):  # numbers of thousands of digits, hundreds of signs
            raise self._refused("what cannot be read", 0) from None

    def _check_number(self, text, place):
        """Refuse what is no decimal number, or one that a double has not: it would be infinite, or zero."""
        if not NUMBER.fullmatch(text):
            raise self._refused(f"'{text[:40]}', which is no decimal number,", place)
        value, has_digits = float(text), re.search("[1-9]", re.split("[eE]", text)[0])
        if math.isinf(value) or (value == 0 and has_digits):
            raise self._refused(f"'{text[:40]}', a number beyond those of double precision,", place)

    def at(self, values: Mapping[str, float]) -> float:
        """Return the value at values of the parameters. Raises InputError where it is not a finite number."""
        try:
            value = float(value_of(self.tree, values))
        except (ArithmeticError, ValueError):
            value = math.nan
        if not math.isfinite(value):
            where = ", ".join(f"{name} = {values[name]:g}" for name in sorted(self.names)) or "any values"
            raise InputError(f"expression '{self.text}': found no finite number at {where}")
        return value

    def _names_in(self, node):
        """Yield the names below a node; refuse nodes that are not of an expression."""
        if isinstance(node, ast.Name) and node.id not in CONSTANTS and node.id not in FUNCTIONS:
            check_name(f"expression '{self.text}'", node.id)
            yield node.id
        elif isinstance(node, ast.UnaryOp | ast.BinOp) and type(node.op) in OPERATORS:
            for side in ("left", "right", "operand"):
                if hasattr(node, side):
                    yield from self._names_in(getattr(node, side))
        elif isinstance(node, ast.Call):
            if not isinstance(node.func, ast.Name) or node.func.id not in FUNCTIONS:
                raise self._refused("a function that is not known", self._place(node.col_offset))
            if len(node.args) != 1 or node.keywords:
                raise self._refused(f"{len(node.args)} arguments of {node.func.id} in place of one",
                                    self._place(node.col_offset))  # fmt: skip
            yield from self._names_in(node.args[0])
        elif not (isinstance(node, ast.Name) and node.id in CONSTANTS
                  or isinstance(node, ast.Constant) and type(node.value) in (int, float)):  # fmt: skip
            raise self._refused("what is no part of a formula", self._place(node.col_offset))

    def _place(self, offset):
        """The place in the text of one in the source, where ^ is **."""
        stripped = len(self.text) - len(self.text.lstrip(" "))
        ends = [i for i, letter in enumerate(self.text[stripped:].replace("^", "^^")) if letter == "^"]
        return stripped + offset - sum(place < offset for place in ends[1::2])

    def _refused(self, what, place):
        return InputError(f"expression '{self.text}': found {what} at letter {place + 1}; {EXPECTED}")


def value_of(node: ast.expr, values: Mapping[str, float]) -> float:
    """Return the value of a part of an expression; raises ArithmeticError or ValueError where it has none."""
    match node:
        case ast.Constant():
            return float(node.value)
        case ast.Name():
            return CONSTANTS.get(node.id) or values[node.id]
        case ast.UnaryOp():
            value = OPERATORS[type(node.op)](value_of(node.operand, values))
        case ast.BinOp():
            value = OPERATORS[type(node.op)](value_of(node.left, values), value_of(node.right, values))
        case ast.Call():
            value = FUNCTIONS[node.func.id](value_of(node.args[0], values))
    if not math.isfinite(value):  # sums and products overflow without an exception, and 1 / inf is a number
        raise OverflowError
    return value


def in_c(expression: Expression, places: Mapping[str, str]) -> str:
    """Return an expression in C, of what stands there for each parameter."""

    def text(node):
        match node:
            case ast.Constant():
                return f"{float(node.value)!r}"
            case ast.Name():
                return repr(CONSTANTS[node.id]) if node.id in CONSTANTS else places[node.id]
            case ast.UnaryOp():
                return f"({SIGNS[type(node.op)]}{text(node.operand)})"
            case ast.BinOp() if isinstance(node.op, ast.Pow):
                return f"pow({text(node.left)}, {text(node.right)})"
            case ast.BinOp():
                return f"({text(node.left)} {SIGNS[type(node.op)]} {text(node.right)})"
            case ast.Call():
                name = "fabs" if node.func.id == "abs" else node.func.id
                return f"{name}({text(node.args[0])})"

    return text(expression.tree)
