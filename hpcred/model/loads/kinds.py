"""Define loads that are more than a force at a node: pressure, traction, line loads, gravity, load vectors of files.

Each load is a column of B (a moving load several), and its input is a factor without unit: the load acts as it is
declared where the factor is 1. The output that belongs to it by C = B^T is the work b^T q of the load on displacements
q, in J.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from ...parallel.declared import Settings
from ...parallel.failures import InputError
from ...parallel.ranges import Label, Number, Range, Vector
from ..interfaces.nodes import Nodes, check_word

BASE, SUPPORT = "base", "support"  # kinds of columns of bases: all that holds a body moves, or a part of it


def _something(key, value):
    if not np.any(value):
        raise InputError(f"{key}: found {value}, which is no load; leave it out")


def _direction(key, value):
    if value is not None and not any(value):
        raise InputError(f"{key}: found {value}, which has no direction")


def _each_once(key, value):
    if not value or len(set(value)) < len(value):
        raise InputError(f"{key}: expected at least one number of a node, and each once")


Place = Annotated[tuple[Label, ...], _each_once] | Nodes | str
Size = Annotated[Number, _something]
Direction = Annotated[Vector, _direction]


@dataclass(frozen=True, kw_only=True)
class NamedLoad(Settings):
    """Base of the loads: inputs with names.

    Parameters
    ----------
    name : str
        Name of the input: a word that begins with a letter.
    """

    name: str

    @property
    def where(self) -> str:
        return f"load '{self.name}': "

    def __post_init__(self):
        super().__post_init__()
        check_word(f"{self.where.partition(' ')[0]}.name", self.name)


@dataclass(frozen=True, kw_only=True)
class Pressure(NamedLoad):
    """A pressure on faces of the surface.

    Parameters
    ----------
    on : str, Nodes or sequence of int
        The faces of the surface all of whose nodes are these: those of a node set or of an interface of this name, of
        a bore, pin, box, sphere or cylinder, or nodes by number.
    value : float, default 1.0
        In N/m^2. It pushes on solids from outside; on shells in the direction of their normal, from which the nodes of
        an element are seen counterclockwise.

    Raises
    ------
    InputError
        As all loads do: for a value of zero, and names that are no words.
    """

    on: Place
    value: Size = 1.0
    kind: Literal["pressure"] = field(default="pressure", repr=False)


@dataclass(frozen=True, kw_only=True)
class Traction(NamedLoad):
    """A force per area on faces of the surface, of one direction.

    Parameters
    ----------
    on : str, Nodes or sequence of int
        The faces, as for Pressure.
    value : tuple of three floats
        In N/m^2.
    """

    on: Place
    value: Annotated[Vector, _something]
    kind: Literal["traction"] = field(default="traction", repr=False)


@dataclass(frozen=True, kw_only=True)
class LineLoad(NamedLoad):
    """A force per length along edges of elements.

    Parameters
    ----------
    on : str, Nodes or sequence of int
        The beams, and the edges of faces of the surface, all of whose nodes are these (as for Pressure).
    value : tuple of three floats
        In N/m.
    """

    on: Place
    value: Annotated[Vector, _something]
    kind: Literal["line"] = field(default="line", repr=False)


@dataclass(frozen=True, kw_only=True)
class Gravity(NamedLoad):
    """The weight of the body: M times a rigid-body translation, exact for all elements.

    Parameters
    ----------
    value : tuple of three floats
        Acceleration of gravity in m/s^2, such as (0, 0, -9.81).
    """

    value: Annotated[Vector, _something]
    kind: Literal["gravity"] = field(default="gravity", repr=False)


@dataclass(frozen=True, kw_only=True)
class Centrifugal(NamedLoad):
    """The centrifugal forces of a body of solids that spins about an axis: omega^2 M r, exact for its mass matrix.

    Parameters
    ----------
    name : str
        Name of the input. Its factor is the square of the angular velocity by `value`.
    axis : tuple of three floats
        Direction of the axis.
    point : tuple of three floats, default (0, 0, 0)
        A point of the axis in m.
    value : float, default 1.0
        Angular velocity in rad/s.

    Raises
    ------
    InputError
        As Pressure, and for an axis without direction.
    """

    axis: Direction
    point: Vector = (0.0, 0.0, 0.0)
    value: Size = 1.0
    kind: Literal["centrifugal"] = field(default="centrifugal", repr=False)


@dataclass(frozen=True, kw_only=True)
class GivenLoad(NamedLoad):
    """A column of a matrix file, as those of inputs.

    Parameters
    ----------
    file : str
        A matrix file with the rows of the model, SI units; of a Harwell-Boeing file with right-hand sides, as that of
        HBMAT of ANSYS, these are the columns.
    column : int, default 1
        Number of the column.

    Raises
    ------
    InputError
        For names that are no words, and numbers below 1.
    """

    file: str
    column: Label = 1
    kind: Literal["given"] = field(default="given", repr=False)


@dataclass(frozen=True, kw_only=True)
class DeckLoad(NamedLoad):
    """The loads that a finite-element program reads from its input file.

    Parameters
    ----------
    file : str
        An input file of Abaqus or CalculiX, or of Nastran, or a .full file of a static analysis of ANSYS with its load
        vector, in the units in which the model was converted.
    step : int, optional
        Number of the *Step, from 1, of an Abaqus or CalculiX file.
    sid : int, optional
        Number of the load set of a Nastran file.

    Raises
    ------
    InputError
        For names that are no words, and if both step and sid are given.
    """

    file: str
    step: Label | None = None
    sid: Label | None = None
    kind: Literal["deck"] = field(default="deck", repr=False)

    def __post_init__(self):
        super().__post_init__()
        if self.step is not None and self.sid is not None:
            raise InputError(
                f"load '{self.name}': expected `step` (of an input file of Abaqus or CalculiX) or `sid` (of Nastran)"
            )


@dataclass(frozen=True, kw_only=True)
class Temperature(NamedLoad):
    """The load of a rise in temperature on solids of isotropic materials: what would hold their expansion back.

    Parameters
    ----------
    value : float, default 1.0
        Rise of the temperature in K; with a file, the factor of its temperatures.
    file : str, optional
        Lines of node, rise of temperature in K, for all nodes of the solids; by default the rise is the same
        everywhere. Within an element temperatures are interpolated as displacements are.

    Raises
    ------
    InputError
        For a value of zero, and names that are no words.
    """

    value: Size = 1.0
    file: str | None = None
    kind: Literal["temperature"] = field(default="temperature", repr=False)


@dataclass(frozen=True, kw_only=True)
class MovingLoad(NamedLoad):
    """A force that moves along a path of nodes: several inputs, which are forces at points of the path.

    Parameters
    ----------
    name : str
        The inputs are NAME.1, NAME.2, and so on.
    on : sequence of int, str or Nodes
        The nodes of the path: numbers in their order along it; or as for Pressure, and then `along`.
    value : tuple of three floats
        The force in N.
    points : int, default 5
        Number of points, evenly spread over the length of the path; between two nodes, the force is shared by them.
    along : tuple of three floats, optional
        Direction in which nodes follow each other that are not given by number.

    Raises
    ------
    InputError
        For a force of zero, fewer than two points, nodes without an order, and names that are no words.
    """

    on: Place
    value: Annotated[Vector, _something]
    points: Annotated[int, Range(2, 1000)] = 5
    along: Direction | None = None
    kind: Literal["moving"] = field(default="moving", repr=False)

    def __post_init__(self):
        super().__post_init__()
        if self.along is None and not isinstance(self.on, tuple):
            raise InputError(f"{self.where}along: missing; expected the direction in which its nodes follow each other")

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(f"{self.name}.{k + 1}" for k in range(self.points))

    def factors(self, places: ArrayLike) -> np.ndarray:
        """Return the factors of the inputs for a force at places on the path.

        Parameters
        ----------
        places : array_like, shape (n,)
            From 0 at the first node of the path to 1 at the last; elsewhere the force is not on the body.

        Returns
        -------
        ndarray, shape (n, points)
            By a natural cubic spline over the points: sums and first moments along the path are exact.
        """
        from scipy.interpolate import CubicSpline  # which few models need

        places = np.asarray(places, dtype=float)
        spline = CubicSpline(np.linspace(0.0, 1.0, self.points), np.eye(self.points), bc_type="natural")
        return np.where(((places >= 0) & (places <= 1))[..., None], spline(places), 0.0)


AnyLoad = Annotated[
    Pressure | Traction | LineLoad | Gravity | Centrifugal | Temperature | MovingLoad | GivenLoad | DeckLoad,
    Field(discriminator="kind"),
]


def input_names(load) -> tuple[str, ...]:
    """Return the names of the inputs of a load."""
    return load.input_names if isinstance(load, MovingLoad) else (load.name,)


@dataclass(frozen=True, kw_only=True)
class LoadColumn:
    """A load of a model: an input that is not the direction of a node, and its sums.

    Attributes
    ----------
    name : str
        Name of the input.
    kind : str
        As of its definition.
    force, moment : tuple of three floats
        Sums of the forces in N, and of their moments about the origin in N m, with those on held dofs.
    held_force, held_moment : tuple of three floats
        The parts of the sums on dofs that are held and have no row, which do not deform the body.
    area : float
        Of the faces that it acts on, in m^2.
    remark : str
        What to know of it.
    spins : bool
        Whether centrifugal forces are in it.
    integrated : int
        How often the acceleration of a base has been integrated: the input is its velocity for 1, its displacement
        for 2.
    """

    name: str
    kind: str
    force: Vector
    moment: Vector
    held_force: Vector = (0.0, 0.0, 0.0)
    held_moment: Vector = (0.0, 0.0, 0.0)
    area: float = 0.0
    remark: str = ""
    spins: bool = False
    integrated: int = 0

    @property
    def is_motion(self) -> bool:
        """Whether the input is the motion of a base, in place of a force."""
        return self.kind in (BASE, SUPPORT)

    @property
    def deflects(self) -> bool:
        """Whether this acceleration is of one of several supports, beside which the body has a static deflection."""
        return self.kind == SUPPORT

    @property
    def row(self) -> dict:
        """For a table: name, kind, force and moment by axis."""
        cells = {"load": self.name, "kind": self.kind}
        cells |= {f"F{axis} (N)": value for axis, value in zip("xyz", self.force, strict=True)}
        return cells | {f"M{axis} (N m)": value for axis, value in zip("xyz", self.moment, strict=True)}

    @property
    def notes(self) -> list[str]:
        """Sentences on it, and on the part that acts on held dofs."""
        notes = [f"load '{self.name}': {self.remark}"] if self.remark else []
        if any(self.held_force) or any(self.held_moment):
            lost = ", ".join(f"{value:.6g}" for value in self.held_force)
            notes.append(
                f"load '{self.name}': [{lost}] N of it act on held dofs; they count in its sums, and deform nothing"
            )
        return notes


def motions_of(loads) -> list[str]:
    """Return the names of inputs that are motions of bases, of the LoadColumns of a model or record."""
    return [load.name for load in loads if load.is_motion]
