"""Write and read objects of open families, such as components and error measures, as plain data.

A family is an abstract base class. Each member is a frozen dataclass with a field `kind` that names it; members may be
defined anywhere, also in a script. What is read of a kind that no class is known of keeps its settings, and is written
again as it was.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, is_dataclass
from typing import Any

from pydantic import TypeAdapter


@dataclass(frozen=True)
class UnknownKind:
    """What stands for a member of a family whose class is not known here: its `kind` and its settings."""

    kind: str
    settings: dict[str, Any]


def table_of(settings) -> dict[str, Any]:
    """Return the kind and the settings of a member of a family as plain data."""
    return settings.settings | {"kind": settings.kind} if isinstance(settings, UnknownKind) else asdict(settings)


def from_table(family: type, unknown: type, table) -> Any:
    """Return the member of a family that `table_of` made a table of; of the class `unknown` where its own is not
    defined."""
    if isinstance(table, family):
        return table
    if not (isinstance(table, dict) and isinstance(table.get("kind"), str)):
        raise ValueError("a table with the text 'kind' is expected")
    settings = dict(table)
    for member in _subclasses(family):
        known = is_dataclass(member) and not issubclass(member, UnknownKind)
        if known and getattr(member, "kind", None) == settings["kind"]:
            return TypeAdapter(member).validate_python(settings)
    return unknown(settings.pop("kind"), settings)


def _subclasses(parent):
    for kind in parent.__subclasses__():
        yield kind
        yield from _subclasses(kind)
