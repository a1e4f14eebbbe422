"""Reduce a model by a one-sided projection onto the span of basis components."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

import numpy as np

from ..linalg.eigensolver import congruent, settled
from ..linalg.solvers.settings import Factoring
from ..model.damping import Damping, NoDamping, caughey_terms, loss_factor_of, warnings_of_damping
from ..model.definiteness import growing, warnings_of_definiteness
from ..model.digits import warnings_of_digits
from ..model.frames import Frame, NoFrame, apply_frame, inputs_without_effect
from ..model.input_output_counts import require_room
from ..model.load_columns import loads_of, resultants
from ..model.operator import Operator
from ..model.scales import in_usual_units
from ..model.second_order_model import SecondOrderModel, massless, require_model
from ..parallel.decisions import decided
from ..parallel.failures import ComputationError, InputError, Owned
from ..parallel.memory import give_back
from ..parallel.petsc import free_dropped
from ..parallel.progress import Progress
from ..parallel.stopping import stop_if_asked
from .checks import check_added, check_model, check_series, check_unsymmetric, warnings_of
from .components.component import Component, PointComponent
from .components.groups import blocks_in_groups, number_of_groups
from .interface_coordinates import Projected, check_interface_coordinates, to_interface_coordinates
from .massless import separate_dampers, without_round_off
from .notes import Notes
from .projection import (
    diagonalise,
    diagonalise_with_massless,
    everywhere,
    project,
    project_columns,
    project_stiffness,
)
from .record import make_record
from .reduced_damping import reduced_damping
from .reduced_model import ReducedModel
from .reductor import Reductor
from .run import Run, identity_of_model
from .settings import Reduction
from .store import Store
from .tolerance.accuracy import Accuracy

ORTHONORMAL_TO = 1e-12


@dataclass(frozen=True, kw_only=True)
class BasisReductor(Reductor):
    """Reduce by a one-sided projection onto the span of the components: V^T M V = I, V^T K V diagonal.

    A reductor of another kind of projection replaces the steps of _reduce: what is checked, how large the bases are,
    how they are filled, and how the model is projected.
    """

    basis: tuple[Component, ...] = ()
    frame: Frame = NoFrame()
    damping: Damping = NoDamping()
    settings: Reduction = Reduction()
    factoring: Factoring = Factoring()
    store: Store | None = None
    progress: Progress = field(compare=False)

    projection = "one_sided"
    counts_modes = False  # whether factors count negative pivots on any number of ranks

    def reduce(self, model) -> ReducedModel:
        require_model(model)
        with in_usual_units(model) as (usual, inputs, outputs):
            reduced = self._reduce(usual)
        if usual is not model:
            reduced.B, reduced.C = reduced.B * inputs, reduced.C * outputs
            reduced.Cv, reduced.Ca = (part if part is None else part * outputs for part in (reduced.Cv, reduced.Ca))
            accuracy = reduced.record.accuracy
            reduced.record = replace(
                reduced.record, digests=model.digests, loads=loads_of(model),
                accuracy=accuracy and accuracy.times(inputs, outputs),
            )  # fmt: skip
        reduced.resultants = resultants(model)
        reduced.model = model.shared()
        free_dropped(model.comm)
        return reduced

    def _reduce(self, model) -> ReducedModel:
        """Reduce a model in usual units: again, where M has turned out not to see all motions that count."""
        self.progress.expect(model.size)
        with self.progress.stage("check"):
            warnings = self._check(model)
        with self.progress.stage("frame"):
            framed = apply_frame(model, self.frame, self.damping)
            warnings += inputs_without_effect(framed)
        tau, notes = self._tau(framed), Notes()
        if massless(framed.model) and tau:
            return self._reduce_in(model, framed, warnings, notes, tau)
        try:
            reduced = self._reduce_in(model, framed, warnings, notes, 0.0)
        except InputError:
            if not (tau and (notes.massless or notes.incomplete)):
                raise
        else:
            if not (tau and (notes.massless or notes.incomplete)):
                return reduced
        return self._reduce_in(model, framed, warnings, Notes(), tau)

    def _reduce_in(self, model, framed, warnings, notes, tau) -> ReducedModel:
        """Reduce a model in its frame by bases that are orthonormal in M + tau^2 K; `notes` of the run, empty."""
        settings, progress = self.settings, self.progress
        with Owned(model.comm) as owned:
            deflation, columns, identity = self._deflation(framed), self._expected_columns(framed), {}
            if self.store is not None:
                with progress.stage("store"):
                    asked = {"frame": self.frame, "damping": self.damping,
                             "basis": [asdict(item) for item in self.basis]}  # fmt: skip
                    identity = identity_of_model(model, framed, **asked)
            run = owned.owns(Run(
                framed, progress, deflation, self.factoring, columns, self.counts_modes, self.store, identity, notes,
                tau=tau,
            ))  # fmt: skip
            runs = [run, *(owned.owns(other) for other in self._more_runs(run))]
            with progress.stage("copy of M"):
                run.mass, run.inner  # noqa: B018  (made before memory is given back)
            give_back()  # what it took to read and copy matrices, of which a basis may not find enough in one piece
            bases = [run.new_basis(columns) for _ in runs]
            groups = number_of_groups(settings.groups, run, self._points(model))
            search = self._fill(bases, runs, groups)
            for each in runs:
                run.notes.massless |= each.notes.massless
                each.solvers.release()
            if not all(vectors.size for vectors in bases):
                raise InputError("basis: no vector is left; no mode lies in the bands and no input loads the body")
            with progress.stage("project"):
                reduced, defect = self._project(model, framed, bases, run)
            accuracy = self._accuracy(search, reduced, framed)
            if accuracy is None and framed.rigid is not None:
                run.check_free_motions(float(reduced.frequencies.min()), _highest(self.basis, run))
            reduced.record = make_record(
                model, framed, runs, progress, frame=self.frame, damping=self.damping, basis=self.basis, groups=groups,
                projection=self.projection, deflation_tolerance=deflation, drop_above=settings.drop_above,
                coordinates=settings.coordinates, orthonormality_defect=defect, accuracy=accuracy,
                warnings=(*(accuracy.warnings if accuracy is not None else ()), *warnings, *run.notes.warnings),
                unstable_poles=tuple((pole.real, pole.imag) for pole in reduced.unstable_poles().tolist()),
            )  # fmt: skip
            return reduced

    # steps that other reductors have their own of

    def _check(self, model) -> tuple[str, ...]:
        """Refuse what cannot be reduced in this way; returns warnings of the model. Collective."""
        check_model(model)
        check_added(model, self.damping)
        check_unsymmetric(model, self.damping)
        check_series(model, self.damping)
        self._check_room(model)
        if self.settings.coordinates == "interface":
            check_interface_coordinates(model, self.frame)
        warnings = warnings_of_damping(self.damping)
        if model.D is not None and isinstance(self.damping, NoDamping):
            warnings += (f"damping: none, though {model.name} has a damping matrix, which kind = 'given' takes",)
        return warnings_of(model, self.frame, self._constant()) + warnings

    def _constant(self) -> SecondOrderModel | None:
        """Return the constant part of a model with parameters, None for others."""
        return None

    def _check_room(self, model):
        require_room(model, 0)

    def _deflation(self, framed) -> float:
        """Return the deflation tolerance."""
        return self.settings.deflation_tolerance

    def _tau(self, framed) -> float:
        """Return tau (s) of the inner product M + tau^2 K for models with motions without mass, 0 where that cannot
        serve: a time of the frequencies that count, by default of the highest point, else of the whole model."""
        if (caughey_terms(self.damping) or ())[2:]:  # powers of M^-1 K
            return 0.0
        points = [abs(item.point) for item in self.basis if hasattr(item, "point")]
        highest = max([point for point in points if np.isfinite(point)], default=0.0)
        return 1 / (highest or np.sqrt(abs(framed.model.mean_eigenvalue)))

    def _expected_columns(self, framed) -> int:
        """Return how many columns the basis is expected to have. Raises InputError where it cannot fit."""
        if not self.basis:
            raise InputError("basis: the list of components is empty, and no tolerance is asked for")
        return max(self._component_columns(framed), 1)

    def _component_columns(self, framed) -> int:
        """Return how many vectors the components are asked for, at most. Raises InputError where they cannot fit."""
        model, rigid = framed.model, framed.rigid_size
        for item in self.basis:
            item.check(model.size, rigid)
        columns = sum(item.columns(model.B.getSize()[1], rigid) for item in self.basis)
        for item in self.basis:
            if item.per_direction is not None and not model.interfaces:
                raise InputError(f"basis: {item.kind} needs at least one [[interface]]")
            columns += 6 * len(model.interfaces) * (item.per_direction or 0)
        if columns > model.size - rigid:
            raise InputError(
                f"basis: {columns} vectors asked for, but {model.name} has only {model.size - rigid} elastic "
                "coordinates in this frame; ask for fewer modes, points or lower orders"
            )
        return columns

    def _more_runs(self, run) -> tuple[Run, ...]:
        """Return the runs of other subspaces."""
        return ()

    def _points(self, model) -> int:
        """Return how many points may be factored at the same time."""
        return sum(isinstance(item, PointComponent) for item in self.basis)

    def _fill(self, bases, runs, groups):
        """Extend each of the bases, with its run; returns what _accuracy needs."""
        extend_by_all(self.basis, bases, runs, groups)

    def _accuracy(self, search, reduced, framed) -> Accuracy | None:
        """Return the accuracy of the reduced model, None without a tolerance."""
        return None

    def _project(self, model, framed, bases, run) -> tuple[ReducedModel, float]:
        """Return the reduced model with its basis in all dofs, and the orthonormality defect."""
        (vectors,), full, drop_above = bases, framed.model, self.settings.drop_above
        static = 0

        def stiffness(columns):
            if full.is_symmetric("K"):
                return project_stiffness(full.K, columns, run.cancels)
            return project(full.K, columns)

        if run.tau:
            eigenvalues, static = diagonalise_with_massless(vectors, run.mass, stiffness, run.tau)
        else:
            eigenvalues = diagonalise(vectors, stiffness(vectors.columns))
        frequencies = np.sqrt(np.maximum(eigenvalues, 0.0)) / (2 * np.pi)
        if drop_above is not None:
            kept = int((frequencies <= drop_above).sum())
            if kept == 0:
                raise InputError(f"drop_above: no pseudo-frequency lies below {drop_above:g} Hz")
            run.note(f"pseudo-frequencies up to {drop_above:g} Hz", len(frequencies), kept)
            vectors.multiply(np.eye(len(frequencies))[:, :kept])
            static = max(static - len(frequencies) + kept, 0)
            eigenvalues, frequencies = eigenvalues[:kept], frequencies[:kept]
        moving = len(frequencies) - static
        if static and "D" in full.matrices:
            separate_dampers(vectors, full.matrices["D"], static)
        # the part of each column that has mass: the digits of the rest are missing in M x
        weights = 1 / np.sqrt(1 + run.tau**2 * np.maximum(eigenvalues, 0.0)) * (np.arange(len(eigenvalues)) < moving)
        mass, defect = vectors.gram(run.mass, weights)
        if defect > ORTHONORMAL_TO:
            raise ComputationError(
                f"the basis has lost its orthonormality: max |V^T M V - I| = {defect:.1e}, allowed is "
                f"{ORTHONORMAL_TO:g}"
            )
        columns = vectors.columns
        # round-off of the product V X couples parts that hardly couple: the small matrices alone are turned once more
        X, again = np.eye(len(eigenvalues)), not run.tau and full.is_symmetric("K")
        if again:
            eigenvalues, X = decided(model.comm, settled, stiffness(columns), mass)
            mass, frequencies = congruent(mass, X), np.sqrt(np.maximum(eigenvalues, 0.0)) / (2 * np.pi)
        run.notes.remarks += warnings_of_digits(model, full.K, eigenvalues, columns)
        if not warnings_of_definiteness(model) and (unstable := growing(model, eigenvalues)):
            run.notes.remarks.append(unstable)
        small = {"M": mass, "K": np.diag(eigenvalues)}
        if static:
            mass[moving:] = mass[:, moving:] = 0.0
            small["K"][moving:, moving:] = np.eye(static) / run.tau**2
        if not full.is_symmetric("K"):
            K = stiffness(columns)
            small["K"] += (K - K.T) / 2
        if "D" in full.matrices:
            small["D"] = without_round_off(congruent(project(full.matrices["D"], columns), X), static, run.tau)
        else:
            small["D"] = reduced_damping(framed.damping, small["K"], frequencies, mass)
        for key, value in small.items():
            if full.is_symmetric(key):
                small[key] = (value + value.T) / 2
        added = full.added.map(lambda mat: congruent(_symmetric(project(mat, columns)), X))
        operator = Operator.of(**small, added=added)
        inputs = X.T @ project_columns(columns, full.B)
        outputs = (inputs if full.Ct is None else X.T @ project_columns(columns, full.Ct)).T.copy()
        if again:
            vectors.multiply(X)
        if self.settings.coordinates == "interface":
            moved = to_interface_coordinates(framed, Projected(columns, operator, inputs, outputs), run.tau)
            frequencies = np.concatenate([np.zeros(framed.rigid_size), frequencies])
            reduced = reduced_model(model, framed, moved.operator, moved.B, moved.C, frequencies)
            reduced.interfaces = full.interfaces
            reduced.columns = everywhere(model, framed, moved.columns)
            return reduced, defect
        reduced = reduced_model(model, framed, operator, inputs, outputs, frequencies)
        reduced.columns = everywhere(model, framed, columns)
        return reduced, defect


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
    points = [abs(getattr(item, "point", 0.0)) for item in basis if isinstance(item, PointComponent)]
    modes = [max(item.frequencies_hz) for item in run.notes.components if item.frequencies_hz]
    return max([*(point / 2 / np.pi for point in points if np.isfinite(point)), *modes], default=0.0) or np.inf


def _symmetric(matrix):
    return (matrix + matrix.T) / 2


def reduced_model(model, framed, operator, inputs, outputs, frequencies):
    """Return the model of the same arrays on all ranks, to the last digit; `outputs` (k, m): the measured rows."""
    operator, inputs, outputs, frequencies = model.comm.bcast((operator, inputs, outputs, frequencies))
    loss = loss_factor_of(framed.damping)
    return ReducedModel.of_operator(
        operator, B=inputs, **model.rates.of(outputs), frequencies=frequencies, loss_factor=loss,
        input_names=model.input_names, output_names=model.output_names,
    )  # fmt: skip
