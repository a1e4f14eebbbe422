"""Plan a reduction on a cluster: memory and time of each way to solve, before anything large is taken.

The factor is known from an analysis by MUMPS; where that takes too long itself, from the power law of cubes, which are
the worst of solids. The constants below were measured; the pages of the documentation that they name have the numbers.
"""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass
from math import ceil, log2, sqrt

from ..analysis.summary import inspect
from ..files.hdf5 import reading
from ..files.model_file import FORMAT, SCHEMA, VERSION
from ..linalg.solvers.mumps import Mumps, nested_dissection
from ..linalg.solvers.settings import LinearSolver
from ..parallel import startup
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import PETSc, is_complex
from ..parallel.progress import Progress, counted, in_time
from ..parallel.ranges import COUNT, Range, within
from ..settings.job_file import Job, read_job
from ..settings.source import Source
from .model_of_job import model_of_files
from .workflow import workflow

GB, MB = 1e9, 1e6  # those of MUMPS
MOST_ANALYSED = 1_000_000  # rows up to which an analysis takes seconds, and fits this machine if the matrices do

# docs/large.md, "At 10^7 dofs": an analysis on two ranks, and exponents of the rows
CUBE = {"rows": 1_014_300, "flops": 2.5e13, "entries": 2.5e9, "mb": 40_936}
EXPONENTS = {"flops": 1.98, "entries": 1.38, "mb": 1.33}
# of MUMPS' memory: two ranks over one (506 and 652 MB for a cube of 45,000 dofs), and each doubling of them (55 GB on
# 16 for the cube above)
ON_TWO, MORE_BY_RANKS = 1.3, 1.1
# docs/large.md, "Options for large models": 3.0 of 5.8 GB of MUMPS, and 85 instead of 60 s
ON_DISK, DISK_SLOWER = 0.5, 1.4
PROGRAM = 0.15 * GB  # a rank: 0.09 GB after the start, buffers of messages and files
MATRICES = 160  # bytes a nonzero, docs/large.md, "Time and memory": M and K with two copies
# docs/evidence.md, "Large models": bytes a nonzero in all, and processor seconds a nonzero, to a tolerance over 38
# modes, of the larger cube; the smaller one has the same bytes, and on a slower machine took 1.9 times as long
MULTIGRID, SECONDS_OF_MULTIGRID = 75, 1440 / 243_000_000
# seconds a dof beside factors, on one rank and divided by the root of the ranks (docs/evidence.md, "More ranks"); at
# 10^5 dofs a reduction to a tolerance takes more
BESIDE = 80e-6
CARD = 1.06 * 8  # bytes an entry of a factor on a GPU: docs/large.md, "At 10^7 dofs"
# GFlop/s: of a rank, 12 to 18 on an Intel Xeon, and 15 to 20 on an AMD EPYC (docs/large.md); of an H200, 14 to 20
# thousand at 10^6 dofs and more (docs/evidence.md, "On a GPU")
GFLOPS, GFLOPS_OF_GPU = 10.0, 1e4

# of a reduction to a tolerance: one or two factors are usual, and fewer columns V and M V
FACTORS, COLUMNS = 2, 100
SPARE = 1.2  # memory that is asked for, over that which is expected

# as in jobs/reduce.slurm
LAUNCHER = (
    'launcher="mpiexec -n $SLURM_NTASKS"',
    'if srun --mpi=list 2>&1 | grep -qw pmix; then launcher="srun --mpi=pmix"; fi',
)


@dataclass(frozen=True, kw_only=True)
class Way:
    """One way to solve: its `name`, by the key of a job; the `option` of reduce that takes it; whether a `job` chose
    it; bytes of all ranks, seconds, and what there is to say."""

    name: str
    option: str
    job: bool = False
    memory: float
    seconds: float
    remark: str = ""
    on_gpu: bool = False

    def on_node(self, ranks, nodes) -> float:
        """Return the bytes of a node with the most of the ranks, which share them."""
        return self.memory * ceil(ranks / nodes) / ranks


@workflow
def plan_file(
    path, *, ranks: int | None = None, nodes: int = 1, memory_gb: float | None = None, gflops: float = GFLOPS,
    analyse: bool = False, comm=None, progress: Progress | None = None,
) -> dict:  # fmt: skip
    """Return memory and time that a reduction takes on `ranks` of `nodes`.

    Collective. Raises InputError.

    Parameters
    ----------
    path : str or PathLike
        A job file, which says how many points are factored, and how; or a model.h5, which is reduced to a tolerance.
        Of a model.h5 with more than 10^6 dofs only its size is read, unless `analyse`.
    ranks : int, optional
        Of the job that is planned; by default those of this run.
    nodes : int, default 1
        Nodes that these ranks are on.
    memory_gb : float, optional
        GB of a node; by default nothing is said to fit or not.
    gflops : float, default 10
        GFlop/s of a rank, which `hpcred bench` measures.
    analyse : bool, default False
        Analyse also a larger model.

    Returns
    -------
    dict
        `dofs`, `nonzeros`, `operations` and `entries` of a factor, `source` of these, `factors`, how many of them are
        made, `points`, where, in words, `rows` of a table with GB and hours of each way, `best`, the way of the job, or
        else the first that fits, `script`, a script for SLURM, and `warnings` of a model that was read.
    """
    ranks = comm.size if ranks is None else ranks
    within("--ranks", ranks, COUNT)
    within("--nodes", nodes, COUNT)
    if nodes > ranks:
        raise InputError(f"--nodes: found {nodes} for {counted(ranks, 'rank')}, expected at least one rank a node")
    within("--memory", memory_gb, Range(1e-3, 1e9, "GB"))
    within("--gflops", gflops, Range(1e-3, 1e9))
    with agreed(comm):
        job = read_job(path) if str(path).endswith(".toml") else None
    model = path if job is None else job.model
    size = _size(model, analyse, comm, progress)
    factors, points = _points(job)
    ways = _ways(size, ranks, gflops, factors, job)
    room = float("inf") if memory_gb is None else memory_gb * GB / SPARE
    chosen = [way for way in ways if way.job] or [way for way in ways if not way.on_gpu]
    best = next((way for way in chosen if way.on_node(ranks, nodes) <= room), None)
    return {
        "model": model.K if isinstance(model, Source) else os.path.normpath(model), "ranks": ranks, "nodes": nodes,
        "dofs": size.dofs, "nonzeros": size.nonzeros, "operations": size.flops, "entries": size.entries,
        "source": size.source, "factors": factors, "points": points,
        "rows": [_row(way, ranks, nodes, None if memory_gb is None else room) for way in ways],
        "best": best and best.name, "script": _script(best, str(path), job, ranks, nodes) if best else "",
        "warnings": list(size.warnings),
    }  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Size:
    """Of a model: its dofs and the nonzeros of K; operations and entries of a factor, MB in core and on a disk, as
    estimated for `ranks`, the `source` of these, and what looks wrong with the model."""

    dofs: int
    nonzeros: int
    flops: float
    entries: float
    mb: float
    mb_on_disk: float
    ranks: int
    source: str
    warnings: tuple[str, ...] = ()


def _size(model, analyse, comm, progress) -> Size:
    """Return the Size of a model file, or of the matrix files of a job. Collective."""
    if not isinstance(model, Source):
        with agreed(comm), reading(model, FORMAT, VERSION, SCHEMA) as file:
            dofs, nonzeros = file["matrices/indptr"].shape[0] - 1, file["matrices/indices"].shape[0]
        if dofs > MOST_ANALYSED and not analyse:
            return _as_cube(dofs, nonzeros)
    startup.start(preferred="real")
    with progress.stage("read", str(model)):
        loaded = model_of_files(model, comm)
    with loaded, progress.stage("analysis", f"{loaded.size} dofs"):
        factor = Mumps(loaded.K, loaded.symmetric, "shift_")
        estimate = factor.expected([nested_dissection()])[nested_dissection()]
        factor.close()
        nonzeros = int(loaded.K.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"])
        dofs, warnings = loaded.size, tuple(inspect(loaded, progress=progress)["warnings"])
    if is_complex():
        estimate |= {key: estimate[key] / 2 for key in ("mb", "mb_on_disk")}
    source = f"by MUMPS' analysis on {counted(comm.size, 'rank')} here"
    return Size(
        dofs=dofs, nonzeros=nonzeros, ranks=comm.size, source=source, warnings=warnings,
        **{key: estimate[key] for key in ("flops", "entries", "mb", "mb_on_disk")},
    )  # fmt: skip


def _as_cube(dofs, nonzeros) -> Size:
    """Return the Size of a cube of so many dofs."""
    sizes = {key: CUBE[key] * (dofs / CUBE["rows"]) ** power for key, power in EXPONENTS.items()}
    return Size(
        dofs=dofs, nonzeros=nonzeros, **sizes, mb_on_disk=ON_DISK * sizes["mb"], ranks=2,
        source="of a cube of as many dofs, the worst of solids (--analyse asks MUMPS)",
    )  # fmt: skip


def _points(job) -> tuple[int, str]:
    """Return how many factors are made, and at which points, in words."""
    if job is None or job.tolerance is not None:
        return FACTORS, "of a reduction to a tolerance, which takes one or two"
    names = list(dict.fromkeys(getattr(component, "name", "0 Hz") for component in job.basis))  # others factor K
    return len(names), f"at {', '.join(names)}"


def _ways(size: Size, ranks, gflops, factors, job: Job | None) -> list[Way]:
    """Return the ways to solve, the quickest first, and the GPU; that of the job is marked."""
    # groups of ranks factor points at the same time; complex factors take twice the memory and four times the work
    groups = min(job.groups, factors, ranks) if job is not None and isinstance(job.groups, int) else 1
    reals = 2 if job is not None and job.preferred_scalar == "complex" else 1
    each = ranks / groups

    # MUMPS estimates for the ranks of the analysis
    growth = (ON_TWO if size.ranks == 1 < each else 1.0) * MORE_BY_RANKS ** max(log2(each / max(size.ranks, 2)), 0.0)
    in_core, on_disk = (reals * groups * growth * mb * MB for mb in (size.mb, size.mb_on_disk))
    rest = PROGRAM * ranks + reals * (MATRICES * groups * size.nonzeros + 16 * size.dofs * COLUMNS)

    operations = reals**2 * ceil(factors / groups) * size.flops
    beside = BESIDE * size.dofs / sqrt(ranks)
    seconds = operations / (each * gflops * 1e9) + beside
    file, card = 8 * reals * size.entries / GB, CARD * reals * size.entries / GB
    solver = LinearSolver() if job is None else job.solver
    low_rank, out_of_core = (None, None) if job is None else (job.low_rank, job.out_of_core)
    accuracy = f"{low_rank or 1e-8:g}".replace("e-0", "e-")
    ways = [
        Way(name="direct", option="", memory=in_core + rest, seconds=seconds),
        Way(name=f"low_rank = {accuracy}", option=f"--low-rank {accuracy}", job=low_rank is not None,
            memory=in_core + rest, seconds=seconds, remark="at most; less from about 10^6 dofs on"),
        Way(name="out_of_core", option="--out-of-core $TMPDIR", job=out_of_core is not None,
            memory=on_disk + rest, seconds=DISK_SLOWER * seconds, remark=f"and {_two(file):g} GB of local disks"),
        Way(name="kind = multigrid", option="--set solver.kind=multigrid", job=solver.kind == "multigrid",
            memory=PROGRAM * ranks + MULTIGRID * size.nonzeros, seconds=SECONDS_OF_MULTIGRID * size.nonzeros / ranks,
            remark="the time is that of two ranks, divided by the ranks"),
        Way(name="package = cudss", option="--set solver.package=cudss", job=solver.package == "cudss", on_gpu=True,
            memory=rest, seconds=operations / (GFLOPS_OF_GPU * 1e9) + beside,
            remark=f"and {_two(card):g} GB of one GPU, half in single precision"),
    ]  # fmt: skip
    # multigrid solves at real points
    imaginary = job is not None and job.tolerance is None and any(getattr(part, "point", 0j).imag for part in job.basis)
    return [way for way in ways if way.name != "kind = multigrid" or not imaginary]


def _row(way: Way, ranks, nodes, room) -> dict:
    """Return a row of the table; `room`: bytes of a node, None where they are not known."""
    node = way.on_node(ranks, nodes)
    fits = "not known" if room is None or way.on_gpu else "yes" if node <= room else "no"
    return {
        "way": way.name, "GB a rank": _two(way.memory / ranks / GB), "GB a node": _two(node / GB),
        "GB in all": _two(way.memory / GB), "time": in_time(way.seconds), "hours": _two(way.seconds / 3600),
        "fits": fits, "remark": way.remark,
    }  # fmt: skip


def _two(value):
    """A number with two digits, which estimates have."""
    return float(f"{value:.2g}")


def _script(way: Way, path, job, ranks, nodes):
    """Return a script for SLURM, with memory and time that leave room, which starts its ranks as jobs/reduce.slurm."""
    minutes = max(ceil(3 * way.seconds / 60 / 30) * 30, 30)
    name = "job.toml" if job is None else shlex.quote(path)
    store = "" if job is not None and job.store else " --store points"
    option = f" {way.option}" if way.option and not way.job else ""
    return "\n".join([
        "#!/bin/bash",
        f"#SBATCH --nodes={nodes}",
        f"#SBATCH --ntasks={ranks}",
        f"#SBATCH --ntasks-per-node={ceil(ranks / nodes)}",
        "#SBATCH --cpus-per-task=1",
        *["#SBATCH --gpus-per-node=1"] * way.on_gpu,
        f"#SBATCH --mem={ceil(SPARE * way.on_node(ranks, nodes) / GB + 1)}G",
        f"#SBATCH --time={minutes // 60}:{minutes % 60:02}:00",
        "export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1",
        "export HDF5_USE_FILE_LOCKING=FALSE PYTHONUNBUFFERED=1",
        "# Where SLURM has no PMIx, srun would start as many programs of one rank.",
        *LAUNCHER,
        f"$launcher hpcred reduce {name}{store}{option}",
    ])  # fmt: skip
