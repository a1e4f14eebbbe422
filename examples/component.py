"""A new component of a basis: static shapes under unit loads at dofs that are no inputs.

With them the reduced body has the exact static deflection for these loads as well, without an input for each: what the
estimate and the responses are about stays as it is.
"""

from dataclasses import dataclass, field
from typing import Literal

import hpcred
from hpcred import InputError
from hpcred.linalg.blocks import create_block, from_dense
from hpcred.reduction import Component


@dataclass(frozen=True, kw_only=True)
class FurtherLoads(Component):
    """K^-1 e for each of `loads`, (node, direction) pairs; by inertia relief for a free body."""

    loads: tuple[tuple[int, str], ...]
    kind: Literal["further_loads"] = field(default="further_loads", repr=False)

    def __post_init__(self):
        if not self.loads:
            raise InputError('further_loads.loads: expected at least one [node, direction], such as [20, "z"]')

    def columns(self, inputs, rigid):
        return len(self.loads)

    def extend(self, basis, run):
        loaded = run.model.with_inputs(self.loads)
        load = from_dense(loaded.B)
        shapes = create_block(run.model.K, len(self.loads))
        solver = run.solvers.factored(0.0, "further loads")
        with run.progress.stage("solve"):
            solver.solve(load, shapes)
        with run.progress.stage("orthogonalise"):
            found = basis.extend(shapes)
        run.note("further loads", len(self.loads), found)


def main():
    basis = [hpcred.Modes(count=4), FurtherLoads(loads=((10, "z"), (4, "x")))]
    with hpcred.linkage() as model, hpcred.reduce(model, basis, hpcred.Buckens()) as reduced:
        for item in reduced.record.components:
            print(f"{item.where}: {item.kept} vectors")
        print(f"{reduced.size} coordinates")


if __name__ == "__main__":
    main()
