"""Find the columns of B and of C^T that belong to dofs and interface nodes. Errors are InputErrors."""

from __future__ import annotations

import numpy as np

from ..parallel.declared import declared
from ..parallel.failures import InputError
from .dofs import DIRECTIONS, row_of, rows_of_node, target_name
from .interfaces import SIX, find_interface, node_number
from .stress_outputs import StressOutput, stress_columns


def unit_columns(model, key: str, targets) -> tuple[np.ndarray, list[str]]:
    """Return the rows of this rank of unit columns, of columns of G^T, or of stresses, and their names. Collective."""
    kinds = int | str | tuple[int | str, str]
    if key == "outputs":
        kinds |= StressOutput
    targets = declared(key, targets, tuple[kinds, ...])
    if not targets:
        raise InputError(f"{key}: found an empty list, expected dof numbers, (node, direction) or interfaces")
    targets = [single for target in targets for single in _single_targets(model, target)]
    local = np.zeros((model.local_rows, len(targets)))
    stresses = [j for j, target in enumerate(targets) if isinstance(target, StressOutput)]
    if stresses:
        local[:, stresses] = stress_columns(model, [targets[j] for j in stresses])
    for j, target in enumerate(targets):
        if j in stresses:
            continue
        column = _interface_column(model, target)
        if column is not None:
            local[:, j] = model.Gt.getColumnVector(column).getArray(readonly=True).real
        elif 0 <= (row := row_of(model, target) - model.first_row) < model.local_rows:
            local[row, j] = 1.0
    return local, [target.name if isinstance(target, StressOutput) else target_name(target) for target in targets]


def interface_targets(interfaces) -> tuple[str, ...]:
    """Return the names of all directions of all interfaces, as inputs."""
    return tuple(target_name((item.name, name)) for item in interfaces for name in item.directions)


def _single_targets(model, target) -> list:
    """Return the single targets of a target of inputs or outputs, such as all directions of (node, "all").

    Interface nodes are named. Collective. Raises InputError.
    """
    if isinstance(target, int | StressOutput):
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
