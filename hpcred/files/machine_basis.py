"""Write the shapes of a machine into its result: the bases of its bodies, turned and moved, and elements and sets.

Every rank takes a part of the nodes of every body. Nodes are numbered on from body to body; sets and interfaces have
the name of the body before their own.
"""

from contextlib import ExitStack, contextmanager

import numpy as np

from ..assembly.parts import ROUND_OFF, Part
from ..body.node_shapes import NodeShape
from ..fe.dofs import SCALAR
from ..model.interfaces.motion import rigid_rows
from ..parallel.failures import agreed
from ..parallel.shares import row_range
from .hdf5 import reading
from .model_file import place_of_set, sets_of
from .result_file import FORMAT, SCHEMA, VERSION, Result

LABELS = ("node", "direction", "position")


@contextmanager
def _file(result: Result):
    """Open the file of a result; there is none of a superelement in memory."""
    if result.path is None:
        yield {}
        return
    with reading(result.path, FORMAT, VERSION, SCHEMA) as file:
        yield file


def first_numbers(results: list[Result], comm) -> list[int]:
    """Return what is added to the node numbers of each result. Collective."""
    largest = np.array([max([shape.node for shape in result.nodes], default=0) for result in results])
    with agreed(comm):
        for k, result in enumerate(results):
            with _file(result) as file:
                for node in (file[key] for key in ("dofs/node", "held/node") if key in file):
                    largest[k] = max(largest[k], node[slice(*row_range(comm, len(node)))].max(initial=0))
    return [0, *np.cumsum(np.max(comm.allgather(largest), axis=0))[:-1].tolist()]


def nodes_of_machine(results, parts: list[Part], T, numbers) -> list[NodeShape]:
    """Return the shapes of the interface nodes of all bodies in the coordinates of the machine; `T` (n, m): from these
    to those of all parts."""
    nodes = []
    for result, part, number, X in zip(results, parts, numbers, _parts_of(T, parts), strict=True):
        for shape in result.nodes:
            moved = rigid_rows(np.arange(6), np.tile(shape.position - part.origin, (6, 1))) @ part.rigid_motions
            phi, psi = np.hstack([moved[:3], shape.phi]), np.hstack([moved[3:], shape.psi])
            name = f"{part.name}.{part.labels[shape.node]}"
            nodes.append(NodeShape(shape.node + number, part.turn @ shape.position + part.shift, part.turn @ phi @ X,
                                   part.turn @ psi @ X, shape.rotates, name))  # fmt: skip
    return nodes


def write_basis_of_machine(file, comm, results, parts: list[Part], T, numbers):
    """Write basis, dofs, elements and sets of the bodies that have a basis into a result that is being written.
    Collective."""
    labels, columns, held, elements, sets = [], [], [], {}, {}
    ordered = _ordered(results, comm)
    with ExitStack() as stack, agreed(comm):
        for result, part, number, X, by_node in zip(results, parts, numbers, _parts_of(T, parts), ordered, strict=True):
            # the files stay open, since what is read of them is written at the end
            of = stack.enter_context(_file(result))
            if "basis/V" not in of or "dofs" not in of:
                continue
            rows = _rows_of_rank(of["dofs/node"], by_node["dofs"], comm)
            node, direction, position = (of[f"dofs/{key}"][rows] for key in LABELS)
            # the basis of the body, turned and moved to its place, in the coordinates of the machine
            V = of["basis/V"][:, rows]
            if result.turn is not None:
                V = result.turn.T @ V
            node, direction, position, V = _placed(part, node, direction, position, V, X)
            labels.append((node + number, direction, position))
            columns.append(V)
            if "held" in of:
                rows = _rows_of_rank(of["held/node"], by_node["held"], comm)
                node, direction, position = _turned(part, *(of[f"held/{key}"][rows] for key in LABELS))
                held.append((node + number, direction, position @ part.turn.T + part.shift))
            # elements and sets go with it, under numbers and names of their own
            for kind, cells in of.get("elements", {}).items():
                elements.setdefault(kind, []).append(cells[slice(*row_range(comm, len(cells)))] + number)
            for name, nodes in sets_of(of).items():
                sets[f"{part.name}.{name}"] = nodes[slice(*row_range(comm, len(nodes)))] + number
    if not columns:
        return
    file.rows("basis/V", np.ascontiguousarray(np.concatenate(columns, axis=1)), axis=1)
    for group, tables in (("dofs", labels), ("held", held)):
        if tables:
            for key, pieces in zip(LABELS, zip(*tables, strict=True), strict=True):
                file.rows(f"{group}/{key}", np.concatenate(pieces))
    for kind, cells in elements.items():
        file.rows(f"elements/{kind}", np.concatenate(cells))
    for name, nodes in sets.items():
        file.rows(place_of_set(name), nodes)


def _parts_of(T, parts) -> list[np.ndarray]:
    """Return the rows of T that belong to each part."""
    return np.split(T, np.cumsum([part.size for part in parts])[:-1])


def _ordered(results, comm) -> list[dict[str, bool]]:
    """Return for each result whether its dofs, and those that are held, are ordered by node. Collective."""
    ordered = np.ones((len(results), 2), dtype=bool)
    with agreed(comm):
        for k, result in enumerate(results):
            with _file(result) as file:
                for j, node in enumerate(file.get(f"{group}/node", np.zeros(0)) for group in ("dofs", "held")):
                    first, last = row_range(comm, len(node))
                    ordered[k, j] = (np.diff(node[max(first - 1, 0) : last].astype(float)) >= 0).all()
    return [dict(zip(("dofs", "held"), row, strict=True)) for row in np.all(comm.allgather(ordered), axis=0).tolist()]


def _rows_of_rank(node, ordered: bool, comm) -> slice:
    """Return the rows of whole nodes of this rank; rows that are not ordered by node are all on the first."""
    if not ordered:
        return slice(0, len(node) if comm.rank == 0 else 0)
    return slice(*(_start(node, row) for row in row_range(comm, len(node))))


def _turned(part: Part, node, direction, position):
    """Return labels of what is held in axes of the machine, those of the body in which it is not turned: directions
    that are held because all are of which they are made."""
    numbers, row, place = np.unique(node, return_index=True, return_inverse=True)
    known = np.zeros((len(numbers), 6), dtype=bool)
    there = direction < SCALAR
    known[place[there], direction[there]] = True
    uses = np.abs(part.turn) > ROUND_OFF
    at, d = np.nonzero((known.reshape(-1, 2, 1, 3) | ~uses).all(axis=-1).reshape(-1, 6))
    return numbers[at], d, position[row][at]


def _start(node, first) -> int:
    """Return the first row at or after one that begins a node."""
    if first in (0, len(node)):
        return first
    before, step = node[first - 1 : first][0], 64
    while first < len(node):
        piece = node[first : first + step]
        if (piece != before).any():
            return first + int((piece != before).argmax())
        first += len(piece)
    return len(node)


def _placed(part: Part, node, direction, position, V, X):
    """Return labels and columns (m, rows) in the machine, of rows of whole nodes in the coordinates of the body."""
    there = direction < SCALAR
    node, direction, position, V = node[there], direction[there].astype(int), position[there], V[:, there]
    # with the motions of the rows by rigid-body coordinates, in axes of the body
    moved = rigid_rows(direction, position - part.origin) @ part.rigid_motions
    W = X.T @ np.vstack([moved.T, V])
    position = position @ part.turn.T + part.shift
    if np.array_equal(part.turn, np.eye(3)):
        return node, direction, position, W
    # three displacements, or rotations, of each node that has some
    numbers, row, place = np.unique(node, return_index=True, return_inverse=True)
    full, known = np.zeros((len(W), len(numbers), 6)), np.zeros((len(numbers), 6), dtype=bool)
    full[:, place, direction], known[place, direction] = W, True
    full = np.concatenate([full[..., :3] @ part.turn.T, full[..., 3:] @ part.turn.T], axis=-1)
    known = np.repeat(known.reshape(-1, 2, 3).any(axis=2), 3, axis=1)
    at, d = np.nonzero(known)
    return numbers[at], d, position[row][at], full[:, at, d]
