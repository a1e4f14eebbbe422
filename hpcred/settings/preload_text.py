"""Read a preload of the command line: a table in TOML."""

from __future__ import annotations

from dataclasses import dataclass

from ..body.preload import Preload
from .toml_file import CONFIG, parse, table_around


@dataclass(frozen=True, kw_only=True)
class _Holder:
    """The table around a preload."""

    preload: Preload

    __pydantic_config__ = CONFIG


def preload_of(text: str | None) -> Preload | None:
    """Return the preload of a text such as "{omega = [0, 0, 300]}", or None for None. Raises InputError."""
    if text is None:
        return None
    examples = "'{omega = [0, 0, 300]}' or '{forces = {\"crank:x\" = 100.0}}'"
    return parse(_Holder, table_around("preload", text, examples)).preload
