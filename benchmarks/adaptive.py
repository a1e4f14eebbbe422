"""The automatic reduction: factorisations, columns, size, seconds, and the estimated error against full solves.

usage: python benchmarks/adaptive.py [--ranks 2] [--fresh 31] [row ...]

A row is a model and a tolerance with figures to reach; by default all rows, those of GROUPED with two groups of ranks
as well. The largest has 112,500 dofs and takes an hour, nearly all of it for full solves at fresh frequencies.
"""

import argparse
import json
import sys
from dataclasses import dataclass

from common import finish, job, workspace


@dataclass(frozen=True)
class Row:
    """A model, its band (Hz) and damping (alpha, beta), and {tolerance: (factorisations, size) at most}."""

    make: str
    band: tuple[float, float]
    figures: dict[float, tuple[int, int]]
    frame: str = "none"
    rayleigh: tuple[float, float] | None = None
    columns: int | None = None
    share: float | None = None  # seconds over those of two factorisations, at most
    fresh: int | None = None


ROWS = {
    "linkage": Row("linkage", (0, 300), {1e-4: (2, 7), 1e-6: (2, 8)}, "chord", (2.0, 1e-5)),
    "linkage-mimo": Row("linkage-mimo", (0, 300), {1e-4: (3, 20), 1e-6: (3, 22)}, "buckens", (2.0, 1e-5)),
    "solid": Row("16 6 5", (0, 25782), {1e-2: (3, 22), 1e-4: (3, 27), 1e-6: (3, 33)}),
    "free": Row("14 5 4 free", (0, 37762), {1e-2: (3, 24), 1e-4: (3, 30)}, "buckens"),
    "plate": Row("20 20 1", (0, 30020), {1e-2: (5, 80), 1e-4: (5, 86)}),
    "free-18000": Row("40 16 8 free", (0, 15000), {1e-4: (3, 41), 1e-6: (3, 46)}, "buckens", (20.0, 1e-7), fresh=9),
    "solid-112500": Row("60 24 24", (0, 6000), {1e-4: (2, 26)}, "none", (20.0, 1e-7), 90, 1.6, fresh=2),
}
GROUPED = ("linkage", "solid", "plate")


def model_of(row):
    import hpcred
    from hpcred.examples import linkage

    if row.make == "linkage":
        return hpcred.linkage()
    if row.make == "linkage-mimo":
        return hpcred.linkage(inputs=(*linkage.SUPPORTS, linkage.LOAD))
    cells = tuple(int(word) for word in row.make.split()[:3])
    return hpcred.solid(cells, clamped="free" not in row.make)


def frame_of(row):
    import hpcred
    from hpcred.examples import linkage

    return {"chord": linkage.FRAME, "buckens": hpcred.Buckens(), "none": None}[row.frame]


def reduce(name, tolerance, groups):
    """In a job of its own: result.h5, and what was done."""
    import hpcred

    row = ROWS[name]
    with model_of(row) as model:
        damping = hpcred.Rayleigh(*row.rayleigh) if row.rayleigh else None
        with hpcred.reduce(model, frame=frame_of(row), damping=damping, tolerance=tolerance, band=row.band,
                           groups=groups) as reduced:  # fmt: skip
            hpcred.write_result("result.h5", reduced, model)
            record, accuracy = reduced.record, reduced.record.accuracy
            factors = [item.factor_seconds + item.analysis_seconds for item in record.factorisations]
            if model.comm.rank == 0:
                print(json.dumps({
                    "factorisations": len(factors), "columns": accuracy.uncompressed_size, "size": reduced.size,
                    "estimated": accuracy.largest, "noise": accuracy.noise, "reached": accuracy.reached,
                    "seconds": record.timing.elapsed,
                    "factor seconds": sum(factors),
                }))  # fmt: skip


def check(name, fresh):
    """In a job of its own, with complex arithmetic: the largest true error, and the estimated over it where clear."""
    import hpcred
    from hpcred.analysis.error_check import check_reduced

    hpcred.start("complex")
    with model_of(ROWS[name]) as model:
        reduced = hpcred.read_result("result.h5").reduced
        found = check_reduced(reduced, model, fresh, seed=5)
        clear = [(estimated / measured) for estimated, measured in zip(found.estimated, found.measured, strict=True)
                 if measured > 10 * reduced.record.accuracy.noise]  # fmt: skip
        if model.comm.rank == 0:
            ratios = [min(clear, default=1.0), max(clear, default=1.0)]
            print(json.dumps({"true": max(found.measured), "ratios": ratios}))


def measured(name, tolerance, groups, ranks, fresh):
    """A row of the table."""
    row = ROWS[name]
    with workspace() as folder:
        ours = job(ranks, folder, "--reduce", name, tolerance, groups)
        true = job(ranks, folder, "--check", name, min(fresh, row.fresh or fresh))
    most, size = row.figures[tolerance]
    low, high = true["ratios"]
    share = ours["seconds"] / (2 * ours["factor seconds"] / ours["factorisations"])
    fails = [word for word, good in (
        ("factorisations", ours["factorisations"] <= most + (groups > 1)), ("size", ours["size"] <= size),
        ("columns", row.columns is None or ours["columns"] <= row.columns),
        ("seconds", row.share is None or share <= row.share),
        ("error", ours["reached"] and true["true"] <= tolerance), ("estimated", low >= 0.5 and high <= 2),
    ) if not good]  # fmt: skip
    return {
        "model": name, "asked": tolerance, "groups": groups, "factorisations": ours["factorisations"], "at most": most,
        "columns": ours["columns"], "size": ours["size"], "size at most": size, "estimated": ours["estimated"],
        "true": true["true"], "estimated / true": f"{low:.2f} to {high:.2f}", "noise": ours["noise"],
        "seconds": ours["seconds"], "over two factors": share, "reached": ", ".join(fails) or "yes",
    }  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--fresh", type=int, default=31)
    parser.add_argument("rows", nargs="*", choices=[[], *ROWS], default=[])
    given = parser.parse_args()
    table = []
    for name in given.rows or ROWS:
        for tolerance in ROWS[name].figures:
            # with groups one row a model
            for groups in (1, 2) if name in GROUPED and tolerance == 1e-4 and given.ranks > 1 else (1,):
                table.append(measured(name, tolerance, groups, given.ranks, given.fresh))
                print(json.dumps(table[-1]), file=sys.stderr, flush=True)
    finish("adaptive", table)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--reduce"]:
        reduce(sys.argv[2], float(sys.argv[3]), int(sys.argv[4]))
    elif sys.argv[1:2] == ["--check"]:
        check(sys.argv[2], int(sys.argv[3]))
    else:
        main()
