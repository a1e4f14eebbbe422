"""Make commands of functions, and define the options and the table titles that several of them share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from inspect import Signature, signature
from typing import Annotated, Any, get_args

import typer

from ..parallel.declared import Keywords, Option, flattened, plain_type
from ..settings import texts
from . import session

JsonFile = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the numbers; - prints them.", callback=session.checked),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Replace a key of the file: tolerance=1e-6, basis.0.order=2"),
]
OutOfCore = Annotated[str | None, typer.Option(metavar="DIR", help="Keep the factors in files there.")]
LowRank = Annotated[float | None, typer.Option(metavar="EPS", help="Block low rank factors, such as 1e-8.")]
Details = Annotated[bool, typer.Option("--details", help="Show basis, points, time and memory too.")]
DIRECTIONS = "Directions, the least accurate first (|H| in SI units: m/N, rad/(N m))"


def command(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make a command of a function: an option of every parameter, or field of Keywords, that is annotated by an Option,
    and the value of its text. Fields that are not annotated are no options."""
    called, options, parameters = flattened(function), {}, []
    for argument in signature(called).parameters.values():
        about = getattr(argument.annotation, "__metadata__", ())
        if about and isinstance(option := about[-1], Option):
            options[argument.name] = option
            shown = typer.Option(*option.names, metavar=option.metavar, help=option.help)
            default = argument.default if option.parsed is None else option.text
            kind = Annotated[_kind_of_text(argument.annotation, option), shown]
            argument = argument.replace(annotation=kind, default=default)
        if about or argument.annotation is typer.Context:
            parameters.append(argument)

    @wraps(called)
    def parsed(**given):
        for key, option in options.items():
            if given[key] is None:
                del given[key]
            elif option.parsed is not None:
                given[key] = option.parsed(given[key], option.name(key))
        return called(**given)

    parsed.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    parsed.__annotations__ = {argument.name: argument.annotation for argument in parameters}
    return parsed


def _kind_of_text(annotation, option):
    """Return the type that the parser of the command line makes: a number or a flag, or else a text."""
    if option.many:
        return list[str] | None
    kind = plain_type(annotation)
    known = option.parsed is None and ({kind, *get_args(kind)} & {int, float, bool})
    return kind if known else str | None


@dataclass(frozen=True, kw_only=True)
class Solving(Keywords):
    """Options on how models are factored."""

    out_of_core: OutOfCore = None
    low_rank: LowRank = None
    package: Annotated[str | None, typer.Option(help="What factors: auto, mumps, cudss, superlu_dist or petsc.")] = None

    @property
    def given(self) -> dict:
        """The keywords of a workflow."""
        factoring = texts.factoring(self.out_of_core, self.low_rank, self.package)
        return {"factoring": factoring, "progress": session.progress()}


@dataclass(frozen=True, kw_only=True)
class SharedSolving(Solving):
    """The same, with groups of ranks."""

    groups: Annotated[int | None, typer.Option(help="Groups of ranks that share the frequencies.")] = None

    @property
    def given(self) -> dict:
        return super().given | {"groups": self.groups}
