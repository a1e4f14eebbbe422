"""Other methods that work with sparse solves at a solid of 104,040 dofs: sizes for an error, and seconds.

usage: python benchmarks/rivals_large.py [--cells 170 50 3] [--top 800] [--modes 60] [--turns 1]

A clamped plate of hexahedra with two interfaces of six directions at its free end. Every method makes its basis with
the factors, modes and projections of hpcred, on one rank, so that seconds compare. Errors are those of the worst
direction, relative over the band (docs/theory/error.md), at uniform frequencies and at resonances, all against the same
sparse solves. Modes are computed once; models of fewer of them, which nest, are cut from the reduced matrices. IRKA,
which needs complex factors at each point and turn, ends after a few turns.
"""

import argparse
import json
import sys
import time

from common import finish, job, workspace
from rivals import EPS, HPCRED, least, sized

UNIFORM, RESONANCES = 10, 14  # frequencies
RAYLEIGH = (5.0, 1e-6)  # 1/s, s: damping ratios of 0.3 % at 800 Hz and less below
POINTS = (2, 3, 4)  # of rational Krylov, of order 0


def model_of(cells):
    """The plate with its interfaces."""
    import hpcred

    length, width = (0.01 * count for count in cells[:2])
    near = 1e-3
    ends = {"left": (-near, width / 4 + near), "right": (3 * width / 4 - near, width + near)}
    with hpcred.solid(cells) as body:
        interfaces = [
            hpcred.Interface(name=name, nodes=hpcred.Nodes(box=((length - near, low, -1), (length + near, high, 1))))
            for name, (low, high) in ends.items()
        ]
        with body.with_interfaces(interfaces) as jointed:
            return jointed.with_inputs([(name, "all") for name in ends])


def damped():
    import hpcred

    return hpcred.Rayleigh(*RAYLEIGH)


def reduced(cells, top, modes):
    """In a job of its own, of real numbers: runs of all methods but IRKA, and the frequencies; writes runs.npz."""
    import numpy as np

    import hpcred

    model, runs, responses = model_of(cells), [], []

    def made(*basis, **keywords):
        start = time.process_time()
        rom = hpcred.reduce(model, list(basis) or None, damping=damped(), **keywords)
        return rom, time.process_time() - start

    searches = [made(tolerance=eps, band=(0.0, top)) for eps in EPS]
    own = searches[-1][0].frequencies
    own = own[own < top]
    f = np.concatenate([np.linspace(0, top, UNIFORM), own[np.linspace(0, len(own) - 1, RESONANCES).astype(int)]])
    f = np.unique(f)

    def note(method, size, seconds, H):
        runs.append({"method": method, "size": size, "seconds": seconds, "unstable": 0})
        responses.append(H)

    for rom, seconds in searches:
        note(HPCRED, rom.size, seconds, rom.frequency_response(f))
    for count in POINTS:
        points = [hpcred.Krylov((k + 0.5) * top / count, 0) for k in range(count)]
        rom, seconds = made(*points)
        note("rational Krylov", rom.size, seconds, rom.frequency_response(f))

    s = 2j * np.pi * f
    alpha, beta = RAYLEIGH
    a, b = 1 + s * beta, s * s + s * alpha

    def cut(rom, V):
        """H (S, r, p) of the model on columns V of another one."""
        V = np.linalg.qr(V)[0]
        K, M, B = V.T @ rom.K @ V, V.T @ rom.M @ V, V.T @ rom.B
        return np.array([B.T @ np.linalg.solve(x * K + y * M, B) for x, y in zip(a, b, strict=True)])

    rom, seconds = made(hpcred.Modes(count=modes), hpcred.Krylov(0.0, 0))
    eigenvalues, shapes = np.linalg.eigh(rom.K)  # V^T M V = I
    static = np.linalg.solve(rom.K, rom.B)
    for count in range(1, modes + 1):
        lowest, loads = shapes[:, :count], shapes[:, :count].T @ rom.B
        note("MTA", count + rom.B.shape[1], seconds, cut(rom, np.hstack([lowest, static])))
        H = np.einsum("kr,sk,kp->srp", loads, 1 / (np.multiply.outer(a, eigenvalues[:count]) + b[:, None]), loads)
        note("mode acceleration", count, seconds, H + rom.B.T @ static - (loads.T / eigenvalues[:count]) @ loads)
    rom, seconds = made(hpcred.CraigBampton(count=modes))
    static = np.linalg.solve(rom.K, rom.B)
    held = np.linalg.svd(rom.B.T)[2][rom.B.shape[1] :].T
    shapes = held @ np.linalg.eigh(held.T @ rom.K @ held)[1]
    for count in range(modes + 1):
        note("Craig-Bampton", count + static.shape[1], seconds, cut(rom, np.hstack([static, shapes[:, :count]])))
    measure = searches[-1][0].record.accuracy.measure
    np.savez("runs.npz", f=f, H=np.array(responses), inputs=measure.inputs, outputs=measure.outputs,
             drive=measure.drive)  # fmt: skip
    print(json.dumps({"dofs": model.size, "modes": len(own), "runs": runs}))


def solved(cells, top, turns):
    """In a job of its own, of complex numbers: errors of those runs beside sparse solves, and the run of IRKA."""
    import numpy as np

    import hpcred

    hpcred.start("complex")
    from hpcred.reduction.result.measure import Directions

    with np.load("runs.npz") as known:
        f, found = known["f"], known["H"]
        measure = Directions(**{key: tuple(known[key].tolist()) for key in ("inputs", "outputs", "drive")})
    model = model_of(cells)
    start = time.process_time()
    H = hpcred.frequency_response(model, f, damping=damped())
    seconds = time.process_time() - start

    def error(of):
        return float(measure.eps(H - of, H, np.einsum("sii->si", H)).max())

    eps, irka = [error(of) for of in found], []
    if turns:
        start = time.process_time()
        rom = hpcred.IRKA(size=24, band=(0.0, top), damping=damped(), turns=turns).reduce(model)
        irka = [{"method": f"IRKA, turns: {turns}", "size": rom.size, "seconds": time.process_time() - start,
                 "eps": error(rom.frequency_response(f)), "unstable": len(rom.unstable_poles())}]  # fmt: skip
    print(json.dumps({"eps": eps, "irka": irka, "frequencies": len(f), "solves": seconds}))


def rows_of(runs):
    """A row for each method: its smallest models, and its error at the sizes of hpcred."""
    found = [least(runs, eps) for eps in EPS]
    sizes = [best[HPCRED]["size"] for best in found]
    rows = []
    for method in dict.fromkeys(run["method"] for run in runs):
        own = sorted((run for run in runs if run["method"] == method), key=lambda run: run["size"])
        row = {"method": method}
        for eps, best in zip(EPS, found, strict=True):
            row[f"size for {eps:g}"] = sized(best.get(method))
        row["seconds"] = (found[-1].get(method) or own[-1])["seconds"]
        for size in sizes:
            below = [run["eps"] for run in own if run["size"] <= size]
            row[f"error with {size}"] = min(below, default="-")
        rows.append(row | {"largest tried": own[-1]["size"]})
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cells", type=int, nargs=3, default=(170, 50, 3))
    parser.add_argument("--top", type=float, default=800.0, help="end of the band in Hz")
    parser.add_argument("--modes", type=int, default=60)
    parser.add_argument("--turns", type=int, default=1, help="of IRKA; 0: without it")
    given = parser.parse_args()
    with workspace() as folder:
        first = job(1, folder, "--reduced", *given.cells, given.top, given.modes)
        second = job(1, folder, "--solved", *given.cells, given.top, given.turns)
    runs = [{**run, "eps": eps} for run, eps in zip(first["runs"], second["eps"], strict=True)] + second["irka"]
    print(f"{first['dofs']} dofs, {first['modes']} modes in the band; {second['frequencies']} sparse solves, "
          f"{second['solves']:.0f} s of processor time")  # fmt: skip
    finish("rivals_large", rows_of(runs))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--reduced"]:
        reduced(tuple(map(int, sys.argv[2:5])), float(sys.argv[5]), int(sys.argv[6]))
    elif sys.argv[1:2] == ["--solved"]:
        solved(tuple(map(int, sys.argv[2:5])), float(sys.argv[5]), int(sys.argv[6]))
    else:
        main()
