"""What a result file says about the run that made it."""

from __future__ import annotations

import platform
from dataclasses import asdict
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version

from ..model.damping import NoDamping
from ..model.frames import NoFrame
from ..parallel.petsc import MPI, PETSc, SLEPc, is_complex


def versions() -> dict:
    """Versions of everything that can change a number."""
    found = {
        "python": platform.python_version(),
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "slepc": ".".join(map(str, SLEPc.Sys.getVersion())),
        "mpi": MPI.Get_library_version().strip("\x00\n ").split(",")[0],
    }
    for package in ("hpcred", "numpy", "h5py", "mpi4py"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = str(getattr(__import__(package), "__version__", "unknown"))
    return found


def describe(item) -> dict:
    """A frozen dataclass of the public API as a dictionary, with its kind."""
    return {"kind": item.kind, **{key: value for key, value in asdict(item).items() if value is not None}}


def provenance(model, framed, basis, frame, damping, contexts, progress, defect) -> dict:
    """Everything but the matrices; plain types only. Collective."""
    run = progress.summary()
    context = contexts[0]
    records = [record for item in contexts for record in item.records]
    record = {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "versions": versions(),
        "scalar": "complex" if is_complex() else "real",
        "ranks": model.comm.size,
        "petsc_options": PETSc.Options().getAll(),
        "model": model.name,
        "size": model.size,
        "free_size": framed.model.size,
        "nonzeros": framed.model.nonzeros,
        "rigid_body_modes": framed.rigid.count if framed.rigid is not None else 0,
        "inputs": model.input_names,
        "outputs": model.output_names,
        "frame": describe(frame or NoFrame()),
        "damping": describe(damping or NoDamping()),
        "basis": [describe(item) for item in basis],
        "deflation_tolerance": context.tolerance,
        "ingredients": context.report,
        "orthonormality_defect": defect,
        "symmetry_defects": model.symmetry_defects,
        "ordering": records[-1]["ordering"] if records else "none",
        "factorisations": records,
        "symbolic_analyses": sum(item.analyses for item in contexts),
        "run": run,
    }
    return model.comm.bcast(record)
