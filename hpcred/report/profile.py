"""Print the times of PETSc events in each stage of a run, of the slowest rank (`--profile`)."""

from ..parallel.petsc import PETSc
from .tables import show_table

EVENTS = {
    "MatCholFctrSym": "analysis of MUMPS (LDL^T)", "MatLUFactorSym": "analysis of MUMPS (LU)",
    "MatCholFctrNum": "factorisation (LDL^T)", "MatLUFactorNum": "factorisation (LU)",
    "MatMatSolve": "solves, several columns", "MatSolve": "solves, one column",
    "MatMatMultSym": "sparse times block, set-up", "MatMatMultNum": "sparse times block",
    "MatMult": "sparse times vector",
    "BVDot": "inner products", "BVMult": "sums of columns", "BVMultInPlace": "bases times factors", "BVCopy": "copies",
    "MatAXPY": "sums of matrices", "MatCopy": "copies of matrices", "MatAssemblyEnd": "assembly",
    "EPSSolve": "eigensolver",
}  # fmt: skip


def start_profile():
    """Have PETSc log its events from now on."""
    PETSc.Log.begin()


def show_profile(comm, progress):
    """Print one row per event and stage, in the order of time. Collective."""
    progress.timing()
    rows, total = [], sum(progress.seconds.values())
    # groups of ranks may have come through different stages
    for stage in sorted(set().union(*comm.allgather(set(progress.seconds)))):
        number = PETSc.Log.Stage(stage).id
        for event, words in EVENTS.items():
            info = PETSc.Log.Event(event).getPerfInfo(number)
            seconds = max(comm.allgather(info["time"]))
            if info["count"] and seconds > 1e-3 * total:
                rows.append({"stage": stage, "": words, "event": event, "calls": int(info["count"]), "seconds": seconds,
                             "% of all": 100 * seconds / total})  # fmt: skip
    show_table("PETSc events by stage", sorted(rows, key=lambda row: -row["seconds"]))
    stages = sorted(progress.seconds.items(), key=lambda pair: -pair[1])
    show_table("Stages", [{"stage": n, "seconds": s, "% of all": 100 * s / total} for n, s in stages if s > 0])
