"""Write the tables of benchmarks in docs/benchmarks.md from the results of a run: python benchmarks/tables.py [folder].

They stand between two comments; rows whose results are not in the folder are left out.
"""

import json
import sys
from pathlib import Path

PAGE = Path(__file__).parent.parent / "docs" / "benchmarks.md"
BEGIN, END = "<!-- benchmarks: made by benchmarks/tables.py -->", "<!-- end of benchmarks -->"
HEAD = ("work", "dofs", "hpcred", "peer", "peer / hpcred", "largest difference")


def number(value, unit=""):
    return f"{value:.3g}{unit}"


def line(work, dofs, ours, theirs, agreement):
    size = f"{dofs:,}" if dofs else ""
    return [work, size, number(ours, " s"), number(theirs, " s"), number(theirs / ours), number(agreement)]


def points_of(row):
    return f"{row['points']} point{'s' * (row['points'] > 1)} of order {row['order']}"


def solids(row):
    yield line(f"6 inputs, {points_of(row)}; peer: SciPy with MKL PARDISO", row["dofs"], row["hpcred, 2 ranks (s)"],
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
        yield line(f"sweep of 24 jobs, {row['factorisations']} factorisations with a store; peer: without, "
                   f"{row['factorisations'] + row['saved']}", 112_500, row["seconds"],
                   row["seconds"] * row["without / this"], row["difference"])  # fmt: skip


def readers(name, work, ours, theirs):
    """Rows of a file read by hpcred and by peers; `ours` and `theirs` begin the names of the readers in their rows."""

    def cells(rows):
        own = next(row for row in rows if row[name].startswith(ours))
        for row in rows:
            if row[name].startswith(theirs):
                count = next(own[key] for key in ("nonzeros", "stored nonzeros") if key in own)
                agreement = row["agreement"] if "agreement" in row else abs(row["sum"] / own["sum"] - 1)
                peer = row[name].removeprefix("K.mtx by ")
                yield line(f"{work}, {count:,} entries; peer: {peer}", None, own["seconds"], row["seconds"], agreement)

    return cells


def parts_of_solids(rows):
    for row in rows:
        yield [f"{points_of(row)}, {row['dofs']:,} dofs: outside of MUMPS, with start and files; orthogonalisation",
               f"{100 * row['outside MUMPS']:.0f} %; {100 * row['orthogonalisation']:.1f} %"]  # fmt: skip
        yield [f"{points_of(row)}, {row['dofs']:,} dofs: memory of both ranks (of PARDISO), kB a dof",
               f"{row['kB/dof']:.1f} ({row['PARDISO kB/dof']:.1f})"]  # fmt: skip


def growth(rows):
    sizes = [row["dofs"] for row in rows if row["varied"] == "dofs"]
    fixed = next(f"{row['dofs']:,} dofs" for row in rows if row["varied"] == "inputs")
    named = {
        "exponent of dofs": f"growth of the time from {min(sizes):,} to {max(sizes):,} dofs, 2 points: exponent",
        "96 inputs / 6 inputs": f"{fixed}: 96 inputs take so many times as long as 6",
        "1 rank / 2 ranks": f"{fixed}: two ranks are so many times as fast as one",
        "1 group / 2 groups": f"{fixed}: two groups of one rank, as many times as fast as one of two",
    }
    yield from ([named[row["varied"]], number(row["value"])] for row in rows if row["varied"] in named)


def multigrid(rows):
    cubes, exponents = [row for row in rows if row["varied"] == "cube"], {row["varied"]: row["value"] for row in rows}
    last = cubes[-1]
    yield [f"cube of {last['dofs']:,} dofs by multigrid, {last['size']} columns at 0 Hz",
           f"{number(last['seconds'], ' s')}, {last['GB']:.1f} GB"]  # fmt: skip
    yield [f"growth from {cubes[0]['dofs']:,} dofs to that: exponents of time and memory",
           f"{number(exponents['exponent of seconds'])}; {number(exponents['exponent of memory'])}"]  # fmt: skip


def to_a_tolerance(row):
    yield [f"cube of {row['dofs']:,} dofs by multigrid to {row['asked']:g}: processor seconds; memory",
           f"{number(row['processor seconds'])}; {row['GB of all ranks']:.1f} GB"]  # fmt: skip


def each(cells):
    return lambda rows: [found for row in rows for found in cells(row)]


COMPARED = {
    "solids": each(solids), "accuracy": each(accuracy), "interpolation": each(interpolation), "modes": each(modes),
    "reading": readers("file", "Matrix Market on two ranks", "K.mtx", "K.mtx by"),
    "op4": readers("reader", "binary OP4 on one rank", "hpcred, 1", "pyYeti"),
    "ansys_full": readers("reader", "ANSYS' .full on one rank", "hpcred, 1", "ansys"),
    "sweep": each(sweep),
}  # fmt: skip
MORE = {"solids": parts_of_solids, "growth": growth, "growth-multigrid": multigrid, "million": each(to_a_tolerance)}


def table(folder, head, makers, machines):
    """Lines of a table from the results that the folder has, in Markdown."""
    rows = []
    for name, make in makers.items():
        path = Path(folder) / f"{name}.json"
        if path.exists():
            found = json.loads(path.read_text())
            machines.append(found["machine"])
            rows += make(found["rows"])
    return [f"| {' | '.join(cells)} |\n" for cells in (head, ["---"] * len(head), *rows)] if rows else []


def main(folder="benchmark-results"):
    machines = []
    tables = [table(folder, HEAD, COMPARED, machines), table(folder, ("more", "value"), MORE, machines)]
    if not machines:
        sys.exit(f"{folder}: found no results for a table; docs/benchmarks.md stays as it is")
    said = f"Measured on: {'; '.join(dict.fromkeys(machines))}."
    before, rest = PAGE.read_text().split(BEGIN)
    after = rest.split(END)[1]
    text = "\n".join("".join(lines) for lines in tables if lines)
    PAGE.write_text("".join([before, BEGIN, "\n", text, f"\n{said}\n", END, after]))


if __name__ == "__main__":
    main(*sys.argv[1:])
