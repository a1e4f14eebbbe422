"""Plan a reduction on a cluster: memory and time of each way to solve, before anything large is taken.

The factor is known from an analysis by MUMPS; where that takes too long itself, from the power law of cubes, which are
the worst of solids (docs/large.md).
"""

from __future__ import annotations

from math import ceil, log2

from ..files.hdf5 import reading
from ..files.model_file import FORMAT, SCHEMA, VERSION, read_model
from ..linalg.solvers.mumps import Mumps, nested_dissection
from ..parallel import startup
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import is_complex
from ..parallel.progress import Progress, in_time
from ..parallel.ranges import COUNT, within
from .workflow import workflow

GB = 1e9
MOST_ANALYSED = 1_000_000  # rows up to which an analysis takes seconds, and fits this machine if the matrices do
CUBE = {"rows": 1_014_300, "flops": 2.5e13, "entries": 2.5e9, "mb": 40_936}  # analysis on two ranks, docs/large.md
EXPONENTS = {"flops": 1.98, "entries": 1.38, "mb": 1.33}  # of the rows, the same table
ON_TWO, MORE_BY_RANKS = 1.3, 1.1  # of MUMPS' memory: two ranks over one, then each doubling; that cube has 55 GB on 16
UNEVEN = 1.2  # largest share of a rank in the memory of all
ON_DISK = 0.5  # of the memory of MUMPS that stays where factors are on a disk: 3.0 of 5.8 GB at 359,100 dofs
PROGRAM = 0.15 * GB  # an interpreter with its libraries, a rank
MATRICES = 160  # bytes a nonzero: M and K with the copies for solves and products, 12 kB a dof of a solid
MULTIGRID = 80  # bytes a nonzero in all, columns included: 5.6 to 5.8 kB a dof of a cube of 10^6 and 3 x 10^6 dofs
COLUMNS = 100  # of a reduction to a tolerance, V and M V
FACTORS = 2  # that a reduction to a tolerance takes
CARD = 1.06 * 8  # bytes an entry of a factor on a GPU
SECONDS_OF_MULTIGRID = 485 / 76_000_000  # of one core a nonzero, to a tolerance of 1e-4 over 38 modes
GFLOPS, GFLOPS_OF_GPU = 10.0, 1e4  # of a rank (12 on an Intel Xeon, 15 to 20 on an AMD EPYC), and of an H200
DISK_SLOWER = 1.4  # 85 instead of 60 s
SPARE = 1.15  # memory that is asked for, over that which is expected


@workflow
def plan_file(
    path, *, ranks: int, nodes: int = 1, memory_gb: float | None = None, gflops: float = GFLOPS, analyse: bool = False,
    comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Return memory and time that a reduction of a model file to a tolerance takes on `ranks` of `nodes`.

    Collective. Raises InputError.

    Parameters
    ----------
    path : str or PathLike
        model.h5; of a model with more than 10^6 dofs only its size is read, unless `analyse`.
    ranks, nodes : int
        Of the job that is planned; this run may have others.
    memory_gb : float, optional
        GB of a node; by default nothing is said to fit or not.
    gflops : float, default 10
        GFlop/s of a rank, which `hpcred bench` measures.
    analyse : bool, default False
        Analyse also a larger model.

    Returns
    -------
    dict
        `dofs`, `nonzeros`, `operations` and `entries` of a factor, `source` of these, `rows` of a table with GB and
        hours of each way, `best`, the first way that fits, and `script`, the head of a script for SLURM.
    """
    within("--ranks", ranks, COUNT)
    within("--nodes", nodes, COUNT)
    if nodes > ranks:
        raise InputError(f"--nodes: found {nodes} for {ranks} ranks, expected at least one rank a node")
    for key, value in (("--memory", memory_gb), ("--gflops", gflops)):
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"{key}: found {value:g}, expected more than 0")
    with agreed(comm), reading(path, FORMAT, VERSION, SCHEMA) as file:
        dofs, nonzeros = file["matrices/indptr"].shape[0] - 1, file["matrices/indices"].shape[0]
    if analyse or dofs <= MOST_ANALYSED:
        factor = _analysed(path, comm, progress)
        source, on = f"by MUMPS' analysis ({comm.size} rank(s) here)", comm.size
    else:
        factor = {key: CUBE[key] * (dofs / CUBE["rows"]) ** power for key, power in EXPONENTS.items()}
        source, on = "of a cube of as many dofs, the worst of solids (--analyse asks MUMPS)", 2
    # MUMPS estimates for the ranks of the analysis
    more = (ON_TWO if on == 1 < ranks else 1.0) * MORE_BY_RANKS ** max(log2(ranks / max(on, 2)), 0.0)
    in_core = factor["mb"] * 2**20 * more
    on_disk = factor.get("mb_on_disk", ON_DISK * factor["mb"]) * 2**20 * more
    rows = _rows(dofs, nonzeros, factor, in_core, on_disk, ranks, nodes, memory_gb, gflops)
    best = next((row for row in rows if row["fits"] == "yes"), None) if memory_gb is not None else rows[0]
    return {
        "model": str(path), "dofs": dofs, "nonzeros": nonzeros, "operations": factor["flops"],
        "entries": factor["entries"], "source": source, "rows": rows, "best": best and best["way"],
        "script": _script(best, ranks, nodes) if best else "", "warnings": [],
    }  # fmt: skip


def _analysed(path, comm, progress):
    """Return what MUMPS' analysis of K says of a factor. Collective."""
    startup.start(preferred="real")
    with progress.stage("read", str(path)):
        model = read_model(path, comm)
    with model, progress.stage("analysis", f"{model.size} dofs"):
        factors = Mumps(model.K, model.symmetric, "shift_")
        found = factors.expected([nested_dissection()])[nested_dissection()]
        factors.close()
    if is_complex():
        found |= {key: found[key] / 2 for key in ("mb", "mb_on_disk")}
    return found


def _rows(dofs, nonzeros, factor, in_core, on_disk, ranks, nodes, memory_gb, gflops):
    """Return the rows of the table: ways to solve, the quickest first."""
    rest = PROGRAM * ranks + MATRICES * nonzeros + 16 * dofs * COLUMNS
    hours = FACTORS * factor["flops"] / (ranks * gflops * 1e9) / 3600
    multigrid = SECONDS_OF_MULTIGRID * nonzeros / ranks / 0.7 / 3600
    card = CARD * factor["entries"]
    disks = f"and {_two(8 * factor['entries'] / GB):g} GB of local disks"
    ways = (
        ("direct", in_core + rest, hours, ""),
        ("low_rank = 1e-8", in_core + rest, hours, "at most; less from about 10^6 dofs on"),
        ("out_of_core", on_disk + rest, DISK_SLOWER * hours, disks),
        ("kind = multigrid", PROGRAM * ranks + MULTIGRID * nonzeros, multigrid, "a tolerance, real points"),
    )  # fmt: skip
    rows = []
    for way, total, time, remark in ways:
        node = total / nodes * (UNEVEN if ranks > 1 else 1.0)
        fits = "not known" if memory_gb is None else "yes" if node <= memory_gb * GB / SPARE else "no"
        rows.append({
            "way": way, "GB a rank": _two(node * nodes / ranks / GB), "GB a node": _two(node / GB),
            "GB in all": _two(total / GB), "time": in_time(3600 * time), "hours": _two(time), "fits": fits,
            "remark": remark,
        })  # fmt: skip
    hours_of_gpu = FACTORS * factor["flops"] / (GFLOPS_OF_GPU * 1e9) / 3600
    rows.append({
        "way": "package = cudss", "GB a rank": _two((rest / ranks) / GB), "GB a node": _two(rest / nodes / GB),
        "GB in all": _two(rest / GB), "time": in_time(3600 * hours_of_gpu), "hours": _two(hours_of_gpu),
        "fits": "not known", "remark": f"and {_two(card / GB):g} GB of one GPU, half in single precision",
    })  # fmt: skip
    return rows


def _two(value):
    """A number with two digits, which estimates have."""
    return float(f"{value:.2g}")


def _script(best, ranks, nodes):
    """Return the head of a script for SLURM, with memory and time that leave room."""
    each = ceil(ranks / nodes)
    minutes = max(ceil(3 * best["hours"] * 60 / 30) * 30, 30)
    setting = {"direct": "", "low_rank = 1e-8": " --low-rank 1e-8", "out_of_core": " --out-of-core $TMPDIR",
               "kind = multigrid": " --set solver.kind=multigrid"}[best["way"]]  # fmt: skip
    return "\n".join([
        "#!/bin/bash",
        f"#SBATCH --nodes={nodes}",
        f"#SBATCH --ntasks={ranks}",
        f"#SBATCH --ntasks-per-node={each}",
        "#SBATCH --cpus-per-task=1",
        f"#SBATCH --mem={ceil(SPARE * best['GB a node'] + 1)}G",
        f"#SBATCH --time={minutes // 60}:{minutes % 60:02}:00",
        "export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 HDF5_USE_FILE_LOCKING=FALSE",
        f"srun hpcred reduce job.toml --store points{setting}",
    ])  # fmt: skip
