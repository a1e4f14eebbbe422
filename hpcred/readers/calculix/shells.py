"""Find where the nodes are that CalculiX makes of a node of shells: below, in and above its middle surface.

A shell of second order becomes solids with three nodes at corners and two at edges, one of first order with two, along
the mean normal. A *Tie takes the nodes of its first surface out, which is below (S1, SNEG) or above (S2, SPOS).
"""

import numpy as np

from ...parallel.lookup import look_up, sort_over_ranks
from ..abaqus.input_file import data_lines
from ..abaqus.materials import number_of

SIDES = {"S1": -1, "SNEG": -1, "S2": 1, "SPOS": 1}
LEVELS = {"corner": (-1.0, 0.0, 1.0), "edge": (-1.0, 1.0), "linear": (-1.0, 1.0)}
CORNERS = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4}


def offsets(comm, mesh, node, number) -> np.ndarray | None:
    """Return how far (k, 3) made nodes are from the node that they are made of; None where it is not known of all.

    `node` (k,), `number` (k,): those of this rank, ascending. Collective.
    """
    # one row for each node of each element: normal, thickness, and what tells how many nodes CalculiX made
    thickness, tied = _thickness(comm, mesh), _tied(comm, mesh)
    table = [np.zeros((0, 8))]
    kinds = [kind for kind in mesh.elements if kind in CORNERS]
    for kind in kinds:
        table.append(_of_elements(comm, mesh, kind, thickness[kind], tied[kind]))
    if any(len(beams) for beams in comm.allgather([kind for kind in mesh.elements if kind in ("line", "line3")])):
        return None
    # rows of one node meet: normals are added, the others must agree
    whole = np.concatenate(table)
    label, *columns = sort_over_ranks(comm, whole[:, 0].astype(np.int64), list(whole[:, 1:].T))
    label, start = np.unique(label, return_index=True)
    x, y, z, most, least, level, below, above = columns = [
        reduce.reduceat(column, start) if len(start) else column for reduce, column in zip(
            (np.add, np.add, np.add, np.maximum, np.minimum, np.maximum, np.maximum, np.maximum),
            [*columns[:4], columns[3], *columns[4:]], strict=True)]  # fmt: skip
    # each made node is the k-th of those of its node
    every, place, count = _counted(comm, node, number)
    there, values = look_up(comm, label, columns, every)
    normal = np.array(values[:3]).T
    size = np.linalg.norm(normal, axis=1)
    good = there & (values[3] == values[4]) & (values[3] > 0) & (size > 0)
    # its level through the thickness, by the number of levels that this kind of node has
    shift = np.zeros(len(every))
    for kind, levels in enumerate(LEVELS.values()):
        for low in (0, 1):
            for high in (0, 1):
                left = np.array(levels[low : len(levels) - high])
                mine = (values[5] == kind) & (values[6] == low) & (values[7] == high)
                good &= ~mine | (count == len(left))
                mine &= good
                shift[mine] = left[place[mine]]
    if not all(comm.allgather(bool(good.all()))):
        return None
    return (shift * values[3] / 2)[:, None] * normal / np.maximum(size, 1e-300)[:, None]


def _counted(comm, node, number):
    """Return the nodes, the place of each made node among those of its node, and how many these are, as given."""
    keys, made = sort_over_ranks(comm, node, [number])
    label, start, back, count = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    place = np.arange(len(keys)) - start[back]
    there, (place, count) = look_up(comm, made, [place, count[back]], number)
    return node, place, count


def _thickness(comm, mesh) -> dict:
    """Return the thickness of each shell of this rank by kind; 0 where a section does not tell a plain one."""
    of_elements = {kind: np.zeros(len(nodes)) for kind, nodes in mesh.elements.items()}
    for section in mesh.sections:
        if section.keyword != "shellsection":
            continue
        plain = set(section.parameters) <= {"elset", "material", "orientation"}
        lines = data_lines(section) if plain else []
        value = (number_of(lines[0][0]) if lines else None) or 0.0
        numbers = mesh.element_sets.get(section.parameters.get("elset", "").lower(), np.zeros(0, np.int64))
        for kind, thickness in of_elements.items():
            thickness[look_up(comm, numbers, [], mesh.keys[kind])[0]] = value
    return of_elements


def _tied(comm, mesh) -> dict:
    """Return by kind whether the nodes of each element of this rank (elements, 2) are tied below and above."""
    tied = {kind: np.zeros((len(nodes), 2), bool) for kind, nodes in mesh.elements.items()}
    surfaces = {section.parameters.get("name", "").lower(): data_lines(section) for section in mesh.sections
                if section.keyword == "surface"}  # fmt: skip
    slaves = [line[0].lower() for section in mesh.sections if section.keyword == "tie" for line in data_lines(section)]
    for words in (line for name in slaves for line in surfaces.get(name, ()) if len(line) > 1):
        side, name = SIDES.get(words[1].upper()), words[0].lower()
        numbers = mesh.element_sets.get(name, np.zeros(0, np.int64))
        if name.isdecimal():
            numbers = np.array([int(name)][: comm.rank == 0], np.int64)
        if side is None:
            continue
        for kind, flags in tied.items():
            flags[look_up(comm, numbers, [], mesh.keys[kind])[0], int(side > 0)] = True
    return tied


def _of_elements(comm, mesh, kind, thickness, tied) -> np.ndarray:
    """Return rows (k, 8) of node, normal, thickness, place in LEVELS, and whether tied below and above, of a kind."""
    nodes, corners = mesh.elements[kind], CORNERS[kind]
    _, places = look_up(comm, mesh.nodes.label, list(mesh.nodes.position.T), nodes.ravel())
    xyz = np.array(places).T.reshape(*nodes.shape, 3)
    first = xyz[:, 2] - xyz[:, 0]
    second = xyz[:, 3] - xyz[:, 1] if corners == 4 else xyz[:, 1] - xyz[:, 0]
    normal = np.cross(first, second) if corners == 4 else np.cross(second, first)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    linear = nodes.shape[1] == corners
    level = np.where(np.arange(nodes.shape[1]) < corners, 2 if linear else 0, 1)
    count = nodes.shape[1]
    return np.column_stack([
        nodes.ravel(), np.repeat(normal, count, axis=0), np.repeat(thickness, count), np.tile(level, len(nodes)),
        np.repeat(tied, count, axis=0),
    ])  # fmt: skip



