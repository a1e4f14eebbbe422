"""Find the holes and pins of a model, so that bearings need no coordinates typed in."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..fe.faces import gathered_surface
from ..model.interfaces.nodes import Interface, Nodes
from ..model.second_order_model import SecondOrderModel, require_model
from ..parallel.decisions import decided
from ..parallel.declared import declared, spelled
from ..parallel.failures import InputError
from .cylinder_search import find_cylinders

TURN = 120.0  # degrees: a fillet between two faces at right angles has 90
DIGITS = 7  # of places, relative to the radius


@dataclass(frozen=True, kw_only=True)
class Bore:
    """A cylinder on the surface of a body.

    Attributes
    ----------
    name : str
        "bore1", "pin1" and so on.
    kind : str
        "bore" around a hole, "pin" where it is seen from outside, "shell" on shells.
    start, end : tuple of three floats
        The ends of its axis in m.
    radius : float
        m.
    turn : float
        Degrees around the axis that the surface covers, 360 for a whole one.
    nodes : tuple of int
        Their numbers, ascending.
    """

    name: str
    kind: str
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float
    turn: float
    nodes: tuple[int, ...] = field(repr=False)

    def __str__(self):
        return (
            f"{self.name}: {self.kind} of radius {self.radius:.6g} m from {list(self.start)} to {list(self.end)} m, "
            f"{self.turn:.6g} degrees, {len(self.nodes)} nodes"
        )

    @property
    def length(self) -> float:
        """In m, along the axis."""
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

    @property
    def centre(self) -> tuple[float, float, float]:
        """The middle of the axis (m)."""
        x, y, z = ((np.array(self.start) + self.end) / 2).tolist()
        return x, y, z

    @property
    def axis(self) -> tuple[float, float, float]:
        """The direction of the axis, a unit vector."""
        x, y, z = (np.subtract(self.end, self.start) / self.length).tolist()
        return x, y, z

    def interface(self, name: str | None = None, **more) -> Interface:
        """Return an interface on it, by default of its name, whose reference node is at its centre; `more`: other
        settings, such as kind="rigid"."""
        where = Nodes(**{"pin" if self.kind == "pin" else "bore": (self.start, self.end, self.radius)})
        return Interface(**{"name": name or self.name, "nodes": where, "at": self.centre} | more)


@spelled
def find_bores(model: SecondOrderModel, *, turn: float = TURN) -> tuple[Bore, ...]:
    """Find the cylinders on the surface of a model: holes first, then pins, each the largest first. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        With elements, whose free faces are the surface.
    turn : float, default 120
        Degrees around its axis that a cylinder has at least; rounded edges of a block have 90.

    Returns
    -------
    tuple of Bore
        The same on all ranks, named bore1, bore2, ..., pin1, ..., in SI units.

    Raises
    ------
    InputError
        If the model has no nodes or no elements with faces.

    Notes
    -----
    Corners of faces have to lie on the cylinder to 0.2 % of its radius and span less than 52 degrees each, so that 8
    faces make a turn. Cones, tori, spheres and flats are left out. The surface of the body is on one rank at a time.
    """
    return bores_and_warnings(model, turn)[0]


def bores_and_warnings(model, turn: float) -> tuple[tuple[Bore, ...], list[str]]:
    """Return the bores of find_bores, and warnings of faces that it cannot use. Collective."""
    require_model(model)
    turn = declared("turn", turn, float)
    if not 0 < turn <= 360:
        raise InputError(f"turn: found {turn:g}, expected degrees from 0 to 360")
    if model.dofs is None:
        raise InputError(f"{model.name} has no node coordinates, and so no surface; convert it with --nodes")
    surface = gathered_surface(model)
    if not model.comm.bcast(surface is not None and len(surface.faces.corners)):
        raise InputError(
            f"{model.name} has no elements with faces, by which bores are found; convert it from an input file that "
            "has them, or name the nodes of a bearing by {cylinder = [[x, y, z], [x, y, z], radius]} or a node set"
        )
    bores, hidden = decided(model.comm, _bores, surface, turn)
    return bores, [
        f"{hidden} faces of the surface are left out, since a node of theirs has no row in {model.name}: it follows "
        "others, as in a rigid body; name its reference node in `inputs`, or export the body without it"
    ] * bool(hidden)


def _bores(surface, turn):
    """Return the bores of a surface, and how many faces it lacks; on one rank."""
    bores = []
    for cylinder in find_cylinders(surface.faces, surface.points, turn):
        faces = surface.faces.take(cylinder.faces)
        nodes = np.unique(np.concatenate([faces.corners.ravel(), faces.middles.ravel()]))
        kind = {None: "shell", True: "bore", False: "pin"}[cylinder.inwards]
        # as many digits as mean something, so that 1e-19 is 0
        places = DIGITS - 1 - int(np.floor(np.log10(cylinder.radius)))
        start, end = ((np.round(point, places) + 0.0).tolist() for point in (cylinder.start, cylinder.end))
        bores.append(Bore(
            name="", kind=kind, start=tuple(start), end=tuple(end), radius=round(cylinder.radius, places),
            turn=round(cylinder.turn, 1), nodes=tuple(surface.nodes[nodes[nodes >= 0]].tolist()),
        ))  # fmt: skip
    order = ("bore", "pin", "shell")
    bores.sort(key=lambda bore: (order.index(bore.kind), -bore.radius, bore.start, bore.end))
    number = dict.fromkeys(order, 0)
    named = []
    for bore in bores:
        number[bore.kind] += 1
        named.append(replace(bore, name=f"{bore.kind}{number[bore.kind]}"))
    return tuple(named), surface.without_place
