"""Read the rows of the basis of result.h5 by nodes: each rank has some of the nodes, whole, and their shapes.

Nodes ascend over the ranks. Nothing of the size of the model is on one rank.
"""

from dataclasses import dataclass, field

import numpy as np

from ..fe.dofs import SCALAR
from ..model.second_order_model import listed
from ..parallel.exchange import exchange
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up, sort_over_ranks
from ..parallel.shares import row_range
from .hdf5 import reading, texts
from .model_file import sets_of
from .result_file import FORMAT, SCHEMA, VERSION, require_basis, require_stress

NONE = np.zeros(0, np.int64)
NO_ROW = -1  # of a dof that is held
SPARSE = 4  # times as many rows as are wanted are read in one piece rather than picked


@dataclass(eq=False)
class Points:
    """Nodes of this rank and how they move with the m coordinates.

    `node` (k,): their numbers, ascending over the ranks; interface nodes come last, on the last rank. `position` (k, 3)
    in the axes of the model, in m. `shapes` (m, 3 k): displacements by coordinate. `first`, `total`: place of the first
    node among the nodes of all ranks, and their number. `names` of the interface nodes by their numbers, on all ranks.
    `cells` (e, nodes): elements of this rank by kind, as places of nodes, all of which are there. `stress` (m, 6 s):
    stresses by coordinate, in Pa: xx, yy, zz, xy, yz, zx at each of the nodes at the places `stressed` (s,).
    """

    node: np.ndarray
    position: np.ndarray
    shapes: np.ndarray
    first: int
    total: int
    names: dict = field(default_factory=dict)
    cells: dict = field(default_factory=dict)
    stress: np.ndarray | None = None
    stressed: np.ndarray = field(default_factory=lambda: NONE)


@dataclass(eq=False)
class _Mark:
    """An interface node: its phi is (3, m)."""

    node: int
    name: str
    position: np.ndarray
    phi: np.ndarray


@dataclass(eq=False)
class _Labels:
    """What a rank reads of the nodes: entries of the dofs, held ones too; parts of the sets; elements; stress nodes."""

    node: np.ndarray
    direction: np.ndarray
    row: np.ndarray
    position: np.ndarray
    cells: dict
    stress_node: np.ndarray
    marks: list = field(default_factory=list)
    numbers: list = field(default_factory=list)
    sets: dict = field(default_factory=dict)


def read_points(path, comm, nodes=None, stress: bool = False) -> Points:
    """Read the nodes of a result, by default all nodes of the mesh, with the stress modes where these are wanted.

    `nodes`: numbers, names of interfaces and names of node sets; a set stands for its nodes that have dofs. Collective.
    Raises InputError without nodes, basis or stress modes, and for nodes that do not exist.
    """
    with agreed(comm), reading(path, FORMAT, VERSION, SCHEMA) as file:
        # the directions of one node come together on one rank, in the order of their numbers
        labels = _labels(path, file, comm, stress)
        if nodes is not None:
            _name(path, file, comm, nodes, labels)
    columns = labels.direction, labels.row, *labels.position.T
    node, direction, row, *place = sort_over_ranks(comm, labels.node, columns)
    position = np.stack(place, axis=1)
    if nodes is not None:
        chosen = _wanted(path, comm, labels, node)
        node, direction, row, position = node[chosen], direction[chosen], row[chosen], position[chosen]
    # nodes, and behind those of the last rank the reference nodes that have no row
    number, first, place = np.unique(node, return_index=True, return_inverse=True)
    marks = labels.marks if comm.rank == comm.size - 1 else []
    counts = comm.allgather(len(number) + len(marks))
    start = sum(counts[: comm.rank])
    cells = _cells(comm, labels.cells, number, start)
    stress_row, stressed = _stressed(comm, labels.stress_node, number)
    with agreed(comm), reading(path, FORMAT, VERSION, SCHEMA) as file:
        # of each node the translations that are in the basis
        moved = (direction < 3) & (row != NO_ROW)
        shapes = _columns(file["basis/V"], row[moved], (3 * place + direction)[moved], 3 * len(number))
        modes = _columns(file["basis/stress"], stress_row, np.arange(len(stressed)), len(stressed)) if stress else None
    return Points(
        np.concatenate([number, [mark.node for mark in marks]]).astype(np.int64),
        np.concatenate([position[first], *(mark.position[None] for mark in marks)]),
        np.concatenate([shapes, *(mark.phi.T for mark in marks)], axis=1) if marks else shapes,
        start, sum(counts), {mark.node: mark.name for mark in labels.marks}, cells, modes, stressed,
    )  # fmt: skip


def _labels(path, file, comm, stress) -> _Labels:
    """Read the parts of this rank. Raises InputError."""
    require_basis(file, path)
    if stress:
        require_stress(file, path)
    rows = slice(*row_range(comm, file["basis/V"].shape[1]))
    groups = [(file["dofs"], rows, np.arange(rows.start, rows.stop))]
    if "held" in file:
        held = slice(*row_range(comm, len(file["held/node"])))
        groups.append((file["held"], held, np.full(held.stop - held.start, NO_ROW)))
    node, direction, position = (np.concatenate([group[key][rows_of] for group, rows_of, _ in groups])
                                 for key in ("node", "direction", "position"))  # fmt: skip
    row = np.concatenate([row for *_, row in groups])
    placed = direction < SCALAR
    cells = {kind: nodes[slice(*row_range(comm, len(nodes)))] for kind, nodes in file.get("elements", {}).items()}
    there = file["basis/stress_node"] if stress else NONE
    return _Labels(
        node[placed].astype(np.int64), direction[placed].astype(np.int64), row[placed], position[placed], cells,
        there[slice(*row_range(comm, len(there)))].astype(np.int64),
    )  # fmt: skip


def _name(path, file, comm, nodes, labels):
    """Sort what a user names into interface nodes, numbers, and parts of sets. Raises InputError."""
    marks = {}
    if "interface" in file and "name" in file["interface"]:
        group = file["interface"]
        entries = zip(group["node"][...].tolist(), texts(group["name"]), group["position"][...], group["phi"][...],
                      strict=True)  # fmt: skip
        marks = {name: _Mark(node, name, position, phi) for node, name, position, phi in entries if name}
    by_number = {mark.node: name for name, mark in marks.items()}
    sets = sets_of(file)
    for node in dict.fromkeys(by_number.get(node, node) for node in nodes):
        if node in marks:
            labels.marks.append(marks[node])
        elif not isinstance(node, str):
            labels.numbers.append(node)
        elif node in sets:
            labels.sets[node] = sets[node][slice(*row_range(comm, len(sets[node])))].astype(np.int64)
        else:
            raise InputError(f"{path}: node '{node}': no interface or node set of this name; interfaces: "
                             f"{listed(sorted(marks))}; node sets: {listed(sorted(sets))}")  # fmt: skip


def _wanted(path, comm, labels, node) -> np.ndarray:
    """Return whether each entry belongs to a node that is chosen. Collective. Raises InputError."""
    there = np.unique(node)
    is_known = np.array(comm.allgather(np.isin(labels.numbers, there))).any(axis=0)
    missing = [number for number, is_there in zip(labels.numbers, is_known, strict=True) if not is_there]
    missing += [f"'{name}'" for name, nodes in labels.sets.items()
                if not comm.allreduce(int(look_up(comm, there, [], nodes)[0].sum()))]  # fmt: skip
    if missing:
        reason = f"no node of the set {missing[0]} has dofs" if isinstance(missing[0], str) else (
            f"node {missing[0]} does not exist; nodes have the numbers of the finite-element program, and interfaces "
            "their names")  # fmt: skip
        raise InputError(f"{path}: {reason}")
    mine = [np.array(labels.numbers if comm.rank == 0 else [], np.int64), *labels.sets.values()]
    keys = np.unique(sort_over_ranks(comm, np.concatenate(mine))[0])
    return look_up(comm, keys, [], node)[0]


def _cells(comm, cells, number, start) -> dict:
    """Return the elements with places of nodes for their numbers, those of which all nodes are there. Collective."""
    cells_here = {}
    for kind in sorted(set().union(*comm.allgather(set(cells)))):
        nodes = cells[kind]
        there, (place,) = look_up(comm, number, [start + np.arange(len(number))], nodes.ravel().astype(np.int64))
        cells_here[kind] = place.reshape(nodes.shape)[there.reshape(nodes.shape).all(axis=1)]
    return cells_here


def _stressed(comm, node, number) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of the stresses for nodes of this rank, and the places of their nodes; `node`: of this rank's rows.
    Collective."""
    first = comm.exscan(len(node)) or 0
    there, (owner, place) = look_up(comm, number, [np.full(len(number), comm.rank), np.arange(len(number))], node)
    row, place = exchange(comm, owner[there], [(first + np.arange(len(node)))[there], place[there]])
    order = np.argsort(place, kind="stable")
    return row[order], place[order]


def _columns(dataset, rows, places, count) -> np.ndarray:
    """Return (m, count numbers) of a dataset (m, n, ...): its rows at their places, and zeros elsewhere."""
    width = int(np.prod(dataset.shape[2:]))
    low, high = (int(rows.min()), int(rows.max()) + 1) if len(rows) else (0, 0)
    if len(rows) == count == high - low and (np.diff(rows) == 1).all() and (np.diff(places) == 1).all():
        return dataset[:, low:high].reshape(dataset.shape[0], -1)  # as they stand in the file
    shapes = np.zeros((dataset.shape[0], count, width))
    near = high - low <= SPARSE * len(rows)
    for k in range(dataset.shape[0] if len(rows) else 0):
        block = dataset[k, low:high][rows - low] if near else dataset[k, rows]
        shapes[k, places] = block.reshape(-1, width)
    return shapes.reshape(dataset.shape[0], -1)
