"""Reductions to a tolerance where the measure has edges: random small models of some classes against dense solves.

usage: python benchmarks/hunt_measure.py [fractional silent signs vanishing] [--models 50] [--first 0]

fractional: laws with a branch point at 0 Hz. silent: outputs beyond weak ties, and such that symmetry forbids, in units
of their own. signs: factors of terms by which static responses pass zero in the ranges. vanishing: loads or outputs
whose factor is zero somewhere. A miss is a model that was said to have reached its tolerance and has not, for an output
that was not named as left out.
"""

import argparse
import sys

import numpy as np
from common import HERE, finish

sys.path.insert(0, str(HERE.parent / "tests"))


def outcome(kind, seed):
    """One row of the table, of the model of a seed."""
    from measure_models import random_case

    import hpcred

    case = random_case(kind, seed)
    row = {"class": kind, "seed": seed, "dofs": len(case.K), "tolerance": case.tolerance}
    try:
        with case.reduced() as rom:
            accuracy = rom.record.accuracy
            true, where = case.largest_error(rom, np.random.default_rng(seed))
            verdict = ("miss" if true > 1.02 * case.tolerance else "reached") if accuracy.reached else "not reached"
            return row | {"verdict": verdict, "true": true, "over": true / case.tolerance, "where": where,
                          "estimated": accuracy.largest, "noise": accuracy.noise, "size": rom.size,
                          "left out": len(accuracy.silent)}  # fmt: skip
    except hpcred.InputError as error:
        return row | {"verdict": "refused", "why": str(error)[:160]}


def main():
    from measure_models import KINDS

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", default=list(KINDS))
    for name, value in (("models", 50), ("first", 0)):
        parser.add_argument(f"--{name}", type=int, default=value)
    options = parser.parse_args()
    rows = []
    for kind in options.kinds:
        for seed in range(options.first, options.first + options.models):
            rows.append(outcome(kind, seed))
            print(*(f"{key} {value:.2g}" if isinstance(value, float) else f"{key} {value}"
                    for key, value in rows[-1].items()), flush=True)  # fmt: skip
    verdicts = ("reached", "not reached", "refused", "miss")
    counts = {word: sum(row["verdict"] == word for row in rows) for word in verdicts}
    finish("hunt_measure", [{"models": len(rows), **counts}, *[row for row in rows if row["verdict"] != "reached"]])
    sys.exit(bool(counts["miss"]))


if __name__ == "__main__":
    main()
