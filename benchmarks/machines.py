"""Compare the estimated error of random machines of reduced bodies with the true one.

    python benchmarks/machines.py [--machines 300] [--first 0] [--exponents 1.4]

Prints one line a machine, and at the end, for each exponent of the sums over directions, the smallest ratio of the
estimate to the truth at any frequency, and the median ratio of the maxima over the band. Exits with 1 where an estimate
with the exponent that is taken is below half of the truth.
"""

import argparse
import sys

import numpy as np
from common import HERE, finish

from hpcred.assembly import error

sys.path.insert(0, str(HERE.parent / "tests"))
TAKEN = error.SIGNS
ROUND_OFF = 1e-5  # of the truth, below which it may be round-off of the responses, beside sharp resonances near 0 Hz


def compared(exponent, seeds):
    """One row of the table, of the machines of these seeds."""
    from random_machines import estimated_and_true

    error.SIGNS = exponent
    smallest, of_maxima = [], []
    for seed in seeds:
        estimated, true, bound = estimated_and_true(seed)
        there = true > ROUND_OFF
        smallest.append((estimated[there] / true[there]).min(initial=np.inf))
        if there.any():
            of_maxima.append(estimated.max() / true.max())
        print(f"{seed:5d}  true {true.max():.2e}  estimated {estimated.max():.2e}  without circles {bound.max():.2e}  "
              f"smallest ratio {smallest[-1]:.2f}", flush=True)  # fmt: skip
    return {
        "exponent": exponent, "machines": len(smallest), "errors above 1e-5": len(of_maxima),
        "not known": int(np.isinf(of_maxima).sum()), "smallest ratio": float(min(smallest)),
        "median ratio of the largest": float(np.median(of_maxima)),
    }  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--exponents", type=float, nargs="+", default=[TAKEN])
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.machines)
    rows = [compared(exponent, seeds) for exponent in options.exponents]
    finish("machines", rows)
    return int(any(row["exponent"] == TAKEN and row["smallest ratio"] < 0.5 for row in rows))


if __name__ == "__main__":
    sys.exit(main())
