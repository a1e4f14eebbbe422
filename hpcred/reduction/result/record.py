"""Record the origin of a reduced model as one typed value of plain numbers and texts."""

from __future__ import annotations

import platform
from abc import ABC
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any

from pydantic import PlainSerializer, PlainValidator

from ...linalg.solvers.base import FactorRecord
from ...model.damping import Damping
from ...model.digests import PARTS
from ...model.frames import Frame, NoFrame
from ...model.interfaces.nodes import Interface, InterfaceNode
from ...model.laws.registry import NamedLaw, laws_of
from ...model.loads.columns import loads_of
from ...model.loads.kinds import LoadColumn
from ...parallel import processor
from ...parallel.declared import renamed
from ...parallel.failures import InputError
from ...parallel.petsc import MPI, PETSc, SLEPc, is_complex
from ...parallel.progress import Timing, counted
from .accuracy import Accuracy
from .kinds import UnknownKind, from_table, table_of

MACHINE = "a machine of "  # before the names of its bodies, in place of the name of a model
TERMS = "terms"  # key of the digest of the terms of parameters
DIGITS_OF_DIGEST = 32  # hexadecimal


class BasisPart(ABC):
    """Base class of what a basis is made of, as records hold it: components derive from it."""

    kind: str


@dataclass(frozen=True)
class UnknownPart(UnknownKind, BasisPart):
    """A part of a basis whose class is not known here, as of a result that another program made."""


AnyPart = Annotated[BasisPart, PlainValidator(partial(from_table, BasisPart, UnknownPart)), PlainSerializer(table_of)]


@dataclass(frozen=True, kw_only=True)
class ComponentRecord:
    """What a part of the basis brought: columns offered and kept, and how clear the decision was.

    `smallest_kept` and `largest_dropped`: weights (see linalg.basis.Extension) of the directions on both sides of the
    deflation tolerance, None where there are none. For modes their frequencies in Hz, the largest residual, and what
    dominant ones contribute. `from_store`: it was not computed in this run.
    """

    where: str
    columns: int
    kept: int
    smallest_kept: float | None = None
    largest_dropped: float | None = None
    frequencies_hz: tuple[float, ...] | None = None
    residual: float | None = None
    dominance: tuple[float, ...] | None = None
    from_store: bool = False


@dataclass(frozen=True, kw_only=True)
class JointRecord:
    """A joint of a machine: its `key`, such as joint[0], its kind, its ends, and how far `apart` they are in m; None
    where one is the ground, or has no place."""

    key: str
    kind: str
    ends: tuple[str, str]
    apart: float | None = None

    @property
    def row(self) -> dict:
        """For a table."""
        return {"joint": self.key, "kind": self.kind, "from": self.ends[0], "to": self.ends[1],
                "apart (m)": self.apart}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Record:
    """What made a reduced model.

    Attributes
    ----------
    date, versions, scalar, ranks, petsc_options
        When and by what it was made: versions by name, "real" or "complex", the number of ranks, options by name.
    model : str
        The name of the full model.
    size, free_size, nonzeros, rigid_body_modes : int
        Dofs of the full model, those that its frame leaves, entries of K, and rigid-body modes.
    symmetry_defects : dict
        Of M, D and K.
    inputs, outputs : tuple of str
        Their names.
    interfaces, interface_nodes, loads : tuples
        The interfaces and their nodes, and loads with their sums.
    joints : tuple of JointRecord
        Of a machine.
    frame, damping, basis, projection, coordinates, deflation_tolerance, drop_above, groups
        Settings of the reduction.
    components : tuple of ComponentRecord
        What each component of the basis brought.
    factorisations : tuple of FactorRecord
        Every factorisation.
    factorisations_saved, symbolic_analyses : int
        How many factorisations a store saved, and how often the matrix was analysed.
    orthonormality_defect : float
        max |V^T M V - I|.
    unstable_poles : tuple
        (re, im) in rad/s.
    warnings, hints : tuple of str
        Sentences; hints name what would take less time.
    timing : Timing
        Where the time went.
    accuracy : Accuracy or None
        Of an automatic reduction.
    viscoelastic : tuple of NamedLaw
        The laws of viscoelastic parts.
    job, contents : dict or None
        The job file with its overrides, file names absolute, and the contents of the files that it names.
    basis_of : str
        The result over ranges of parameters whose basis it is at the values `at` of the job, "" for a basis of its own.
    digests : dict
        By which the full model is known again; none in results of earlier versions.
    units : str
        From which the numbers of the model were converted to SI, "" where nothing is known of that.
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
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    frame: Frame
    damping: Damping
    basis: tuple[AnyPart, ...]
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
    joints: tuple[JointRecord, ...] = ()
    coordinates: str = "modal"
    accuracy: Accuracy | None = None
    factorisations_saved: int = 0
    job: dict[str, Any] | None = None
    contents: dict[str, str] | None = None
    hints: tuple[str, ...] = ()
    viscoelastic: tuple[NamedLaw, ...] = ()
    basis_of: str = ""
    digests: dict[str, str] = field(default_factory=dict)
    units: str = ""

    @classmethod
    def without_reduction(cls, reduced, **known) -> Record:
        """Return the record of a `reduced` model that no reduction made, but that was put together of others, or read;
        `known`: further fields."""
        neutral = {
            "date": datetime.now(timezone.utc).isoformat(timespec="seconds"), "versions": versions(), "scalar": "real",
            "ranks": 1, "petsc_options": {}, "free_size": reduced.size, "symmetry_defects": {}, "inputs":
            reduced.input_names, "outputs": reduced.output_names, "basis": (), "projection": "one_sided",
            "deflation_tolerance": 0.0, "drop_above": None, "groups": 1, "components": (), "factorisations": (),
            "symbolic_analyses": 0, "orthonormality_defect": 0.0, "unstable_poles": (), "warnings": (),
        }  # fmt: skip
        return cls(**neutral | known)

    def away_from_reference(self) -> Record:
        """Return the record of the model at other values of its parameters, where of the error over the frequencies no
        more is known than the largest one over all values."""
        if self.accuracy is None:
            return self
        low, high = self.accuracy.band
        largest = self.accuracy.largest
        known = replace(self.accuracy, frequencies=(low, high), eps=(largest, largest), mean=largest, directions=(),
                        counted=None, missing_modes=None, last_digits=())  # fmt: skip
        return replace(self, accuracy=known)

    @property
    def knows_its_model(self) -> bool:
        """Whether it has digests of the model in the form of today: earlier versions had others, or none."""
        return bool(self.digests) and all(len(digest) == DIGITS_OF_DIGEST for digest in self.digests.values())

    def require_model(self, path) -> None:
        """Raise InputError where no full model can be compared with the result at `path`."""
        if self.model.startswith(MACHINE) and not self.digests:
            raise InputError(f"{path}: is {self.model}, which has no full model; --estimate shows its error, and each "
                             "of its bodies can be compared with its own model")  # fmt: skip
        if not self.digests and not self.basis and self.accuracy is None:
            raise InputError(f"{path}: is a superelement that was read from {self.model}, which has no full model; "
                             "take it in a machine, or without --full")  # fmt: skip
        if not self.knows_its_model:
            raise InputError(f"{path}: an earlier version wrote it, which did not keep what tells its model from "
                             "others today; reduce again")  # fmt: skip

    @property
    def ordering(self) -> str:
        """The fill-reducing ordering of the last factor."""
        return self.factorisations[-1].ordering if self.factorisations else "none"

    @property
    def effort(self) -> str:
        """How often was factored or coarsened, in words."""
        if self.basis_of:
            return f"no factorisation, the basis of {self.basis_of}"
        factors = [factor for factor in self.factorisations if factor.direct]
        words = counted(len(factors), "factorisation")
        if self.factorisations_saved:
            words += f", {self.factorisations_saved} saved by the store"
        analyses = counted(self.symbolic_analyses, "analysis", "analyses")
        words += f", {analyses} ({factors[-1].ordering if factors else 'none'})"
        if len(factors) < len(self.factorisations):
            most = max(factor.iterations for factor in self.factorisations)
            words += (
                f", {len(self.factorisations) - len(factors)} by conjugate gradients with multigrid (at most {most} "
                "iterations)"
            )
        return words

    @property
    def interface_rows(self) -> list[dict]:
        """For a table: name, number, kind, number of nodes and place in m of each interface; of a machine without kind
        and number of nodes."""
        kinds = [{"kind": known.kind, "nodes": node.count}
                 for known, node in zip(self.interfaces, self.interface_nodes, strict=False)]  # fmt: skip
        return [
            {"interface": node.name, "node": node.node, **kind,
             **{axis: round(value, 12) + 0.0 for axis, value in zip("xyz", node.position, strict=True)}}
            for node, kind in zip(self.interface_nodes, kinds or [{}] * len(self.interface_nodes), strict=False)
        ]  # fmt: skip


def versions() -> dict[str, str]:
    """Return versions of everything that can change a number. Collective where PETSc has not been started."""
    known = {
        "python": platform.python_version(),
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "slepc": ".".join(map(str, SLEPc.Sys.getVersion())),
        "mpi": MPI.Get_library_version().strip("\x00\n ").split(",")[0],
        "blas": processor.blas() or "unknown",
    }
    return known | {package: version_of(package) for package in ("hpcred", "numpy", "h5py", "mpi4py")}


@cache  # each result names four, whose metadata take milliseconds to read
def version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return str(getattr(__import__(package), "__version__", "unknown"))


def difference_of(digests: dict[str, str], record) -> str | None:
    """Return the first part in which the digests of a model differ from those of a record, None where none does.

    D counts where it was used, nodes where a frame or interfaces were made from them, and terms of parameters where
    both have some.
    """
    unused = {"D"} if record.damping.kind != "given" else set()
    unused |= {"dofs"} if isinstance(record.frame, NoFrame) and not record.interfaces else set()
    unused |= set() if TERMS in digests and TERMS in record.digests else {TERMS}
    keys = (key for key in (*PARTS, TERMS) if key not in unused)
    return next((key for key in keys if digests.get(key) != record.digests.get(key)), None)


def difference_between(record, other) -> str | None:
    """Return the part in which the full models of two records differ, None where they do not."""
    return difference_of(record.digests, other)


def make_record(model, framed, runs, progress, **known) -> Record:
    """Return the Record of a reduction; `known`: what the caller has at hand. Collective."""
    # the notes of all runs are one; numbers of this rank become those of the first rank for all
    notes = [run.recorded for run in runs if run.owns_solvers]
    record = Record(
        date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        versions=versions(),
        scalar="complex" if is_complex() else "real",
        ranks=model.comm.size,
        petsc_options={key: str(value) for key, value in PETSc.Options().getAll().items()},
        model=model.name,
        units=model.converted_from,
        size=model.size,
        free_size=framed.model.size,
        nonzeros=framed.model.nonzeros,
        rigid_body_modes=framed.rigid_size,
        symmetry_defects=model.symmetry_defects,
        digests=model.digests,
        inputs=model.input_names,
        outputs=model.output_names,
        interfaces=tuple(interface.definition for interface in model.interfaces),
        interface_nodes=tuple(replace(interface, definition=None) for interface in model.interfaces),
        loads=loads_of(model),
        viscoelastic=laws_of(model.added),
        components=tuple(notes[0].components),
        factorisations=tuple(record for run in notes for record in run.factorisations),
        factorisations_saved=sum(run.factorisations_saved for run in notes),
        symbolic_analyses=sum(run.analyses for run in notes),
        timing=progress.timing(),
        hints=processor.hints(model.comm),
        **known,
    )
    return model.comm.bcast(record)
