"""Compare the estimated error of random machines of reduced bodies with the true one.

    python benchmarks/machines.py [--machines 300] [--first 0]

Prints one line a machine, and at the end the smallest ratio of the estimate to the truth at any frequency, and the
median ratio of their maxima. Exits with 1 where an estimate is below half of the truth.
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
    smallest, ratios = [], []
    for seed in range(options.first, options.first + options.machines):
        _, estimated, true = estimated_and_true(seed)
        there = true > ROUND_OFF
        smallest.append((estimated[there] / true[there]).min(initial=np.inf))
        ratios.append(estimated.max() / true.max())
        print(f"{seed:5d}  true {true.max():.2e}  estimated {estimated.max():.2e}  smallest ratio {smallest[-1]:.2f}",
              flush=True)  # fmt: skip
    print(f"{len(ratios)} machines: smallest ratio {min(smallest):.2f}, median ratio of the maxima "
          f"{np.median(ratios):.1f}, not known for {np.isinf(ratios).sum()}")  # fmt: skip
    return int(min(smallest) < 0.5)


if __name__ == "__main__":
    sys.exit(main())
