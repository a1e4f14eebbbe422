"""Seconds to eps <= 1e-6 over the band, proof included, against the same algorithm on PARDISO and against modes.

usage: python benchmarks/accuracy.py [small | block | cube | 360k ...]

The copy on PARDISO is given the points and orders that the search chose, factors each of them, and does no estimate;
"chain alone" is its first point, without a proof. Modes: all up to 1.5 and 2 times the band. By hand: the quickest
single point in the middle of the band that is as accurate, its order found beforehand. Errors are those of the
responses at CHECK, against exact solves.
"""

import json
import sys
from pathlib import Path

from common import CHECK, difference, finish, hpcred, krylov, peer, reduce, solid, workspace

CASES = {"small": (36, 15, 15), "block": (60, 24, 24), "cube": (33, 33, 33), "360k": (90, 37, 34)}
BAND, TOLERANCE = 6000.0, 1e-6
INPUTS = 6


def orders_of(points):
    """Points and orders of a search from its record."""
    return [point["frequency"] for point in points], [round(point["columns"] / INPUTS) - 1 for point in points]


def by_hand(folder, exact, highest=14):
    """The point in the middle of the band at the lowest order with the accuracy: its order, seconds and error."""
    for order in range(4, highest):
        found = reduce(folder, krylov([BAND / 2], order))
        error = difference(found["response"], exact)
        if error <= TOLERANCE:
            break
    return order, found["seconds"], error


def main(names=None):
    rows = []
    for name in names or ("block", "cube"):
        with workspace() as folder:
            folder = Path(folder)
            solid(folder, CASES[name], INPUTS)
            model = folder / "model.h5"
            exact = peer("pardiso_response.py", model, json.dumps(CHECK))["response"]
            ours = reduce(folder, f"band = [0.0, {BAND}]\ntolerance = {TOLERANCE}\nmeasure = \"paper\"\n")
            hpcred("evaluate", "result.h5", "--full", "model.h5", "--check", "2", folder=folder)
            points, orders = orders_of(json.loads((folder / "ours.json").read_text())["accuracy"]["points"])
            copy = peer("pardiso_krylov.py", model, json.dumps(orders), json.dumps(points), json.dumps(CHECK))
            alone = peer("pardiso_krylov.py", model, json.dumps(orders[:1]), json.dumps(points[:1]), json.dumps(CHECK))
            order, hand, error = by_hand(folder, exact)
            row = {
                "body": name, "dofs": ours["dofs"], "size": ours["size"], "hpcred, 2 ranks (s)": ours["seconds"],
                "error": difference(ours["response"], exact), "PARDISO copy (s)": copy["seconds"],
                "copy / hpcred": copy["seconds"] / ours["seconds"], "copy's error": difference(copy["response"], exact),
                "chain alone (s)": alone["seconds"], "chain alone / hpcred": alone["seconds"] / ours["seconds"],
                "chain alone's error": difference(alone["response"], exact),
                f"by hand, order {order} (s)": hand, "hpcred / hand": ours["seconds"] / hand, "hand's error": error,
            }  # fmt: skip
            for factor in (1.5, 2.0):
                modes = peer("arpack_modes.py", model, f"{factor * BAND}Hz", json.dumps(CHECK))
                row |= {
                    f"modes to {factor:g} times the band": modes["count"], f"{factor:g}: (s)": modes["seconds"],
                    f"{factor:g}: modes / hpcred": modes["seconds"] / ours["seconds"],
                    f"{factor:g}: error": difference(modes["response"], exact),
                }  # fmt: skip
        rows.append(row)
    finish("accuracy", rows)


main(sys.argv[1:])
