"""What eps bounds and what it does not, on the connecting rod of README: the numbers of docs/errors.md and choose.md.

usage: python benchmarks/bounds.py [--dofs 3000]

The error of drive points above and below their floors, of responses from one place to another, of frequencies, and of
deflection and stress under constant forces, beside a reduction to 1e-8 and the static solutions.
"""

import argparse
import time

import numpy as np
from common import finish

BAND, ETA, POINTS = (0.0, 4000.0), 0.002, 8001
SMALL = 1e-2  # of its scale: responses that stay below are left out
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-6)


def responses(rom, frequencies):
    """H (F, p, p) with the loss factor."""
    K = (1 + 1j * ETA) * rom.K
    return np.array([rom.C @ np.linalg.solve(K - (2 * np.pi * f) ** 2 * rom.M, rom.B) for f in frequencies])


def static_stress(model, rom):
    """Stresses (p, nodes, 6) under a constant unit load at each input."""
    import hpcred

    return np.einsum("mnc,mp->pnc", hpcred.stress_modes(model, rom.columns).stress, np.linalg.solve(rom.K, rom.B))


def row(rom, model, tight, stress):
    """What the model is off by."""
    import hpcred

    f = np.linspace(*BAND, POINTS)
    H, Hr = responses(tight, f), responses(rom, f)
    measure = rom.record.accuracy.measure
    floors, E = np.array(measure.inputs), np.abs(H - Hr)
    drive = np.abs(np.einsum("fii->fi", H))
    off = np.einsum("fii->fi", E) / drive
    scale = np.sqrt(np.maximum(drive, floors))
    cross = [(j, i) for j in range(len(floors)) for i in range(j)
             if (np.abs(H[:, j, i]) / scale[:, j] / scale[:, i]).max() > SMALL]  # fmt: skip
    of_themselves = [(E[:, j, i] / np.maximum(abs(H[:, j, i]), np.median(abs(H[:, j, i])))).max() for j, i in cross]
    below = np.unravel_index(off.argmax(), off.shape)
    count = (tight.frequencies < BAND[1]).sum()
    lost = np.abs(static_stress(model, rom) - stress).max(axis=(1, 2)) / np.abs(stress).max(axis=(1, 2))
    return {
        "size": rom.size, "eps": float(hpcred.relative_error(H, Hr, measure).max()),
        "above the floor": float(off[drive >= floors].max()), "below": float(off[below]),
        "there, of the floor": float(drive[below] / floors[below[1]]), "cross": float(max(of_themselves)),
        "of": len(cross), "frequencies": float(np.abs(rom.frequencies[:count] / tight.frequencies[:count] - 1).max()),
        "static": float(off[0].max()), "stress": float(lost.max()),
    }  # fmt: skip


def main():
    import hpcred
    from hpcred import Buckens, Interface, Nodes, StaticCorrection

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dofs", type=int, default=3000)
    given = parser.parse_args()
    ends = [Interface(name=name, nodes=Nodes(set=of)) for name, of in (("crank", "BIG_EYE"), ("piston", "SMALL_EYE"))]
    rows = []
    with hpcred.crank(given.dofs) as rod, rod.with_interfaces(ends) as jointed:
        model = jointed.with_inputs([(item.name, "all") for item in ends])
        common = {"frame": Buckens(), "band": BAND}
        tight = hpcred.reduce(model, tolerance=1e-8, **common)
        stress = static_stress(model, hpcred.reduce(model, [StaticCorrection()], Buckens()))
        for tolerance, static in [*((item, "tolerance") for item in TOLERANCES), (1e-4, "exact")]:
            start = time.perf_counter()
            rom = hpcred.reduce(model, tolerance=tolerance, static=static, **common)
            seconds = time.perf_counter() - start
            found = row(rom, model, tight, stress)
            rows.append({"tolerance": tolerance, "asked of 0 Hz": static, "seconds": seconds, **found})
    finish("bounds", rows)


if __name__ == "__main__":
    main()
