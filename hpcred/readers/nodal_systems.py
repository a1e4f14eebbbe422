"""Rotate matrices from axes of single nodes to the global axes."""

import numpy as np

from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up
from .entries import Entries, label_name, label_of, node_and_direction

AXES = 3
PIECE = 2**17  # entries that are turned in one step; each becomes up to nine
ZERO = 1e-12  # cosine of a right angle, as programs write it


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
    label, row = parts.row_labels
    own, direction = node_and_direction(label)
    found, factors = look_up(comm, node, list(rotation.reshape(-1, 9).T), own)
    factors = np.array(factors).reshape(3, 3, -1)  # to, from
    came_from = direction % AXES
    base = direction - came_from
    target = np.array([label_of(own, base + k) for k in range(AXES)])
    factor = np.where(found, factors[:, came_from, np.arange(len(label))], np.arange(AXES)[:, None] == came_from)
    factor[np.abs(factor) < ZERO] = 0.0
    exists, (place,) = look_up(comm, label, [row], target.ravel())
    exists, place = exists.reshape(AXES, -1), place.reshape(AXES, -1)
    with agreed(comm):
        lost = np.flatnonzero(((factor != 0) & ~exists).any(axis=0))
        if lost.size:
            k = lost[0]
            missing = target[:, k][(factor[:, k] != 0) & ~exists[:, k]][0]
            raise InputError(
                f"{where}: found {label_name(label[k])} along an axis of its node that is not global, while "
                f"{label_name(missing)} was held or is missing; turn the node's axes back (NROTAT or NMODIF), or "
                "export the body without supports in turned axes"
            )
    place[factor == 0] = -1
    turned = np.flatnonzero((factor != (np.arange(AXES)[:, None] == came_from)).any(axis=0))
    table = [row[turned], *place[:, turned], *factor[:, turned]]
    for key in list(parts.matrices):
        parts.matrices[key] = _turned(comm, parts.matrices[key], table)
    return int(comm.allreduce(len(np.unique(own[turned]))))


def _turned(comm, entries, table):
    """Return T A T^T, with the rows of `table` (row, its three new rows or -1, their factors) in T, and ones
    elsewhere."""
    asked = np.unique(np.concatenate([entries.rows, entries.columns]))
    hit, found = look_up(comm, table[0], table[1:], asked)
    place = np.where(hit, np.array(found[:AXES]), np.array([asked, np.full_like(asked, -1), np.full_like(asked, -1)]))
    factor = np.where(hit, np.array(found[AXES:]), np.array([[1.0], [0.0], [0.0]]))
    ends = [np.searchsorted(asked, item) for item in (entries.rows, entries.columns)]
    touched = hit[ends[0]] | hit[ends[1]]
    parts = [(entries.rows[~touched], entries.columns[~touched], entries.values[~touched])]
    for low in range(0, int(touched.sum()), PIECE):
        some = np.flatnonzero(touched)[low : low + PIECE]
        i, j = (item[some] for item in ends)
        rows = np.broadcast_to(place[:, None, i], (AXES, AXES, len(some))).ravel()
        columns = np.broadcast_to(place[None, :, j], (AXES, AXES, len(some))).ravel()
        values = (factor[:, None, i] * factor[None, :, j] * entries.values[some]).ravel()
        kept = (rows >= 0) & (columns >= 0)
        parts.append(_summed(rows[kept], columns[kept], values[kept], entries.shape[1]))
    return Entries(entries.shape, *(np.concatenate(items) for items in zip(*parts, strict=True)))


def _summed(rows, columns, values, width):
    """Return entries at the same place as one."""
    key = rows * width + columns
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.flatnonzero(np.append(True, key[1:] != key[:-1]))[: len(key)]
    return key[first] // width, key[first] % width, np.add.reduceat(values[order], first) if len(key) else values
