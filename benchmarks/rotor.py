"""A spinning shaft over a range of speeds: one basis for all speeds against a reduction for each of some speeds.

usage: python benchmarks/rotor.py [--cells 100 18 18] [--tolerance 1e-4] [--speeds 9] [--pairs 40] [--ranks 2] [--peer]
       [--external 100]

With --peer on a small shaft, such as --cells 20 3 3, beside the greedy basis of pyMOR.

A clamped steel shaft of 0.6 x 0.06 x 0.06 m in the frame that spins with it about its axis, 0 to 800 rad/s: Coriolis
forces 2 omega G in D, spin softening -omega^2 N in K; three forces at its end, Rayleigh damping, 0 to 1000 Hz. What is
said of the error is compared with full responses at fresh pairs of frequency and speed. With --external ALPHA (1/s) the
damping ALPHA M is that of the surroundings, which does not spin: a circulatory term ALPHA omega M skew(e) in K; beta K,
2e-5 s then, spins with the shaft. The limit of stability is compared too; without rotary inertia it is that of the
first mode, omega_1 (1 + alpha / (beta omega_1^2)).
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from common import finish, job, peer, workspace

SIZE, BAND, FASTEST, INTERNAL = (0.6, 0.06, 0.06), (0.0, 1000.0), 800.0, 2e-5


def shaft(cells, external=0.0):
    """The model with its parameter."""
    import hpcred
    from hpcred.model.damping import with_damping

    damping = hpcred.Rayleigh(external, INTERNAL) if external else hpcred.Rayleigh(10.0, 1e-7)
    solid = with_damping(hpcred.solid(cells, size=SIZE, inputs=3), damping)
    fastest = 2 * FASTEST if external else FASTEST
    terms = hpcred.rotation_terms(solid, "x")
    if external:
        turned = terms[0].matrix.copy()  # 2 M skew(e)
        turned.scale(external / 2)
        terms = [*terms, hpcred.Term("K", turned, "omega")]
    return hpcred.ParametricModel(solid, [hpcred.Parameter("omega", (0.0, fastest), unit="rad/s")], terms)


def limit_of(rom, model, external):
    """The limit of stability of the reduced model, its relative distance from that of the full model, whose growth is
    interpolated between two speeds, and the one that the first mode has without rotary inertia."""
    import hpcred

    omega = 2 * np.pi * hpcred.natural_modes(model.model, 1).frequencies[0]
    found = hpcred.campbell(rom, axis="x").stability_limit
    speeds = [found * (1 - 1e-4), found * (1 + 1e-4)]
    growth = [hpcred.damped_modes(model.at(omega=speed), 6).poles.real.max() for speed in speeds]
    exact = float(np.interp(0.0, growth, speeds))
    of_mode = omega * (1 + external / (INTERNAL * omega**2))
    return {"limit": found, "limit off by": abs(found / exact - 1), "limit of the first mode": of_mode}


def one_basis(cells, tolerance, pairs, external=0.0):
    """One reduction for all speeds, and its error at fresh pairs."""
    import hpcred
    from hpcred.reduction.result.measure import MEASURES
    from hpcred.reduction.small.error_estimate import measure_over
    from hpcred.reduction.small.pseudo_modal import InputsOutputs, diagonalised

    model = shaft(cells, external)
    started = time.perf_counter()
    rom = hpcred.reduce(model, tolerance=tolerance, band=BAND)
    found = figures(rom, model.size, time.perf_counter() - started)
    accuracy = rom.record.accuracy
    found |= {"values": len(accuracy.parameters.points), "estimated": accuracy.largest}
    if external:
        found |= limit_of(rom, model, external)
    rng, true = np.random.default_rng(7), 0.0
    at_once = 5  # frequencies at a speed, which share the analysis of a factor
    for _ in range(pairs // at_once):
        speed, frequencies = float(rng.uniform(*model.parameters[0].range)), np.sort(rng.uniform(*BAND, at_once))
        full = model.at(omega=speed).frequency_response(frequencies)
        reduced = rom.at(omega=speed)
        io = InputsOutputs(*[np.eye(reduced.B.shape[1])] * 2)
        dense = diagonalised(reduced.K, reduced.B, reduced.D, io=io, symmetric=not external)
        measure = measure_over(MEASURES["directions"], BAND, dense)
        drive = np.einsum("sii->si", full)
        true = max(true, float(measure.eps(full - reduced.frequency_response(frequencies), full, drive).max()))
    return found | {"measured": true, "pairs": pairs // at_once * at_once}


def one_a_speed(cells, tolerance, speeds):
    """A reduction for each of some speeds."""
    import hpcred

    model = shaft(cells)
    started, found = time.perf_counter(), []
    for speed in np.linspace(0.0, FASTEST, speeds).tolist():
        rom = hpcred.reduce(model.at(omega=speed), tolerance=tolerance, band=BAND)
        found.append(figures(rom, model.size, 0.0))
    return {
        "dofs": model.size, "seconds": time.perf_counter() - started, "reached": all(f["reached"] for f in found),
        "coordinates": f"{max(f['coordinates'] for f in found)} each",
        "factorisations": sum(f["factorisations"] for f in found),
    }  # fmt: skip


def with_pymor(folder, cells, tolerance, pairs):
    """pyMOR's greedy basis of the same shaft, by files in a folder; on one rank."""
    import scipy.sparse

    import hpcred

    model = shaft(cells)
    constant, coriolis, softening = model.model, *(item.matrix for item in model.terms)
    parts = {"M": constant.M, "D": constant.D, "K": constant.K, "G": coriolis, "N": softening}
    for key, mat in parts.items():
        start, columns, values = mat.getValuesCSR()
        scipy.sparse.save_npz(folder / f"{key}.npz", scipy.sparse.csr_matrix((values, columns, start), mat.getSize()))
    rng = np.random.default_rng(7)
    frequencies, speeds = rng.uniform(*BAND, pairs), rng.uniform(0, FASTEST, pairs)
    at = zip(frequencies.tolist(), speeds.tolist(), strict=True)
    full = [hpcred.frequency_response(model.at(omega=w), [f])[0] for f, w in at]
    np.savez(
        folder / "reference.npz", B=constant.B.getDenseArray(), band=BAND, fastest=FASTEST, full=full,
        frequencies=frequencies, speeds=speeds,
    )  # fmt: skip
    return peer("pymor_greedy.py", folder, tolerance)


def figures(rom, dofs, seconds):
    accuracy = rom.record.accuracy
    return {"dofs": dofs, "seconds": seconds, "reached": accuracy.reached, "coordinates": rom.size,
            "factorisations": accuracy.factorisations}  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", nargs="?", choices=["one", "speeds"], help="on the ranks of this process")
    parser.add_argument("--cells", type=int, nargs=3, default=[100, 18, 18])
    parser.add_argument("--tolerance", type=float, default=1e-4)
    for name, value in (("speeds", 9), ("pairs", 40), ("ranks", 2)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--peer", action="store_true")
    parser.add_argument("--external", type=float, default=0.0)
    options = parser.parse_args()
    if options.part:
        cells, tolerance = tuple(options.cells), options.tolerance
        found = one_basis(cells, tolerance, options.pairs, options.external) if options.part == "one" else one_a_speed(
            cells, tolerance, options.speeds)  # fmt: skip
        from mpi4py import MPI

        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps(found))
        return
    asked = ["--cells", *options.cells, "--tolerance", options.tolerance, "--speeds", options.speeds, "--pairs",
             options.pairs, "--external", options.external]  # fmt: skip
    parts = {"one": "one basis for all speeds", "speeds": f"{options.speeds} speeds, each by itself"}
    if options.external:
        parts = {"one": f"one basis, 0 to {2 * FASTEST:g} rad/s, external damping {options.external:g} 1/s"}
    with workspace() as folder:
        rows = [{"what": what, **job(options.ranks, folder, part, *asked)} for part, what in parts.items()]
        if options.peer:
            found = with_pymor(Path(folder), tuple(options.cells), options.tolerance, options.pairs)
            rows.append({"what": "pyMOR 2026.1, strong greedy", "dofs": found["dofs"], "seconds": found["seconds"],
                         "coordinates": found["size"], "measured": found["true"]})  # fmt: skip
    finish("rotor", rows)


main()
