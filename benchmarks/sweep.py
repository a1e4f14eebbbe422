"""A sweep of 24 jobs (4 damping models, 3 orders, 2 mixtures) on a block, with and without a store of points.

usage: python benchmarks/sweep.py [27k|112k] [ranks]

The last column is the largest relative difference of the responses of a job in the two sweeps.
"""

import json
import sys
import time
from pathlib import Path

import h5py
from common import difference, finish, hpcred, responses, solid, workspace

CASES = {"2k": (16, 6, 5), "27k": (36, 15, 15), "112k": (60, 24, 24)}
SWEEP = """
[job]
model = "model.h5"
write_basis = false
[[vary]]
key = "damping"
names = ["none", "light", "heavy", "structural"]
values = [
    {{kind = "none"}}, {{kind = "rayleigh", alpha = 2.0, beta = 1e-7}},
    {{kind = "rayleigh", alpha = 20.0, beta = 1e-6}},
    {{kind = "structural", loss_factor = 0.02}},
]
[[vary]]
key = "basis"
names = ["krylov", "krylov-modal"]
values = [
    [{{kind = "krylov", frequency = 100.0}}, {{kind = "krylov", frequency = 3000.0}}],
    [{{kind = "krylov", frequency = 100.0}}, {{kind = "krylov", frequency = 3000.0}}, {{kind = "modes", count = 10}}],
]
[[vary]]
key = ["basis.0.order", "basis.1.order"]
values = [1, 2, 3]
[launch]
ranks = {ranks}
"""


def main(case="27k", ranks="2"):
    rows, found = [], {}
    with workspace() as folder:
        folder = Path(folder)
        solid(folder, CASES[case])
        with h5py.File(folder / "model.h5") as file:
            size = int(file.attrs["size"])
        for name, options in (("without", []), ("with", ["--store", "points"])):
            (folder / f"{name}.toml").write_text(SWEEP.format(ranks=ranks))
            start = time.perf_counter()
            hpcred("sweep", f"{name}.toml", "--json", f"{name}.json", *options, ranks=None, folder=folder)
            seconds = time.perf_counter() - start
            report = json.loads((folder / f"{name}.json").read_text())
            results = sorted((folder / name).glob("*.h5"))
            assert report["finished"] == len(results) == 24
            found[name] = [responses(path) for path in results]
            rows.append({"store": name, "dofs": size, "jobs": 24, "factorisations": report["factorisations"],
                         "saved": report["factorisations_saved"], "seconds": seconds})  # fmt: skip
    for row in rows:
        row["without / this"] = rows[0]["seconds"] / row["seconds"]
        row["difference"] = max(map(difference, found[row["store"]], found["without"]))
    finish("sweep", rows)


main(*sys.argv[1:])
