"""The rivals of dense_methods.py at a model in a folder (full.npz, dense.npz, reference.npz): runs as JSON."""

import sys
import time
from pathlib import Path

import dense_methods as methods
import numpy as np
import scipy.sparse
from least_size import Reference, report, searched

SECONDS = 3  # of processor time, for all sizes of a method


def read(folder):
    """The model of the finite elements, with sparse matrices."""
    given = {key: scipy.sparse.load_npz(Path(folder) / f"{key}.npz").tocsc() for key in "MDK"}
    loads = np.load(Path(folder) / "loads.npz")
    return methods.Model(**given, **{key: loads[key] for key in ("B", "C", "Cv")})


def timed(make, *arguments):
    start = time.process_time()
    return make(*arguments), time.process_time() - start


def main(folder):
    reference, full = Reference(folder), read(folder)
    saved = np.load(Path(folder) / "dense.npz")
    model = methods.Model(*(saved[key] for key in ("M", "D", "K", "B", "C", "Cv")))
    before, runs = float(saved["seconds"]), []
    most = min(len(model.M) - 1, 120)
    A, B, C = methods.first_order(model)
    for name, band in (("", None), ("in the band, ", reference.band)):
        roots, used = timed(methods.gramians, A, B, C, band)
        reduced, _ = methods.balanced(A, B, C, roots)
        before_all = before + used
        runs += searched(reference, f"{name}first-order BT", lambda size, of=reduced: of(2 * size), most, SECONDS,
                         before_all)  # fmt: skip
        for kind in ("position", "velocity", "position-velocity", "free velocity"):
            reduced, _ = methods.balanced_second_order(model, roots, kind)
            runs += searched(reference, f"{name}SOBT {kind}", reduced, most, SECONDS, before_all)
    for name, make in (("mode acceleration", methods.modes_with_residual), ("MTA", methods.truncation_augmentation)):
        runs += searched(reference, name, make(model), most, SECONDS, before)
    (reduced, held), used = timed(methods.craig_bampton, full, most)
    if reduced:
        runs += searched(reference, "Craig-Bampton", reduced, most, SECONDS, used)
    report(runs)


if __name__ == "__main__":
    main(sys.argv[1])
