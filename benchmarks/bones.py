"""Reduce the bone models of the MOR Wiki, 127,224 to 11,969,688 dofs, over 1 to 100 Hz: all sizes on one curve.

    python benchmarks/bones.py --data FOLDER                        # BS01.M, BS01.K, BS01.B, BS01.C, BS10.M, ...
    python benchmarks/bones.py --data FOLDER --ranks 16 B120 --set solver.kind=multigrid

Writes bones.json and bones.png into the current folder, after each bone: coordinates and processor seconds over dofs.
Seconds are user and system time of all ranks, of reading the four files into model.h5 and of its reduction. Further
arguments are those of `hpcred reduce`.
"""

import argparse
import json
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
from common import finish, hpcred, workspace
from models import MODELS
from models.morwiki import BONES

from hpcred import InputError


def processor_seconds():
    """User and system time of all programs that ran from here."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured(name, data, ranks, options):
    """Sizes, errors and seconds of one bone, as a row of the table."""
    published = MODELS[name]
    files = [text for key, path in published.paths(data).items() for text in (f"-{key}", Path(path).resolve())]
    with workspace() as folder:
        folder = Path(folder)
        start = processor_seconds()
        hpcred("convert", *files, "model.h5", ranks=ranks, folder=folder)
        read = processor_seconds()
        (folder / "job.toml").write_text(published.job("model.h5"))
        try:
            hpcred("reduce", "job.toml", "--json", "run.json", *options, ranks=ranks, folder=folder)
        except subprocess.CalledProcessError:
            if not (folder / "run.json").is_file():  # which a model has that misses the tolerance
                raise
        end = processor_seconds()
        record = json.loads((folder / "run.json").read_text())
    return {
        "model": name, "dofs": record["size"], "coordinates": record["reduced_size"],
        "error": record["accuracy"]["largest"], "reached": record["accuracy"]["reached"],
        "factorisations": len(record["factorisations"]),
        "read (processor s)": read - start, "reduce (processor s)": end - read,
        "GB": sum(record["timing"]["memory_mb_per_rank"]) / 1024,
    }  # fmt: skip


def draw(rows, path="bones.png"):
    """Coordinates and processor seconds over dofs, with the exponent of the latter."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    dofs = [row["dofs"] for row in rows]
    seconds = [row["reduce (processor s)"] for row in rows]
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    left.semilogx(dofs, [row["coordinates"] for row in rows], "o-")
    left.set(xlabel="dofs", ylabel="coordinates", ylim=(0, None))
    right.loglog(dofs, seconds, "o-")
    right.set(xlabel="dofs", ylabel="processor seconds of the reduction")
    if len(set(dofs)) > 1:
        right.set_title(f"grows with the power {np.polyfit(np.log(dofs), np.log(seconds), 1)[0]:.2f} of the dofs")
    for row in rows:
        left.annotate(row["model"], (row["dofs"], row["coordinates"]))
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--data", required=True, metavar="FOLDER")
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"of {', '.join(BONES)}; by default all that are there"
    )
    given, options = parser.parse_known_args(arguments)
    if unknown := [name for name in given.names if name not in BONES]:
        parser.error(f"found the name {', '.join(unknown)}, expected some of {', '.join(BONES)}")
    there = [name for name in BONES if (Path(given.data) / MODELS[name].file).is_file()]
    names = sorted(given.names or there, key=lambda name: list(BONES).index(name))
    if not names:
        parser.error(
            f"{given.data}: found no bone, expected {MODELS['BS01'].file} and others of {MODELS['BS01'].where}"
        )
    try:
        for name in names:
            MODELS[name].paths(given.data)
    except InputError as error:
        parser.error(str(error))
    rows, failed = [], []
    for name in names:
        try:
            rows.append(measured(name, given.data, given.ranks, options))
        except subprocess.CalledProcessError as error:  # a larger one may go with other settings
            failed.append(name)
            words = [str(word) for word in error.cmd]
            print(f"{name}: left out; hpcred {words[words.index('hpcred') + 1]} ended with status {error.returncode} "
                  "(see above)", file=sys.stderr)  # fmt: skip
            continue
        rows.sort(key=lambda row: row["dofs"])
        finish("bones", rows)  # after each, for a larger one may fail
        draw(rows)
    sys.exit(f"left out: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
