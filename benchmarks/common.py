"""Run hpcred and a peer on the same work in one call, and set their seconds, memory and answers side by side."""

import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from datetime import date
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
PEER_PYTHON = os.environ.get("HPCRED_PEER_PYTHON", str(HERE.parent / ".venv-peers/bin/python"))
CHECK = [50.0, 700.0, 2500.0, 5000.0]  # Hz, where transfer functions are compared
ENVIRONMENT = {
    **os.environ, "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1", "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",  # of peers, too
}  # fmt: skip
POINTS = (100.0, 3000.0, 6000.0, 9000.0)


def hpcred(*arguments, ranks=2, folder=".", threads=1):
    """Run the command line on some ranks, each with so many threads; None: without a launcher."""
    unbound = ["--bind-to", "none"] if threads > 1 else []  # Open MPI binds each of one or two ranks to one core
    launcher = ["mpiexec", "-n", str(ranks), *unbound] if ranks is not None else []
    command = [*launcher, sys.executable, "-m", "hpcred", *map(str, arguments)]
    environment = {**ENVIRONMENT, "OPENBLAS_NUM_THREADS": str(threads)}
    subprocess.run(command, check=True, cwd=folder, env=environment, stdout=sys.stderr)


def job(ranks, folder, *arguments):
    """Run the program that calls this once more, with other arguments, on some ranks; its last line is JSON."""
    command = ["mpiexec", "-n", str(ranks), sys.executable, str(Path(sys.argv[0]).resolve()), *map(str, arguments)]
    environment = {**ENVIRONMENT, "OPENBLAS_NUM_THREADS": "1"}
    run = subprocess.run(command, check=True, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
    return json.loads(run.stdout.strip().splitlines()[-1])


def solid(folder, cells, inputs=6, free=False, ranks=2):
    """model.h5 of a block of hexahedra."""
    hpcred("example", "solid", "--cells", *cells, "--inputs", inputs, *(["--free"] if free else []), "-o", "model.h5",
           ranks=ranks, folder=folder)  # fmt: skip


def reduce(folder, basis, ranks=2, options=(), threads=1):
    """Reduce model.h5; returns the record of the run, and the responses at CHECK."""
    (folder / "job.toml").write_text('model = "model.h5"\noutput = "result.h5"\n' + basis)
    hpcred("reduce", "job.toml", "--json", "ours.json", *options, ranks=ranks, folder=folder, threads=threads)
    record = json.loads((folder / "ours.json").read_text())
    run, factors = record["timing"], record["factorisations"]
    mumps = sum(f["analysis_seconds"] + f["factor_seconds"] + f["solve_seconds"] for f in factors)
    return {
        "seconds": run["elapsed"],
        "stages": run["seconds"],
        "outside_mumps": 1 - mumps / run["elapsed"],
        "orthogonalise": run["seconds"].get("orthogonalise", 0.0) / run["elapsed"],
        "analyses": record["symbolic_analyses"],
        "memory_mb": sum(run["memory_mb_per_rank"]),
        "dofs": record["size"],
        "size": record["reduced_size"],
        "ordering": factors[-1]["ordering"],
        "iterations": max(f["iterations"] for f in factors),
        "factor_gflops": sum(f["flops"] for f in factors) / sum(f["factor_seconds"] for f in factors) / 1e9,
        "frequencies": record["frequencies_hz"],
        "response": responses(folder / "result.h5"),
    }


def krylov(points=POINTS, order=1):
    return "".join(f'[[basis]]\nkind = "krylov"\nfrequency = {f}\norder = {order}\n' for f in points)


def responses(result):
    """H (len(CHECK), r, p) of a result file without damping."""
    import h5py

    with h5py.File(result) as file:
        K, B, C = (file[f"reduced/{key}"][...] for key in "KBC")
    return np.array([C @ np.linalg.solve(K - (2 * np.pi * f) ** 2 * np.eye(len(K)), B) for f in CHECK])


def peer(script, *arguments, threads=2):
    """Run a script of peers/ in the peers' environment; its last line is JSON."""
    environment = {**ENVIRONMENT, **{f"{name}_NUM_THREADS": str(threads) for name in ("MKL", "OMP", "OPENBLAS")}}
    command = [PEER_PYTHON, str(HERE / "peers" / script), *map(str, arguments)]
    run = subprocess.run(command, check=True, env=environment, stdout=subprocess.PIPE, text=True)
    return json.loads(run.stdout.strip().splitlines()[-1])


def difference(ours, theirs):
    """Largest relative difference of two lists of responses."""
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    norms = [np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(ours, theirs, strict=True)]
    return float(max(norms))


def workspace():
    return tempfile.TemporaryDirectory(prefix="hpcred-bench-")


def machine():
    name = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    return f"{name}, {os.cpu_count()} cores, {memory:.0f} GiB"


def finish(name, rows):
    """Print rows (dicts) as a table and as JSON, and write them to <name>.json in the current folder."""
    keys = list(dict.fromkeys(key for row in rows for key in row))
    cells = [[f"{row.get(key):.3g}" if isinstance(row.get(key), float) else str(row.get(key, "")) for key in keys]
             for row in rows]  # fmt: skip
    print(f"\n{name} ({machine()})\n")
    print("| " + " | ".join(keys) + " |\n|" + " --- |" * len(keys))
    for row in cells:
        print("| " + " | ".join(row) + " |")
    Path(f"{name}.json").write_text(json.dumps({**origin(), "rows": rows}, indent=1) + "\n")


def origin():
    """Where a table comes from: machine, date, commit, with a + where the package has changes, and versions."""

    def git(*words):
        if shutil.which("git") is None:
            return ""
        return subprocess.run(["git", "-C", str(HERE.parent), *words], capture_output=True, text=True).stdout.strip()

    commit = git("rev-parse", "--short", "HEAD") + "+" * bool(git("status", "--porcelain", "hpcred"))
    known = "from hpcred.reduction.result.record import versions; import json; print(json.dumps(versions()))"
    found = subprocess.run([sys.executable, "-c", known], env=ENVIRONMENT, check=True, capture_output=True, text=True)
    versions = json.loads(found.stdout.splitlines()[-1])
    return {"machine": machine(), "date": date.today().isoformat(), "commit": commit or "unknown", "versions": versions}
