"""Make outputs of stresses at nodes: rows of C that take displacements to the mean stress of the solids at a node."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...fe.solids import Solids
from ...fe.strain_matrices import COMPONENTS, nodal_stress_matrices
from ...parallel.declared import Settings
from ...parallel.failures import InputError
from ...parallel.ranges import Label

NAME = re.compile(rf"stress (\d+):({'|'.join(COMPONENTS)})")


@dataclass(frozen=True, kw_only=True)
class StressOutput(Settings):
    """An output that is a component of the stress at a node, in Pa, the mean of all solid elements there.

    Parameters
    ----------
    node : int
        Number of the node.
    stress : str
        "xx", "yy", "zz", "xy", "yz" or "zx".

    Raises
    ------
    InputError
        For other components, and numbers that no node has.
    """

    node: Label
    stress: Literal["xx", "yy", "zz", "xy", "yz", "zx"]

    where = "outputs."

    @property
    def name(self) -> str:
        """The name as output: "stress 20:xx"."""
        return f"stress {self.node}:{self.stress}"


def stress_output_of(name: str) -> StressOutput | None:
    """Return the stress that an output is by its name, or None."""
    match = NAME.fullmatch(name)
    return match and StressOutput(node=int(match[1]), stress=match[2])


def stress_columns(model, outputs) -> np.ndarray:
    """Return the rows of this rank of the columns of C^T (rows, outputs) of stresses, in Pa/m.

    Collective. Raises InputError as Solids.
    """
    solids = Solids(model, {output.node for output in outputs})
    local = np.zeros((model.local_rows, len(outputs)))
    for column, output in enumerate(outputs):
        places = np.flatnonzero(solids.number == output.node)
        rows, values, count = _parts(solids, places, COMPONENTS.index(output.stress))
        gathered = model.comm.allgather((rows, values, count))  # as large as the elements at a node
        total = sum(count for *_, count in gathered)
        if not total:
            raise InputError(
                f"outputs: node {output.node} of {model.name} has no stress, since its elements have nodes without "
                "rows, such as those that follow a rigid body; choose another node"
            )
        for rows, values, _ in gathered:
            mine = (rows >= model.first_row) & (rows < model.first_row + model.local_rows)
            np.add.at(local[:, column], rows[mine] - model.first_row, values[mine] / total)
    return local


def _parts(solids, place, component):
    """Return rows, values and number of elements of this rank of the stress at a node (its `place`, if it is here)."""
    entries, count = [(np.zeros(0, np.int64), np.zeros(0))], 0
    for group in solids.groups if len(place) else ():
        nodes = group.nodes[(group.nodes == place).any(axis=1)]
        matrices = nodal_stress_matrices(group.kind, group.rule, solids.position[nodes], group.elastic)
        entries.append((solids.rows[nodes].ravel(), matrices[nodes == place][:, component].ravel()))
        count += len(nodes)
    rows, values = (np.concatenate(arrays) for arrays in zip(*entries, strict=True))
    return rows, values, count
