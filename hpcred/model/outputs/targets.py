"""Find the columns of B and of C^T that belong to dofs and interface nodes. Errors are InputErrors."""

from __future__ import annotations

import numpy as np

from ...fe.dofs import DIRECTIONS, QUANTITIES, quantity_name, row_of, rows_of_node, target_name
from ...parallel.declared import declared
from ...parallel.failures import InputError
from ..interfaces.nodes import SIX, find_interface, node_number
from .cuts import CutOutput, cut_columns, cuts_refused
from .motions import MotionOutput
from .stresses import StressOutput, stress_columns, stress_output_of


def unit_columns(model, key: str, targets) -> tuple[np.ndarray, list[str]]:
    """Return the rows of this rank of unit columns or of columns of G^T, and their names. Collective."""
    targets = [single for target in _declared(key, targets) for single in _single_targets(model, target)]
    return np.column_stack([_column(model, target) for target in targets]), list(map(target_name, targets))


def output_columns(model, targets) -> tuple[dict[str, np.ndarray | None], list[str]]:
    """Return the rows of this rank of the columns of C^T, Cv^T and Ca^T, each None where it is zero, and the names of
    the outputs. Collective."""
    # a column for each single output, of whatever quantity
    columns, quantities, names = [], [], []
    for target in _declared("outputs", targets, MotionOutput | StressOutput | CutOutput):
        quantity = target.quantity if isinstance(target, MotionOutput) else QUANTITIES[0]
        if isinstance(target, StressOutput):
            of_target, called = [np.zeros(model.local_rows)], [target.name]  # all of them together, below
        elif isinstance(target, CutOutput):
            if model.added:
                raise cuts_refused(model, model.added)
            of_target, called = list(cut_columns(model, target).T), target.names
        else:
            singles = _single_targets(model, target.target if isinstance(target, MotionOutput) else target)
            of_target = [_column(model, target) for target in singles]
            called = [quantity_name(quantity, target_name(target)) for target in singles]
        columns, names, quantities = columns + of_target, names + called, quantities + [quantity] * len(of_target)
    local = np.column_stack(columns)
    stresses = {j: stress for j, name in enumerate(names) if (stress := stress_output_of(name))}
    if stresses:
        if any(load.deflects for load in model.loads):
            raise InputError(f"outputs: stresses of {model.name} would lack those of its static deflection, since one "
                             "of several supports moves; leave them out")  # fmt: skip
        local[:, list(stresses)] = stress_columns(model, list(stresses.values()))
    # displacements belong to C, velocities to Cv, accelerations to Ca
    by_order = {}
    for key, quantity in zip(("C", "Cv", "Ca"), QUANTITIES, strict=True):
        chosen = np.array([of_column == quantity for of_column in quantities])
        by_order[key] = local * chosen if chosen.any() else None
    return by_order, names


def _declared(key, targets, more=int):
    """Return targets of the declared types. Raises InputError for others, and for none."""
    targets = declared(key, targets, tuple[int | str | tuple[int | str, str] | more, ...])
    if not targets:
        raise InputError(f"{key}: found an empty list, expected dof numbers, (node, direction) or interfaces")
    return targets


def _column(model, target) -> np.ndarray:
    """Return the rows of this rank of the column of a single target. Collective."""
    local, column = np.zeros(model.local_rows), _interface_column(model, target)
    if column is not None:
        return model.Gt.getColumnVector(column).getArray(readonly=True).real
    if 0 <= (row := row_of(model, target) - model.first_row) < model.local_rows:
        local[row] = 1.0
    return local


def interface_targets(interfaces) -> tuple[str, ...]:
    """Return the names of all directions of all interfaces, as inputs."""
    return tuple(target_name((interface.name, name)) for interface in interfaces for name in interface.directions)


def _single_targets(model, target) -> list:
    """Return the single targets of a target of inputs or outputs, such as all directions of (node, "all").

    Interface nodes are named. Collective. Raises InputError.
    """
    if isinstance(target, int):
        return [target]
    node, direction = (target, "all") if isinstance(target, str) else target
    place = find_interface(model, node_number(model, node))
    if place is not None:
        node = model.interfaces[place].name
    if direction != "all":
        return [(node, direction)]
    if place is not None:
        return [(node, name) for name in model.interfaces[place].directions]
    return [(int(node), DIRECTIONS[index]) for index in sorted(rows_of_node(model, int(node)))]


def _interface_column(model, target) -> int | None:
    """Return the column of G^T of a target, None for a dof. Raises InputError."""
    place = find_interface(model, target[0]) if isinstance(target, tuple) else None
    if place is None:
        return None
    known = model.interfaces[place].directions
    if target[1] not in known:
        raise InputError(f"interface '{target[0]}': direction: found {target[1]!r}, expected {', '.join(known)} or all")
    return 6 * place + SIX.index(target[1])
