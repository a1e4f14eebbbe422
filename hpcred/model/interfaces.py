"""Interface nodes: sets of nodes enter; reference nodes with six directions, whose motion is that of a set, leave.

The motion u_R, theta_R of a reference node is the weighted least-squares rigid motion of its set,

    [u_R; theta_R] = (sum w E^T E)^-1 sum w E^T u = G u,      u_j = E_j [u_R; theta_R] for a rigid set,

so that loads on it are distributed by the columns of G^T. `averaging` (distributing coupling, RBE3) leaves the matrices
as they are. `rigid` (kinematic coupling, RBE2) makes the coupled dofs of the set follow the six dofs of the reference
node, q = T q^, and M, D, K become T^T A T; then G T = I.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import count as numbers_from
from typing import Literal

import numpy as np

from ..parallel.decisions import decided
from ..parallel.declared import as_declared, declared
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up
from ..parallel.petsc import MPI, PETSc
from ..parallel.ranges import COORDINATE, LABEL, within
from .dofs import DIRECTIONS, SCALAR, Dofs, require_dofs
from .elements import surface_areas

Vector = tuple[float, float, float]
SIX = DIRECTIONS[:6]
NAME = re.compile(r"[A-Za-z_][\w.\-]{0,62}")
FAR = 20.0  # times the size of the body, beyond which a reference node is not meant
FLAT = 1e-9  # of the radius of gyration of a set, or of the size of the body, below which a distance is round-off
UNDEFINED_MOTION = 1e-10  # eigenvalue of sum w E^T E, scaled, below which a motion of the reference node is not defined


@dataclass(frozen=True, kw_only=True)
class Nodes:
    """Which nodes: exactly one of `set`, the name of a node set; `box`, two corners; `sphere`, centre and radius;
    `cylinder`, two points of its axis, at its ends, and radius; in m."""

    set: str | None = None
    box: tuple[Vector, Vector] | None = None
    sphere: tuple[Vector, float] | None = None
    cylinder: tuple[Vector, Vector, float] | None = None

    def __post_init__(self):
        as_declared(self, "interface.nodes.")
        given = [key for key in ("set", "box", "sphere", "cylinder") if getattr(self, key) is not None]
        if len(given) != 1:
            raise InputError(
                f"interface.nodes: found {', '.join(given) or 'none'}, expected exactly one of set, box, sphere, "
                "cylinder, or node numbers"
            )
        for key in ("box", "sphere", "cylinder"):
            within(f"interface.nodes.{key}", getattr(self, key), COORDINATE)
        radius = (self.sphere or self.cylinder or (1.0,))[-1]
        if radius <= 0:
            raise InputError(f"interface.nodes: found radius {radius:g} m, expected a positive one")
        if self.cylinder is not None and self.cylinder[0] == self.cylinder[1]:
            raise InputError("interface.nodes.cylinder: its two points are the same, expected the ends of its axis")

    def contain(self, points: np.ndarray) -> np.ndarray:
        """Whether points (k, 3) lie inside, or on the surface up to 1e-9 of its size; not for a set."""
        if self.box is not None:
            low, high = np.sort(self.box, axis=0)
            slack = 1e-9 * np.abs(high - low).max()
            return ((points >= low - slack) & (points <= high + slack)).all(axis=1)
        if self.sphere is not None:
            centre, radius = self.sphere
            return np.linalg.norm(points - np.array(centre), axis=1) <= radius * (1 + 1e-9)
        start, end, radius = (np.array(item) for item in self.cylinder)
        length = np.linalg.norm(end - start)
        axis, arm = (end - start) / length, points - start
        along = arm @ axis
        across = np.linalg.norm(arm - along[:, None] * axis, axis=1)
        slack = 1e-9 * max(length, radius)
        return (along >= -slack) & (along <= length + slack) & (across <= radius + slack)


@dataclass(frozen=True, kw_only=True)
class Interface:
    """What an interface node is to be.

    `nodes`: numbers, or Nodes; in a job file also the name of a file of numbers. `at`: its position in m, by default
    the centre of the surface that the set is, where elements have faces on all its nodes, or else the mean of its
    nodes, with given weights the weighted one. `weights` of the nodes: "equal", "area" (of the surface that belongs to
    a node, where elements are known), or one number a node in the order of `nodes`. `directions`: those in which the
    nodes of a rigid set follow. `node`: the number of the reference node, by default the next one that nothing of the
    model names.
    """

    name: str
    nodes: tuple[int, ...] | Nodes | str
    at: Vector | None = None
    kind: Literal["averaging", "rigid"] = "averaging"
    weights: Literal["equal", "area"] | tuple[float, ...] = "equal"
    directions: tuple[str, ...] = SIX
    node: int | None = None

    def __post_init__(self):
        as_declared(self, f"interface '{self.name}': ")
        where = f"interface '{self.name}'"
        if not NAME.fullmatch(self.name):
            raise InputError(
                f"interface.name: found '{self.name[:80]}', expected a word that begins with a letter, of letters, "
                "digits, '_', '-' and '.', of at most 63 signs"
            )
        if isinstance(self.nodes, tuple) and (not self.nodes or len(set(self.nodes)) < len(self.nodes)):
            raise InputError(f"{where}: nodes: expected at least one number, and each once")
        if not self.directions or not set(self.directions) <= set(SIX) or len(set(self.directions)) < len(
            self.directions
        ):
            raise InputError(f"{where}: directions: found {list(self.directions)}, expected some of {', '.join(SIX)}")
        if self.kind == "averaging" and self.directions != SIX:
            raise InputError(f"{where}: directions belong to kind 'rigid'; an averaging set takes its translations")
        if self.kind == "rigid" and self.weights != "equal":
            raise InputError(f"{where}: weights belong to kind 'averaging'; the nodes of a rigid set all follow")
        if isinstance(self.weights, tuple):
            if not isinstance(self.nodes, tuple) or len(self.weights) != len(self.nodes):
                raise InputError(f"{where}: weights: a list of numbers needs `nodes` as a list of as many numbers")
            within(f"{where}: weights", self.weights, (1e-12, 1e12, ""))
        if isinstance(self.nodes, tuple):
            within(f"{where}: nodes", self.nodes, LABEL)
        within(f"{where}: node", self.node, LABEL)
        within(f"{where}: at", self.at, COORDINATE)


@dataclass(frozen=True)
class InterfaceNode:
    """A reference node: its `name`, its number `node`, which no node of the body has, and its `position` in m.

    `directions`: those in which its set moves it. `count`: the number of nodes of its set, and `definition`: what it
    was made from; 0 and None after reading a result.
    """

    name: str
    node: int
    position: Vector
    directions: tuple[str, ...] = SIX
    definition: Interface | None = field(default=None, compare=False)
    count: int = field(default=0, compare=False)


def with_interfaces(model, interfaces):
    """The model with interface nodes, in place of those that it has. Collective. Raises InputError.

    Inputs and outputs may then be (name, direction), and (name, "all") for all six.
    """
    interfaces = declared("interfaces", interfaces, tuple[Interface, ...])
    names = [item.name for item in interfaces]
    if not names:
        return model._with(Gt=None, interfaces=())
    if len(set(names)) < len(names):
        raise InputError(f"interface: found the names {', '.join(names)}, expected each once")
    dofs = require_dofs(model, "an interface")
    # also of nodes without rows, such as those that follow a rigid body
    known = [part.node for part in (dofs, model.held) if part is not None] + [*model.sets.values()]
    known += [part.ravel() for part in model.elements.values()]
    own = model.comm.allreduce(max((int(part.max(initial=0)) for part in known), default=0), op=MPI.MAX)
    own = max(own, *(item.node or 0 for item in interfaces), 0)
    unnamed = numbers_from(own + 1)
    numbers = [next(unnamed) if item.node is None else item.node for item in interfaces]
    for item, number in zip(interfaces, numbers, strict=True):
        taken = model.comm.allreduce(bool((dofs.node == number).any()), op=MPI.LOR)
        if taken or numbers.count(number) > 1:
            raise InputError(f"interface '{item.name}': node: the number {number} is taken; take another one")
    found, entries, coupled = [], [], []
    for item, number in zip(interfaces, numbers, strict=True):
        members = _members(model, item)
        own = _set_of(model, members)
        position, directions, rows, weights = _reference(model, item, members, own)
        found.append(InterfaceNode(item.name, number, tuple(position.tolist()), directions, item, len(own.nodes)))
        entries.append((rows, weights))
        coupled.append(rows)
    _check_overlaps(model, interfaces, coupled)
    return model._with(Gt=_sparse_columns(model, entries), interfaces=tuple(found))


def find_interface(model, node) -> int | None:
    """The place of an interface node, given by its name or number, in the list of the model; None for another node."""
    return next((i for i, item in enumerate(model.interfaces) if node in (item.name, item.node)), None)


def doubts_of_interfaces(model) -> list[str]:
    """Sentences on sets of which some nodes have no row, and so no part in the motion of the interface. Collective."""
    made = [item for item in model.interfaces if item.definition and isinstance(item.definition.nodes, Nodes)]
    sizes = model.set_sizes if made else {}
    return [
        f"interface '{item.name}': {total - item.count} of the {total} nodes of the set '{name}' have no row in "
        f"{model.name}, since they follow others; it moves with the {item.count} that have"
        for item in made if (name := item.definition.nodes.set) and item.count < (total := sizes.get(name, 0))
    ]  # fmt: skip


def node_number(model, node) -> int:
    """The number of a node, or of the interface node of that name. Raises InputError."""
    if not isinstance(node, str):
        return int(node)
    place = find_interface(model, node)
    if place is None:
        known = ", ".join(item.name for item in model.interfaces)
        known = f"its interfaces are {known}" if known else "it has none; the job declares them by tables [[interface]]"
        raise InputError(f"'{node}' is no interface of {model.name}; {known}")
    return model.interfaces[place].node


def single_targets(model, target) -> list:
    """A target of inputs or outputs, or the six of ("name", "all"), with interface nodes by name. Raises InputError."""
    if not isinstance(target, tuple | list):
        return [target]
    node, direction = target
    place = find_interface(model, node_number(model, node))
    if place is not None:
        node = model.interfaces[place].name
    elif direction == "all":
        raise InputError(f"node {node}: direction 'all' belongs to interfaces; name those of a node one by one")
    return [(node, name) for name in (model.interfaces[place].directions if direction == "all" else (direction,))]


def interface_column(model, target) -> int | None:
    """The column of G^T that a target means, None for a dof. Raises InputError."""
    place = find_interface(model, target[0]) if isinstance(target, tuple) else None
    if place is None:
        return None
    known = model.interfaces[place].directions
    if target[1] not in known:
        raise InputError(f"interface '{target[0]}': direction: found {target[1]!r}, expected {', '.join(known)} or all")
    return 6 * place + SIX.index(target[1])


def _members(model, item) -> np.ndarray:
    """Which rows of this rank belong to the nodes of an interface (rows,). Collective. Raises InputError."""
    comm, dofs, nodes, where = model.comm, model.dofs, item.nodes, f"interface '{item.name}'"
    if isinstance(nodes, str):
        raise InputError(f"{where}: nodes: found the text '{nodes}', expected numbers or Nodes")
    held = model.held if model.held is not None else dofs.take(slice(0, 0))
    placed = (dofs.direction != SCALAR, np.ones(len(held.node), bool))
    if isinstance(nodes, Nodes) and nodes.set is None:
        inside = [mask & nodes.contain(part.position) for mask, part in zip(placed, (dofs, held), strict=True)]
    elif isinstance(nodes, Nodes):
        names = model.set_sizes
        if nodes.set not in names:
            known = ", ".join(names) or "none"
            raise InputError(f"{where}: nodes.set: {model.name} has no set '{nodes.set}'; it has {known}")
        numbers = model.sets.get(nodes.set, np.zeros(0, np.int64))
        inside = [look_up(comm, numbers, [], part.node)[0] for part in (dofs, held)]
    else:
        inside = [np.isin(part.node, nodes) for part in (dofs, held)]
        mine = {int(number) for part, mask in zip((dofs, held), inside, strict=True) for number in part.node[mask]}
        missing = sorted(set(nodes) - set().union(*comm.allgather(mine)))
        if missing:
            raise InputError(f"{where}: nodes: node {missing[0]} does not exist in {model.name}")
    stuck = [node for part in comm.allgather(held.node[inside[1]][:1].tolist()) for node in part]
    if stuck:
        raise InputError(
            f"{where}: node {stuck[0]} of its set is held in some direction by the program that wrote the matrices; "
            "leave it out of the set, or export the body without that support"
        )
    if not comm.allreduce(bool(inside[0].any()), op=MPI.LOR):
        if isinstance(nodes, Nodes) and nodes.set is not None:
            raise InputError(
                f"{where}: nodes.set: none of the {names[nodes.set]} nodes of the set '{nodes.set}' has a row in "
                f"{model.name}; nodes that follow another one, as in a rigid body, have none: take their reference "
                "node in place of the interface, inputs = [[node, 'x'], ...], or export the body without it"
            )
        ends = comm.allgather((dofs.position.min(axis=0), dofs.position.max(axis=0)) if dofs.node.size else None)
        low, high = zip(*(pair for pair in ends if pair is not None), strict=True)
        low, high = np.min(low, axis=0), np.max(high, axis=0)
        raise InputError(
            f"{where}: nodes: none lies there; the nodes of {model.name} lie between "
            f"({', '.join(f'{x:g}' for x in low)}) and ({', '.join(f'{x:g}' for x in high)}) m"
        )
    return inside[0]


@dataclass(frozen=True)
class _Set:
    """The nodes (k,) of a set, ascending, their points (k, 3) in m and areas (k,) in m^2 of the surface; the same on
    all ranks."""

    nodes: np.ndarray
    points: np.ndarray
    areas: np.ndarray

    @property
    def centre(self) -> np.ndarray | None:
        """The centre (3,) of its surface, None where some of its nodes lie on no face of it."""
        return self.areas @ self.points / self.areas.sum() if (self.areas > 0).all() else None


def _set_of(model, members) -> _Set:
    """The set whose rows of this rank are given (rows,). Collective."""
    found = model.comm.allgather((model.dofs.node[members], model.dofs.position[members]))  # as large as the set
    nodes, positions = (np.concatenate(part) for part in zip(*found, strict=True))
    nodes, first = np.unique(nodes, return_index=True)
    points = positions[first]
    return _Set(nodes, points, surface_areas(model.comm, model.elements, nodes, points))


def _coupled(model, item, members):
    """The rows of this rank that carry an interface: their places, directions and positions."""
    allowed = [SIX.index(name) for name in (item.directions if item.kind == "rigid" else SIX[:3])]
    rows = np.flatnonzero(members & np.isin(model.dofs.direction, allowed))
    return rows, model.dofs.direction[rows], model.dofs.position[rows]


def _rigid_rows(direction, arm) -> np.ndarray:
    """E (rows, 6): a row of the motion of rigidly coupled dofs, at `arm` (rows, 3) from the reference node."""
    E = np.zeros((len(direction), 6))
    place = np.arange(len(direction))
    E[place, direction] = 1.0
    moved = direction < 3
    for k in range(3):  # component `direction` of e_k x arm
        E[moved, 3 + k] = np.cross(np.eye(3)[k], arm[moved])[np.arange(moved.sum()), direction[moved]]
    return E


def _reference(model, item, members, own):
    """Position (3,) and directions of the reference node, rows of this rank, and their rows (rows, 6) of G^T.

    Collective.
    """
    comm = model.comm
    rows, direction, position = _coupled(model, item, members)
    weight = _weights(model, item, rows, own)
    share = weight * (direction < 3)
    total = comm.allreduce(share.sum())
    centre = comm.allreduce(share @ position) / total if total else np.zeros(3)
    at = centre if item.at is None else np.array(item.at)
    if item.at is None and item.weights == "equal" and own.centre is not None:
        at = own.centre
    reach = np.max(comm.allgather(np.abs(model.dofs.position - centre).max(initial=0.0)))
    if np.abs(at - centre).max() > FAR * reach:
        raise InputError(
            f"interface '{item.name}': at: found {list(item.at)} m, which is {np.abs(at - centre).max() / reach:.0f} "
            "times as far from its set as any node of the body; coordinates are in m"
        )
    spread = comm.allreduce(share @ ((position - centre) ** 2).sum(axis=1))
    length = np.sqrt(spread / total) if total else 0.0
    if length <= FLAT * max(reach, np.abs(centre).max()):
        length = 1.0  # of a single point, whose centre has round-off
    arm = position - at
    arm[np.abs(arm) < FLAT * length] = 0.0  # of a flat set, whose centre has round-off
    engaged = np.any(comm.allgather((_rigid_rows(direction, arm) != 0).any(axis=0)), axis=0)
    engaged[:] |= engaged[:3].all()  # only a set that does not move in some direction may leave others out
    # about the centre, which is better conditioned, and moved along, unless a direction has no part in the motion
    shift = np.eye(6)
    if engaged.all():
        shift[:3, 3:] = np.cross(np.eye(3), at - centre).T  # theta x (at - centre)
    E = _rigid_rows(direction, position - centre if engaged.all() else arm)
    weight = weight * np.where(direction < 3, 1.0, length**2)
    gram = comm.allreduce(E.T @ (weight[:, None] * E))
    inverse = decided(comm, _inverse, gram, length, engaged, item)
    directions = tuple(name for name, there in zip(SIX, engaged, strict=True) if there)
    return at, directions, rows, weight[:, None] * (E @ inverse) @ shift.T


def _inverse(gram, length, engaged, item):
    """(sum w E^T E)^-1 on the engaged directions, zero in the others, for a set with a radius of gyration `length`.

    Raises InputError where there is none.
    """
    scale = np.array([1.0] * 3 + [1 / length] * 3) / np.sqrt(max(np.diag(gram)[:3].max(), 1e-300))
    # an eigenvalue of one stands for a direction that has no part
    values, vectors = np.linalg.eigh(gram * np.outer(scale, scale) + np.diag(1.0 - engaged))
    if values[0] < UNDEFINED_MOTION:
        free = (vectors[:, values < UNDEFINED_MOTION] ** 2).sum(axis=1)
        named = ", ".join(name for name, part in zip(SIX, free, strict=True) if part > 0.1)
        advice = "take several nodes around the place, not all on one line; at = [x, y, z] puts its node there" + (
            "; a single node of beams or shells, which has rotations, can be named in `inputs` as it is, or be of kind "
            "'rigid'" if item.kind == "averaging" else ", and `directions` says in which they follow"
        )  # fmt: skip
        raise InputError(f"interface '{item.name}': its nodes do not define the motion in {named}; {advice}")
    return scale[:, None] * (vectors / values) @ vectors.T * scale * np.outer(engaged, engaged)


def _weights(model, item, rows, own) -> np.ndarray:
    """The weight of each row. Raises InputError."""
    node = model.dofs.node[rows]
    if isinstance(item.weights, tuple):
        order = np.argsort(item.nodes)
        return np.array(item.weights)[order][np.searchsorted(np.array(item.nodes)[order], node)]
    if item.weights == "equal":
        return np.ones(len(rows))
    if not own.areas.any():
        raise InputError(
            f"interface '{item.name}': weights: 'area' needs elements with a face on the set, and {model.name} has "
            "none there; take 'equal', or give a list of weights"
        )
    return own.areas[np.searchsorted(own.nodes, node)]


def _check_overlaps(model, interfaces, coupled):
    """Refuse dofs that follow two reference nodes; `coupled`: the rows of this rank by interface. Collective."""
    owner = np.full(model.local_rows, -1)
    for i, (item, rows) in enumerate(zip(interfaces, coupled, strict=True)):
        if item.kind != "rigid":
            continue
        with agreed(model.comm):
            twice = rows[owner[rows] >= 0]
            if twice.size:
                raise InputError(
                    f"interface '{item.name}': node {model.dofs.node[twice[0]]} belongs to the rigid set of "
                    f"'{interfaces[owner[twice[0]]].name}' as well; a dof can follow one reference node only"
                )
        owner[rows] = i


def _sparse_columns(model, entries):
    """G^T (n, 6k) as a sparse matrix, from rows of this rank and their six values by interface."""
    parts = [(np.repeat(rows, 6), 6 * i + np.tile(np.arange(6), len(rows)), values.ravel())
             for i, (rows, values) in enumerate(entries)]  # fmt: skip
    return _sparse(model, parts, (None, 6 * len(entries)))


def _sparse(model, parts, width):
    """A matrix of the local rows from (rows, columns, values), with columns ascending from part to part."""
    rows, columns, values = (np.concatenate(items) for items in zip(*parts, strict=True))
    order = np.argsort(rows, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=model.local_rows))])
    csr = (starts.astype(PETSc.IntType), columns[order].astype(PETSc.IntType), values[order])
    return PETSc.Mat().createAIJ(((model.local_rows, model.size), width), csr=csr, comm=model.K.comm)


def couple(model):
    """The model in which the dofs of rigid sets follow their reference nodes, and T (n, n^) with q = T q^.

    The dofs of the reference nodes come last. Without rigid sets the model itself, with references of its own, and
    None. Collective.
    """
    rigid = [item for item in model.interfaces if item.definition.kind == "rigid"]
    if not rigid:
        return model.shared(), None
    T, dofs = _coupling(model, rigid)
    return model.in_coordinates({key: mat.ptap(T) for key, mat in model.matrices.items()}, T, dofs), T


def _coupling(model, rigid):
    """T (n, n^), and the labels of the rows of this rank of q^."""
    comm, last = model.comm, model.comm.rank == model.comm.size - 1
    follow = np.zeros(model.local_rows, bool)
    entries = []
    for item in rigid:
        rows, direction, position = _coupled(model, item.definition, _members(model, item.definition))
        follow[rows] = True
        places = [SIX.index(name) for name in item.directions]
        entries.append((rows, places, _rigid_rows(direction, position - np.array(item.position))[:, places]))
    free = np.flatnonzero(~follow)
    kept = comm.allreduce(len(free))
    parts = [(free, (comm.exscan(len(free)) or 0) + np.arange(len(free)), np.ones(len(free)))]
    counts = [len(places) for _, places, _ in entries]
    for (rows, places, E), count, more in zip(entries, counts, np.cumsum(counts), strict=True):
        columns = kept + more - count + np.arange(count)
        parts.append((np.repeat(rows, len(places)), np.tile(columns, len(rows)), E.ravel()))
    T = _sparse(model, parts, (len(free) + (sum(counts) if last else 0), kept + sum(counts)))
    dofs = model.dofs.take(free)
    if last:
        number, position = ([getattr(item, key) for item in rigid] for key in ("node", "position"))
        places = np.concatenate([places for _, places, _ in entries])
        more = Dofs(np.repeat(number, counts), places, np.repeat(position, counts, axis=0))
        pairs = [(getattr(dofs, key), getattr(more, key)) for key in ("node", "direction", "position")]
        dofs = Dofs(*(np.concatenate(pair).astype(pair[0].dtype) for pair in pairs))  # the same on all ranks
    return T, dofs
