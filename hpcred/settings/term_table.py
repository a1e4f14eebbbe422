"""Define the tables [[term]] of a job: a matrix in a file, or a term of rotation made from M, and its factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..model.parameters.definitions import Term
from ..model.rotation import unit_axis
from ..parallel.failures import InputError
from .toml_file import check_file_names

OF_KIND = {"matrix": ("of", "file", "variable", "units"), "coriolis": ("axis",), "spin_softening": ("axis",)}


@dataclass(frozen=True)
class TermTable:
    """A term of the affine form of a model with parameters, factor times matrix.

    `factor`: an expression of the parameters, of numbers, + - * / ^, parentheses, pi, sqrt, exp, log, sin, cos, tan and
    abs. `kind`: "matrix", of a file; or made from M, in the frame of a body that spins about an axis: "coriolis",
    2 M skew(e) of D, whose factor is the angular velocity in rad/s, and "spin_softening", M skew(e)^2 of K, whose
    factor is its square. `of`: the matrix of the model that the file adds to. `file`: a matrix as those of a model are
    read, with the rows of the model; B (n, p) or C (r, n) as `inputs` and `outputs` have it. `variable`: its name in a
    MATLAB file. `units`: of its numbers, such as "mm,t,s", of M, D and K of a model that was converted to SI. `axis`:
    "x", "y", "z" or a vector.
    """

    factor: str
    kind: Literal["matrix", "coriolis", "spin_softening"] = "matrix"
    of: Literal["M", "D", "K", "B", "C"] | None = None
    file: str | None = None
    variable: str | None = None
    units: str | None = None
    axis: str | tuple[float, float, float] | None = None

    def __post_init__(self):
        where = f"term of kind '{self.kind}'"
        for key in ("of", "file", "variable", "units", "axis"):
            if getattr(self, key) is not None and key not in OF_KIND[self.kind]:
                raise InputError(f"{where}: found {key}, expected {', '.join(OF_KIND[self.kind])} and factor")
        for key in ("of", "file") if self.kind == "matrix" else ("axis",):
            if getattr(self, key) is None:
                raise InputError(f"{where}: {key}: missing; expected {', '.join(OF_KIND[self.kind][:2])} and factor")
        check_file_names(**{f"{where}: file": self.file})
        if self.axis is not None:
            unit_axis(f"{where}: axis", self.axis)
        self.with_matrix(None)  # refused early

    def with_matrix(self, matrix) -> Term:
        """Return the term of a model with its matrix."""
        of = self.of or {"coriolis": "D", "spin_softening": "K"}[self.kind]
        return Term(of, matrix, self.factor)

    @property
    def matrix_in_words(self) -> str:
        """The file, or the kind and the axis."""
        if self.kind == "matrix":
            return f"{self.file}: {self.variable}" if self.variable else str(self.file)
        return f"{self.kind.replace('_', ' ')} about {self.axis if isinstance(self.axis, str) else list(self.axis)}"
