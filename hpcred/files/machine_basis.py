"""Write the shapes of a machine into its result: the bases of its bodies, turned and moved, and elements and sets.

Every rank takes a part of the nodes of every body. Nodes are numbered on from body to body; sets and interfaces have
the name of the body before their own.
"""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from ..assembly.parts import Part
from ..body.node_shapes import NodeShape
from ..fe.dofs import SCALAR
from ..model.rotation import skew
from ..parallel.failures import agreed
from ..parallel.petsc import MPI
from ..parallel.shares import row_range
from .hdf5 import reading
from .model_file import place_of_set, sets_of
from .result_file import FORMAT, SCHEMA, VERSION, Result

LABELS = ("node", "direction", "position")


def first_numbers(results: list[Result], comm) -> list[int]:
    """Return what is added to the node numbers of each result. Collective."""
    found, number = [], 0
    with agreed(comm):
        for result in results:
            found.append(number)
            largest = max([shape.node for shape in result.nodes] or [0])
            with reading(result.path, FORMAT, VERSION, SCHEMA) as file:
                for key in ("dofs/node", "held/node"):
                    if key in file and len(file[key]):
                        first, last = row_range(comm, len(file[key]))
                        largest = max(largest, int(file[key][first:last].max(initial=0)))
            number += comm.allreduce(largest, op=MPI.MAX)
    return found


def nodes_of_machine(results, parts: list[Part], T, numbers) -> list[NodeShape]:
    """Return the shapes of the interface nodes of all bodies in the coordinates of the machine; `T` (n, m): from these
    to those of all parts."""
    found = []
    for result, part, number, X in zip(results, parts, numbers, _parts_of(T, parts), strict=True):
        k = part.rigid_motions.shape[1]
        for shape in result.nodes:
            arm = shape.position - part.origin
            turns = part.rigid_motions[3:]
            phi = np.hstack([part.rigid_motions[:3] - skew(arm) @ turns, shape.phi]) if k else shape.phi
            psi = np.hstack([turns, shape.psi]) if k else shape.psi
            name = f"{part.name}.{part.labels[shape.node]}"
            found.append(NodeShape(shape.node + number, part.turn @ shape.position + part.shift, part.turn @ phi @ X,
                                   part.turn @ psi @ X, shape.rotates, name))  # fmt: skip
    return found


def write_basis_of_machine(file, comm, results, parts: list[Part], T, numbers):
    """Write basis, dofs, elements and sets of the bodies that have a basis into a result that is being written.
    Collective."""
    labels, columns, held, elements, sets = [], [], [], {}, {}
    with ExitStack() as stack, agreed(comm):
        for result, part, number, X in zip(results, parts, numbers, _parts_of(T, parts), strict=True):
            of = stack.enter_context(reading(result.path, FORMAT, VERSION, SCHEMA))
            if "basis/V" not in of or "dofs" not in of:
                continue
            node, direction, position, V = _rows_of_rank(of, comm)
            if result.turn is not None:
                V = result.turn.T @ V
            node, direction, position, V = _placed(part, node, direction, position, V, X)
            labels.append((node + number, direction, position))
            columns.append(V)
            if "held" in of:
                first, last = row_range(comm, len(of["held/node"]))
                there = [of[f"held/{key}"][first:last] for key in LABELS]
                held.append((there[0] + number, there[1], there[2] @ part.turn.T + part.shift))
            for kind, cells in of.get("elements", {}).items():
                elements.setdefault(kind, []).append(cells[slice(*row_range(comm, len(cells)))] + number)
            for name, nodes in sets_of(of).items():
                sets[f"{part.name}.{name}"] = nodes[slice(*row_range(comm, len(nodes)))] + number
    if not columns:
        return
    file.rows("basis/V", np.ascontiguousarray(np.concatenate(columns, axis=1)), axis=1)
    for group, given in (("dofs", labels), ("held", held)):
        if given:
            for key, pieces in zip(LABELS, zip(*given, strict=True), strict=True):
                file.rows(f"{group}/{key}", np.concatenate(pieces))
    for kind, cells in elements.items():
        file.rows(f"elements/{kind}", np.concatenate(cells))
    for name, nodes in sets.items():
        file.rows(place_of_set(name), nodes)


def _parts_of(T, parts) -> list[np.ndarray]:
    """Return the rows of T that belong to each part."""
    return np.split(T, np.cumsum([part.size for part in parts])[:-1])


def _rows_of_rank(file, comm):
    """Return labels of whole nodes and the columns (m, rows) of this rank; rows that are not ordered by node are all on
    the first."""
    first, last = row_range(comm, total := len(file["dofs/node"]))
    node = file["dofs/node"][max(first - 1, 0) : last]
    if comm.allreduce(bool((np.diff(node) < 0).any()), op=MPI.LOR):
        first, last = (0, total) if comm.rank == 0 else (total, total)
    elif comm.size > 1:
        ends = comm.allgather(_start(file["dofs/node"], first))
        first, last = ends[comm.rank], [*ends[1:], total][comm.rank]
    return *(file[f"dofs/{key}"][first:last] for key in LABELS), file["basis/V"][:, first:last]


def _start(node, first) -> int:
    """Return the first row at or after one that begins a node."""
    if first == 0:
        return 0
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
    k = part.rigid_motions.shape[1]
    # motions of the rows by rigid-body coordinates, in axes of the body
    arm = position - part.origin
    motion = np.eye(6)[direction]
    cross = np.cross(arm[:, None, :], np.eye(3)[None])  # e_d . (theta x arm) = theta . (arm x e_d)
    moved = direction < 3
    motion[moved, 3:] = cross[moved, direction[moved]]
    W = X[k:].T @ V + (X[:k].T @ (motion @ part.rigid_motions).T if k else 0.0)
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
