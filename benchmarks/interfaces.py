"""Bearings: errors of Craig-Bampton, modes and moment matching at the same size, and what the interfaces cost.

usage: python benchmarks/interfaces.py [bearings] [interfaces] [--ranks 2] [--dofs 16821]

The first table reduces the connecting rod of `hpcred example crank`, free, with forces and moments at both bearings, to
each tolerance and then by the other methods to that size; the largest error is over 0 to 6000 Hz, from full solves at
61 uniform frequencies, at and beside each resonance, and at the antiresonances of all drive points. The second takes a
block of 103,275 dofs with two interfaces of 2025 nodes each.
"""

import argparse
import json
import sys
import time

from common import finish, job, workspace

BAND, LAW = (0.0, 6000.0), (20.0, 1e-7)
UNIFORM, FINE = 61, 6001  # frequencies of full solves; those at which minima of drive points are looked for
CELLS = (16, 44, 44)


def telling_frequencies(model, frame, damping):
    """By a model to 1e-6: uniform frequencies, resonances and 0.3 times their half-widths beside them, and minima of
    drive points; and the measure with the floors of the band."""
    import numpy as np

    import hpcred

    grid = np.linspace(*BAND, FINE)
    with hpcred.reduce(model, frame=frame, damping=damping, tolerance=1e-6, band=BAND) as tight:
        poles = tight.frequencies[tight.frequencies < BAND[1]]
        drive = np.abs(np.diagonal(hpcred.frequency_response(tight, grid), axis1=1, axis2=2))
        measure = tight.record.accuracy.measure
    lowest = (drive[1:-1] < drive[:-2]) & (drive[1:-1] < drive[2:])
    width = poles * (LAW[0] / (4 * np.pi * poles) + LAW[1] * np.pi * poles)
    minima = grid[1:-1][lowest.any(axis=1)]
    parts = (np.linspace(*BAND, UNIFORM), *(poles + share * width for share in (-0.3, 0.0, 0.3)), minima)
    return np.unique(np.concatenate(parts)), measure


def methods(dofs):
    """In a job of its own: rows of the first table."""

    import hpcred
    from hpcred import Buckens, CraigBampton, Interface, Krylov, Modes, Nodes, Rayleigh
    from hpcred.reduction import ResidualAttachment

    hpcred.start("complex")
    bearings = [Interface(name=name, nodes=Nodes(set=f"{name.upper()}_EYE")) for name in ("big", "small")]
    damping, rows = Rayleigh(*LAW), []
    with hpcred.crank(dofs) as model:
        model = model.with_interfaces(bearings).with_inputs([(item.name, "all") for item in bearings])
        frequencies, measure = telling_frequencies(model, Buckens(), damping)
        full = hpcred.frequency_response(model, frequencies, Buckens(), damping)
        for tolerance in (1e-2, 1e-4, 1e-6):
            size = None
            for name in ("to a tolerance", "points by hand", "Craig-Bampton", "modes", "modes and attachment modes"):
                basis = {} if size is None else {"basis": {
                    "points by hand": [Krylov(0.0, 0), *([Krylov(5000.0, (size - 13) // 12)] if size > 12 else [])],
                    "Craig-Bampton": [CraigBampton(count=max(size - 6, 1))],
                    "modes": [Modes(count=size)],
                    "modes and attachment modes": [Modes(count=max(size - 12, 1)), ResidualAttachment()],
                }[name]}  # fmt: skip
                keywords = basis or {"tolerance": tolerance, "band": BAND}
                with hpcred.reduce(model, frame=Buckens(), damping=damping, **keywords) as reduced:
                    size = size or reduced.size
                    error = hpcred.relative_error(full, hpcred.frequency_response(reduced, frequencies), measure).max()
                    rows.append({"method": name, "asked": tolerance, "coordinates": reduced.size,
                                 "largest error": float(error), "seconds": reduced.record.timing.elapsed})  # fmt: skip
        if model.comm.rank == 0:
            print(json.dumps(rows))


def cost():
    """In a job of its own: rows of the second table."""
    import hpcred
    from hpcred import Buckens, Interface, Nodes

    rows = []
    with hpcred.solid(CELLS, clamped=False) as model:
        ends = {"left": 0.0, "right": 0.01 * CELLS[0]}
        for kind in ("averaging", "rigid"):
            interfaces = [Interface(name=name, kind=kind, nodes=Nodes(box=((x, -1, -1), (x, 1, 1))))
                          for name, x in ends.items()]  # fmt: skip
            model.comm.Barrier()
            start = time.perf_counter()
            marked = model.with_interfaces(interfaces).with_inputs([(name, "all") for name in ends])
            model.comm.Barrier()
            made = time.perf_counter() - start
            with hpcred.reduce(marked, frame=Buckens(), tolerance=1e-4, band=(0.0, 15000.0)) as reduced:
                hpcred.write_result("result.h5", reduced, marked)
                timing = reduced.record.timing
            total = made + timing.elapsed
            rows.append({"interfaces": kind, "dofs": marked.size, "seconds": total, "made": made,
                         "share": made / total, "frame": timing.seconds["frame"]})  # fmt: skip
        if model.comm.rank == 0:
            print(json.dumps(rows))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[[], "bearings", "interfaces"], default=[])
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--dofs", type=int, default=16821)
    given = parser.parse_args()
    with workspace() as folder:
        if "interfaces" not in given.tables or "bearings" in given.tables:
            finish("bearings", job(given.ranks, folder, "--methods", given.dofs))
        if "bearings" not in given.tables or "interfaces" in given.tables:
            finish("interfaces", job(given.ranks, folder, "--cost"))


if sys.argv[1:2] == ["--methods"]:
    methods(int(sys.argv[2]))
elif sys.argv[1:2] == ["--cost"]:
    cost()
else:
    main()
