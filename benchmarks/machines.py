"""Compare the estimated error of random machines of reduced bodies with the true one.

    python benchmarks/machines.py [--machines 300] [--first 0]

Prints one line a machine, and at the end the smallest ratio of the estimate to the truth at any frequency, the median
ratio at all of them and of the maxima, and the same of the bound, without circles. Exits with 1 where an estimate is
below half of the truth.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from random_machines import estimated_and_true  # noqa: E402

ROUND_OFF = 1e-5  # of the truth, below which it may be round-off of the responses, beside sharp resonances near 0 Hz


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    smallest, ratios, of_bound, every = [], [], [], []
    for seed in range(options.first, options.first + options.machines):
        estimated, true, bound = estimated_and_true(seed)
        there = true > ROUND_OFF
        smallest.append((estimated[there] / true[there]).min(initial=np.inf))
        if there.any():
            ratios.append(estimated.max() / true.max())
            of_bound.append(bound.max() / true.max())
        every.append(np.array([estimated[there], bound[there]]) / true[there])
        print(f"{seed:5d}  true {true.max():.2e}  estimated {estimated.max():.2e}  bound {bound.max():.2e}  smallest "
              f"ratio {smallest[-1]:.2f}", flush=True)  # fmt: skip
    every = np.hstack(every)
    print(f"{len(smallest)} machines, {len(ratios)} of which have errors above {ROUND_OFF:g}")
    for name, maxima, each in (("estimate", ratios, every[0]), ("bound", of_bound, every[1])):
        print(f"{name}: median ratio {np.median(each):.1f} of all frequencies, {np.median(maxima):.1f} of the maxima, "
              f"not known for {np.isinf(maxima).sum()} machines, smallest {each.min():.2f}")  # fmt: skip
    return int(min(smallest) < 0.5)


if __name__ == "__main__":
    sys.exit(main())
