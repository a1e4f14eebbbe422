"""Reduce a model by a projection onto the span of basis components: check, frame, fill, compress, project, record.

Each step takes and returns what its types say. A reductor of another kind has other ones: another plan of its bases,
other columns in them, a compression, an error that it measures, or a projection from two sides.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from ..linalg.basis import Basis
from ..linalg.solvers.settings import Factoring
from ..model.damping import Damping, NoDamping, caughey_terms, loss_factor_of, warnings_of_damping
from ..model.frames import Frame, FramedModel, NoFrame, apply_frame, inputs_without_effect
from ..model.input_output_counts import require_room
from ..model.loads.columns import loads_of, resultants
from ..model.rigid_body.modes import exchange_of_matrices
from ..model.scales import in_usual_units
from ..model.second_order_model import SecondOrderModel, massless, require_model
from ..parallel.decisions import decided
from ..parallel.failures import InputError, Owned
from ..parallel.memory import give_back
from ..parallel.petsc import free_dropped
from ..parallel.progress import Progress
from ..parallel.stopping import stop_if_asked
from .checks import check_added, check_model, check_series, check_unsymmetric, doubts_of_matrices, warnings_of
from .components.component import Component, PointComponent
from .components.groups import blocks_in_groups, number_of_groups
from .interface_coordinates import check_interface_coordinates
from .one_sided import one_sided
from .reductor import Reductor
from .result.accuracy import Accuracy
from .result.record import make_record
from .result.reduced_model import ReducedModel
from .run.notes import Notes
from .run.projection import Projection, everywhere
from .run.run import Run, identity_of_model
from .run.store import Store
from .settings import Reduction


class Plan(NamedTuple):
    """What the bases of a reduction are to be: `deflation`, the tolerance below which directions are dropped; `tau`
    (s) of their inner product M + tau^2 K where M does not see all motions, 0 where that cannot serve; how many
    `columns` one is expected to have; and how many `points` may be factored at the same time."""

    deflation: float
    tau: float
    columns: int
    points: int


class Setup(NamedTuple):
    """A model in usual units, the same in its frame, the plan of its bases, and what a user of the result has to know
    of it."""

    model: SecondOrderModel
    framed: FramedModel
    plan: Plan
    warnings: tuple[str, ...]


class Subspaces(NamedTuple):
    """The basis V, and the basis W of a two-sided projection, with the run of each; `groups` of ranks fill them."""

    bases: tuple[Basis, ...]
    runs: tuple[Run, ...]
    groups: int


@dataclass(frozen=True, kw_only=True)
class BasisReductor(Reductor):
    """Reduce by a one-sided projection onto the span of the components: V^T M V = I, V^T K V diagonal."""

    basis: tuple[Component, ...] = ()
    frame: Frame = NoFrame()
    damping: Damping = NoDamping()
    settings: Reduction = Reduction()
    factoring: Factoring = Factoring()
    store: Store | None = None
    progress: Progress = field(compare=False)

    projection = "one_sided"
    constant = None  # the part of a model with parameters that has none
    counts_modes = False  # whether factors count negative pivots on any number of ranks

    def reduce(self, model) -> ReducedModel:
        require_model(model)
        with in_usual_units(model) as (usual, inputs, outputs):
            reduced = self.reduced(usual)
        known: dict[str, Any] = {"resultants": resultants(model), "model": model.shared()}
        if usual is not model:
            accuracy = reduced.record.accuracy
            known["record"] = replace(
                reduced.record, digests=model.digests, loads=loads_of(model),
                accuracy=accuracy and accuracy.times(inputs, outputs),
            )  # fmt: skip
            known["B"], known["C"] = reduced.B * inputs, reduced.C * outputs
            known |= {key: rows * outputs for key in ("Cv", "Ca") if (rows := getattr(reduced, key)) is not None}
            known["feedthrough"] = model.rates.direct
        free_dropped(model.comm)
        return replace(reduced, **known)

    def reduced(self, model) -> ReducedModel:
        """Reduce a model in usual units: again, where M has turned out not to see all motions that count."""
        self.progress.expect(model.size)
        with self.progress.stage("check"):
            warnings = self.check(model)
            model.digests  # noqa: B018  (kept for the record: made from copies, before what takes most memory)
        with self.progress.stage("frame"):
            framed = apply_frame(model, self.frame, self.damping)
            warnings += inputs_without_effect(framed)
        setup, notes = Setup(model, framed, self.plan(framed), warnings), Notes()
        tau = setup.plan.tau
        if massless(framed.model) and tau:
            return self._reduced_in(setup, tau, notes)
        try:
            reduced = self._reduced_in(setup, 0.0, notes)
        except InputError:
            if not (tau and (notes.massless or notes.incomplete)):
                raise
        else:
            if not (tau and (notes.massless or notes.incomplete)):
                return reduced
        return self._reduced_in(setup, tau, Notes())

    def _reduced_in(self, setup, tau, notes) -> ReducedModel:
        """Reduce by bases that are orthonormal in M + tau^2 K; `notes` of the run, empty."""
        with Owned(setup.model.comm) as owned:
            spaces = self._opened(setup, tau, notes, owned)
            outcome = self.compress(spaces, self.fill(spaces))  # a search has blocks, and is let go of here
            for run in spaces.runs:
                notes.massless |= run.notes.massless
                run.solvers.release()
            if not all(vectors.size for vectors in spaces.bases):
                raise InputError("basis: no vector is left; no mode lies in the bands and no input loads the body")
            with self.progress.stage("project"):
                projection = self.project(setup, spaces)
            return self._recorded(setup, spaces, projection, outcome)

    # the steps

    def check(self, model) -> tuple[str, ...]:
        """Refuse what cannot be reduced in this way; returns warnings of the model. Collective."""
        check_model(model)
        exchanged = exchange_of_matrices(model)
        doubts = doubts_of_matrices(model, exchanged)
        for doubt in doubts:  # before what takes long, and before what follows from it is refused
            self.progress.warn(doubt)
        check_added(model, self.damping)
        check_unsymmetric(model, self.damping)
        check_series(model, self.damping)
        require_room(model, 0)
        if self.settings.coordinates == "interface":
            check_interface_coordinates(model, self.frame)
        warnings = warnings_of_damping(self.damping)
        if model.D is not None and isinstance(self.damping, NoDamping):
            warnings += (f"damping: none, though {model.name} has a damping matrix, which kind = 'given' takes",)
        return doubts + warnings_of(model, self.frame, exchanged, self.constant) + warnings

    def plan(self, framed) -> Plan:
        """Plan the bases. Collective. Raises InputError where they cannot fit."""
        if not self.basis:
            raise InputError("basis: the list of components is empty, and no tolerance is asked for")
        columns = max(columns_of(self.basis, framed), 1)
        points = [component for component in self.basis if isinstance(component, PointComponent)]
        return Plan(self.settings.deflation_tolerance, self._tau(framed), columns, len(points))

    def _tau(self, framed) -> float:
        """Return tau: a time of the frequencies that count, by default of the highest point, else of the whole model;
        0 beside powers of M^-1 K."""
        if has_powers(self.damping):
            return 0.0
        points = [abs(component.point) for component in self.basis if hasattr(component, "point")]
        highest = max([point for point in points if np.isfinite(point)], default=0.0)
        return 1 / (highest or np.sqrt(abs(framed.model.mean_eigenvalue)))

    def _opened(self, setup, tau, notes, owned) -> Subspaces:
        """Return empty bases and their runs, which `owned` closes. Collective."""
        model, framed, plan, _ = setup
        run = owned.owns(Run(
            framed, self.progress, plan.deflation, self.factoring, plan.columns, self.counts_modes, self.store,
            self.identity(model, framed), notes, tau=tau,
        ))  # fmt: skip
        runs = (run,) if self.projection == "one_sided" else (run, owned.owns(run.dual()))
        with self.progress.stage("copy of M"):
            run.mass, run.inner  # noqa: B018  (made before memory is given back)
        give_back()  # what it took to read and copy matrices, of which a basis may not find enough in one piece
        bases = tuple(run.new_basis(plan.columns) for _ in runs)
        return Subspaces(bases, runs, number_of_groups(self.settings.groups, run, plan.points))

    def identity(self, model, framed, asked=()) -> dict:
        """Return what decides about columns, for keys of the store: empty without one. Collective."""
        if self.store is None:
            return {}
        basis = [*map(asdict, self.basis), *asked]
        with self.progress.stage("store"):
            return identity_of_model(model, framed, frame=self.frame, damping=self.damping, basis=basis)

    def fill(self, spaces: Subspaces):
        """Extend the bases; returns the search that compress() ends, None without one. Collective."""
        extend_by_all(self.basis, *spaces)

    def compress(self, spaces: Subspaces, search):
        """Keep fewer columns of the bases; returns the Outcome of a search, None without one. Collective."""

    def project(self, setup: Setup, spaces: Subspaces) -> Projection:
        """Project the model in its frame. Collective."""
        return one_sided(setup.model, setup.framed, spaces.bases[0], spaces.runs[0], self.settings)

    def accuracy(self, setup: Setup, reduced: ReducedModel, outcome) -> Accuracy | None:
        """Return the accuracy of the reduced model, which may use up the basis; None without a tolerance. Collective.
        """

    def _recorded(self, setup, spaces, projection, outcome) -> ReducedModel:
        """Return the whole model with its record, the same on all ranks to the last digit. Collective."""
        model, framed, plan, warnings = setup
        run, V, W = spaces.runs[0], projection.columns, projection.left
        operator, B, rows, frequencies = model.comm.bcast(
            (projection.operator, projection.B, projection.C, projection.frequencies)
        )
        reduced = ReducedModel(
            operator=operator, B=B, **model.rates.of(rows), frequencies=frequencies, feedthrough=model.rates.direct,
            loss_factor=loss_factor_of(framed.damping), input_names=model.input_names,
            output_names=model.output_names, interfaces=projection.interfaces,
            columns=everywhere(model, framed, V), left_columns=None if W is None else everywhere(model, framed, W),
        )  # fmt: skip
        # what is known of its stability and of its error
        poles = decided(model.comm, reduced.unstable_poles)
        if len(poles) and self.projection == "two_sided":
            self._tell_unstable(poles, run)
        accuracy = self.accuracy(setup, reduced, outcome)
        if accuracy is None and framed.rigid is not None:
            run.check_free_motions(float(reduced.frequencies.min()), _highest(self.basis, run))
        record = make_record(
            model, framed, spaces.runs, self.progress, frame=self.frame, damping=self.damping, basis=self.basis,
            groups=spaces.groups, projection=self.projection, deflation_tolerance=plan.deflation,
            drop_above=self.settings.drop_above, coordinates=self.settings.coordinates,
            orthonormality_defect=projection.defect, accuracy=accuracy,
            warnings=(accuracy.warnings if accuracy is not None else ()) + warnings + run.notes.warnings,
            unstable_poles=tuple((pole.real, pole.imag) for pole in poles.tolist()),
        )  # fmt: skip
        return replace(reduced, record=record)

    def _tell_unstable(self, poles, run):
        """Refuse poles in the right half-plane of a two-sided projection, or warn of them where they are allowed."""
        listed = ", ".join(f"{pole.real:.3g}{pole.imag:+.4g}i" for pole in poles[:6])
        told = (
            f"projection: the two-sided reduced model is unstable, with {len(poles)} poles in the right "
            f"half-plane ({listed}{', ...' if len(poles) > 6 else ''} rad/s)"
        )
        if not self.settings.allow_unstable:
            raise InputError(f"{told}; take projection = 'one_sided', which keeps stability, or allow_unstable = "
                             "true for frequency responses only")  # fmt: skip
        run.notes.remarks.append(f"{told}: use it for frequency responses only, or take other points or another "
                                 "size, or a tolerance, which keeps stability")  # fmt: skip


def has_powers(damping) -> bool:
    """Test for a Caughey series with powers of M^-1 K, which M has to be regular for."""
    return bool((caughey_terms(damping) or ())[2:])


def columns_of(basis, framed) -> int:
    """Return how many vectors components are asked for, at most. Raises InputError where they cannot fit."""
    model, rigid = framed.model, framed.rigid_size
    for component in basis:
        component.check(model.size, rigid)
    columns = sum(component.columns(model.B.getSize()[1], rigid) for component in basis)
    for component in basis:
        if component.per_direction is not None and not model.interfaces:
            raise InputError(f"basis: {component.kind} needs at least one [[interface]]")
        columns += 6 * len(model.interfaces) * (component.per_direction or 0)
    if columns > model.size - rigid:
        raise InputError(
            f"basis: {columns} vectors asked for, but {model.name} has only {model.size - rigid} elastic "
            "coordinates in this frame; ask for fewer modes, points or lower orders"
        )
    return columns


def extend_by_all(basis, bases, runs, groups, last=True):
    """Extend each of the bases, with its run, by all components; `last`: whether nothing comes after them."""
    ready = blocks_in_groups(basis, runs, groups) if groups > 1 else {}
    for i, component in enumerate(basis):
        runs[0].progress.step("points and modes", i, len(basis), always=True)
        for r, (vectors, run) in enumerate(zip(bases, runs, strict=True)):
            if (i, r) in ready:
                ready.pop((i, r)).join(vectors, run)
            else:
                component.extend(vectors, run)
        if i + 1 < len(basis) or not last:
            stop_if_asked(runs[0].model.comm, f"part {i + 1} of the basis")


def _highest(basis, run) -> float:
    """Return the highest point or mode (Hz) that a basis was made for."""
    at_points = [component for component in basis if isinstance(component, PointComponent)]
    points = [abs(getattr(component, "point", 0.0)) / 2 / np.pi for component in at_points]
    modes = [max(notes.frequencies_hz) for notes in run.notes.components if notes.frequencies_hz]
    return max(modes + [point for point in points if np.isfinite(point)], default=0.0) or np.inf
