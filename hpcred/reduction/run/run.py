"""Share one context among the components of a reduction: the model in its frame, solvers, loads, store and notes."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, is_dataclass, replace
from functools import cached_property

import numpy as np

from ...linalg.basis import Basis, Extension
from ...linalg.blocks import from_dense, independent, inner, multiply, times
from ...linalg.csr import without_zeros
from ...linalg.free_motions import check_free_motions
from ...linalg.solvers.base import DoesNotFit, FactorRecord
from ...linalg.solvers.settings import Factoring
from ...model.damping import GivenDamping
from ...model.frames import FramedModel
from ...model.operator import ADDED
from ...model.outputs.rates import KEY as RATES
from ...parallel.decisions import decided
from ...parallel.memory import MB
from ...parallel.petsc import PETSc
from ...parallel.progress import Progress
from ..result.record import ComponentRecord
from .independent_loads import independent_loads
from .notes import Notes
from .projection import CANCELS
from .run_solvers import RunSolvers
from .store import Store

NEAR_ZERO = 0.01  # of a frequency of interest, below which a pseudo-mode may be a motion without force
FOR_MASS_IMAGES = 0.1  # of the memory of a rank may go to M V beside the columns V
DEPENDENT_LOAD = 1e-14  # square of a combination of unit loads below which they count as dependent


@dataclass
class Run:
    """One reduction under way, as a component sees it. Call close(), which frees factors; methods are collective.

    `framed`: the model in its frame; `solvers` for A(s); `notes`: what is recorded; `columns`: how many the basis is
    expected to have; `inertia`: whether negative pivots are counted on any number of ranks; `store`: a Store, or
    None; `identity`: what of the model and of the job decides about columns (see
    identity_of_model); `is_dual`: whether it is of the output Krylov subspaces of a two-sided projection; `tau` (s):
    bases are orthonormal in M + tau^2 K, which sees motions without mass, in place of M where it is 0.
    """

    framed: FramedModel
    progress: Progress
    tolerance: float
    factoring: Factoring = Factoring()
    columns: int = 16
    inertia: bool = False
    store: Store | None = None
    identity: dict = field(default_factory=dict)
    notes: Notes = field(default_factory=Notes)
    solvers: RunSolvers | None = None  # those of another run, shared with it
    is_dual: bool = False
    tau: float = 0.0
    cancels: float = CANCELS  # see project_stiffness

    def __post_init__(self):
        self.model, self.rigid = self.framed.model, self.framed.rigid
        self._checked = False
        self.owns_solvers = self.solvers is None
        if self.owns_solvers:
            self.solvers = RunSolvers(
                self.framed, self.progress, self.factoring, self.inertia, self._reserved_mb, self.remark
            )

    @cached_property
    def keeps_mass_images(self) -> bool:
        """Whether M V is kept beside V, of basis and point: where it takes little of the memory, and multigrid
        does not take most of the time."""
        multigrid = self.factoring.solver.kind == "multigrid"
        return not multigrid and 2 * self._columns_mb() <= FOR_MASS_IMAGES * self.factoring.limit_mb(self.model.comm)

    def _columns_mb(self):
        rows = np.diff(self.model.M.getOwnershipRanges()).max()
        return self.columns * rows * np.dtype(PETSc.ScalarType).itemsize / MB

    def _reserved_mb(self):
        """Return the memory for the columns of the basis and those of a point."""
        return (4 if self.keeps_mass_images else 2) * self._columns_mb()

    def check_free_motions(self, lowest: float, among: float):
        """Refuse a free body in parts or with hinges, whose other free motions are pseudo-modes near 0 Hz.

        It takes a factor of K, and is done where the `lowest` pseudo-frequency is far below those it is `among` (Hz),
        unless factors of this run have shown that there are no such motions, or the store had all that was needed.
        Multigrid does not come to an end where there are. Frees the factor.
        """
        made = self.factorisations
        known = self._checked or lowest > NEAR_ZERO * among or any(component.inertia_relief for component in made)
        if not known and not self.solvers.multigrid and (self.store is None or made):
            self.solvers.release()
            try:
                check_free_motions(self.model, self.rigid, self.factoring)
            except DoesNotFit as error:
                self.remark(f"whether the body has parts or hinges was not looked at: {str(error).partition(';')[0]}")
            self._checked = True

    @property
    def factorisations(self) -> list[FactorRecord]:
        """The factorisations of the run, but for those by solvers that it shares; local."""
        return self.notes.factorisations + (self.solvers.records if self.owns_solvers else [])

    @property
    def recorded(self) -> Notes:
        """The notes, with what the solvers have done; local."""
        analyses = self.notes.analyses + (self.solvers.analyses if self.owns_solvers else 0)
        return replace(self.notes, factorisations=self.factorisations, analyses=analyses)

    @cached_property
    def loads(self):
        """The independent columns of B, self-equilibrated for a free body, as a block."""
        loads = from_dense(self.model.B)
        if self.rigid is not None:
            self.rigid.equilibrate(loads)
        factor, _ = decided(self.model.comm, independent, inner(loads, loads), DEPENDENT_LOAD)
        count, kept = factor.shape
        if kept < count:
            multiply(loads, factor)
            loads.setActiveColumns(0, kept)
            self.note("inputs", count, kept)
        return loads

    @cached_property
    def independent_loads(self) -> tuple:
        """The independent loads of inputs and outputs together, and both in terms of them. Raises InputError."""
        return independent_loads(self)

    @cached_property
    def mass(self) -> PETSc.Mat:
        """M for products with blocks, without its stored zeros where they are many."""
        return without_zeros(self.model.M)

    @cached_property
    def inner(self) -> PETSc.Mat | None:
        """The matrix M + tau^2 K of the inner product of bases, with the symmetric part of K; None for M."""
        if not self.tau:
            return None
        model = self.model
        matrix = model.K.copy()
        if not model.is_symmetric("K"):
            matrix.axpy(1.0, model.K.transpose(PETSc.Mat()), PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            matrix.scale(0.5)
        matrix.scale(self.tau**2)
        matrix.axpy(1.0, model.M, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        matrix.stateIncrease()
        return matrix

    def new_basis(self, room: int, *, deflate=True, kind=Basis) -> Basis:
        """Return an empty basis of the run's inner product, with `room` for so many columns; by default without the
        rigid-body modes of the frame, and with the run's deflation tolerance."""
        return kind(
            self.mass, self.framed.rigid_columns if deflate else None, self.tolerance, room, self.keeps_mass_images,
            self.inner,
        )  # fmt: skip

    def times_mass(self, block):
        """Return M block as a new block."""
        return times(self.mass, block)

    def note(self, where: str, columns: int, new: Extension | int, minor=False, **more):
        """Record how many of the columns offered were new; shown by the command line, kept in the result; local.

        `minor`: see Progress.say."""
        weights = {}
        if isinstance(new, Extension):
            if new.kept:
                weights["smallest_kept"] = new.smallest_kept
            if new.largest_dropped:
                weights["largest_dropped"] = new.largest_dropped
            self.notes.massless |= new.massless > 0
            new = new.kept
        self.notes.components.append(ComponentRecord(where=where, columns=columns, kept=new, **weights, **more))
        dropped = f", {columns - new} dependent dropped" if columns > new else ""
        self.progress.say(f"{where}: {new} new vectors{dropped}", minor=minor)

    def remark(self, sentence):
        """Keep a warning in the result; local."""
        self.notes.remarks.append(sentence)
        self.progress.say(sentence)

    def identity_of(self, *keys) -> dict:
        """Return the part of the identity that a key of the store takes, with what stands for all columns."""
        known = {key: self.identity.get(key) for key in ("frame", "nodes", "symmetric", *keys)}
        return known | ({"tau": self.tau} if self.tau else {})

    def stored(self, key, most=None):
        """Return the Entry that a store has under a key, None without one."""
        if self.store is None:
            return None
        with self.progress.stage("store"):
            return self.store.load(self.model, key, self.remark, most)

    def keep(self, key, entry):
        """Have the store keep an Entry."""
        if self.store is not None:
            with self.progress.stage("store"):
                self.store.save(self.model, key, entry, self.remark)

    def on_group(self, framed) -> Run:
        """Return a run for a copy of the framed model on a group of ranks."""
        return Run(framed, self.progress, self.tolerance, self.factoring, self.columns, self.inertia,
                   store=self.store, identity=self.identity, tau=self.tau)  # fmt: skip

    def take_over(self, of_group: Run, leads: bool, components=False):
        """Take over the notes of the runs on all groups of ranks, of the `components` of a basis only those of the
        first; `leads`: whether this rank is the first of its group."""
        for number, notes in enumerate(self.model.comm.allgather(of_group.recorded if leads else None)):
            if notes is not None:
                self.notes.add(notes, components and number == 0)

    def dual(self) -> Run:
        """Return the run of the output Krylov subspaces (33): C^T in place of B, transposed matrices.

        Symmetric matrices share the solvers, and so the factors of a point that was used right before, and the notes.
        """
        model, shares = self.model.as_dual(), self.model.symmetric
        framed = FramedModel(model, rigid=self.rigid, damping=self.framed.damping)
        identity = self.identity | {"inputs": self.identity.get("outputs"), "transposed": not shares}
        own = Notes(components=self.notes.components, remarks=self.notes.remarks)
        return Run(framed, self.progress, self.tolerance, self.factoring, self.columns, store=self.store,
                   identity=identity, notes=self.notes if shares else own,
                   solvers=self.solvers if shares else None, is_dual=True, tau=self.tau)  # fmt: skip

    def close(self):
        if self.owns_solvers:
            self.solvers.close()
        self.solvers = None  # which refer to the run


def identity_of_model(model, framed, **known) -> dict:
    """Return the parts of the keys of a store: digests of the model as its files have it, the frame, and what else is
    `known`. Collective.

    Digests of the framed model would not do: where nodes are turned its last digits depend on the number of ranks.
    """
    of = model.digests.get
    identity = {"M": of("M"), "K": of("K"), "inputs": of("B"), "outputs": [of("Ct"), of(RATES)]}
    identity["D"] = [of("D") if isinstance(framed.damping, GivenDamping) else None, of(ADDED)]
    identity["nodes"] = [of("dofs"), framed.model.digest_of("labels"), of("interfaces")]
    identity["transposed"] = False
    identity["symmetric"] = bool(framed.model.symmetric)
    return identity | {key: asdict(value) if is_dataclass(value) else value for key, value in known.items()}
