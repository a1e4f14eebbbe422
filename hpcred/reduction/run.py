"""One reduction under way: the framed model, solvers, loads and settings that a component may use, and its notes."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, field, is_dataclass
from functools import cached_property

import numpy as np

from ..linalg.basis import Extension
from ..linalg.blocks import apply, create_block, from_dense, independent, inner, multiply
from ..linalg.csr import without_zeros
from ..linalg.free_motions import check_free_motions
from ..linalg.solvers.base import DoesNotFit, FactorRecord, Solver
from ..linalg.solvers.complex import ComplexSolver
from ..linalg.solvers.settings import Factoring
from ..model.damping import GivenDamping
from ..model.frames import FramedModel, NoFrame
from ..parallel.decisions import decided
from ..parallel.memory import MB
from ..parallel.petsc import PETSc
from ..parallel.progress import Progress
from .run_solvers import RunSolvers
from .tolerance.ports import loads_and_ports

NEAR_ZERO = 0.01  # of a frequency of interest, below which a pseudo-mode may be a motion without force
FOR_IMAGES = 0.1  # of the memory of a rank may go to images of columns
DEPENDENT_LOAD = 1e-14  # square of a combination of unit loads below which they count as dependent
WITHOUT_MASS = (
    "M is singular: directions that move no mass were left out of the basis, and with them the static deflection by "
    "loads on what has no mass; give it a little mass, or take it out by static condensation"
)


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


@dataclass
class Run:
    """Given to `extend(basis, run)` of every component. Call close(); collective.

    `columns`: how many the basis is expected to have; `store`: a Store (see chain), or None; `identity`: what of the
    model and of the job decides about columns (see identity_of_model). `needed`: the factors (mass and damping, as in
    FactorRecord) that a run without store has. `massless`: whether directions were left out since they move no mass.
    """

    framed: FramedModel
    progress: Progress
    tolerance: float
    factoring: Factoring = Factoring()
    components: list[ComponentRecord] = field(default_factory=list)
    inertia: bool = False  # whether the solver counts negative pivots on any number of ranks
    columns: int = 16
    store: object = None
    identity: dict = field(default_factory=dict)
    needed: list[tuple[str, str]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    massless: bool = False
    solvers: RunSolvers | None = None  # those of another run, shared with it
    is_dual: bool = False  # of the output Krylov subspaces of a two-sided projection
    _loads: object = None
    _loads_and_ports: tuple | None = None
    _own_model: object = None
    _mass: object = None
    _added: list[FactorRecord] = field(default_factory=list)
    _added_analyses: int = 0
    _checked: bool = False

    def __post_init__(self):
        self.model, self.rigid = self.framed.model, self.framed.rigid
        self._owns_solvers = self.solvers is None
        if self._owns_solvers:
            self.solvers = RunSolvers(
                self.framed, self.progress, self.factoring, self.inertia, self._reserved_mb, self.remark
            )

    @cached_property
    def keeps_images(self) -> bool:
        """Whether M V is kept beside V, of basis and point: where it takes little of the memory. Collective."""
        return 2 * self._columns_mb <= FOR_IMAGES * self.factoring.limit_mb(self.model.comm)

    @property
    def _columns_mb(self):
        rows = np.diff(self.model.M.getOwnershipRanges()).max()
        return self.columns * rows * np.dtype(PETSc.ScalarType).itemsize / MB

    def _reserved_mb(self):
        """Memory for the columns of the basis and those of a point."""
        return (4 if self.keeps_images else 2) * self._columns_mb

    def factored(self, mass: float, name: str, damping: float = 0.0, may_give_up: bool = True) -> Solver:
        """See RunSolvers."""
        return self.solvers.factored(mass, name, damping, may_give_up)

    @property
    def complex_solver(self) -> ComplexSolver:
        """The one solver of the run for complex A(s)."""
        return self.solvers.complex

    @property
    def multigrid(self) -> bool:
        """Whether solves are by multigrid, which serves real points alone."""
        return self.solvers.multigrid

    def check_free_motions(self, lowest: float, among: float):
        """Refuse a free body in parts or with hinges, whose other free motions are pseudo-modes near 0 Hz.

        It takes a factor of K, and is done where the `lowest` pseudo-frequency is far below those it is `among` (Hz),
        unless factors of this run have shown that there are no such motions, or the store had all that was needed.
        Multigrid does not come to an end where there are. Frees the factor. Collective.
        """
        known = self._checked or lowest > NEAR_ZERO * among or any(item.inertia_relief for item in self.factorisations)
        if not known and not self.multigrid and (self.store is None or self.factorisations):
            self.release()
            try:
                check_free_motions(self.model, self.rigid, self.factoring)
            except DoesNotFit as error:
                self.remark(f"whether the body has parts or hinges was not looked at: {str(error).partition(';')[0]}")
            self._checked = True

    @property
    def factorisations(self) -> list[FactorRecord]:
        """The factorisations of the run, but for those by solvers that it shares."""
        return self._added + (self.solvers.records if self._owns_solvers else [])

    @property
    def analyses(self) -> int:
        """Its symbolic analyses."""
        return self._added_analyses + (self.solvers.analyses if self._owns_solvers else 0)

    @property
    def loads(self):
        """The independent columns of B, self-equilibrated for a free body, as a block; owned by the run."""
        if self._loads is None:
            self._loads = from_dense(self.model.B)
            if self.rigid is not None:
                self.rigid.equilibrate(self._loads)
            factor, _ = decided(self.model.comm, independent, inner(self._loads, self._loads), DEPENDENT_LOAD)
            count, kept = factor.shape
            if kept < count:
                multiply(self._loads, factor)
                self._loads.setActiveColumns(0, kept)
                self.note("inputs", count, kept)
        return self._loads

    @property
    def loads_and_ports(self) -> tuple:
        """The independent loads of inputs and outputs together, and the ports (see ports.loads_and_ports); owned by the
        run. Collective. Raises InputError."""
        if self._loads_and_ports is None:
            self._loads_and_ports = loads_and_ports(self)
        return self._loads_and_ports

    @property
    def mass(self) -> PETSc.Mat:
        """M for products with blocks, without its stored zeros where they are many; owned by the run. Collective."""
        if self._mass is None:
            self._mass = without_zeros(self.model.M)
        return self._mass

    def times_mass(self, block):
        """M block as a new block."""
        first, last = block.getActiveColumns()
        product = create_block(self.mass, last - first)
        apply(self.mass, block, product)
        return product

    def note(self, where: str, columns: int, found: Extension | int, **more):
        """Record how many of the columns offered were new; shown by the command line, kept in the result."""
        weights = {}
        if isinstance(found, Extension):
            if found.kept:
                weights["smallest_kept"] = found.smallest_kept
            if found.largest_dropped:
                weights["largest_dropped"] = found.largest_dropped
            self.massless |= found.massless > 0
            found = found.kept
        self.components.append(ComponentRecord(where=where, columns=columns, kept=found, **weights, **more))
        dropped = f", {columns - found} dependent dropped" if columns > found else ""
        self.progress.say(f"{where}: {found} new vectors{dropped}")

    def identity_of(self, *keys) -> dict:
        """The part of the identity that a key of the store takes, with what stands for all columns."""
        return {key: self.identity.get(key) for key in ("frame", "nodes", "symmetric", *keys)}

    def stored(self, key, most=None):
        """The Entry that a store has under a key, None without one. Collective."""
        if self.store is None:
            return None
        with self.progress.stage("store"):
            return self.store.load(self.model, key, self.remark, most)

    def keep(self, key, entry):
        """Have the store keep an Entry. Collective."""
        if self.store is not None:
            with self.progress.stage("store"):
                self.store.save(self.model, key, entry, self.remark)

    def needs(self, mass: str, damping: str):
        """Note what a part of the basis comes from, whether it had to be factored or not."""
        if self.needed[-1:] != [(mass, damping)]:
            self.needed.append((mass, damping))

    def remark(self, sentence):
        """A warning that the result keeps."""
        self.remarks.append(sentence)
        self.progress.say(sentence)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user of the result has to know."""
        return (*dict.fromkeys(self.remarks), *([WITHOUT_MASS] if self.massless else []))

    @property
    def factorisations_saved(self) -> int:
        """How many factors were not made because of the store."""
        if not self._owns_solvers:
            return 0  # counted there
        made = Counter((record.mass, record.damping) for record in self.factorisations)
        return (Counter(self.needed) - made).total()

    def on_group(self, framed):
        """A run for a copy of the framed model on a group of ranks."""
        return Run(framed, self.progress, self.tolerance, self.factoring, inertia=self.inertia, columns=self.columns,
                   store=self.store, identity=self.identity)  # fmt: skip

    def told(self):
        """What add() of another run takes over."""
        return self.factorisations, self.analyses, self.components, self.needed, self.remarks, self.massless

    def add(self, factorisations, analyses, components, needed, remarks, massless):
        """Take over what was recorded on a group of ranks."""
        self._added += factorisations
        self._added_analyses += analyses
        self.components += components
        self.needed += needed
        self.remarks += remarks
        self.massless |= massless

    def dual(self):
        """The run of the output Krylov subspaces (33): C^T in place of B, transposed matrices. Collective.

        Symmetric matrices share the solvers, and so the factors of a point that was used right before.
        """
        model, shares = self.model.as_dual(), self.model.symmetric
        framed = FramedModel(model, rigid=self.rigid, damping=self.framed.damping)
        identity = self.identity | {"inputs": self.identity.get("outputs"), "transposed": not shares}
        other = Run(framed, self.progress, self.tolerance, self.factoring, self.components, columns=self.columns,
                    store=self.store, remarks=self.remarks, identity=identity,
                    solvers=self.solvers if shares else None, needed=self.needed if shares else [],
                    is_dual=True)  # fmt: skip
        other._own_model = model
        return other

    def release(self):
        """Free the factors."""
        self.solvers.release()

    def close(self):
        for item in (self.solvers if self._owns_solvers else None, self._own_model):
            if item is not None:
                item.close()
        for item in (self._loads, self._mass, *(self._loads_and_ports or ())[:1]):
            if item is not None:
                item.destroy()


def identity_of_model(model, framed, **known) -> dict:
    """What the keys of a store are made of: digests of the model as its files have it, the frame, and what else is
    `known`. Collective.

    Digests of the framed model would not do: where nodes are turned its last digits depend on the number of ranks.
    """
    found = {key: model.digest_of(key) for key in ("M", "K")}
    found |= {"inputs": model.digest_of("B"), "outputs": model.digest_of("Ct"), "transposed": False}
    found["D"] = model.digest_of("D") if isinstance(framed.damping, GivenDamping) else None
    # frames and interface nodes are made from the nodes
    found["nodes"] = None
    if model.interfaces or not isinstance(known["frame"], NoFrame):
        made_of = [asdict(item.definition) for item in model.interfaces]
        found["nodes"] = [model.digest_of("dofs"), framed.model.digest_of("labels"), made_of]
    found["symmetric"] = bool(framed.model.symmetric)
    return found | {key: asdict(value) if is_dataclass(value) else value for key, value in known.items()}
