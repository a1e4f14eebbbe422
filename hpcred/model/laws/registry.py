"""Find the laws of terms: every dataclass of a module beside this one that derives from Law, by its `kind`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from importlib import import_module
from operator import or_
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from ..operator import Law, Term
from . import __path__


def _kinds(base) -> list[type]:
    """Return the classes with a `kind` that derive from a base."""
    return [kind for each in base.__subclasses__() for kind in ([each] if hasattr(each, "kind") else _kinds(each))]


for _module in iter_modules(__path__):
    if _module.name != "registry":
        import_module(f"{__package__}.{_module.name}")

if TYPE_CHECKING:
    AnyLaw = Law
else:
    AnyLaw = Annotated[reduce(or_, _kinds(Law)), Field(discriminator="kind")]


@dataclass(frozen=True, kw_only=True)
class NamedLaw:
    """The law of a term by name, for records."""

    name: str
    law: AnyLaw


def laws_of(terms: Iterable[Term]) -> tuple[NamedLaw, ...]:
    """Return names and laws of terms."""
    return tuple(NamedLaw(name=term.name, law=term.law) for term in terms)
