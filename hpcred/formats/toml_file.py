"""Tables of a TOML file become checked frozen dataclasses; every refusal names the key, what was found and expected."""

import difflib
import sys
from dataclasses import MISSING, fields
from pathlib import Path
from typing import get_args, get_origin

from pydantic import ConfigDict, TypeAdapter, ValidationError

from ..parallel.failures import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

WORDS = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
}


def read_table(path, overrides=()) -> dict:
    """The tables of a TOML file; `overrides` are texts "key.path=value". Raises InputError."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        table = tomllib.loads(path.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a TOML file: {error}") from error
    for text in overrides:
        _override(table, text)
    return table


def as_kind(classes, item: dict, where: str):
    """An instance of the one of some dataclasses that the key `kind` of a table names. Raises InputError."""
    item, kinds = tuples(item), {cls.kind: cls for cls in classes}
    if not isinstance(item, dict):
        raise InputError(f"{where}: found {item!r}, expected a table with a key 'kind'")
    if "kind" not in item:
        raise InputError(f"{where}.kind: missing; expected one of {', '.join(kinds)}")
    kind = item["kind"]
    if kind not in kinds:
        raise InputError(f"{where}.kind: found {kind!r}, expected one of {', '.join(kinds)}{_near(kind, kinds)}")
    return as_table(kinds[kind], {key: value for key, value in item.items() if key != "kind"}, where)


def as_table(cls, values, where):
    """An instance of a dataclass from the values of a table, with strict types. Raises InputError."""
    names = {field.name: field for field in fields(cls)}
    check_known(values, names, where)
    checked = {}
    for name, field in names.items():
        place = f"{where}.{name}" if where else name
        if name in values:
            checked[name] = _checked(field.type, values[name], place)
        elif field.default is MISSING:
            raise InputError(f"{place}: missing; expected {_expected(field.type)}")
    return cls(**checked)


def _checked(kind, value, place):
    try:
        return TypeAdapter(kind, config=ConfigDict(strict=True)).validate_python(value)
    except ValidationError as error:
        raise InputError(f"{place}: found {_as_toml(value)}, expected {_expected(kind)}") from error


def _expected(kind) -> str:
    """A type in words."""
    if kind in WORDS:
        return WORDS[kind]
    parts = [part for part in get_args(kind) if part not in (type(None), ...)]
    if get_origin(kind) is tuple:
        if ... in get_args(kind):
            return f"a list of {' or '.join(_expected(part) for part in parts)}"
        return f"[{', '.join(_expected(part) for part in parts)}]"
    return " or ".join(_expected(part) for part in parts) or "a table"


def _as_toml(value):
    if isinstance(value, tuple):
        return "[" + ", ".join(_as_toml(item) for item in value) + "]"
    return f"'{value}'" if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else str(value)


def check_known(table, names, where):
    """Raise InputError for a key that is none of `names`."""
    for key in table:
        if key not in names:
            place = f"{where}.{key}" if where else key
            raise InputError(f"{place}: unknown key{_near(key, names)}; known are {', '.join(names)}")


def _near(word, words) -> str:
    close = difflib.get_close_matches(str(word), list(words), n=1, cutoff=0.5)
    return f" (did you mean '{close[0]}'?)" if close else ""


def tuples(value):
    """Lists as tuples, at every depth, since the dataclasses are frozen."""
    if isinstance(value, dict):
        return {key: tuples(item) for key, item in value.items()}
    return tuple(tuples(item) for item in value) if isinstance(value, list) else value


def _override(table, text):
    """Put the value of "a.b.0.c=value" (TOML, or a bare word) into the tables."""
    key, equals, value = text.partition("=")
    if not equals:
        raise InputError(f"--set: found '{text}', expected key=value, such as basis.0.frequency=150.0")
    try:
        value = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        value = value.strip()
    *path, last = key.strip().split(".")
    try:
        for part in path:
            table = table[int(part)] if isinstance(table, list) else table.setdefault(part, {})
        table[int(last) if isinstance(table, list) else last] = value
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"--set: the job has no place '{key}'") from error
