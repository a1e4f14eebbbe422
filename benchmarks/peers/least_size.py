"""Sizes of a method that reach errors, by bisection: what the scripts of rivals have in common."""

import json
import signal
import time
from pathlib import Path

import numpy as np

EPS = (1e-2, 1e-4)


class Reference:
    """`folder`/reference.npz: frequencies (Hz), response H and scale (S, r, p): an error counts by its part of that."""

    def __init__(self, folder):
        given = np.load(Path(folder) / "reference.npz")
        self.frequencies, self.response, self.scale = (given[key] for key in ("frequencies", "response", "scale"))
        self.sizes, self.band = given["sizes"].tolist(), given["band"]

    def error(self, response):
        found = (np.abs(response - self.response) / self.scale).max()
        return float(found) if np.isfinite(found) else float("inf")


def searched(reference, method, make, most, seconds, before=0.0):
    """Runs of a method at the sizes of hpcred, and where its error passes EPS: a list of dicts.

    `make(size)` is a model with response(), or None; `most` the largest size; `seconds` of processor time that all may
    take, beside `before`, which each run needs. Errors are taken to fall with the size.
    """
    runs = {}

    def error(size):
        if size not in runs:
            begun, model, eps = time.process_time(), None, float("inf")
            try:
                model = make(size)
                used = before + time.process_time() - begun
                eps = float("inf") if model is None else reference.error(model.response(reference.frequencies))
            except TimeoutError:
                raise
            except Exception as failed:  # noqa: BLE001 - whatever a rival ends with counts as no model
                used = 0.0
                print(f"{method} {size}: {failed}", flush=True)
            unstable = np.isfinite(eps) and model.unstable()
            runs[size] = {"method": method, "size": size, "seconds": used, "eps": eps,
                          "unstable": unstable}  # fmt: skip
        return runs[size]["eps"]

    def stop(*_):
        raise TimeoutError

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, 0.5)  # again, where a destructor swallows the first one
    try:
        for size in reference.sizes:
            error(size)
        for eps in EPS:
            low, high = 0, min((size for size in runs if runs[size]["eps"] <= eps), default=max(reference.sizes))
            while error(high) > eps and high < most:
                low, high = high, min(high + max(high // 2, 4), most)
            low = max([size for size in runs if size < high and runs[size]["eps"] > eps], default=low)
            while error(high) <= eps and high - low > 1:
                middle = (low + high) // 2
                low, high = (low, middle) if error(middle) <= eps else (middle, high)
    except TimeoutError:
        print(f"{method}: stopped after {seconds} s", flush=True)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return [run for run in runs.values() if np.isfinite(run["eps"])]


def report(runs):
    """Print runs as the last line."""
    print(json.dumps(runs))
