"""Define what an export is, one class registered by its address or by an entry point, and what it takes."""

import re
from abc import ABC, abstractmethod
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ..body.body import Body
from ..body.units import fields_in, in_units
from ..files.outputs import SUPERELEMENT, kind_of_start
from ..files.result_file import Result, Shapes
from ..model.units import SI, Units
from ..reduction.parametric.reduced import ParametricReducedModel
from ..reduction.result.reduced_model import ReducedModel
from .superelement import Superelement, superelement

OF_NAMES = "surrogateescape"  # for texts with names of files, whose bytes need not be UTF-8


@dataclass
class ExportSource:
    """What a Writer takes of a result. Each part is made when it is first asked for, on one rank.

    Attributes
    ----------
    result : Result
        The result file.
    name : str
        Of the result, without suffix.
    stem : str
        Of the file that is written.
    nodes : list of int or str, optional
        The interface nodes that were chosen.
    units : Units
        Those of the file, in which `body` and `superelement` are; everything else is in SI.
    modes : list of int or None
        Numbers from 1 of the chosen shapes.
    surface, stress : bool
        Whether the body has them.
    options : object or None
        The settings of the Writer, an instance of its class `options`.
    beside : dict
        Contents (str or bytes) of further files to write, by what follows `stem` in their names.
    parametric : ParametricReducedModel or None
        The reduced model with its parameters; None where it has none or values were chosen.
    base : str or None
        What the inputs of bases are, see ReducedModel.driven_by; None for accelerations.
    """

    result: Result
    stem: str
    nodes: list[int | str] | None = None
    units: Units = SI
    modes: list[int] | None = None
    surface: bool = False
    stress: bool = False
    options: Any = None
    beside: dict[str, str | bytes] = field(default_factory=dict)
    parametric: ParametricReducedModel | None = None
    base: str | None = None

    @property
    def name(self) -> str:
        return Path(self.result.path).stem

    @property
    def reduced(self) -> ReducedModel:
        """The reduced model, for programs that know inputs and outputs and no nodes."""
        return self.driven(self.result.reduced)

    def driven(self, reduced: ReducedModel) -> ReducedModel:
        """Return a `reduced` model of accelerations of its bases with the inputs that were asked for. Raises
        InputError."""
        return reduced if self.base is None else reduced.driven_by(self.base)

    @cached_property
    def body(self) -> Body:
        """The body with its interface nodes, and its surface and stresses where they are wanted. Raises InputError."""
        body = self.result.body(self.nodes)
        body.surface = self.result.surface() if self.surface and body.nodes else None
        body.stress = self.result.stress_to_export() if self.stress else None
        return body if self.units == SI else in_units(body, self.units)

    @cached_property
    def superelement(self) -> Superelement:
        """The superelement of a result in interface coordinates. Raises InputError for others."""
        element = superelement(self.reduced)
        if self.units == SI:
            return element
        return replace(element, **fields_in(element, self.units), remarks=(*element.remarks, f"in {self.units.name}"))

    def shapes(self) -> AbstractContextManager[Shapes]:
        """A context with the shapes of all nodes (see Shapes)."""
        return self.result.shapes()


class Writer(ABC):
    """An export: derive, set `suffix` and `needs`, and write `write` and `begins`.

    Attributes
    ----------
    name : str
        The word for --format; by default the name of the entry point.
    suffix : str
        What follows the name of the result in that of the file, such as ".fem".
    needs : str
        What it takes: "body"; "reduced", for programs that know inputs and outputs and no nodes; "shapes"; or
        "superelement". Options that do not go with it are refused before anything is read.
    si : bool
        Whether the program that reads a body or a superelement wants SI. By default False.
    surface : bool
        Whether the body has the surface that is drawn. By default False.
    stress : bool
        Whether the body has its stress modes, where the result has some. By default False.
    keeps_parameters : bool
        Whether the file keeps parameters of a model that has some. By default False: it is at their reference values.
    picture : bool
        Whether it shows chosen shapes (--modes). By default False.
    options : type or None
        A frozen dataclass of its own settings with defaults, `--set format.key=value`. By default None.
    kind : str
        The kind of its files where files.outputs knows it, by default none: `begins` tells them.

    Notes
    -----
    Register the class of another package by an entry point of the group "hpcred.writers", whose name is that of the
    format.
    """

    name = suffix = needs = kind = ""
    si = surface = stress = picture = keeps_parameters = False
    options: type | None = None
    package = ""  # that brings it

    def __init__(self) -> None:
        if not self.suffix or self.needs not in ("body", "reduced", "shapes", "superelement"):
            raise TypeError(f"{type(self).__name__} has no suffix, or needs '{self.needs}'")

    @property
    def any_units(self) -> bool:
        """Whether it can be written in other units than SI."""
        return self.needs in ("body", "superelement") and not self.si

    @abstractmethod
    def write(self, target: Path, source: ExportSource) -> list[str]:
        """Write the file `target` from the parts of the result that `needs` names, in `source`; called on one rank.

        Return remarks on what the file does not hold, or, of a writer of shapes, the names of those that it wrote.
        Raise InputError for a result that the format cannot hold.
        """

    def begins(self, start: bytes) -> bool:
        """Return whether a file with this `start` of 4096 bytes is of this format, and may be replaced by a new one."""
        return bool(self.kind) and kind_of_start(start) == self.kind

    def describe(self, path) -> dict:
        """Return what `hpcred info` says of a file `path` that begins so, besides its name; called on one rank.

        One of our own returns nothing of a file that its format shares with others, such as a .mat.
        """
        return {}


class SuperelementWriter(Writer):
    """An export of a superelement: derive, and write `make`.

    `title`, `begin` and `nodes`, for info: what its text is and how it begins, and a pattern of the `name` and `node`
    of each interface node.
    """

    needs, kind = "superelement", SUPERELEMENT
    title = begin = nodes = ""

    @abstractmethod
    def make(self, element: Superelement, stem: str) -> tuple[bytes | str, dict[str, bytes | str], list[str]]:
        """Return the content of the file, the contents beside it by what follows `stem`, and remarks.

        Raise InputError for a superelement that the format cannot hold.
        """

    def write(self, target, source):
        content, source.beside, remarks = self.make(source.superelement, source.stem)
        target.write_bytes(content if isinstance(content, bytes) else content.encode(errors=OF_NAMES))
        return list(remarks)

    def begins(self, start):
        return bool(self.begin) and start.startswith(self.begin.encode())

    def describe(self, path):
        text = Path(path).read_text(encoding="utf-8", errors="replace")
        interfaces = {match["name"]: int(match["node"]) for match in re.finditer(self.nodes, text)}
        return {"format": f"superelement: {self.title}", "interface_nodes": interfaces}
