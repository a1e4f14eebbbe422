"""Write the table of benchmarks in README.md from the results of a run: python benchmarks/tables.py [folder].

The table stands between two comments; rows whose results are not in the folder are left out.
"""

import json
import sys
from pathlib import Path

README = Path(__file__).parent.parent / "README.md"
BEGIN, END = "<!-- benchmarks: made by benchmarks/tables.py -->", "<!-- end of benchmarks -->"
HEAD = ("work", "dofs", "hpcred", "peer", "peer / hpcred", "largest difference")


def number(value, unit=""):
    return f"{value:.3g}{unit}"


def line(work, dofs, ours, theirs, agreement):
    return [work, f"{dofs:,}", number(ours, " s"), number(theirs, " s"), number(theirs / ours), number(agreement)]


def solids(row):
    yield line("6 inputs, 4 points of order 1; peer: SciPy with MKL PARDISO", row["dofs"], row["hpcred, 2 ranks (s)"],
               row["PARDISO, 2 threads (s)"], row["agreement"])  # fmt: skip


def interpolation(row):
    yield line(f"6 inputs, 2 points of order 0; peer: pyMOR, {row['pyMOR']}", row["dofs"], row["hpcred, 2 ranks (s)"],
               row["pyMOR, 2 threads (s)"], row["agreement"])  # fmt: skip


def modes(row):
    yield line("30 lowest modes; peer: ARPACK of SciPy with PARDISO", row["dofs"], row["hpcred, 2 ranks (s)"],
               row["ARPACK + PARDISO (s)"], row["agreement"])  # fmt: skip


def accuracy(row):
    ours, size = row["hpcred, 2 ranks (s)"], row["size"]
    asked = f"{row['body']}: eps <= 1e-6 to 6000 Hz, {size} coordinates (error {number(row['error'])}); peer: "
    yield line(asked + "its points and orders on PARDISO", row["dofs"], ours, row["PARDISO copy (s)"],
               row["copy's error"])  # fmt: skip
    if "chain alone's error" in row:
        yield line(asked + "its first point on PARDISO, no proof", row["dofs"], ours, row["chain alone (s)"],
                   row["chain alone's error"])  # fmt: skip
    for factor in ("1.5", "2"):
        count = row[f"modes to {factor} times the band"]
        yield line(asked + f"{count} modes to {factor} times the band", row["dofs"], ours, row[f"{factor}: (s)"],
                   row[f"{factor}: error"])  # fmt: skip
    hand = next(key for key in row if key.startswith("by hand"))
    yield line(asked + hand.replace("by hand", "one point by hand").removesuffix(" (s)"), row["dofs"], ours, row[hand],
               row["hand's error"])  # fmt: skip


def sweep(row):
    if row["store"] == "with":
        yield [f"sweep of 24 jobs, {row['factorisations']} factorisations with a store; peer: without, "
               f"{row['factorisations'] + row['saved']}", "112,500", number(row["seconds"], " s"),
               number(row["seconds"] * row["without / this"], " s"), number(row["without / this"]),
               number(row["difference"])]  # fmt: skip


def main(folder="benchmark-results"):
    rows, machines = [], []
    for make in (solids, accuracy, interpolation, modes, sweep):
        path = Path(folder) / f"{make.__name__}.json"
        if path.exists():
            found = json.loads(path.read_text())
            machines.append(found["machine"])
            rows += [cells for row in found["rows"] for cells in make(row)]
    if not rows:
        sys.exit(f"{folder}: found no results for a table; README.md stays as it is")
    table = [" | ".join(cells) for cells in (HEAD, ["---"] * len(HEAD), *rows)]
    said = f"Measured on: {'; '.join(dict.fromkeys(machines))}."
    before, rest = README.read_text().split(BEGIN)
    after = rest.split(END)[1]
    README.write_text("".join([before, BEGIN, "\n", *(f"| {row} |\n" for row in table), f"\n{said}\n", END, after]))


if __name__ == "__main__":
    main(*sys.argv[1:])
