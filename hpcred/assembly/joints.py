"""Define what a machine is made of: bodies and where they stand, rigid joints, bushings, and masses at interfaces."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from ..fe.dofs import DIRECTIONS
from ..model.laws.registry import AnyLaw
from ..model.operator import Law
from ..model.rotation import skew, unit_axis
from ..parallel.declared import Settings, as_declared
from ..parallel.failures import InputError
from ..parallel.ranges import LABEL, Coordinate, Range, within

Vector = tuple[Coordinate, Coordinate, Coordinate]
SIX = DIRECTIONS[:6]
GROUND = "ground"
NotNegative = Annotated[float, Range(0.0, 1e30)]


@dataclass(frozen=True, kw_only=True)
class Turn(Settings):
    """A rotation.

    Parameters
    ----------
    axis : {"x", "y", "z"} or tuple of three floats
        Of any length.
    degrees : float
        Angle about it.
    """

    axis: Literal["x", "y", "z"] | Vector
    degrees: Annotated[float, Range(-1e6, 1e6, "degrees")]

    where = "turn."

    def __post_init__(self):
        super().__post_init__()
        unit_axis("turn.axis", self.axis)

    @property
    def matrix(self) -> np.ndarray:
        """The rotation matrix (3, 3); that of multiples of 90 degrees about x, y or z without round-off."""
        axis = unit_axis("turn.axis", self.axis)
        sine, cosine = np.sin(np.radians(self.degrees % 360)), np.cos(np.radians(self.degrees % 360))
        if self.degrees % 90 == 0:
            sine, cosine = round(sine), round(cosine)
        return cosine * np.eye(3) + sine * skew(axis) + (1 - cosine) * np.outer(axis, axis)


def _with_turn(settings, where):
    """Make the turn of a body or a joint a Turn where it is a dict, as in a file. Raises InputError for other types."""
    if isinstance(settings.turn, dict):
        object.__setattr__(settings, "turn", Turn(**{"axis": None, "degrees": None, **settings.turn}))
    if not isinstance(settings.turn, Turn | None):
        raise InputError(f"{where}turn: found {str(settings.turn)[:60]!r}, expected "
                         'hpcred.assembly.Turn(axis="z", degrees=90.0), or a dict of both')  # fmt: skip


def matrix_of(turn: Turn | None) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a turn, that of none where there is none."""
    return np.eye(3) if turn is None else turn.matrix


@dataclass(frozen=True, kw_only=True)
class MachineBody:
    """A body of a machine.

    Parameters
    ----------
    name : str
        By which joints, inputs and outputs call it.
    result : str
        Of kind "reduced": result.h5; in Python also a Result. Of kind "measured": a file of responses, .unv, .uff, .mat
        or .npz, see docs/assembly.md.
    position : tuple of three floats, default (0, 0, 0)
        Of the origin of the body in the machine, in m.
    turn : Turn or dict, optional
        Of the body about its origin, such as {"axis": "z", "degrees": 90.0}.
    nodes : dict of str to int
        Names for nodes by number, such as {foot = 20}.
    kind : {"reduced", "measured"}, default "reduced"
        What the file is.
    exact : bool, default False
        Whether the result counts as exact in the error of the machine, as of a superelement of another program, in
        whose file nothing is known of its error.

    Raises
    ------
    InputError
        For names that are no words, and values of other types.
    """

    name: str
    result: str
    position: Vector = (0.0, 0.0, 0.0)
    turn: Turn | None = None
    nodes: dict[str, int] = field(default_factory=dict)
    kind: Literal["reduced", "measured"] = "reduced"
    exact: bool = False

    def __post_init__(self):
        _with_turn(self, "body.")
        as_declared(self, "body.", keys=("name", "position", "kind", "nodes", "exact"))
        if self.exact and self.kind == "measured":
            raise InputError(f"body.exact: body '{self.name}' is measured, and has no coordinates; leave it out")
        for key, name in (("name", self.name), *(("nodes", name) for name in self.nodes)):
            if not name or set(name) & set(".: /") or not name.isprintable() or name == GROUND:
                raise InputError(f"body.{key}: found {ascii(name[:40])}, expected a word without '.', ':', '/' and "
                                 f"blanks, and not '{GROUND}'")  # fmt: skip
        within("body.nodes", numbers := tuple(self.nodes.values()), LABEL)
        if len(set(numbers)) < len(numbers):
            raise InputError(f"body.nodes: found one of the nodes {list(numbers)} twice, expected one name for each")


@dataclass(frozen=True, kw_only=True)
class RigidJoint(Settings):
    """A rigid joint: the two interfaces move alike in some directions.

    Parameters
    ----------
    bodies : tuple of two str
        The interfaces, such as "bed.guide_left", or "ground" for one of them. Where they lie apart, they are joined
        rigidly at the first.
    directions : str or sequence of str, default ("x", "y", "z", "rx", "ry", "rz")
        Such as "xyz" or ["x", "rz"].
    turn : Turn or dict, optional
        Of the axes of the directions; by default those of the machine.
    """

    bodies: tuple[str, str]
    directions: str | tuple[str, ...] = SIX
    turn: Turn | None = None
    kind: Literal["rigid"] = "rigid"

    where = "joint."

    def __post_init__(self):
        _with_turn(self, self.where)
        super().__post_init__()
        check_bodies(self)
        unknown = [name for name in self.directions if name not in SIX]
        if unknown or not self.directions or len(set(self.directions)) < len(self.directions):
            raise InputError(f"joint.directions: found {list(self.directions)}, expected some of {', '.join(SIX)}, "
                             "each once; letters alone, such as \"xyz\", are displacements")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class BushingJoint:
    """Springs and dampers between two interfaces, in x, y, z against displacements and about them against rotations.

    Parameters
    ----------
    bodies : tuple of two str
        The interfaces, as of a rigid joint.
    stiffness, damping : sequence of three or six floats
        Stiffness in N/m and N m/rad, damping in N s/m and N m s/rad; directions that are not given have none.
    law : law, optional
        How the stiffness depends on frequency, {kind = "maxwell", factors = [0.5], times = [1e-3]}: what a law adds to
        its static value multiplies `stiffness`, which is the static one.
    table : str, optional
        A .csv with a dynamic stiffness over frequency, beside `stiffness`: columns f_hz, re_x, im_x and so on to im_rz,
        and perhaps a column for a parameter, such as amplitude.
    at : dict of str to float
        The value of the parameter of the table, such as {amplitude = 1e-5}; between its values it is linear.
    turn : Turn or dict, optional
        Of the axes x, y, z; by default those of the machine.
    """

    bodies: tuple[str, str]
    stiffness: tuple[NotNegative, ...] = ()
    damping: tuple[NotNegative, ...] = ()
    law: AnyLaw | None = None
    table: str | None = None
    at: dict[str, float] = field(default_factory=dict)
    turn: Turn | None = None
    kind: Literal["bushing"] = "bushing"

    def __post_init__(self):
        _with_turn(self, "joint.")
        as_declared(self, "joint.", keys=("bodies", "stiffness", "damping", "table", "at"))
        check_bodies(self)
        for key in ("stiffness", "damping"):
            if (count := len(getattr(self, key))) not in (0, 3, 6):
                raise InputError(f"joint.{key}: found {count} numbers, expected three, or six with rotations")
        if not any(self.stiffness) and not any(self.damping) and self.table is None:
            raise InputError("joint: a bushing without stiffness, damping and table holds nothing; give one of them")
        if not isinstance(self.law, Law | None):
            raise InputError(f"joint.law: found {str(self.law)[:60]!r}, expected a law, such as "
                             "hpcred.laws.Maxwell((0.5,), (1e-3,))")  # fmt: skip
        if self.law is not None and not any(self.stiffness):
            raise InputError("joint.law: multiplies `stiffness`, and there is none; give it")
        if self.at and self.table is None:
            raise InputError("joint.at: is the value of the parameter of a table, and there is no table; leave it out")


@dataclass(frozen=True, kw_only=True)
class PointMass(Settings):
    """A rigid mass at an interface.

    Parameters
    ----------
    at : str
        The interface, such as "spindle.tool".
    mass : float
        In kg.
    inertia : tuple of three floats, default (0, 0, 0)
        About x, y and z of the machine through the interface, in kg m^2.
    """

    at: str
    mass: NotNegative
    inertia: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)

    where = "mass."

    def __post_init__(self):
        super().__post_init__()
        if self.at == GROUND or not all(self.at.partition(".")):
            raise InputError(f"mass.at: found '{self.at[:60]}', expected a body and an interface with a dot between "
                             "them, such as spindle.tool; the ground does not move")  # fmt: skip
        if not self.mass and not any(self.inertia):
            raise InputError("mass.mass: found 0 and no inertia, which change nothing; give one of them")


def check_bodies(joint):
    """Raise InputError unless a joint is between two different interfaces, at most one of them the ground."""
    if joint.bodies[0] == joint.bodies[1]:
        raise InputError(f"joint.bodies: found '{joint.bodies[0]}' twice, expected two different interfaces")
    for name in joint.bodies:
        if name != GROUND and not all(name.partition(".")):
            raise InputError(f"joint.bodies: found '{name[:60]}', expected a body and an interface with a dot between "
                             "them, such as bed.guide, or ground")  # fmt: skip
