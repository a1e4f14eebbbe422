"""A superelement in OpenFAST's own module ExtPtfm: forces on the platform under a prescribed motion.

usage: python benchmarks/openfast.py SOURCE, the source of OpenFAST (its folder modules); needs gfortran, CMake and
LAPACK. The layout of the files follows from the source: `keywords` from OpenFAST 5 on, else `flex`.

The module is compiled with a driver (peers/openfast) that moves the platform in all six directions, harmonically and
growing from rest. Its forces are compared over time with the equations of motion of result.h5, solved by SciPy, and
at the end, when they are harmonic, with the dynamic stiffness of the full model.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from common import HERE, workspace
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import hpcred

FREQUENCY, PERIODS, PER_PERIOD, GROWTH = 12_000.0, 60, 400, 10  # Hz; of the growth in periods
BAND, TOLERANCE = (0.0, 15_000.0), 1e-3
AMPLITUDES = np.array([1.0, -0.6, 0.3, 20.0, 10.0, -15.0]) * 1e-7  # m, rad: angles are small in the module too


def motion():
    """Return instants (t,) and displacements, velocities and accelerations (t, 6) of the platform."""
    t = np.arange(PERIODS * PER_PERIOD + 1) / (FREQUENCY * PER_PERIOD)
    T, w = GROWTH / FREQUENCY, 2 * np.pi * FREQUENCY
    x = np.minimum(t / T, 1.0)
    grown = np.array([x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / T,
                      60 * x * (1 - x) * (1 - 2 * x) / T**2])  # fmt: skip
    wave = np.array([np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)])
    parts = (grown[0] * wave[0], grown[1] * wave[0] + grown[0] * wave[1],
             grown[2] * wave[0] + 2 * grown[1] * wave[1] + grown[0] * wave[2])  # fmt: skip
    return t, [np.outer(part, AMPLITUDES) for part in parts]


def body(folder):
    """Write the superelement of a clamped block; return the full model's response to forces of the platform."""
    top = hpcred.Interface(name="top", nodes=hpcred.Nodes(box=((0.119, -1, -1), (0.121, 1, 1))), kind="averaging")
    damping = hpcred.Rayleigh(2000.0, 2e-6)
    with hpcred.solid((12, 3, 3)) as block, block.with_interfaces([top]) as marked, \
         marked.with_inputs([("top", "all")]) as model:  # fmt: skip
        with hpcred.reduce(model, tolerance=TOLERANCE, band=BAND, damping=damping, coordinates="interface") as rom:
            hpcred.write_result(folder / "tower.h5", rom, model)
        return model.size, hpcred.frequency_response(model, [FREQUENCY], damping=damping)[0]


def by_scipy(rom, t, u, v, a):
    """Return forces on the platform (t, 6) and modal coordinates by the equations of motion."""
    M, D, K, inside = rom.M, rom.D, rom.K, slice(6, None)
    at = CubicSpline(t, a @ M[inside, :6].T + v @ D[inside, :6].T + u @ K[inside, :6].T)
    inverse, n = np.linalg.inv(M[inside, inside]), rom.size - 6

    def derivative(time, state):
        q, p = state[:n], state[n:]
        return np.concatenate([p, -inverse @ (at(time) + D[inside, inside] @ p + K[inside, inside] @ q)])

    found = solve_ivp(derivative, (0.0, t[-1]), np.zeros(2 * n), "DOP853", t, rtol=1e-9, atol=1e-16).y
    q, p = found[:n].T, found[n:].T
    accelerations = np.array([derivative(time, state)[n:] for time, state in zip(t, found.T, strict=True)])
    whole = [np.hstack(pair) for pair in ((a, accelerations), (v, p), (u, q))]
    return -sum(part @ matrix[:6].T for part, matrix in zip(whole, (M, D, K), strict=True)), q


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path)
    source = parser.parse_args().source.resolve()
    reader = (source / "modules/extptfm/src/ExtPtfm_MCKF_IO.f90").read_text(encoding="utf-8", errors="replace")
    layout = "keywords" if "UserForcing" in reader else "flex"
    with workspace() as folder:
        folder = Path(folder)
        for command in (["cmake", HERE / "peers/openfast", f"-DOPENFAST={source}"], ["make", "-j2"]):
            (folder / "build").mkdir(exist_ok=True)
            subprocess.run(command, cwd=folder / "build", check=True, stdout=subprocess.DEVNULL)
        size, H = body(folder)
        hpcred.export(folder / "tower.h5", "openfast", options={"layout": layout})
        t, moved = motion()
        np.savetxt(folder / "motion.txt", np.hstack(moved), header=f"{len(t)} {t[1]:.17e}", comments="")
        command = [folder / "build/extptfm", "tower_ExtPtfm_input.dat", "motion.txt", "forces.txt"]
        subprocess.run(command, cwd=folder, check=True, stdout=sys.stderr)
        found = np.loadtxt(folder / "forces.txt")
        rom = hpcred.read_result(folder / "tower.h5").reduced
    forces, q = by_scipy(rom, t, *moved)
    last = slice(-PER_PERIOD, None)
    waves = np.exp(1j * 2 * np.pi * FREQUENCY * t[last])
    amplitudes = 2 * (found[last, 1:7] * waves.conj()[:, None]).mean(axis=0) * 1j  # of a sine
    expected = -np.linalg.solve(H, AMPLITUDES.astype(complex))
    scale = np.repeat([np.abs(expected[:3]).max(), np.abs(expected[3:]).max()], 3)
    print(json.dumps({
        "layout": layout, "dofs": size, "coordinates": rom.size, "instants": len(t),
        "forces over time": float((np.abs(found[:, 1:7] - forces) / scale).max()),
        "modal coordinates": float(np.abs(found[:, 7:] - q).max() / np.abs(q).max()),
        "tolerance": TOLERANCE, "forces at the end, full model": float((np.abs(amplitudes - expected) / scale).max()),
    }, indent=1))  # fmt: skip


if __name__ == "__main__":
    main()
