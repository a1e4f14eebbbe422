"""Rotate matrices from axes of single nodes to the global axes."""

from dataclasses import dataclass, replace

import numpy as np

from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up
from .entries import label_name, label_of, node_and_direction

AXES = 3
PIECE = 2**17  # entries that are turned in one step; each becomes up to nine
ZERO = 1e-12  # cosine of a right angle, as programs write it


@dataclass
class Turn:
    """Targets of dofs: `key` (k,) its row or label, `target` (k, 3) those that it goes to or -1, `factor` (k, 3)."""

    key: np.ndarray
    target: np.ndarray
    factor: np.ndarray


def rotation_of_angles(degrees: np.ndarray) -> np.ndarray:
    """Return matrices (nodes, 3, 3) whose columns are the axes after turns about z, then the new x, then the new y."""
    (cz, cx, cy), (sz, sx, sy) = np.cos(np.deg2rad(degrees)).T, np.sin(np.deg2rad(degrees)).T
    one, nil = np.ones_like(cz), np.zeros_like(cz)
    about_z = np.array([[cz, -sz, nil], [sz, cz, nil], [nil, nil, one]])
    about_x = np.array([[one, nil, nil], [nil, cx, -sx], [nil, sx, cx]])
    about_y = np.array([[cy, nil, sy], [nil, one, nil], [-sy, nil, cy]])
    return np.einsum("ijn,jkn,kln->nil", about_z, about_x, about_y)


def turn_to_global(comm, parts, node: np.ndarray, rotation: np.ndarray, where: str) -> int:
    """Turn the matrices of `parts`, whose rows are numbered and labelled; returns how many nodes it were. Collective.

    `node` (turned nodes of this rank,) and `rotation` (nodes, 3, 3), whose columns are the nodes' axes: u_global =
    rotation u_nodal. Raises InputError where a node lacks a dof (removed by the program) that its turned axes need.
    """
    with agreed(comm):
        wrong = np.flatnonzero(np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > 1e-8)
        if wrong.size:
            raise InputError(f"{where}: found axes of node {node[wrong[0]]} that are no rotation")
    if not comm.allreduce(len(node)):
        return 0
    # directions of each row in the global axes
    label, row = parts.row_labels
    own, direction = node_and_direction(label)
    there, factors = look_up(comm, node, list(rotation.reshape(-1, 9).T), own)
    factors = np.array(factors).reshape(3, 3, -1)  # to, from
    came_from = direction % AXES
    target = np.array([label_of(own, direction - came_from + k) for k in range(AXES)])
    straight = np.arange(AXES)[:, None] == came_from
    factor = np.where(there, factors[:, came_from, np.arange(len(label))], straight)
    factor[np.abs(factor) < ZERO] = 0.0
    # rows of these directions
    exists, (place,) = look_up(comm, label, [row], target.ravel())
    exists, place = exists.reshape(AXES, -1), place.reshape(AXES, -1)
    with agreed(comm):
        lost = (factor != 0) & ~exists
        if lost.any():
            k = np.flatnonzero(lost.any(axis=0))[0]
            raise InputError(
                f"{where}: found {label_name(label[k])} along an axis of its node that is not global, while "
                f"{label_name(target[lost[:, k], k][0])} was held or is missing; turn the node's axes back (NROTAT or "
                "NMODIF), or export the body without supports in turned axes"
            )
    # the matrices, where a row is turned at all
    place[factor == 0] = -1
    turned = np.flatnonzero((factor != straight).any(axis=0))
    turn = Turn(row[turned], place[:, turned].T, factor[:, turned].T)
    parts.matrices = {key: turned_entries(comm, turn, matrix) for key, matrix in parts.matrices.items()}
    return int(comm.allreduce(len(np.unique(own[turned]))))


def turned_entries(comm, turn: Turn, entries):
    """Return T A T^T, with the factors of the turn in T and ones elsewhere, of the entries of a matrix. Collective."""
    if not comm.allreduce(len(turn.key)):
        return entries
    ends, values = (entries.rows, entries.columns), entries.values
    asked = np.unique(np.concatenate([np.unique(numbers) for numbers in ends]))
    arrays = [np.ascontiguousarray(column) for column in (*turn.target.T, *turn.factor.T)]
    hit, factors = look_up(comm, turn.key, arrays, asked)
    nil = np.full_like(asked, -1)
    target = np.where(hit, np.array(factors[:AXES]), np.array([asked, nil, nil]))
    factor = np.where(hit, np.array(factors[AXES:]), np.array([[1.0], [0.0], [0.0]]))
    places = [np.searchsorted(asked, numbers) for numbers in ends]
    touched = hit[places[0]] | hit[places[1]]
    triplets = [(*(numbers[~touched] for numbers in ends), values[~touched])]
    touched = np.flatnonzero(touched)
    for low in range(0, len(touched), PIECE):
        some = touched[low : low + PIECE]
        i, j = (numbers[some] for numbers in places)
        rows, columns = np.broadcast_arrays(target[:, None, i], target[None, :, j])
        product = factor[:, None, i] * factor[None, :, j] * values[some]
        kept = (rows >= 0) & (columns >= 0) & (product != 0)
        triplets.append(_summed(rows[kept], columns[kept], product[kept]))
    rows, columns, values = map(np.concatenate, zip(*triplets, strict=True))
    return replace(entries, rows=rows, columns=columns, values=values)


def _summed(i, j, v):
    """Return entries with those at one place summed."""
    order = np.lexsort((j, i))
    i, j, v = i[order], j[order], v[order]
    new = np.append(True, (i[1:] != i[:-1]) | (j[1:] != j[:-1]))[: len(i)]
    return i[new], j[new], np.add.reduceat(v, np.flatnonzero(new)) if len(v) else v
