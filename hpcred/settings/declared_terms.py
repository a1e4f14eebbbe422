"""Define what is declared of the matrices of a model, in a job or on the command line: viscoelastic parts, and whether
K may be unsymmetric."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

from ..model.laws.registry import AnyLaw
from ..parallel.declared import Keywords, Option, as_declared
from ..parallel.failures import InputError
from .toml_file import CONFIG, check_file_names, parse, table_around


@dataclass(frozen=True, kw_only=True)
class ViscoelasticPart:
    """A part with the stiffness g(s) K_v, from a file or from the elements of a material.

    `law`: g, a table with a `kind`. `file`: a matrix file of K_v, with the rows of the model; `variable`: its name in a
    file that holds several; `units`: of its numbers, such as "mm,t,s", for a model that was converted to SI. `name`:
    for messages and records, by default that of the file. `material`: name of the material of the solid elements that
    K_v is made of; K has them with g = 1 already, and becomes K + (g(s) - 1) K_v.
    """

    law: AnyLaw
    file: str | None = None
    material: str | None = None
    variable: str | None = None
    units: str | None = None
    name: str | None = None

    def __post_init__(self):
        as_declared(self, "viscoelastic.")
        check_file_names(**{"viscoelastic.file": self.file})
        if (self.file is None) == (self.material is None):
            raise InputError("viscoelastic: expected either a file or a material")
        if self.material is not None and (self.variable is not None or self.units is not None):
            raise InputError("viscoelastic: variable and units belong to a file, found them with a material")


@dataclass(frozen=True, kw_only=True)
class _Holder:
    """The table around a part."""

    viscoelastic: ViscoelasticPart

    __pydantic_config__ = CONFIG


def viscoelastic_from(tables) -> list[ViscoelasticPart]:
    """Return the parts of tables of a job, as a record has them. Raises InputError."""
    return [parse(_Holder, {"viscoelastic": table}).viscoelastic for table in tables]


def viscoelastic_of(texts, option: str = "--viscoelastic") -> tuple[ViscoelasticPart, ...]:
    """Return the parts of texts such as '{file = "Kv.mtx", law = {kind = "maxwell", ...}}'. Raises InputError."""
    example = "'{file = \"Kv.mtx\", law = {kind = \"maxwell\", factors = [0.5], times = [1e-3]}}'"
    return tuple(parse(_Holder, table_around(option.strip("-"), text, example)).viscoelastic for text in texts)


@dataclass(frozen=True, kw_only=True)
class DeclaredTerms(Keywords):
    """Parts that are added to K, and whether it may be unsymmetric."""

    viscoelastic: Annotated[
        Iterable[ViscoelasticPart],
        Option('Part g(s) K_v: \'{file = "Kv.mtx", law = {kind = "maxwell", ...}}\'', "TABLE", viscoelastic_of,
               many=True),
    ] = ()  # fmt: skip
    circulatory: Annotated[bool, Option("K may be unsymmetric.", names=("--circulatory",))] = False

    def __post_init__(self):
        object.__setattr__(self, "viscoelastic", tuple(self.viscoelastic))  # which is gone through more than once

    @property
    def files(self) -> list[str]:
        """The matrix files."""
        return [part.file for part in self.viscoelastic if part.file is not None]
