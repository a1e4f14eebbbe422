"""Make interface nodes: reference nodes that represent the motion of sets of nodes.

The motion u_R, theta_R of a reference node is the weighted least-squares rigid motion of its set,

    [u_R; theta_R] = (sum w E^T E)^-1 sum w E^T u = G u,      u_j = E_j [u_R; theta_R] for a rigid set,

and the columns of G^T distribute loads on it over the set. `averaging` interfaces (distributing coupling, RBE3) do not
change the matrices; `rigid` ones (kinematic coupling, RBE2) do, see coupling.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count as numbers_from

import numpy as np

from ...fe.cylinders import nodes_on_cylinder
from ...fe.dofs import SCALAR, require_dofs
from ...fe.elements import share_of_faces, surface_areas
from ...linalg.csr import sparse_rows
from ...parallel.decisions import decided
from ...parallel.declared import declared, nearest
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up
from ...parallel.petsc import MPI
from ...parallel.sums import anywhere, joined
from .nodes import SIX, Interface, InterfaceNode, Nodes

FAR = 20.0  # times the size of the body, beyond which a reference node is not meant
MOST = 0.5  # of the surface, or of the nodes, of a body: beyond it a set looks unlike a bearing
SOME = 0.02  # of the nodes: a set with fewer is not looked at
OFF = 3.0  # times the reach of its set: beyond it a reference node looks misplaced
FLAT = 1e-9  # of the radius of gyration of a set, or of the size of the body, below which a distance is round-off
UNDEFINED_MOTION = 1e-10  # eigenvalue of sum w E^T E, scaled, below which a motion of the reference node is not defined


def with_interfaces(model, interfaces):
    """Return the model with interface nodes, in place of those that it has. Collective. Raises InputError.

    Inputs and outputs may then be (name, direction), and (name, "all") for all of its directions.
    """
    interfaces = declared("interfaces", interfaces, tuple[Interface, ...])
    names = [interface.name for interface in interfaces]
    if not names:
        return model.with_fields(Gt=None, interfaces=())
    if len(set(names)) < len(names):
        raise InputError(f"interface: found the names {', '.join(names)}, expected each once")
    dofs = require_dofs(model, "an interface")
    # also of nodes without rows, such as those that follow a rigid body
    known = [rows.node for rows in (dofs, model.held) if rows is not None] + [*model.sets.values()]
    known += [elements.ravel() for elements in model.elements.values()]
    highest = model.comm.allreduce(max((int(numbers.max(initial=0)) for numbers in known), default=0), op=MPI.MAX)
    unnamed = numbers_from(1 + max(highest, *(interface.node or 0 for interface in interfaces)))
    numbers = [next(unnamed) if interface.node is None else interface.node for interface in interfaces]
    for interface, number in zip(interfaces, numbers, strict=True):
        if anywhere(model.comm, dofs.node == number) or numbers.count(number) > 1:
            raise InputError(f"interface '{interface.name}': node: the number {number} is taken; take another one")
    # G^T, and what is known of each reference node
    nodes, entries, coupled, sets = [], [], [], {}
    for interface, number in zip(interfaces, numbers, strict=True):
        mask = members(model, interface)
        node_set = _set_of(model, mask)
        position, directions, rows, weights = _reference(model, interface, mask, node_set)
        warnings = _warnings(model, interface, node_set, position, sets)
        place = tuple(position.tolist())
        nodes.append(InterfaceNode(interface.name, number, place, directions, interface, len(node_set.nodes), warnings))
        sets[interface.name] = node_set.nodes
        entries.append((rows, weights))
        coupled.append(rows)
    _check_overlaps(model, interfaces, coupled)
    return model.with_fields(Gt=_sparse_columns(model, entries), interfaces=tuple(nodes))


def members(model, interface) -> np.ndarray:
    """Return which rows of this rank belong to the nodes of an interface (rows,). Collective. Raises InputError."""
    comm, dofs, nodes, where = model.comm, model.dofs, interface.nodes, f"interface '{interface.name}'"
    if isinstance(nodes, str):
        raise InputError(f"{where}: nodes: found the text '{nodes}', expected numbers or Nodes")
    # nodes by place or surface, by the name of a set, or by their numbers
    held = model.held if model.held is not None else dofs.take(slice(0, 0))
    placed = (dofs.direction != SCALAR, np.ones(len(held.node), bool))
    if isinstance(nodes, Nodes) and nodes.surface is not None:
        numbers = on_surface(model, nodes, f"{where}: nodes")
        inside = [np.isin(rows.node, numbers) for rows in (dofs, held)]
    elif isinstance(nodes, Nodes) and nodes.set is None:
        inside = [mask & nodes.contain(rows.position) for mask, rows in zip(placed, (dofs, held), strict=True)]
    elif isinstance(nodes, Nodes):
        numbers = numbers_of_set(model, nodes.set, f"{where}: nodes")
        inside = [look_up(comm, numbers, [], rows.node)[0] for rows in (dofs, held)]
    else:
        inside = [np.isin(rows.node, nodes) for rows in (dofs, held)]
        mine = {int(number) for rows, mask in zip((dofs, held), inside, strict=True) for number in rows.node[mask]}
        missing = sorted(set(nodes) - set().union(*comm.allgather(mine)))
        if missing:
            raise InputError(f"{where}: nodes: node {missing[0]} does not exist in {model.name}")
    # held nodes cannot move with the others
    if stuck := joined(comm, held.node[inside[1]][:1].tolist()):
        raise InputError(
            f"{where}: node {stuck[0]} of its set is held in some direction by the program that wrote the matrices; "
            "leave it out of the set, or export the body without that support"
        )
    if not anywhere(comm, inside[0]):
        if isinstance(nodes, Nodes) and nodes.set is not None:
            raise InputError(
                f"{where}: nodes.set: none of the {model.set_sizes[nodes.set]} nodes of the set '{nodes.set}' has a "
                f"row in {model.name}; nodes that follow another one, as in a rigid body, have none: take their "
                "reference node in place of the interface, inputs = [[node, 'x'], ...], or export the body without it"
            )
        raise InputError(
            f"{where}: nodes: none lies there; the nodes of {model.name} lie between {extent_in_words(model)}"
        )
    return inside[0]


def extent_in_words(model) -> str:
    """Return the two ends of the box that the nodes of a model fill, in m. Collective."""
    dofs = model.dofs
    ends = model.comm.allgather((dofs.position.min(axis=0), dofs.position.max(axis=0)) if dofs.node.size else None)
    low, high = zip(*(pair for pair in ends if pair is not None), strict=True)
    low, high = (", ".join(f"{x:g}" for x in end) for end in (np.min(low, axis=0), np.max(high, axis=0)))
    return f"({low}) and ({high}) m"


def numbers_of_set(model, name, where) -> np.ndarray:
    """Return this rank's part of the node numbers (k,) of a set; `where` the key stands. Collective. Raises InputError
    for a set that does not exist."""
    names = model.set_sizes
    if name not in names:
        known = ", ".join(names) or "none"
        raise InputError(f"{where}.set: {model.name} has no set '{name}'{nearest(name, names)}; it has {known}")
    return model.sets.get(name, np.zeros(0, np.int64))


def on_surface(model, nodes, where) -> np.ndarray:
    """Return the numbers (k,) of the nodes of a bore or a pin; `where` the key stands. Collective. Raises InputError
    where there are none."""
    *ends, radius = nodes.surface
    key = "bore" if nodes.bore is not None else "pin"
    numbers = nodes_on_cylinder(model, ends, radius, key == "bore")
    if len(numbers):
        return numbers
    if not anywhere(model.comm, [len(elements) for elements in model.elements.values()]):
        raise InputError(
            f"{where}.{key}: {model.name} has no elements, by which its surface is known; take a cylinder of a "
            "little more than the radius, a node set, or numbers"
        )
    raise InputError(
        f"{where}.{key}: no face of {model.name} lies on the cylinder of radius {radius:g} m "
        f"{'around a hole' if key == 'bore' else 'seen from outside'}; `hpcred bores` lists those that there are"
    )


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


def _set_of(model, mask) -> _Set:
    """Return the set whose rows of this rank are given (rows,). Collective."""
    by_rank = model.comm.allgather((model.dofs.node[mask], model.dofs.position[mask]))  # as large as the set
    nodes, positions = (np.concatenate(arrays) for arrays in zip(*by_rank, strict=True))
    nodes, first = np.unique(nodes, return_index=True)
    points = positions[first]
    return _Set(nodes, points, surface_areas(model.comm, model.elements, nodes, points))


def _warnings(model, interface, node_set, position, sets) -> tuple[str, ...]:
    """Return sentences on a set that takes most of the body, that shares nodes with others (`sets` by name), or whose
    reference node lies far from it. Collective."""
    where, warnings, total = f"interface '{interface.name}'", [], model.node_count
    share = len(node_set.nodes) / max(total, 1)
    if share > SOME and len(node_set.nodes) > 1:
        surface = share_of_faces(model.comm, model.elements, node_set.nodes)
        if max(share, surface) > MOST and total > len(node_set.nodes) // 2:
            much = f"{surface:.0%} of the surface" if surface > share else f"{share:.0%} of all nodes"
            warnings.append(
                f"{where}: its set has {len(node_set.nodes)} nodes, {much} of {model.name}; are its places and radii "
                "in m?"
            )
    for name, nodes in sets.items():
        if common := len(np.intersect1d(nodes, node_set.nodes)):
            warnings.append(f"{where}: {common} of its {len(node_set.nodes)} nodes belong to '{name}' as well")
    centre = node_set.points.mean(axis=0)
    reach, off = np.linalg.norm(node_set.points - centre, axis=1).max(), np.linalg.norm(position - centre)
    if reach > 0 and off > OFF * reach:
        warnings.append(
            f"{where}: at: its reference node lies {off:.3g} m from the centre of its set, which reaches {reach:.3g} m "
            "from there; is `at` in m?"
        )
    return tuple(warnings)


def coupled_rows(model, interface, mask):
    """Return the rows of this rank, among those of `mask` (rows,), that carry an interface: their places, directions
    and positions."""
    allowed = [SIX.index(name) for name in (interface.directions if interface.kind == "rigid" else SIX[:3])]
    rows = np.flatnonzero(mask & np.isin(model.dofs.direction, allowed))
    return rows, model.dofs.direction[rows], model.dofs.position[rows]


def rigid_rows(direction, arm) -> np.ndarray:
    """Return E (rows, 6): a row of the motion of rigidly coupled dofs, at `arm` (rows, 3) from the reference node."""
    E = np.zeros((len(direction), 6))
    place = np.arange(len(direction))
    E[place, direction] = 1.0
    moved = direction < 3
    for k in range(3):  # component `direction` of e_k x arm
        E[moved, 3 + k] = np.cross(np.eye(3)[k], arm[moved])[np.arange(moved.sum()), direction[moved]]
    return E


def _reference(model, interface, mask, node_set):
    """Return position (3,) and directions of the reference node, rows of this rank, and their rows (rows, 6) of G^T.
    Collective."""
    comm = model.comm
    # where the reference node is
    rows, direction, position = coupled_rows(model, interface, mask)
    weight = _weights(model, interface, rows, node_set)
    share = weight * (direction < 3)
    total = comm.allreduce(share.sum())
    centre = comm.allreduce(share @ position) / total if total else np.zeros(3)
    at = centre if interface.at is None else np.array(interface.at)
    if interface.at is None and interface.weights == "equal" and node_set.centre is not None:
        at = node_set.centre
    reach = np.max(comm.allgather(np.abs(model.dofs.position - centre).max(initial=0.0)))
    if np.abs(at - centre).max() > FAR * reach:
        raise InputError(
            f"interface '{interface.name}': at: found {list(interface.at)} m, which is "
            f"{np.abs(at - centre).max() / reach:.0f} times as far from its set as any node of the body; "
            "coordinates are in m"
        )
    # the directions that the set moves, by its radius of gyration
    spread = comm.allreduce(share @ ((position - centre) ** 2).sum(axis=1))
    length = np.sqrt(spread / total) if total else 0.0
    if length <= FLAT * max(reach, np.abs(centre).max()):
        length = 1.0  # of a single point, whose centre has round-off
    arm = position - at
    arm[np.abs(arm) < FLAT * length] = 0.0  # of a flat set, whose centre has round-off
    engaged = np.any(comm.allgather((rigid_rows(direction, arm) != 0).any(axis=0)), axis=0)
    engaged[:] |= engaged[:3].all()  # only a set that does not move in some direction may leave others out
    # about the centre, which is better conditioned, and moved along, unless a direction has no part in the motion
    shift = np.eye(6)
    if engaged.all():
        shift[:3, 3:] = np.cross(np.eye(3), at - centre).T  # theta x (at - centre)
    E = rigid_rows(direction, position - centre if engaged.all() else arm)
    weight = weight * np.where(direction < 3, 1.0, length**2)
    gram = comm.allreduce(E.T @ (weight[:, None] * E))
    inverse = decided(comm, _inverse, gram, length, engaged, interface)
    directions = tuple(name for name, there in zip(SIX, engaged, strict=True) if there)
    return at, directions, rows, weight[:, None] * (E @ inverse) @ shift.T


def _inverse(gram, length, engaged, interface):
    """Return (sum w E^T E)^-1 on the engaged directions, zero in the others, for a set with a radius of gyration
    `length`.

    Raises InputError where there is none.
    """
    scale = np.array([1.0] * 3 + [1 / length] * 3) / np.sqrt(max(np.diag(gram)[:3].max(), 1e-300))
    # an eigenvalue of one stands for a direction that has no part
    values, vectors = np.linalg.eigh(gram * np.outer(scale, scale) + np.diag(1.0 - engaged))
    if values[0] < UNDEFINED_MOTION:
        free = (vectors[:, values < UNDEFINED_MOTION] ** 2).sum(axis=1)
        named = ", ".join(name for name, share in zip(SIX, free, strict=True) if share > 0.1)
        advice = "take several nodes around the place, not all on one line; at = [x, y, z] puts its node there" + (
            "; a single node of beams or shells, which has rotations, can be named in `inputs` as it is, or be of kind "
            "'rigid'" if interface.kind == "averaging" else ", and `directions` says in which they follow"
        )  # fmt: skip
        raise InputError(f"interface '{interface.name}': its nodes do not define the motion in {named}; {advice}")
    return scale[:, None] * (vectors / values) @ vectors.T * scale * np.outer(engaged, engaged)


def _weights(model, interface, rows, node_set) -> np.ndarray:
    """Return the weight of each row. Raises InputError."""
    node = model.dofs.node[rows]
    if isinstance(interface.weights, tuple):
        order = np.argsort(interface.nodes)
        return np.array(interface.weights)[order][np.searchsorted(np.array(interface.nodes)[order], node)]
    if interface.weights == "equal":
        return np.ones(len(rows))
    if not node_set.areas.any():
        raise InputError(
            f"interface '{interface.name}': weights: 'area' needs elements with a face on the set, and "
            f"{model.name} has none there; take 'equal', or give a list of weights"
        )
    return node_set.areas[np.searchsorted(node_set.nodes, node)]


def _check_overlaps(model, interfaces, coupled):
    """Refuse dofs that follow two reference nodes; `coupled`: the rows of this rank by interface. Collective."""
    owner = np.full(model.local_rows, -1)
    for i, (interface, rows) in enumerate(zip(interfaces, coupled, strict=True)):
        if interface.kind != "rigid":
            continue
        with agreed(model.comm):
            twice = rows[owner[rows] >= 0]
            if twice.size:
                raise InputError(
                    f"interface '{interface.name}': node {model.dofs.node[twice[0]]} belongs to the rigid set of "
                    f"'{interfaces[owner[twice[0]]].name}' as well; a dof can follow one reference node only"
                )
        owner[rows] = i


def _sparse_columns(model, entries):
    """Return G^T (n, 6k) as a sparse matrix, from rows of this rank and their six values by interface."""
    triplets = [(np.repeat(rows, 6), 6 * i + np.tile(np.arange(6), len(rows)), values.ravel())
             for i, (rows, values) in enumerate(entries)]  # fmt: skip
    return sparse_rows(model.K, triplets, (None, 6 * len(entries)))
