"""Reduce models with viscoelastic parts: estimated errors beside those of dense solves at fresh frequencies.

    python benchmarks/viscoelastic.py 100                   # so many random models, one seed each
    python benchmarks/viscoelastic.py sandwich_beam_840.mat # NLEVP's sandwich beam with Ke, Kv and M, of fractional law

NLEVP (Betcke, Higham, Mehrmann, Schroeder and Tisseur, ACM TOMS 39, 2013) has the beam as `sandwich_beam`, of Van
Beeumen, Meerbergen and Michiels (SIAM J. Sci. Comput. 35, 2013).
"""

import sys
import time
from pathlib import Path

import numpy as np
from models.nlevp import viscoelastic_beam

import hpcred

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from viscoelastic_models import Sandwich, sandwich  # noqa: E402


def random_case(seed: int) -> tuple[Sandwich, tuple[float, float], float]:
    """A model of one to three laws with random numbers, a band in Hz and a tolerance."""
    random = np.random.default_rng(seed)

    def law():
        kind, time = random.integers(3), 10 ** random.uniform(-6, -1)
        if kind == 0:
            count = random.integers(1, 5)
            return hpcred.laws.Maxwell(10 ** random.uniform(-2, 1.5, count), 10 ** random.uniform(-6, -1, count),
                                  float(random.choice([0.0, 1.0])))  # fmt: skip
        exponent = random.uniform(0.2, 1.0)
        if kind == 1:
            low = 10 ** random.uniform(-2, 1)
            return hpcred.laws.Fractional(low, low * 10 ** random.uniform(0.1, 3), time, exponent)
        return hpcred.laws.FractionalKelvinVoigt(random.uniform(0, 2), 10 ** random.uniform(-2, 1), time, exponent)

    laws = [law() for _ in range(random.integers(1, 4))]
    case = sandwich(laws, n=int(2 * random.integers(10, 25)), inputs=int(random.integers(1, 4)), seed=seed,
                    outputs=int(random.choice([0, 0, 2])), damped=bool(random.integers(2)))  # fmt: skip
    low = float(random.choice([0.0, random.uniform(0, 200)]))
    return case, (low, low + random.uniform(50, 600)), 10 ** random.uniform(-7, -2)


def beam(path) -> Sandwich:
    """NLEVP's sandwich beam, moved across near its middle."""
    found = viscoelastic_beam(path)
    parts = [(part.matrix.toarray(), part.law) for part in found.viscoelastic]
    return Sandwich(found.K.toarray(), found.M.toarray(), found.B, parts)


def checked(case, band, tolerance, count=40):
    """The reduced model, and true over estimated errors and the largest true one at fresh frequencies."""
    comm = hpcred.parallel.petsc.MPI.COMM_WORLD
    with case.model(comm) as model, hpcred.reduce(model, tolerance=tolerance, band=band) as rom:
        accuracy = rom.record.accuracy
        fresh = np.sort(np.random.default_rng(7).uniform(*band, count))
        H, drive = case.truth(fresh, accuracy.loss_factor)
        measured = hpcred.frequency_response(rom, fresh)
        if accuracy.loss_factor:
            s = 2j * np.pi * fresh
            measured = np.array([rom.C @ np.linalg.solve(_dynamic(rom, at, accuracy.loss_factor), rom.B) for at in s])
        true = accuracy.measure.eps(H - measured, H, drive)
        estimated = np.exp(np.interp(fresh, accuracy.frequencies, np.log(np.maximum(accuracy.eps, 1e-300))))
    return rom, true, estimated + accuracy.noise


def _dynamic(rom, s, eta):
    added = sum(part.law.excess(s) * part.matrix for part in rom.viscoelastic)
    return s * s * rom.M + s * rom.D + (1 + 1j * eta) * rom.K + added


def main(arguments):
    if not arguments[0].isdigit():
        for band, tolerance in (((0.0, 1000.0), 1e-4), ((0.0, 3000.0), 1e-4)):
            start = time.time()
            rom, true, estimated = checked(beam(arguments[0]), band, tolerance)
            accuracy = rom.record.accuracy
            seconds, ratio = time.time() - start, (true / estimated).max()
            print(f"{band[1]:g} Hz: {rom.size} coordinates of {accuracy.uncompressed_size} columns, "
                  f"{accuracy.factorisations} factorisations, {seconds:.1f} s; {accuracy.sentence}; at {len(true)} "
                  f"fresh frequencies at most {true.max():.1e}, over the estimate with round-off at most {ratio:.2f}")
        return
    above = unreached = 0
    for seed in range(*map(int, ["0", *arguments] if len(arguments) == 1 else arguments)):
        case, band, tolerance = random_case(seed)
        try:
            rom, true, _ = checked(case, band, tolerance)
        except hpcred.InputError as error:
            print(f"seed {seed}: refused: {error}")
            continue
        reached = rom.record.accuracy.reached
        unreached += not reached
        if reached and not true.max() <= tolerance:
            above += 1
            print(f"seed {seed}: true {true.max():.2e} above {tolerance:.2e}")
    print(f"{above} above the tolerance, {unreached} that say they did not reach it")


if __name__ == "__main__":
    main(sys.argv[1:] or ["20"])
