"""The search to a tolerance beside the quickest point chosen by hand: processor and wall seconds of one rank, in turn.

usage: python benchmarks/search.py [case ...] [--runs 3] [--scale 1.0]

By hand means one point at 0.7 of the end of the band (of viscoelastic and parametric models at all values of the
parameters that the search took, too), of the fewest blocks whose model has the tolerance against a search to a
hundredth of it: what an expert would find by trying, whose trials are not counted. `scale`: of the numbers of dofs.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median

import numpy as np
from common import finish

import hpcred
from hpcred.examples import linkage
from hpcred.examples.crank import EYES

POINT = 0.7  # of the end of the band
MOST = 60  # blocks
ALONG = 301  # frequencies at which models are compared, beside those around resonances


@dataclass(frozen=True)
class Case:
    """A model (made for a scale), its band (Hz), tolerances, frame, and damping (alpha, beta) if it has none."""

    make: Callable[[float], object]
    band: tuple[float, float]
    tolerances: tuple[float, ...]
    frame: object = None
    damping: object = hpcred.Rayleigh(20.0, 1e-7)


def solid(cells, inputs=6, scale=1.0):
    return hpcred.solid(tuple(max(2, round(count * scale ** (1 / 3))) for count in cells), inputs=inputs)


def crank(scale):
    """The rod with its two bearings."""
    bearings = [hpcred.Interface(name=name, nodes=hpcred.Nodes(set=name)) for name in EYES]
    rod = hpcred.crank(max(500, round(20_000 * scale))).with_interfaces(bearings)
    return rod.with_inputs([(name, "all") for name in EYES])


def viscoelastic(scale):
    """A block whose stiffness relaxes."""
    model = solid((16, 6, 6), 3, scale)
    return model.with_viscoelastic([hpcred.Viscoelastic(model.K, hpcred.laws.Maxwell([0.1, 0.05], [1e-3, 1e-4]))])


def parametric(scale):
    """A block whose stiffness is not known."""
    model = solid((16, 6, 6), 3, scale)
    return hpcred.ParametricModel(model, [hpcred.Parameter("e", (0.0, 1.0))], [hpcred.Term("K", model.K, "e")])


BLOCK = (36, 15, 15)  # cells; 27,648 dofs
CASES = {
    "block": Case(partial(solid, BLOCK, 6), (0.0, 9000.0), (1e-4, 1e-6)),
    "block-1": Case(partial(solid, BLOCK, 1), (0.0, 9000.0), (1e-4, 1e-6)),
    "block-36": Case(partial(solid, BLOCK, 36), (0.0, 9000.0), (1e-4,)),
    "cube": Case(partial(solid, (20, 20, 20), 6), (0.0, 8000.0), (1e-4, 1e-6)),
    "crank": Case(crank, (1.0, 10000.0), (1e-4,), hpcred.Buckens()),
    "linkage": Case(lambda scale: hpcred.linkage(), (0.0, 300.0), (1e-4, 1e-6), linkage.FRAME,
                    hpcred.Rayleigh(2.0, 1e-5)),
    "viscoelastic": Case(viscoelastic, (0.0, 15000.0), (1e-4,)),
    "parametric": Case(parametric, (0.0, 15000.0), (1e-4,)),
}  # fmt: skip


def by_search(case, model, tolerance):
    return hpcred.reduce(model, frame=case.frame, damping=case.damping, tolerance=tolerance, band=case.band)


def by_hand(case, model, order, values, store=None):
    more = {"parameter_points": values} if values else {}
    point = hpcred.Krylov(frequency=round(POINT * case.band[1], 3), order=order)
    return hpcred.reduce(model, [point], case.frame, case.damping, store=store, **more)


def responses(rom, frequencies, values):
    """H of a reduced model, at all values of the parameters (values, F, r, p)."""
    s = 2j * np.pi * frequencies
    return np.array([rom.transfer_function(s, **one) for one in values] if values else [rom.transfer_function(s)])


def fewest_blocks(case, model, tolerance):
    """The order of the point by hand that has the tolerance, and the values of the parameters that the search took."""
    rom, values = by_search(case, model, tolerance / 100), None
    if isinstance(model, hpcred.ParametricModel):
        values = [point.values for point in rom.record.accuracy.parameters.points]
    around = rom.frequencies[:, None] * (1 + np.linspace(-0.02, 0.02, 21))
    frequencies = np.unique(np.append(np.linspace(*case.band, ALONG), around))
    frequencies = frequencies[(frequencies >= case.band[0]) & (frequencies <= case.band[1])]
    exact = responses(rom, frequencies, values)
    with tempfile.TemporaryDirectory(prefix="hpcred-bench-") as folder:
        for order in range(MOST):  # each takes the blocks of the one before from the store
            found = responses(by_hand(case, model, order, values, hpcred.PointStore(folder)), frequencies, values)
            pairs = zip(exact, found, strict=True)
            if max(hpcred.relative_error(*pair, "paper").max() for pair in pairs) <= tolerance:
                return order, values
    return None, values


def timed(make):
    """What `make` returns, and the processor and wall seconds that it took."""
    start = time.process_time(), time.perf_counter()
    made = make()
    return made, time.process_time() - start[0], time.perf_counter() - start[1]


def row(name, tolerance, runs, scale):
    """A row of the table: medians of runs in turn."""
    case = CASES[name]
    model = case.make(scale)
    order, values = fewest_blocks(case, model, tolerance)
    found = {"model": name, "dofs": model.size, "tolerance": tolerance}
    searches, hands = [], []
    for _ in range(runs):
        searches.append(timed(lambda: by_search(case, model, tolerance)))
        if order is not None:
            hands.append(timed(lambda: by_hand(case, model, order, values)))
    accuracy = searches[0][0].record.accuracy
    found |= {"reached": accuracy.reached, "size": searches[0][0].size, "columns": accuracy.uncompressed_size,
              "search (processor s)": median(item[1] for item in searches),
              "search (wall s)": median(item[2] for item in searches)}  # fmt: skip
    if hands:
        ratios = [search[1] / hand[1] for search, hand in zip(searches, hands, strict=True)]
        found |= {"blocks by hand": order + 1, "size by hand": hands[0][0].size,
                  "hand (processor s)": median(item[1] for item in hands),
                  "hand (wall s)": median(item[2] for item in hands), "search / hand": median(ratios)}  # fmt: skip
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", choices=[[], *CASES], default=[])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--scale", type=float, default=1.0)
    given = parser.parse_args()
    rows = []
    for name in given.cases or CASES:
        for tolerance in CASES[name].tolerances:
            rows.append(row(name, tolerance, given.runs, given.scale))
            print(rows[-1], flush=True)
    finish("search", rows)


if __name__ == "__main__":
    main()
