"""Draw sets of nodes of a model, such as those of bearings."""

from __future__ import annotations

import numpy as np

from ..fe.faces import gathered_surface
from ..files.hdf5 import atomic_output
from ..model.second_order_model import sizes_of_sets
from ..parallel.failures import InputError, agreed
from ..report.figures import kind_of_figure
from ..report.set_pictures import draw_sets
from ..report.surface import surface_of

MOST = 300_000  # nodes of one set, which one rank draws


def draw_sets_of(figure, model, sets: dict, marks=()):
    """Draw sets of nodes of a model: numbers (k,) on this rank, or the same on all, by name; `marks`: name and position
    of reference nodes. The surface is on one rank. Collective. Raises InputError where there are no nodes."""
    if model.dofs is None:
        raise InputError(f"figure {figure}: {model.name} has no node coordinates to draw; convert it with --nodes")
    comm = model.comm
    for name, size in sizes_of_sets(sets, comm).items():
        if size > MOST:
            raise InputError(f"figure {figure}: {name} has {size} nodes, a set to draw at most {MOST}; choose others")
    lines = {kind: nodes for kind, nodes in model.elements.items() if kind.startswith("line")}
    shown = [nodes.ravel() for nodes in [*lines.values(), *sets.values()]]
    if not any(comm.allgather(any(len(nodes) for nodes in model.elements.values()))):
        step = 1 + comm.allreduce(len(model.dofs.node)) // MOST  # nothing else shows the body
        shown.append(np.unique(model.dofs.node)[::step])
    surface = gathered_surface(model, np.concatenate([np.zeros(0, np.int64), *shown]))
    lines, sets = comm.gather(lines), comm.gather(sets)
    with atomic_output(figure, comm) as temporary, agreed(comm):
        if comm.rank == 0:
            places = []
            for name in dict.fromkeys(name for of_rank in sets for name in of_rank):
                numbers = np.concatenate([of_rank[name] for of_rank in sets if name in of_rank])
                places.append((name, np.flatnonzero(np.isin(surface.nodes, numbers))))
            seen = surface_of(surface.points, _cells(surface, lines))
            draw_sets(temporary, seen, surface.points, places, marks, kind_of_figure(figure))


def _cells(surface, lines) -> dict:
    """Return faces as shells, and lines, as indices of the points of a surface."""
    faces, cells = surface.faces, {}
    three, curved = faces.corners[:, 3] < 0, faces.middles[:, 0] >= 0
    for kind, chosen in (("triangle", three & ~curved), ("triangle6", three & curved), ("quad", ~three & ~curved),
                         ("quad8", ~three & curved)):  # fmt: skip
        corners = 3 if kind.startswith("triangle") else 4
        both = [faces.corners[chosen][:, :corners], faces.middles[chosen][:, :corners]]
        cells[kind] = np.hstack(both[: 2 if kind[-1].isdigit() else 1])
    for cells_of_rank in lines:
        for kind, nodes in cells_of_rank.items():
            index = np.searchsorted(surface.nodes, nodes).clip(max=len(surface.nodes) - 1)
            there = (surface.nodes[index] == nodes).all(axis=1)
            cells[kind] = np.concatenate([cells.get(kind, np.zeros((0, nodes.shape[1]), int)), index[there]])
    return cells
