"""Record the origin of a reduced model as one typed value of plain numbers and texts."""

from __future__ import annotations

import platform
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ..linalg.blocks import apply, create_block, from_dense, inner, random_block
from ..linalg.solvers.base import FactorRecord
from ..model.damping import Damping
from ..model.frames import Frame
from ..model.interfaces import Interface, InterfaceNode
from ..model.load_columns import loads_of
from ..model.loads import LoadColumn
from ..model.viscoelastic import NamedLaw, laws_of
from ..parallel import processor
from ..parallel.declared import renamed
from ..parallel.petsc import MPI, PETSc, SLEPc, is_complex
from ..parallel.progress import Timing, counted
from .components.component import AnyKind
from .notes import ComponentRecord
from .tolerance.accuracy import Accuracy

SAME = 1e-8  # relative difference of signatures of the same matrices, written and read on other ranks


@dataclass(frozen=True, kw_only=True)
class Record:
    """What made a reduced model.

    Of the full model: its name, `size` n, `free_size` in the frame, nonzeros, rigid-body modes, inputs and outputs
    by name, interfaces and their nodes, loads with their sums, and `signature` (see signature_of), by which it is known
    again. Of the reduction: frame, damping, basis and settings; what each component brought; every factorisation, and
    how many more a store saved; max |V^T M V - I|; unstable poles (re, im) in rad/s; warnings; where the time went, and
    hints at what would take less; of an automatic one its accuracy. `viscoelastic`: the laws of such parts. `job`: the
    job file with its overrides, file names absolute, and `contents` of the files that it names, by name. `basis_of`:
    the result over ranges of parameters whose basis it is at the values `at` of the job, "" for a basis of its own.
    """

    date: str
    versions: dict[str, str]
    scalar: str
    ranks: int
    petsc_options: dict[str, str]
    model: str
    size: int
    free_size: int
    nonzeros: int
    rigid_body_modes: int
    symmetry_defects: dict[str, float]
    signature: dict[str, tuple[float, ...]]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    frame: Frame
    damping: Damping
    basis: tuple[AnyKind, ...]
    projection: str
    deflation_tolerance: float
    drop_above: float | None
    groups: int
    components: Annotated[tuple[ComponentRecord, ...], renamed("components", "ingredients")]
    factorisations: tuple[FactorRecord, ...]
    symbolic_analyses: int
    orthonormality_defect: float
    unstable_poles: tuple[tuple[float, float], ...]
    warnings: tuple[str, ...]
    timing: Timing
    interfaces: tuple[Interface, ...] = ()
    interface_nodes: tuple[InterfaceNode, ...] = ()
    loads: tuple[LoadColumn, ...] = ()
    coordinates: str = "modal"
    accuracy: Accuracy | None = None
    factorisations_saved: int = 0
    job: dict[str, Any] | None = None
    contents: dict[str, str] | None = None
    hints: tuple[str, ...] = ()
    viscoelastic: tuple[NamedLaw, ...] = ()
    basis_of: str = ""

    def away_from_reference(self) -> Record:
        """Return the record of the model at other values of its parameters, where of the error over the frequencies no
        more is known than the largest one over all values."""
        if self.accuracy is None:
            return self
        low, high = self.accuracy.band
        largest = self.accuracy.largest
        known = replace(self.accuracy, frequencies=(low, high), eps=(largest, largest), mean=largest, directions=(),
                        counted=None, missing_modes=None)  # fmt: skip
        return replace(self, accuracy=known)

    @property
    def ordering(self) -> str:
        """The fill-reducing ordering of the last factor."""
        return self.factorisations[-1].ordering if self.factorisations else "none"

    @property
    def effort(self) -> str:
        """How often was factored or coarsened, in words."""
        if self.basis_of:
            return f"no factorisation, the basis of {self.basis_of}"
        factors = [item for item in self.factorisations if item.direct]
        found = counted(len(factors), "factorisation")
        if self.factorisations_saved:
            found += f", {self.factorisations_saved} saved by the store"
        analyses = counted(self.symbolic_analyses, "analysis", "analyses")
        found += f", {analyses} ({factors[-1].ordering if factors else 'none'})"
        if len(factors) < len(self.factorisations):
            most = max(item.iterations for item in self.factorisations)
            found += (
                f", {len(self.factorisations) - len(factors)} by conjugate gradients with multigrid (at most {most} "
                "iterations)"
            )
        return found

    @property
    def interface_rows(self) -> list[dict]:
        """For a table: name, number, kind, number of nodes and place in m of each interface; empty in older files."""
        pairs = zip(self.interfaces, self.interface_nodes, strict=False)
        return [
            {"interface": found.name, "node": found.node, "kind": asked.kind, "nodes": found.count,
             **{axis: round(value, 12) + 0.0 for axis, value in zip("xyz", found.position, strict=True)}}
            for asked, found in pairs
        ]  # fmt: skip


def versions() -> dict[str, str]:
    """Return versions of everything that can change a number. Collective where PETSc has not been started."""
    found = {
        "python": platform.python_version(),
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "slepc": ".".join(map(str, SLEPc.Sys.getVersion())),
        "mpi": MPI.Get_library_version().strip("\x00\n ").split(",")[0],
        "blas": processor.blas() or "unknown",
        "blas_kernels_chosen_by": processor.chosen_by(),
    }
    return found | {package: version_of(package) for package in ("hpcred", "numpy", "h5py", "mpi4py")}


def version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return str(getattr(__import__(package), "__version__", "unknown"))


def _terms_of(record) -> list[dict]:
    """Return the terms of the job of a record, with the names of their files in any folder."""
    terms = (record.job or {}).get("term", ())
    return [{key: Path(value).name if key == "file" and value else value for key, value in item.items()}
            for item in terms]  # fmt: skip


def signature_of(model) -> dict[str, tuple[float, ...]]:
    """Return z^T A z of M, K and D, w^T A z of D and of an unsymmetric K, since skew-symmetric parts have no other, and
    z^T B, z^T C^T, for fixed random z and w (n,): the same model has the same. Collective."""
    found = {}
    z, w = (random_block(model.K, 1, seed=seed) for seed in (1, 2))
    product = create_block(model.K, 1)
    for key, mat in model.matrices.items():
        apply(mat, z, product)
        skew = key == "D" or not model.is_symmetric(key)
        found[key] = np.append(inner(z, product), inner(w, product) if skew else [])
    for key, mat in (("B", model.B), ("C", model.Ct)):
        if mat is not None:
            found[key] = inner(z, from_dense(mat))
    if model.derivatives is not None:
        found["C"] = np.concatenate([found["C"].ravel(), model.derivatives.parts.ravel()])
    return model.comm.bcast({key: tuple(values.ravel().tolist()) for key, values in found.items()})


def difference_of(signature, record) -> str | None:
    """Return the first of M, K, D, B, C in which a signature differs from that of a record; D counts where it was used.
    """
    for key, expected in record.signature.items():
        if key == "D" and record.damping.kind != "given":
            continue
        values = np.array(signature.get(key, ()))
        values = values[: len(expected)] if key == "D" else values  # earlier versions had z^T D z only
        scale = np.abs(expected).max(initial=0.0)
        if values.shape != np.shape(expected) or np.abs(values - expected).max(initial=0.0) > SAME * scale:
            return key
    return None


def difference_between(one, other) -> str | None:
    """Return in what the full models of two records differ: a key of the signature, or "term"; None where they do not.
    """
    return difference_of(one.signature, other) or (None if _terms_of(one) == _terms_of(other) else "term")


def make_record(model, framed, runs, progress, **known) -> Record:
    """Return the Record of a reduction; `known`: what the caller has at hand. Collective."""
    notes = [run.recorded for run in runs if run.owns_solvers]
    record = Record(
        date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        versions=versions(),
        scalar="complex" if is_complex() else "real",
        ranks=model.comm.size,
        petsc_options={key: str(value) for key, value in PETSc.Options().getAll().items()},
        model=model.name,
        size=model.size,
        free_size=framed.model.size,
        nonzeros=framed.model.nonzeros,
        rigid_body_modes=framed.rigid_size,
        symmetry_defects=model.symmetry_defects,
        signature=signature_of(model),
        inputs=model.input_names,
        outputs=model.output_names,
        interfaces=tuple(item.definition for item in model.interfaces),
        interface_nodes=tuple(replace(item, definition=None) for item in model.interfaces),
        loads=loads_of(model),
        viscoelastic=laws_of(model.viscoelastic),
        components=tuple(notes[0].components),
        factorisations=tuple(record for item in notes for record in item.factorisations),
        factorisations_saved=sum(item.factorisations_saved for item in notes),
        symbolic_analyses=sum(item.analyses for item in notes),
        timing=progress.timing(),
        hints=processor.hints(model.comm),
        **known,
    )
    return model.comm.bcast(record)
