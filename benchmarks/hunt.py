"""Reduce random small models of many classes to a tolerance, and compare what is claimed with dense solves.

usage: python benchmarks/hunt.py [KIND ...] [--models 20] [--first 0] [--minutes 1000]

The kinds are functions of tests/random_models.py; models of all kinds come in turn, by seed. One line for each that has
not reached its tolerance, is refused, or whose claim is false: "above" the tolerance that is said to be reached, "more
than said" where none is, or a wrong "count" of modes. "no model" is better where the last digits of K change the
response by a third of the tolerance, or, of one that is reached, so much that the dense solves do not know it. Then a
table by kind. The exit status is 1 where a claim was false.
"""

import argparse
import sys
import time

import numpy as np
from common import HERE, finish

sys.path.insert(0, str(HERE.parent / "tests"))
ROUND_OFF = 1e-10  # of the dense solves and of the small model
ROOM = 1.02  # of a tolerance, for floors from other frequencies
BESIDE = 1.3  # of an estimate that is no claim: the true error between its frequencies
VERDICTS = ("reached", "no model", "not reached", "refused", "above", "more than said", "count")
FALSE = VERDICTS[4:]


def outcome(kind, seed):
    """One row of the table, of the model of a seed."""
    from random_models import random_case

    import hpcred

    case, start = random_case(kind, seed), time.process_time()
    row = {"class": kind, "seed": seed, "dofs": len(case.K), "tolerance": case.tolerance}
    try:
        with case.reduced() as rom:
            row["seconds"] = time.process_time() - start
            accuracy = rom.record.accuracy
            true, where = case.largest_error(rom, np.random.default_rng(seed))
            said = accuracy.largest + accuracy.noise
            if accuracy.reached:
                verdict = "above" if true > ROOM * case.tolerance else "reached"
            else:
                verdict = "more than said" if true > max(BESIDE * said, ROUND_OFF) else "not reached"
            if verdict == "not reached" and not (case.parameters or case.parts):
                row["digits"] = case.change_by_last_digits(rom, np.random.default_rng(seed))
                if row["digits"] > case.tolerance / 3:
                    verdict = "no model"
            counted = accuracy.counted
            if counted is not None and counted.modes != case.modes_below(counted.below):
                verdict = "count"
            return row | {"verdict": verdict, "true": true, "said": said, "size": rom.size, "where": where,
                          "left out": len(accuracy.silent),
                          "why": "" if accuracy.reached else accuracy.sentence}  # fmt: skip
    except (hpcred.InputError, hpcred.ComputationError) as error:
        return row | {"verdict": "refused", "seconds": time.process_time() - start, "why": str(error)}


def summary(kind, rows):
    """Counts of one kind, its worst error over the estimate where that is no round-off, and its seconds."""
    over = [row["true"] / row["said"] for row in rows if row.get("true", 0.0) > ROUND_OFF]
    counts = {word: sum(row["verdict"] == word for row in rows) for word in VERDICTS}
    return {"class": kind, "models": len(rows), **counts, "true/said": round(max(over, default=0.0), 3),
            "seconds": round(sum(row["seconds"] for row in rows), 1)}  # fmt: skip


def words(row):
    values = (f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values())
    return ", ".join(map(" ".join, zip(row, values, strict=True)))


def main():
    from random_models import KINDS

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", default=list(KINDS), metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--minutes", type=float, default=1000.0)
    for name, value in (("models", 20), ("first", 0)):
        parser.add_argument(f"--{name}", type=int, default=value)
    options = parser.parse_args()
    rows, start = [], time.monotonic()
    for seed in range(options.first, options.first + options.models):
        for kind in options.kinds:
            if time.monotonic() - start < 60 * options.minutes:
                rows.append(outcome(kind, seed))
                if rows[-1]["verdict"] != "reached":
                    print(words(rows[-1]), flush=True)
    table = [summary(kind, [row for row in rows if row["class"] == kind]) for kind in options.kinds]
    for row in table:
        print(words(row))
    finish("hunt", [*table, *[row for row in rows if row["verdict"] != "reached"]])
    sys.exit(any(row["verdict"] in FALSE for row in rows))


if __name__ == "__main__":
    main()
