"""Write the tables of the pages from saved results: python benchmarks/tables.py [folder].

The results of the folder, NAME.json as a benchmark writes it, are first put into benchmarks/outcomes, which is part of
the sources. A table stands between two comments, and a table without any results stays as it is. Results that were not
saved when they were made were taken over from the page that had them (NAME.recorded.json, with the date and commit of
that page), until there are new ones. What `make bench` has no room or machine for stays beside its results under
another name (NAME.larger.recorded.json).
"""

import json
import math
import os
import re
import shutil
import sys
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parent.parent
OUTCOMES = Path(__file__).parent / "outcomes"
BLOCK = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end of table -->)", re.S)
PAGES = (
    "README.md", "docs/evidence.md", "docs/choose.md", "docs/errors.md", "docs/simulate.md", "docs/large.md",
    "docs/benchmarks.md", "docs/theory/assembly.md",
)  # fmt: skip


# of benchmarks.md

HEAD = ("work", "dofs", "hpcred", "peer", "largest difference")


def number(value, unit=""):
    return f"{value:.3g}{unit}"


def line(work, dofs, ours, theirs, agreement):
    size = f"{dofs:,}" if dofs else ""
    return [work, size, number(ours, " s"), number(theirs, " s"), number(agreement)]


def points_of(row):
    return f"{row['points']} point{'s' * (row['points'] > 1)} of order {row['order']}"


def solids(row):
    yield line(f"{points_of(row)}; peer: PARDISO", row["dofs"], row["hpcred, 2 ranks (s)"],
               row["PARDISO, 2 threads (s)"], row["agreement"])  # fmt: skip


def interpolation(row):
    yield line(f"6 inputs, 2 points of order 0; peer: pyMOR, {row['pyMOR']}", row["dofs"], row["hpcred, 2 ranks (s)"],
               row["pyMOR, 2 threads (s)"], row["agreement"])  # fmt: skip


def modes(row):
    yield line("30 lowest modes; peer: ARPACK of SciPy with PARDISO", row["dofs"], row["hpcred, 2 ranks (s)"],
               row["ARPACK + PARDISO (s)"], row["agreement"])  # fmt: skip


def accuracy(row):
    ours, size = row["hpcred, 2 ranks (s)"], row["size"]
    asked = f"{row['body']}: to 1e-6, {size} coordinates ({number(row['error'])}); peer: "
    yield line(asked + "its points and orders on PARDISO", row["dofs"], ours, row["PARDISO copy (s)"],
               row["copy's error"])  # fmt: skip
    count = row["modes to 1.5 times the band"]
    yield line(asked + f"{count} modes to 1.5 times the band", row["dofs"], ours, row["1.5: (s)"], row["1.5: error"])
    hand = next(key for key in row if key.startswith("by hand"))
    yield line(asked + hand.replace("by hand", "one point by hand").removesuffix(" (s)"), row["dofs"], ours, row[hand],
               row["hand's error"])  # fmt: skip


def sweep(row):
    if row["store"] == "with":
        yield line(f"sweep of 24 jobs, {row['factorisations']} factorisations with a store; peer: without, "
                   f"{row['factorisations'] + row['saved']}", row["dofs"], row["seconds"],
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


def shown(value):
    """A number in two digits, a text as it is."""
    if not isinstance(value, float):
        return f"{value:,}" if isinstance(value, int) else "" if value is None else str(value)
    if 100 <= value < 1e6:
        return f"{value:,.0f}"
    text = f"{value:.2g}" if 0.01 <= value < 1e6 else f"{value:.1e}"
    return re.sub(r"(?:\.0)?e([+-])0?", lambda found: f"e{found[1].strip('+')}", text)


# of evidence.md and others: the tables' heads, for the rows of a result their cells, and the result if of another name

CASES = {  # what the bodies of the benchmarks are called on the pages, where one name stands for several
    ("directions", "crank"): "rod", ("directions", "linkage"): "linkage, supports and load",
    ("directions", "plate"): "plate 16 x 16", ("adaptive", "linkage"): "linkage, one force",
    ("adaptive", "linkage-mimo"): "linkage, supports and load", ("adaptive", "plate"): "plate 20 x 20",
    ("adaptive", "solid"): "block 16 x 6 x 5", ("adaptive", "free"): "block 14 x 5 x 4, free",
    ("rivals", "linkage"): "linkage, one force", ("rivals", "block"): "block, damped",
    ("rivals", "plate"): "plate 16 x 16, damped", ("rivals", "foundation"): "foundation, viscous",
    ("rivals", "concrete"): "concrete, viscous", ("rivals", "shaft"): "shaft, viscous",
}  # fmt: skip
TO_A_TOLERANCE = "hpcred"


def case_of(name, row):
    body = row.get("body") or row.get("model")
    return CASES.get((name, body), body)


def columns(*names):
    """(head, cells) of a table with the values of these keys."""
    return list(names), lambda rows: [[shown(row.get(name)) for name in names] for row in rows]


def cells_of_directions(rows):
    keys = ("asked", "size", "estimated", "true", "static", "paper", "its drive point", "Craig-Bampton", "best")
    rows = [row for row in rows if row["solver"] == "direct"]
    return [[case_of("directions", row), shown(row["dofs"]), *(shown(row[key]) for key in keys)] for row in rows]


def cells_of_cost(rows):
    keys = ("groups", "factorisations", "columns", "size", "estimated / true")
    rows = [row for row in rows if row["asked"] == 1e-4]
    return [[case_of("adaptive", row), *(shown(row[key]) for key in keys)] for row in rows]


def cells_of_boundary(rows):
    rows = [row for row in rows if not {row["big eye"], row["small eye"]} & {"1", "100", 1, 100}]
    return [[shown(value) for key, value in row.items() if key != "size"] for row in rows]


def cells_of_published(rows):
    keys = ("dofs", "inputs", "band (Hz)", "coordinates", "largest error", "processor s")
    bases = {"tolerance 0.0001": "to 1e-4"}
    return [[f"`{row['model']}`", bases.get(row.get("basis"), row.get("basis", row.get("verdict", ""))),
             *(shown(row.get(key)) for key in keys)] for row in rows]  # fmt: skip


SAME_SIZE = ("to a tolerance", "Craig-Bampton", "modes", "modes and attachment modes", "points by hand")


def cells_of_same_size(rows):
    found = {(row["asked"], row["method"]): f"{row['coordinates']}: {shown(row['largest error'])}" for row in rows}
    return [[shown(asked), *(found[asked, method] for method in SAME_SIZE)] for asked in sorted(
        {row["asked"] for row in rows}, reverse=True)]  # fmt: skip


def cells_of_rivals(rows):
    """Sizes for both errors, and the error at the size of hpcred; that of hpcred is in other tables."""
    models, methods = (list(dict.fromkeys(row[key] for row in rows)) for key in ("model", "method"))
    by = {(row["model"], row["method"], row["error"]): row for row in rows}
    made = []
    for method in methods:
        cells = [method]
        for model in models:
            loose, close = (by.get((model, method, eps)) for eps in (1e-2, 1e-4))
            if loose is None:
                cells.append("-")
                continue
            error = "-" if method == TO_A_TOLERANCE else close["error at the size of hpcred"]
            cells.append(f"{loose['size']} / {close['size']}" + (f", {shown(error)}" if error != "-" else ""))
        made.append(cells)
    ratios = [[by[model, TO_A_TOLERANCE, eps]["hpcred / best"] for eps in (1e-2, 1e-4)] for model in models]
    return [*made, ["hpcred / best", *(" / ".join(f"{ratio:.2f}" for ratio in pair) for pair in ratios)]]


def head_of_large_rivals(rows):
    """The errors are those with as many coordinates as hpcred has."""
    return ["method", *(key for key in rows[0] if key.startswith("size for")), "seconds",
            *(key for key in rows[0] if key.startswith("error with"))]  # fmt: skip


def head_of_rivals(rows):
    return ["method", *dict.fromkeys(case_of("rivals", row) for row in rows)]


def cells_of_bounds(rows):
    asked = {"tolerance": "", "exact": ", `static = \"exact\"`"}
    keys = ("size", "frequencies", "static")
    return [[f"{shown(row['tolerance'])}{asked[row['asked of 0 Hz']]}", *(shown(row[key]) for key in keys),
             f"{100 * row['stress']:.2g} %" if row["stress"] > 1e-9 else "round-off"]
            for row in sorted(rows, key=lambda row: (-row["tolerance"], row["asked of 0 Hz"] == "exact"))]  # fmt: skip


def cells_of_promise(rows):
    """What eps bounds, with the numbers of the reduction to 1e-4."""
    by = {row["asked of 0 Hz"]: row for row in rows if row["tolerance"] == 1e-4}
    rod, exact = by["tolerance"], by["exact"]
    below = f"{shown(rod['below'])}, where the response is {100 * rod['there, of the floor']:.2g} % of its floor"
    return [
        ["drive points above their floor", "the error of themselves", shown(rod["above the floor"])],
        ["drive points below it (antiresonances)", "that of the floor: at a hundredth of it 100 eps of themselves",
         below],
        ["responses from one place to another", "that of the geometric mean of the two drive points, more of "
         "themselves where they are smaller", f"{shown(rod['cross'])} of themselves or of their median, of the "
         f"{rod['of']} that reach a hundredth of that mean"],
        ["frequencies in the band", "about the damping ratio times eps",
         f"{shown(rod['frequencies'])}, with a ratio of 1e-3"],
        ["deflection under constant forces", "that of each direction", shown(rod["static"])],
        ["stress under constant forces", "nothing; [near loads](stress.md#accuracy-near-loads) it is largest",
         f"{100 * rod['stress']:.2g} % of the largest stress; {shown(exact['stress'])} with `static = \"exact\"`"],
    ]  # fmt: skip


def cells_of_cards(rows):
    """Dofs of the largest cube whose factor, by the power law through two, leaves 0.5 GB of a card."""
    (dofs, used), (more, most) = sorted((row["dofs"], row["GB of the GPU"]) for row in rows
                                        if row["package"] == "cudss")[-2:]  # fmt: skip
    power = math.log(more / dofs) / math.log(most / used)
    return [["million dofs", *(f"{dofs * ((card - 0.5) / used) ** power / 1e6:.2g}" for card in CARDS)]]


def cells_of_simulations(rows):
    usual = {"relative_tolerance 1e-05": " (the default)"}
    return [[row["settings"] + usual.get(row["settings"], ""), *(shown(row[key]) for key in ("error", "seconds", PEER))]
            for row in rows if row["case"] == "pendulum"]  # fmt: skip


def cells_of_scaling(rows):
    """A row a layout, with the seconds of PARDISO on as many threads as it has ranks of one thread."""
    peers = {(row["dofs"], row["threads"]): row["seconds"] for row in rows if row["case"].endswith("PARDISO")}
    made = []
    for row in rows:
        if not row["case"].endswith("PARDISO"):
            ranks = f"{row['ranks']}" + f" of {row['threads']} threads" * (row["threads"] > 1)
            peer = peers.get((row["dofs"], row["ranks"])) if row["threads"] == 1 else None
            values = (row["seconds"], row["factor"], row["GB"], peer)
            made.append([shown(row["dofs"]), ranks, *("" if value is None else f"{value:.3g}" for value in values)])
    return made


def cells_of_sizes(rows):
    """Of the cubes that were analysed with about 10^5 and 10^6 dofs, and of that to which the power law is extended."""
    analysed = [row for row in rows if isinstance(row["dofs"], int)]
    chosen = [min(analysed, key=lambda row: abs(math.log10(row["dofs"]) - power)) for power in (5, 6)]
    return [[shown(row["dofs"]), shown(row["MB in all"] / 1e3), machine]
            for row, machine in zip([*chosen, rows[-1]], MACHINES, strict=True)]  # fmt: skip


def cells_of_doubling(rows):
    """How many times as fast twice as many ranks are, and what half as many of two threads take of time and memory."""
    by = {(row["dofs"], row["ranks"], row["threads"]): row for row in rows if not row["case"].endswith("PARDISO")}
    made = []
    for dofs in dict.fromkeys(row["dofs"] for row in rows):
        times = [by[dofs, ranks, 1]["seconds"] for ranks in (1, *DOUBLED)]
        threads, one = by[dofs, DOUBLED[-1] // 2, 2], by[dofs, DOUBLED[-1], 1]
        ratios = [*(slow / fast for slow, fast in pairwise(times)),
                  *(threads[key] / one[key] for key in ("seconds", "GB"))]  # fmt: skip
        made.append([shown(dofs), *map(shown, ratios)])
    return made


MACHINES = ("a laptop", "a workstation or a node", "several nodes, `--low-rank` or `--out-of-core`")
DOUBLED = (2, 4, 8, 16)  # ranks
CARDS = (16, 24, 32, 48, 80, 141)  # GB
PEER = "Exudyn at this error (s)"

EVIDENCE = {
    "directions": (("body", "dofs", "asked", "size", "estimated", "true", "static", "paper", "its drive point",
                    "Craig-Bampton", "best"), cells_of_directions),
    "adaptive": (("body", "groups", "factorisations", "columns", "size", "estimated / true"), cells_of_cost),
    "boundary": (None, cells_of_boundary),
    "published": (("model", "basis", "dofs", "inputs", "band (Hz)", "coordinates", "largest error", "processor s"),
                  cells_of_published),
    "bearings": (("tolerance", *SAME_SIZE), cells_of_same_size),
    "rivals": (head_of_rivals, cells_of_rivals),
    "rivals_large": (head_of_large_rivals, lambda rows: columns(*head_of_large_rivals(rows))[1](rows)),
    "mbsim_body": columns("quantity", "hpcred, consistent mass", "with the mass lumped to the diagonal"),
    "rotor": columns("what", "dofs", "coordinates", "factorisations", "estimated", "measured"),
    "strong-scaling": (("dofs", "ranks", "seconds", "factor", "GB", "PARDISO (s)"), cells_of_scaling),
    "million": columns("dofs", "asked", "coordinates", "columns solved for", "estimated", "measured",
                       "processor seconds", "GB of all ranks"),
    "search": columns("model", "dofs", "tolerance", "size", "size by hand", "search (processor s)",
                      "hand (processor s)", "search / hand"),
    "gpu": columns("dofs", "tolerance", "package", "reduce (s)", "analysis (s)", "factors (s)", "solves (s)",
                   "GB of the GPU"),
    "shapes": columns("shape", "dofs", "iterations", "expected", "column (s)", "MUMPS: factor (s)", "MUMPS: column (s)",
                      "levels (MB)", "MUMPS: MB"),
    "bounds": (("tolerance", "coordinates", "frequencies in the band", "deflection at 0 Hz",
                "stress at 0 Hz, of the largest"), cells_of_bounds),
    "promise": (("of", "eps bounds", "the rod"), cells_of_promise, "bounds"),
    "cards": (("GB of the card", *map(str, CARDS)), cells_of_cards, "gpu"),
    "extrapolation": columns("dofs", "operations", "entries", "MB in all"),
    "sizes": (("dofs", "GB", "machine"), cells_of_sizes, "extrapolation"),
    "doubling": (("dofs", *(f"{ranks // 2} to {ranks} ranks" for ranks in DOUBLED), "two threads: time", "memory"),
                 cells_of_doubling, "strong-scaling"),
    "programs": columns("program", "what", "largest difference"),
    "machines": columns("exponent", "machines", "errors above 1e-5", "not known", "smallest ratio",
                        "median ratio of the largest"),
    "simulations": (("settings", "error", "seconds", PEER), cells_of_simulations),
}  # fmt: skip


def results(name):
    """(run, row) of the saved results of a benchmark; a run is the name of their file."""
    for path in [*OUTCOMES.glob(f"{name}.json"), *sorted(OUTCOMES.glob(f"{name}.*.json"))]:
        yield from ((path.stem, row) for row in json.loads(path.read_text())["rows"])


def evidence(name):
    """A table of evidence, with the run of each row, or below where all have one."""
    head, cells, *of = EVIDENCE[name]
    by_run = {}
    for run, row in results(*of or [name]):
        by_run.setdefault(run, []).append(row)
    every = [row for rows in by_run.values() for row in rows]
    head = list(head(every) if callable(head) else head or [key for key in every[0] if key != "size"])
    if len(by_run) == 1:
        ((run, rows),) = by_run.items()
        return f"{markdown(head, cells(rows))}\nRun: [{run}](#runs).\n"
    rows = [[*row, f"[{run}](#runs)"] for run, rows in by_run.items() for row in cells(rows)]
    return markdown([*head, "run"], rows)


def runs():
    """Where the rows of evidence come from; runs on one machine, of one date, commit and versions stand together."""
    of = {}
    for run in dict.fromkeys(run for name in EVIDENCE for run, _ in results(name)):
        found = json.loads((OUTCOMES / f"{run}.json").read_text())
        versions = ", ".join(f"{key} {value}" for key, value in found["versions"].items())
        of.setdefault((found["machine"], found["date"], found["commit"], versions), []).append(run)
    yield from ([", ".join(names), *origin] for origin, names in of.items())


def claims():
    """((body, tolerance, method, quantity), value as it is shown, run) of everything that the page says of reductions
    to a tolerance."""
    for name, keys in (
        ("directions", {"size": "size", "true": "error"}),
        ("adaptive", {"size": "size"}),
        ("published", {"coordinates": "size", "largest error": "error", "processor s": "seconds"}),
        ("bounds", {"size": "size"}),
    ):
        for run, row in results(name):
            usual = {"groups": 1, "solver": "direct", "asked of 0 Hz": "tolerance"}
            if any(row.get(key, value) != value for key, value in usual.items()):
                continue
            if not row.get("basis", "tolerance").startswith("tolerance"):
                continue
            asked = row.get("asked", row.get("tolerance", 1e-4))
            body = "rod" if name == "bounds" else case_of(name, row)
            for key, quantity in keys.items():
                if key in row:
                    yield (body, asked, TO_A_TOLERANCE, quantity), shown(row[key]), run
    for run, row in results("rivals"):
        yield (case_of("rivals", row), row["error"], row["method"], "size"), str(row["size"]), run


def markdown(head, rows):
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (head, ["---"] * len(head), *rows))


def compared(name, makers, head):
    """A table of benchmarks.md, and where, when and from which commit its rows were measured; recorded rows stand where
    a benchmark has no result for as many dofs."""
    recorded, rows, measured = json.loads((OUTCOMES / f"{name}.recorded.json").read_text()), [], []
    for benchmark, make in makers.items():
        path, new = OUTCOMES / f"{benchmark}.json", []
        if path.exists():
            result = json.loads(path.read_text())
            new = list(make(result["rows"]))
            measured.append(origin(result))
        earlier = [[row[key] for key in head] for row in recorded["rows"] if row["benchmark"] == benchmark]
        earlier = [row for row in earlier if size_of(row) not in set(map(size_of, new))]
        measured += [origin(recorded)] if earlier else []
        rows += new + earlier
    return markdown(head, rows), measured


def size_of(row):
    """How many dofs a row of benchmarks.md is about, as a text."""
    return row[1] if len(row) == len(HEAD) else re.search(r"([\d,]+) dofs", row[0])[1]


def origin(found):
    return f"{found['machine']}, {found['date']}, commit {found['commit']}"


def table(name):
    """The text of a table, or "" without results."""
    if name == "runs":
        return markdown(("run", "machine", "date", "commit", "versions"), runs())
    if name in EVIDENCE:
        return evidence(name) if any(results(*EVIDENCE[name][2:] or [name])) else ""
    makers, head = {"compared": (COMPARED, HEAD), "more": (MORE, ("more", "value"))}[name]
    text, measured = compared(name, makers, head)
    return f"{text}\nMeasured on: {'; '.join(dict.fromkeys(measured))}.\n"


def written(page):
    """The text of a page with its tables made anew; the runs are on the page of evidence."""
    evidence_page = ROOT / "docs/evidence.md"
    place = "" if ROOT / page == evidence_page else os.path.relpath(evidence_page, (ROOT / page).parent)

    def made(found):
        text = table(found[2]).replace("(#runs)", f"({place}#runs)")
        return f"{found[1]}{text}{found[3]}" if text else found[0]

    return BLOCK.sub(made, (ROOT / page).read_text())


def main(folder=None):
    for path in sorted(Path(folder).glob("*.json")) if folder else ():
        if path.stem in {*EVIDENCE, *COMPARED, *MORE} and json.loads(path.read_text())["rows"]:
            shutil.copy(path, OUTCOMES / path.name)
            (OUTCOMES / f"{path.stem}.recorded.json").unlink(missing_ok=True)
            print(f"{path} is now one of benchmarks/outcomes")
    texts = {page: written(page) for page in PAGES}
    for page, text in texts.items():
        (ROOT / page).write_text(text)


if __name__ == "__main__":
    main(*sys.argv[1:])
