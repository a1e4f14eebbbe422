"""Refuse input files of another mesh: their nodes lie elsewhere than the nodes of these numbers in the model."""

import numpy as np

from ..files.text import first_bytes
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up
from .abaqus import input_file as abaqus_input
from .ansys import nodes as ansys_nodes
from .nastran import bulk
from .nodes.table import NodeTable

SAME_PLACE = 1e-4  # of the largest coordinate: some files have five or six digits


def require_places(comm, path, nodes: NodeTable, units, known, position, name: str):
    """Raise InputError where nodes of a file do not lie where those of a model do. Collective.

    `units`: the Units of the file. `known` (k,), `position` (k, 3): numbers and places in m of nodes of the model on
    this rank. Nodes that only one of them has do not count.
    """
    there, columns = look_up(comm, known, list(position.T), nodes.label)
    place, own = np.stack(columns, axis=1), nodes.position * units.length
    off = np.where(there, np.linalg.norm(own - place, axis=1), 0.0)
    reach = max(comm.allgather(np.abs(position).max(initial=0.0)))
    with agreed(comm):
        if (wrong := np.flatnonzero(off > SAME_PLACE * reach)).size:
            first = wrong[0]
            raise InputError(
                f"{path}: found node {nodes.label[first]} at {_shown(own[first])} m (units: {units.words}), expected "
                f"it at {_shown(place[first])} m as in {name}; the file is of another mesh, or in other units"
            )


def read_nodes(path, comm, calculix: bool = False) -> NodeTable:
    """Return the nodes of an input file of Abaqus, CalculiX, ANSYS or Nastran; `calculix`: whether it is read as
    CalculiX does. Collective. Raises InputError."""
    with agreed(comm):
        start = first_bytes(path)
    if abaqus_input.begins(start):
        return abaqus_input.read(path, comm, calculix=calculix, steps=False).nodes
    if ansys_nodes.begins(start):
        return ansys_nodes.read_nodes(path, comm).nodes
    deck = bulk.read_deck(path, comm)
    if not comm.allreduce(len(deck.label)):
        return NodeTable.as_given(comm, deck.label, deck.coordinates)
    points = bulk.points_of(deck, comm)
    return NodeTable.as_given(comm, points.label[~points.scalar], points.position[~points.scalar])


def _shown(place) -> str:
    return f"({', '.join(f'{x:.6g}' for x in place)})"
