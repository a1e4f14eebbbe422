"""Balanced truncation, IRKA and AAA of pyMOR at a model in a folder (dense.npz, reference.npz): runs as JSON.

The model is in modal coordinates, which makes shifted solves of models with proportional damping divisions.
"""

import sys
from pathlib import Path

import numpy as np
import pymor
import scipy.sparse as sp
from dense_methods import Model, States
from least_size import Reference, report, searched
from pymor.algorithms.to_matrix import to_matrix
from pymor.core.logger import set_log_levels
from pymor.models.iosys import SecondOrderModel
from pymor.reductors.aaa import PAAAReductor
from pymor.reductors.h2 import IRKAReductor
from pymor.reductors.sobt import SOBTpReductor, SOBTvReductor
from pymor.reductors.sor_irka import SORIRKAReductor

SECONDS = {"SOBT": 3, "SOR-IRKA": 6, "IRKA": 6, "AAA": 4}  # of processor time, for all sizes
set_log_levels({"pymor": "ERROR"})


def dense(operator, shape):
    found = to_matrix(operator, format="dense") if operator is not None else None
    return np.zeros(shape) if found is None or not np.ndim(found) else np.asarray(found)


def second_order(rom):
    m = rom.order
    outputs = (rom.dim_output, m)
    return Model(*(dense(item, (m, m)) for item in (rom.M, rom.E, rom.K)), dense(rom.B, (m, rom.dim_input)),
                 dense(rom.Cp, outputs), dense(rom.Cv, outputs))  # fmt: skip


def states(rom):
    E = np.eye(rom.order) if rom.E is None else dense(rom.E, (rom.order,) * 2)
    A, B, C = (np.asarray(to_matrix(item, format="dense")) for item in (rom.A, rom.B, rom.C))
    return States(np.linalg.solve(E, A), np.linalg.solve(E, B), C)


class Rational:
    """A transfer function of AAA."""

    def __init__(self, rom):
        self.rom = rom

    def response(self, frequencies):
        # beside the support points, where pyMOR has no matrix
        return np.array([np.asarray(self.rom.eval_tf(2j * np.pi * f * (1 + 1e-10))) for f in frequencies])

    def unstable(self):
        return None


def main(folder):
    reference = Reference(folder)
    saved = np.load(Path(folder) / "dense.npz")
    M, D, K = (saved[key] for key in "MDK")
    diagonal = np.abs(D - np.diag(np.diag(D))).max() <= 1e-9 * np.abs(D).max()
    matrices = [sp.diags(np.diag(item)).tocsc() if diagonal else item for item in (M, D, K)]
    Cv = saved["Cv"] if saved["Cv"].any() else None
    fom = SecondOrderModel.from_matrices(*matrices, saved["B"], saved["C"], Cv)
    fom.enable_caching("memory")
    before, most, runs = float(saved["seconds"]), min(len(M) - 1, 120), []
    version = f"pyMOR {pymor.__version__}"
    if len(M) <= 480:  # dense Lyapunov equations
        for name, make in (("position", SOBTpReductor), ("velocity", SOBTvReductor)):
            runs += searched(reference, f"{version}: SOBT {name}",
                             lambda size, of=make: second_order(of(fom).reduce(size)), most, SECONDS["SOBT"],
                             before)  # fmt: skip
    runs += searched(reference, f"{version}: SOR-IRKA",
                     lambda size: second_order(SORIRKAReductor(fom).reduce(size, maxit=30)), most,
                     SECONDS["SOR-IRKA"], before)  # fmt: skip
    lti = fom.to_lti()
    runs += searched(reference, f"{version}: IRKA", lambda size: states(IRKAReductor(lti).reduce(2 * size, maxit=50)),
                     most, SECONDS["IRKA"], before)  # fmt: skip

    positive = reference.frequencies > 0
    samples = reference.response[positive]
    known = {}

    def aaa(size):  # with a denominator that all responses share, its states are support points times inputs
        single = min(samples.shape[1:])
        points = max(2 * size // single, 1)
        if points not in known:
            reductor = PAAAReductor([2j * np.pi * reference.frequencies[positive]], samples, conjugate=True,
                                    post_process=False)  # fmt: skip
            known[points] = reductor.reduce(tol=1e-14, max_itpl=[points])
        return Rational(known[points])

    runs += searched(reference, f"{version}: AAA", aaa, most, SECONDS["AAA"])
    report(runs)


if __name__ == "__main__":
    main(sys.argv[1])
