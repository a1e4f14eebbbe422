"""Read TOML files as checked frozen dataclasses; every refusal names the key, what was found and expected."""

from __future__ import annotations

import json
import os
import re
import sys
from dataclasses import is_dataclass
from pathlib import Path
from types import NoneType
from typing import get_args, get_origin

from pydantic import ConfigDict, ValidationError

from ..files.text import absent
from ..parallel.declared import adapter_of, in_words, is_blank, meant_by, nearest, plain_type, types_of
from ..parallel.failures import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

COMMANDS = {"job": ("a sweep", "sweep"), "body": ("a simulation", "simulate"), "model": ("a job", "reduce")}  # by key
MACHINE = "a machine", "assemble"  # with a list of bodies
CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)  # of the outermost dataclass, which hands it to those inside
LONGEST_PATH, LONGEST_NAME = 4096, 255  # bytes, of Linux
STRAY = re.compile("[\ud800-\udfff]")  # bytes of a command line that are no letters, as Python keeps them
LONG_NUMBER = "a whole number of thousands of digits"  # for which Python has no text
UNKNOWN = "unexpected_keyword_argument"


def read_table(path, overrides=()) -> dict:
    """The tables of a TOML file; `overrides` are texts "key.path=value". Raises InputError."""
    path = Path(path)
    if not os.path.isfile(path):
        raise absent(path)
    try:
        table = loads(path.read_text(encoding="utf-8-sig"))  # some editors put a mark in front
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: found a file that is no text, expected a text in TOML, such as job.toml") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not a TOML file: {error}") from error
    for text in overrides:
        override(table, text)
    return table


def loads(text: str) -> dict:
    """The tables of a text in TOML. Raises tomllib.TOMLDecodeError, also for what Python gives up on."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError as error:
        raise tomllib.TOMLDecodeError("found lists or tables inside each other, thousands deep") from error
    except ValueError as error:
        raise tomllib.TOMLDecodeError(f"found {LONG_NUMBER}") from error


def parse(kind, table: dict):
    """An instance of the dataclass `kind`, which has CONFIG as __pydantic_config__, with strict types.

    Tables with a key `kind` become the one of several dataclasses that it names. Raises InputError.
    """
    try:
        text = json.dumps(table, default=lambda date: [None])  # which no key takes
    except RecursionError as error:
        raise InputError("tables inside tables, thousands deep; expected a table of keys") from error
    except ValueError as error:  # of one in base 16
        raise InputError(f"found {LONG_NUMBER}, expected numbers of a few digits") from error
    try:
        settings = adapter_of(kind).validate_json(text, strict=True)
    except ValidationError as error:
        if r"\udc" in text and (stray := _stray_text(table)) is not None:  # as JSON has such bytes
            raise InputError(f"{stray[0]}: {_not_in_locale(stray[1])}") from error
        # of several mistakes the deepest: of the kinds of value that a key takes, the one that was meant
        meant = (UNKNOWN, "value_error")
        details = max(error.errors(), key=lambda problem: (len(problem["loc"]), problem["type"] in meant))
        raise InputError(_sentence(kind, table, details)) from error
    _refuse_blank(settings, "")
    return settings


def _refuse_blank(settings, where):
    """Raise InputError for an empty text where None would mean that nothing is given."""
    for key, kind in types_of(type(settings)).items():
        value = getattr(settings, key)
        if is_blank(value) and NoneType in get_args(plain_type(kind)):
            raise InputError(f"{where}{key}: found an empty text, expected {_expected(_of_values(kind))}; leave it out "
                             "where there is none")  # fmt: skip
        for k, entry in enumerate(value if isinstance(value, tuple) else (value,)):
            if is_dataclass(entry):
                _refuse_blank(entry, f"{where}{key}{f'[{k}]' if isinstance(value, tuple) else ''}.")


def table_around(key, text: str, examples) -> dict:
    """Return {key: value} of the text of an option --key, a value in TOML. Raises InputError."""
    try:
        return loads(f"{key} = {text}")
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"--{key}: found '{text[:80]}', expected a table such as {examples}") from error


def check_file_names(**names):
    """Raise InputError for texts that are no names of files; others are left alone."""
    for key, name in names.items():
        if isinstance(name, str):
            if not name.strip() or any(ord(sign) < 32 for sign in name):
                raise InputError(f"{key}: found {name[:40]!r}, expected the name of a file")
            try:
                os.fsencode(name)
                name.encode()  # no bytes of a command line that are no letters
            except UnicodeEncodeError as error:
                raise InputError(f"{key}: {_not_in_locale(name)}") from error
            if len(name.encode()) > LONGEST_PATH or max(map(len, name.encode().split(b"/"))) > LONGEST_NAME:
                raise InputError(f"{key}: found a name of {len(name)} letters, too long for a file: '{name[:40]}...'")


def _not_in_locale(name: str) -> str:
    return (f"found {ascii(name[:40])}, with letters that names of files do not have in this locale "
            f"({sys.getfilesystemencoding()}); set LC_ALL=C.UTF-8, or choose another name")  # fmt: skip


def _stray_text(value, key="") -> tuple[str, str] | None:
    """The first text, with its key, of a table from a command line in bytes that this locale has no letters for."""
    if isinstance(value, str):
        return (key or "--set", value) if STRAY.search(value) else None
    if isinstance(value, dict):
        entries = [(f"{key}.{name}" if key else name, entry) for name, entry in value.items()]
        entries += [(key, name) for name in value]
    else:
        entries = [(f"{key}[{k}]", entry) for k, entry in enumerate(value)] if isinstance(value, list) else []
    return next((place for name, entry in entries if (place := _stray_text(entry, name)) is not None), None)


def require_kind(path, table, key):
    """Raise InputError for the file of another command: one without `key`, and with the key of another."""
    other = next((word for word in COMMANDS if word in table), None)
    if key not in table and other is not None:
        kind, command = MACHINE if isinstance(table[other], list) else COMMANDS[other]
        raise InputError(f"{path}: found {kind}, which `hpcred {command}` reads; expected {COMMANDS[key][0]}, with a "
                         f"key {key}")  # fmt: skip


_MISSING = object()


def _sentence(kind, table, details) -> str:
    """What pydantic found to be wrong with a table."""
    if details["type"] == "value_error":
        return str(details["ctx"]["error"])
    top = types_of(kind)
    where, kind, value, names = _place(kind, table, details["loc"])
    if details["type"] == UNKNOWN:
        key = details["loc"][-1]
        if where != key and key in top:
            return f"{where[:40]}: '{key}' is a key of the whole file; write it above the first table"
        return f"{where[:40]}: unknown key{nearest(key, names)}; known are {', '.join(names) or 'none'}"
    if details["type"].startswith("union_tag"):
        kinds = {_kind_of(choice): choice for choice in get_args(kind)}
        if "kind" not in value:
            return f"{where}.kind: missing; expected one of {', '.join(kinds)}"
        return (
            f"{where}.kind: found {value['kind']!r}, expected one of {', '.join(kinds)}{nearest(value['kind'], kinds)}"
        )
    if value is _MISSING:
        return f"{where}: missing; expected {_expected(kind)}"
    if isinstance(value, dict) and get_origin(kind) is tuple and _dataclass_of(plain_type(get_args(kind)[0]), {}):
        return f"{where}: found a single table, expected a list of tables; write [[{where}]] in place of [{where}]"
    finite = " that is finite" if details["type"] == "finite_number" else ""
    named = value in [_kind_of(choice) for choice in get_args(kind) if is_dataclass(choice)]  # frame = "buckens"
    such = f", such as {{kind = '{value}'}}" if named else meant_by(value, kind)
    return f"{where}: found {_as_toml(value)}, expected {_expected(kind)}{finite}{such}"


def _place(kind, value, steps):
    """The key at which the steps of pydantic end, its type, its value, and the keys beside it.

    Inside of a list of numbers or texts it is the key of the list; pydantic's words for kinds of values are no keys.
    """
    where, names = "", []
    for step in steps:
        kind = _of_values(kind)
        if isinstance(value, dict):
            if named := [choice for choice in _dataclasses(kind) if choice.__name__ == step]:  # which pydantic chose
                kind = named[0]
                continue
            table = _dataclass_of(kind, value)
            if table is None or (step not in value and step not in types_of(table)):
                continue
            names = list(types_of(table))
            names.sort(key=lambda name: name != "kind")  # which says what the others are
            where = f"{where}.{step}" if where else step
            kind, value = types_of(table).get(step), value.get(step, _MISSING)
        elif isinstance(value, list) and isinstance(step, int) and (choice := _of_items(kind)) is not None:
            if _dataclass_of(plain_type(choice), {}) is None or not (isinstance(value[step], dict) or choice is kind):
                break
            where, kind, value = f"{where}[{step}]", choice, value[step]
        elif not (isinstance(step, str) and _of_items(kind) is not None and isinstance(value, list)):
            break
    return where, _of_values(kind), value, names


def _of_items(kind):
    """The type of the items of a list, also where a list is one of several kinds of value; else None."""
    lists = [choice for choice in (kind, *get_args(kind)) if get_origin(choice) is tuple and ... in get_args(choice)]
    return plain_type(get_args(lists[0])[0]) if lists else None


def _of_values(kind):
    """A type without what Annotated says of it, and without None."""
    kind = plain_type(kind)
    others = [choice for choice in get_args(kind) if choice is not NoneType]
    return plain_type(others[0]) if NoneType in get_args(kind) and len(others) == 1 else kind


def _kind_of(table) -> str | None:
    return getattr(table, "kind", None)


def _dataclass_of(kind, value):
    """The dataclass that a table is meant for, or None; the first one where its key `kind` does not tell."""
    tables = _dataclasses(kind)
    fitting = [choice for choice in tables if "kind" in value and _kind_of(choice) == value["kind"]]
    return next(iter(fitting or tables), None)


def _dataclasses(kind) -> list:
    """A dataclass, or those of several kinds of value, also where Annotated says more of them."""
    if is_dataclass(kind):
        return [kind]
    choices = [plain_type(each) for each in get_args(kind)]
    return [table for each in choices for table in (each, *map(plain_type, get_args(each))) if is_dataclass(table)]


def _expected(kind) -> str:
    """A type in words."""
    return in_words(kind, table="a table")


def _as_toml(value):
    """A value as TOML has it, the beginning of a long one."""
    if isinstance(value, list):
        text = "[" + ", ".join(_as_toml(entry) for entry in value[:8]) + ("" if len(value) <= 8 else ", ...") + "]"
    else:
        text = _item(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _item(value):
    return f"'{value}'" if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else str(value)


def override(table, text):
    """Put the value of "a.b.0.c=value" (TOML, or a bare word) into the tables."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or "\n" in text:
        raise InputError(f"--set: found {text!r}, expected key=value, such as basis.0.frequency=150.0")
    try:
        value = loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        value = value.strip()
    try:
        put(table, key, value)
    except InputError as error:
        raise InputError(f"--set: {error}") from error


def put(table: dict, key: str, value):
    """Put a value at the place "a.b.0.c" of nested tables and lists, in place of what is there. Raises InputError."""
    *path, last = steps = key.strip().split(".")
    if not all(map(str.strip, steps)):
        raise InputError(f"found the key {key[:80]!r}, expected names and numbers with a dot between two of them, such "
                         "as basis.0.order")  # fmt: skip
    try:
        for step in path:
            table = table[_place_in(step)] if isinstance(table, list) else table.setdefault(step, {})
        table[_place_in(last) if isinstance(table, list) else last] = value
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"the job has no place '{key[:80]}'") from error


def _place_in(step) -> int:
    """The place in a list, from 0. Raises ValueError for other words."""
    if not re.fullmatch("[0-9]{1,9}", step):
        raise ValueError(step)
    return int(step)


def as_value(value) -> str:
    """A value as TOML in one line: texts, numbers, lists and tables, without the keys of a table that are None."""
    if isinstance(value, dict):
        entries = (f"{_as_key(key)} = {as_value(entry)}" for key, entry in value.items() if entry is not None)
        return "{" + ", ".join(entries) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(as_value(entry) for entry in value) + "]"
    if isinstance(value, str):  # JSON leaves one character as it is that TOML does not take
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _as_key(key):
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else as_value(key)
