"""Make values of a user plain Python values of the types that are declared, or refuse them.

What reads like a list is one: tuples, lists, arrays, ranges, generators. Numbers of NumPy and paths become Python's
numbers and texts, so that settings can be compared, sent and written whatever they were made from.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass
from difflib import get_close_matches
from functools import cache, wraps
from inspect import Parameter, Signature, signature
from itertools import repeat
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import AliasChoices, Field, TypeAdapter

from .failures import InputError

Function = TypeVar("Function", bound=Callable[..., Any])
WORDS = {str: "a text", int: "a whole number", float: "a number", bool: "true or false"}
MANY = {str: "texts", int: "whole numbers", float: "numbers"}


class _Misfit(Exception):
    """A value is not of a type."""


class Settings:
    """Base of dataclasses whose fields are what their types and the checks in their annotations say.

    `where` comes before the names of the fields in messages, such as "krylov.".
    """

    where: ClassVar[str] = ""

    def __post_init__(self):
        as_declared(self, self.where)


def as_declared(settings, where: str = "", keys: tuple[str, ...] | None = None):
    """Make the fields of a dataclass, or those of `keys`, plain values of their types, and check them as annotated, as
    by ranges.Range. Raises InputError.

    `where` comes before the names of the fields in messages, such as "krylov.".
    """
    chosen = {name: kind for name, kind in types_of(type(settings)).items() if keys is None or name in keys}
    for name, kind in chosen.items():
        object.__setattr__(settings, name, declared(where + name, getattr(settings, name), kind))
    for name, kind in chosen.items():
        check_as_annotated(where + name, getattr(settings, name), kind)


def check_as_annotated(key: str, value, kind):
    """Call the checks (key, value) that the annotations of a type have, also of the items of tuples."""
    if value is None or not _has_checks(kind):
        return
    for check in getattr(kind, "__metadata__", ()):
        if callable(check):
            check(key, value)
    kind = plain_type(kind)
    inner = get_args(kind)
    if get_origin(kind) in (Union, UnionType):
        check_as_annotated(key, value, next(entry_kind for entry_kind in inner if _fits(value, entry_kind)))
    elif get_origin(kind) is tuple and isinstance(value, tuple):
        for entry, entry_kind in zip(value, repeat(inner[0]) if ... in inner else inner, strict=False):
            check_as_annotated(key, entry, entry_kind)


@cache
def _has_checks(kind) -> bool:
    """Whether a type, or a part of it, has checks."""
    return any(map(callable, getattr(kind, "__metadata__", ()))) or any(map(_has_checks, get_args(plain_type(kind))))


def declared(key: str, value, kind):
    """The value as a plain one of a type. Raises InputError that names the key, what was found and expected."""
    try:
        return _fitted(value, kind)
    except _Misfit as misfit:
        such = f", such as {meant}(...)" if (meant := _class_of_kind(value, kind)) else meant_by(value, kind)
        raise InputError(f"{key}: found {_shown(value)}, expected {in_words(kind)}{such}") from misfit


def is_blank(value) -> bool:
    """Whether a value is a text without a letter or sign, which stands for nothing that a user wants."""
    return isinstance(value, str) and not value.strip()


def renamed(name: str, before: str):
    """The annotation of a field of a record that has another name in files of earlier versions."""
    return Field(validation_alias=AliasChoices(name, before))


def _class_of_kind(word, kind) -> str | None:
    """The name of the one of several dataclasses whose field `kind` is a word, as in frame="buckens"."""
    kinds = [plain_type(inner) for inner in (kind, *get_args(kind))]
    for table in kinds + [inner for outer in kinds for inner in get_args(outer)]:
        if is_dataclass(table) and word in [field.default for field in fields(table) if field.name == "kind"]:
            return table.__name__
    return None


@cache
def types_of(table) -> dict:
    """Names and types of the fields of a dataclass."""
    hints = get_type_hints(table, include_extras=True)
    return {field.name: hints[field.name] for field in fields(table)}


@cache
def adapter_of(kind) -> TypeAdapter:
    """What checks and writes values of a type; to make it takes up to 25 ms."""
    return TypeAdapter(kind)


def plain_type(kind):
    """A type without what Annotated says of it."""
    return get_args(kind)[0] if get_origin(kind) is Annotated else kind


def spelled(function: Function) -> Function:
    """Have a function refuse keywords that it does not have by an InputError, which names the one that was meant."""
    return spelled_with(object)(function)


def spelled_with(table: type) -> Callable[[Function], Function]:
    """As spelled, of a function that takes the keys of a TypedDict as well."""

    def decorated(function: Function) -> Function:
        parameters = [*signature(function).parameters.values()]
        by_name = (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
        names = [key.name for key in parameters if key.kind in by_name and key.name != "self"]
        names += getattr(table, "__annotations__", ())
        *_, owner, own = ("", *function.__qualname__.split("."))
        called = owner if own == "__init__" else own

        @wraps(function)
        def checked(*arguments, **keywords):
            for key in keywords:
                if key not in names:
                    raise InputError(
                        f"{called}: unknown keyword '{key}'{nearest(key, names)}; known are "
                        f"{', '.join(names)}"
                    )
            return function(*arguments, **keywords)

        keys = [Parameter(key, Parameter.KEYWORD_ONLY, default=None, annotation=getattr(kind, "__forward_arg__", kind))
                for key, kind in getattr(table, "__annotations__", {}).items()]  # fmt: skip
        if keys:  # shown in place of **keywords
            plain = [parameter for parameter in parameters if parameter.kind is not Parameter.VAR_KEYWORD]
            checked.__signature__ = Signature(plain + keys)  # type: ignore[attr-defined]
        return checked  # type: ignore[return-value]

    return decorated


@dataclass(frozen=True)
class Option:
    """What a command line takes for a parameter, in whose annotation it stands (see cli.options.command).

    `metavar`: a word for the value. `parsed` makes the value of a text, or of all texts where it may be given `many`
    times, and of the name of the option; `text`: the default, as a text. `names`: by default that of the parameter.
    """

    help: str
    metavar: str | None = None
    parsed: Callable[[Any, str], Any] | None = None
    text: str | None = None
    names: tuple[str, ...] = ()
    many: bool = False

    def name(self, key: str) -> str:
        """Return its long name, for a parameter of this name."""
        return next((name for name in self.names if name.startswith("--")), f"--{key.replace('_', '-')}")


class Keywords:
    """Base of frozen dataclasses whose fields a function takes as keywords: see flattened."""

    @property
    def given(self) -> dict[str, Any]:
        """The keywords, for another function."""
        return dict(vars(self))

    def changed(self) -> list[str]:
        """Return the options of what is not as by default."""
        defaults = {field.name: field.default for field in fields(self)}  # type: ignore[arg-type]
        return [get_args(kind)[-1].name(key) for key, kind in types_of(type(self)).items()
                if getattr(self, key) != defaults[key]]  # fmt: skip


def flattened(function: Callable[..., Any]) -> Callable[..., Any]:
    """Have a function take the fields of its parameters that are Keywords as keywords of its own."""
    kinds = get_type_hints(function, include_extras=True)
    tables = {name: kind for name, kind in kinds.items() if isinstance(kind, type) and issubclass(kind, Keywords)}
    parameters, annotations = [], {name: kind for name, kind in kinds.items() if name not in tables}
    for parameter in signature(function).parameters.values():
        if parameter.name not in tables:
            parameters.append(parameter.replace(annotation=kinds.get(parameter.name, parameter.annotation)))
            continue
        annotations |= types_of(tables[parameter.name])
        for field in fields(tables[parameter.name]):
            kind = annotations[field.name]
            parameters.append(Parameter(field.name, Parameter.KEYWORD_ONLY, default=field.default, annotation=kind))

    @wraps(function)
    def called(*arguments, **keywords):
        for name, table in tables.items():
            keywords[name] = table(**{key: keywords.pop(key) for key in types_of(table) if key in keywords})
        return function(*arguments, **keywords)

    parameters.sort(key=lambda parameter: parameter.kind)
    called.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = annotations
    return called


def with_spelled_fields(table):
    """Have a dataclass refuse keywords that it does not have, as spelled functions do; others are as they were."""
    if isinstance(table, type) and is_dataclass(table) and not hasattr(table.__init__, "__wrapped__"):
        table.__init__ = spelled(table.__init__)
    return table


def refuse_file(key: str, value, instead: str):
    """Raise InputError for the name of a file where an object is expected; `instead`: the function that takes files."""
    if isinstance(value, (str, os.PathLike)):
        raise InputError(f"{key}: found '{os.fspath(value)}', expected an object in memory; files are taken by hpcred."
                         f"{instead}")  # fmt: skip


def nearest(word, words) -> str:
    """Words in brackets that ask whether the one of some words was meant that is most alike; empty for none."""
    asked, by_lower = str(word).lower(), {str(known).lower(): known for known in words}
    close = get_close_matches(asked, by_lower, n=5, cutoff=0.55)
    close += [known for known in by_lower if len(asked) > 2 and known.startswith(asked) and known not in close]
    # two letters that changed places come first, and what begins so
    close.sort(key=lambda known: sorted(known) != sorted(asked) and not known.startswith(f"{asked}_"))
    return f" (did you mean '{by_lower[close[0]]}'?)" if close else ""


def meant_by(value, kind) -> str:
    """As nearest, of the words that a type takes."""
    kind = plain_type(kind)
    kinds = [plain_type(inner) for inner in (kind, *get_args(kind))]
    words = [word for inner in kinds if get_origin(inner) is Literal for word in get_args(inner)]
    return nearest(value, words) if isinstance(value, str) else ""


def in_words(kind, table: str = "") -> str:
    """A type in words; `table`: what dataclasses are called, by default their names."""
    kind = plain_type(kind)
    if kind in WORDS:
        return WORDS[kind]
    if get_origin(kind) is Literal:
        return " or ".join(f"'{word}'" for word in get_args(kind))
    inner = [plain_type(inner_kind) for inner_kind in get_args(kind) if inner_kind not in (NoneType, ...)]
    if get_origin(kind) is tuple:
        if ... in get_args(kind):
            return f"a list of {MANY.get(inner[0]) or in_words(inner[0], table)}"
        return f"[{', '.join(in_words(inner_kind, table) for inner_kind in inner)}]"
    if get_origin(kind) is dict:
        return f"{MANY.get(inner[1]) or in_words(inner[1], table)} by name"
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(dict.fromkeys(in_words(inner_kind, table) for inner_kind in inner))
    return table or kind.__name__


def _fitted(value, kind):
    kind, value = plain_type(kind), _plain(value)
    origin, inner = get_origin(kind), tuple(map(plain_type, get_args(kind)))
    if origin in (Union, UnionType):
        if NoneType in inner and is_blank(value):  # which is not the same as nothing
            raise _Misfit
        for choice in inner:
            try:
                return _fitted(value, choice)
            except _Misfit:
                pass
    elif origin is tuple and isinstance(value, tuple):
        if ... in inner:
            if inner[0] is float and all(type(entry) is float for entry in value):  # thousands of frequencies
                return value
            return tuple(_fitted(entry, inner[0]) for entry in value)
        if len(inner) == len(value):
            return tuple(map(_fitted, value, inner))
    elif origin is dict and isinstance(value, dict):
        return {_fitted(key, inner[0]): _fitted(entry, inner[1]) for key, entry in value.items()}
    elif origin is Literal:
        if isinstance(value, str) and value in inner:
            return value
    elif kind is float:
        if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 2**1024:
            return float(value)
        if isinstance(value, float):  # infinite or NaN: for the checks of ranges
            return value
    elif isinstance(value, origin or kind) and (kind is bool or not isinstance(value, bool)):
        return value
    raise _Misfit


def _fits(value, kind) -> bool:
    try:
        _fitted(value, kind)
    except _Misfit:
        return False
    return True


def _plain(value):
    """Python's own for numbers of NumPy, lists of all kinds and paths; others as they are."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    elif isinstance(value, os.PathLike):
        value = os.fspath(value)
    return tuple(value) if isinstance(value, (list, range, Iterator)) else value


def _shown(value) -> str:
    """What was found, the beginning of a long one."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else text[:77] + "..."
