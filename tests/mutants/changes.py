"""All changes of a module that a test should notice: signs, factors, indices, comparisons, constants, terms, calls."""

import ast
import copy
from collections.abc import Callable
from typing import NamedTuple

OTHER = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv, ast.And: ast.Or, ast.Or: ast.And, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
EDGE = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}  # of whole numbers
CALLS = {"max": "min", "min": "max", "maximum": "minimum", "minimum": "maximum", "argmax": "argmin",
         "argmin": "argmax", "sin": "cos", "cos": "sin", "floor": "ceil", "ceil": "floor", "any": "all",
         "all": "any"}  # fmt: skip
LEFT_OUT = {"abs", "conj", "sqrt", "sort", "sorted", "transpose"}  # functions of one array
# calls whose arguments are no numbers of a result: messages, records, progress, the freeing of memory
SILENT = {"stage", "say", "note", "warn", "print", "InputError", "ComputationError", "within", "field", "close",
          "destroy", "damaged", "isinstance", "perf_counter", "monotonic", "require_band", "as_declared"}  # fmt: skip
KEYWORDS = {"readonly", "full_matrices", "copy", "structure", "strict"}  # of which no result depends
FEW = 4  # larger whole numbers are limits of effort, of which the last one says little
SMALL = 1e-3
TEXTS = {"sentence", "_name", "_text", "warnings_of_damping", "describe"}  # functions that make messages


class Change(NamedTuple):
    """The expression at `first` to `last` (lines of the module, in the function `inside`), with what it stands in where
    it is short, what it is changed to, and the source of the changed module; `imported`: it is run by the import."""

    first: int
    last: int
    inside: str
    before: str
    after: str
    imported: bool
    source: Callable[[], str]


def changes(source: str):
    """All changes of a module."""
    tree = ast.parse(source)
    for node, parent, inside, imported in _nodes(tree, ""):
        shown = parent if isinstance(node, (ast.Constant, ast.Slice)) and not hasattr(parent, "body") else node
        for new in _variants(node):
            swap = _Swap(node, new)
            before, after = ast.unparse(shown), ast.unparse(swap.visit(shown))
            if before != after:
                yield Change(node.lineno, node.end_lineno, inside, before, after, imported,
                             lambda swap=swap: ast.unparse(swap.visit(tree)))  # fmt: skip


def _nodes(node, inside, imported=True):
    """The nodes below that may be changed, what each stands in, the name of its function or class, and whether it is
    run by the import of the module."""
    for name, value in ast.iter_fields(node):
        imported = imported and not (isinstance(node, ast.FunctionDef) and name == "body")
        if name in ("annotation", "returns", "decorator_list", "bases", "format_spec"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, (ast.Raise, ast.Assert, ast.JoinedStr)):
                continue
            if isinstance(child, ast.Call) and _name(child) in SILENT:
                continue
            if isinstance(child, ast.Expr) and isinstance(child.value, ast.Call) and _name(child.value) in SILENT:
                continue
            if isinstance(child, ast.FunctionDef) and child.name in TEXTS:
                continue
            if isinstance(node, ast.Module) and isinstance(child, ast.Assign) and _is_limit(child.value):
                continue
            if isinstance(child, ast.keyword) and child.arg in KEYWORDS:
                continue
            place = inside
            if isinstance(child, (ast.FunctionDef, ast.ClassDef)):
                place = f"{inside}.{child.name}".lstrip(".")
            elif hasattr(child, "lineno"):
                yield child, node, inside, imported
            yield from _nodes(child, place, imported)


def _name(call):
    """The last name of what is called."""
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def _variants(node):
    """What may stand in place of a node."""
    match node:
        case ast.BinOp(left, op, right) if type(op) in OTHER:
            yield ast.BinOp(left, OTHER[type(op)](), right)
            yield left
        case ast.AugAssign(target, op, value) if type(op) in OTHER:
            yield ast.AugAssign(target, OTHER[type(op)](), value)
        case ast.UnaryOp(ast.USub() | ast.Not() | ast.Invert(), operand):
            yield operand
        case ast.BoolOp(op, values):
            yield ast.BoolOp(OTHER[type(op)](), values)
        case ast.Compare(left, [op], rest):
            yield ast.Compare(left, [OTHER[type(op)]()], rest)
            if type(op) in EDGE and any(_is_whole(item) for item in (left, *rest)):
                yield ast.Compare(left, [EDGE[type(op)]()], rest)
        case ast.IfExp(test, body, orelse) if not (_is_text(body) or _is_text(orelse)):
            yield ast.IfExp(test, orelse, body)
        case ast.Constant(bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(int() as value) if value <= FEW:
            yield ast.Constant(value + 1)
            if value > 0:
                yield ast.Constant(value - 1)
        case ast.Constant(int() | float() as value):  # small ones are thresholds, which must be right to a power of ten
            yield ast.Constant((2 if abs(value) > SMALL else 1e6) * value if value else 1.0)
            if 0 < abs(value) <= SMALL:
                yield ast.Constant(0.0)
        case ast.Attribute(value, "T"):
            yield value
        case ast.Slice(lower, upper, None) if not isinstance(upper, (ast.Constant, ast.UnaryOp, type(None))):
            yield ast.Slice(lower, ast.BinOp(upper, ast.Sub(), ast.Constant(1)))
        case ast.Call(func, arguments, keywords) if _name(node) in CALLS:
            other = copy.copy(func)
            setattr(other, "attr" if isinstance(func, ast.Attribute) else "id", CALLS[_name(node)])
            yield ast.Call(other, arguments, keywords)
        case ast.Call(ast.Attribute(ast.Name("np"), _) | ast.Name(), [argument], []) if _name(node) in LEFT_OUT:
            yield argument
        case ast.Call(ast.Attribute(value, "conj" | "sort" | "transpose"), [], []):
            yield value
        case ast.Expr(ast.Call()):
            yield ast.Pass()


def _is_limit(node):
    """Whether a constant of a module is a whole number: of steps, tries, rows at a time, or bytes."""
    numbers = [item for item in ast.walk(node) if not isinstance(item, (ast.BinOp, ast.operator))]
    return all(isinstance(item, ast.Constant) and isinstance(item.value, int) for item in numbers)


def _is_text(node):
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _is_whole(node):
    """Whether an expression looks like a whole number."""
    whole = isinstance(node, ast.Constant) and isinstance(node.value, int)
    return whole or (isinstance(node, ast.Call) and _name(node) == "len") or ".size" in ast.unparse(node)


class _Swap(ast.NodeTransformer):
    """visit(tree) is the tree with one node replaced, of which nothing is changed."""

    def __init__(self, old, new):
        self._old, self._new = old, ast.fix_missing_locations(ast.copy_location(new, old))

    def visit(self, node):
        return self._new if node is self._old else super().generic_visit(_shallow(node))


def _shallow(node):
    """A copy with lists of its own, which a NodeTransformer changes."""
    other = copy.copy(node)
    for name, value in ast.iter_fields(other):
        if isinstance(value, list):
            setattr(other, name, list(value))
    return other
