"""Reductions over parameters to a tolerance: random affine models, and what is said of them against dense solves.

usage: python benchmarks/parametric.py hunt [--models 100] [--first 0] [--most 120] [--pairs 60] [--points N]
       [--circulatory]

Each model has 15 to `most` dofs, 1 to 3 parameters, terms of M, D (gyroscopic ones too), K, B, and a tolerance of 1e-2
to 1e-6; with --circulatory terms that make K unsymmetric as well. The true error is that at `pairs` of a frequency and
values, corners and resonances among them. A miss is a model that was said to have reached its tolerance, and has not.
"""

import argparse
import sys
import time

from common import HERE, finish

sys.path.insert(0, str(HERE.parent / "tests"))


def reduced(seed, options):
    """One row of the table, of the model of a seed."""
    from parametric_models import fresh_pairs, random_affine, random_circulatory

    import hpcred

    case, tolerance = (random_circulatory if options.circulatory else random_affine)(seed, options.most)
    search = hpcred.ParameterSearch(points=options.points)
    found = {"seed": seed, "dofs": len(case.K), "damping": case.damping.kind, "tolerance": tolerance,
             "terms": " ".join(f"{of}:{factor.replace(' ', '')}" for of, _, factor in case.terms)}  # fmt: skip
    started = time.perf_counter()
    try:
        with case.model(None) as model, hpcred.reduce(
            model, tolerance=tolerance, band=case.band, damping=case.damping, parameter_search=search
        ) as rom:
            seconds, accuracy = time.perf_counter() - started, rom.record.accuracy
            true = float(case.eps(rom, fresh_pairs(case, options.pairs, seed=seed)).max())
            verdict = ("miss" if true > tolerance else "reached") if accuracy.reached else "not reached"
            return found | {
                "verdict": verdict, "true": true, "said": accuracy.largest, "noise": accuracy.noise,
                "factorisations": accuracy.factorisations, "values": len(accuracy.parameters.points),
                "size": rom.size, "columns": accuracy.uncompressed_size, "seconds": seconds,
            }  # fmt: skip
    except hpcred.InputError as error:
        return found | {"verdict": "refused", "why": str(error)[:200]}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["hunt"])
    for name, value in (("models", 100), ("first", 0), ("most", 120), ("pairs", 60)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--points", type=int)
    parser.add_argument("--circulatory", action="store_true")
    options = parser.parse_args()
    rows = []
    for seed in range(options.first, options.first + options.models):
        rows.append(reduced(seed, options))
        print(*(f"{key} {value:.2g}" if isinstance(value, float) else f"{key} {value}"
                for key, value in rows[-1].items()), flush=True)  # fmt: skip
    verdicts = ("reached", "not reached", "refused", "miss")
    counts = {word: sum(row["verdict"] == word for row in rows) for word in verdicts}
    finish("parametric", [{"models": len(rows), **counts}, *[row for row in rows if row["verdict"] != "reached"]])
    sys.exit(bool(counts["miss"]))


main()
