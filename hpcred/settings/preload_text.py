"""Read a preload of the command line: a table in TOML."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from ..body.preload import Preload
from ..parallel.failures import InputError
from .toml_file import CONFIG, parse

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True, kw_only=True)
class _Holder:
    """The table around a preload."""

    preload: Preload

    __pydantic_config__ = CONFIG


def preload_of(text: str | None) -> Preload | None:
    """Return the preload of a text such as "{omega = [0, 0, 300]}", or None for None. Raises InputError."""
    if text is None:
        return None
    try:
        table = tomllib.loads(f"preload = {text}")
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            f"--preload: found '{text[:80]}', expected a table such as '{{omega = [0, 0, 300]}}' or "
            "'{forces = {\"crank:x\" = 100.0}}'"
        ) from error
    return parse(_Holder, table).preload
