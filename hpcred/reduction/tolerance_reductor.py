"""Reduce a model to a tolerance over a band."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..linalg.blocks import add_product, create_block, local_rows
from ..linalg.csr import diagonal_of
from ..linalg.pencil import MASSLESS
from ..linalg.solvers.base import DoesNotFit
from ..model.digits import changes_by_last_digits, warnings_of_peaks
from ..model.input_output_counts import require_room
from ..parallel.decisions import decided
from ..parallel.failures import InputError
from ..parallel.sums import summed
from .basis_reductor import BasisReductor, Plan, columns_of, extend_by_all, has_powers
from .checks import warnings_of_band
from .components.craig_bampton import ConstraintModes
from .components.krylov import StaticCorrection
from .interface_coordinates import elastic_part
from .run.run_solvers import refusal
from .search.goal import Adaptive
from .search.outcome import Outcome, outcome_of
from .search.round_off import with_round_off
from .search.search import Search, deflation_of_search

CANCELS = 1e4  # of x^T diag(M) x where x^T M x = 1: masses of parts cancel to round-off; meshes have a few hundred
ROOM = 96  # columns that a search is expected to need
ROOM_WITHOUT_FACTORS = 192  # the same by multigrid, whose points have more blocks of a few columns


@dataclass(frozen=True, kw_only=True)
class ToleranceReductor(BasisReductor):
    """Reduce until eps(f) <= tolerance over the band is verified (see search). Components of a basis come first.

    `goal`: the tolerance, the band, and what may be taken for it.
    """

    goal: Adaptive

    counts_modes = True

    def check(self, model):
        warnings = super().check(model)
        require_room(model)
        of_band = warnings_of_band(model, self.goal.band)
        for warning in of_band:  # before a search that may take long for that reason
            self.progress.warn(warning)
        return warnings + of_band

    def plan(self, framed):
        room = ROOM_WITHOUT_FACTORS if self.factoring.solver.kind == "multigrid" else ROOM
        columns = columns_of(self.basis, framed) + min(room, self.goal.columns)
        tau = 0.0 if has_powers(self.damping) else 1 / (2 * np.pi * self.goal.band[1])
        return Plan(deflation_of_search(framed.model), tau, columns, framed.model.comm.size)

    def fill(self, spaces) -> Search:
        (vectors,), (run,), groups = spaces
        kept = self._kept_columns(vectors, run)
        extend_by_all(self.basis, *spaces, last=False)
        before = vectors.size
        try:
            return self.search(vectors, run, groups, kept)
        except DoesNotFit as error:
            if vectors.size > before or not run.solvers.give_up_factors(error):
                raise refusal(error) from error
            return self.search(vectors, run, groups, kept)

    def _kept_columns(self, vectors, run) -> int:
        """Begin the basis with the columns that stay in its span, and return how many they are: those by which
        interfaces move in interface coordinates, as the responses may not need it, and the deflections at 0 Hz where
        these are to be exact."""
        goal, settings = self.goal, self.settings
        if settings.coordinates == "interface":
            ConstraintModes().extend(vectors, run)
        if goal.static == "exact":
            StaticCorrection().extend(vectors, run)
        if goal.static == "exact" and settings.drop_above is not None:
            raise InputError(
                "drop_above: found it beside static = 'exact', whose deflections it may cut; leave one out"
            )
        rigid = self.rigid_beside(run)
        if vectors.size and goal.size is not None and goal.size < rigid + vectors.size:
            raise InputError(
                f"adaptive.size: found {goal.size}, expected at least {rigid + vectors.size}, by which the interfaces "
                "can move, or deflect at 0 Hz (static = 'exact')"
            )
        return vectors.size

    def rigid_beside(self, run) -> int:
        """Return the coordinates of rigid-body motion, which interface coordinates of a free body have besides."""
        return run.framed.rigid_size if self.settings.coordinates == "interface" else 0

    def search(self, vectors, run, groups, kept) -> Search:
        """Search for a basis, whose first columns, `kept` of them, stay in its span. Collective."""
        search = Search(vectors, run, self.goal, groups, kept=kept)
        search.run_to_end()
        if not run.tau:
            run.notes.massless |= self._has_mass_of_round_off(search)
        return search

    def compress(self, spaces, search) -> Outcome:
        (vectors,), (run,), _ = spaces
        outcome = self.outcome(search, run)
        run.note("compressed", vectors.size, outcome.factor.shape[1])
        vectors.multiply(outcome.factor)
        return outcome

    def outcome(self, search, run) -> Outcome:
        """Return how the basis of a search is compressed, and how accurate its model is. Collective."""
        return outcome_of(search, self.settings.drop_above, self.rigid_beside(run))

    def _has_mass_of_round_off(self, search) -> bool:
        """Test whether the stiffest motion of a basis is static in the band, being far beyond it, and moves parts whose
        masses cancel: what round-off leaves of them is no mass. Collective."""
        run = search.run
        model = decided(run.model.comm, search.projections.model)
        if model.eigenvalues.max(initial=0.0) * MASSLESS <= (2 * np.pi * self.goal.band[1]) ** 2:
            return False
        mode = create_block(run.model.K, 1)
        add_product(mode, search.projections.basis.columns, model.vectors[:, -1:], beta=0.0)
        with local_rows(mode) as x:  # x^T M x = 1
            norms = summed(run.model.comm, diagonal_of(run.model.M) @ np.abs(x) ** 2)
        mode.destroy()
        return bool(norms[0] > CANCELS)

    def accuracy(self, setup, reduced, outcome):
        framed, accuracy, projections = setup.framed, outcome.accuracy, outcome.projections
        elastic = elastic_part(reduced, framed.rigid_size if reduced.interfaces else 0)
        # what the last digits of K decide, by the pseudo-modes, which the basis has before its columns are scaled
        count = int((elastic.frequencies <= self.goal.band[1]).sum())
        changes = changes_by_last_digits(framed.model.K, count, projections.basis.columns)
        if framed.model.D is not None and not reduced.interfaces:
            projections.run.notes.remarks += self._warnings_of_peaks(reduced, framed.model, changes, accuracy)
        with self.progress.stage("estimate"):
            measured = with_round_off(accuracy, elastic, projections)
        return replace(measured, last_digits=tuple(changes.tolist()))

    def _warnings_of_peaks(self, reduced, model, changes, accuracy) -> list[str]:
        """Return warnings of resonances of the band that the last digits of K decide about."""
        count = len(changes)
        eigenvalues = np.diag(reduced.K)[:count]
        ratios = np.diag(reduced.D)[:count] / (2 * np.sqrt(np.maximum(eigenvalues, np.finfo(float).tiny)))
        ratios = np.maximum(ratios, 0.0) + accuracy.loss_factor / 2
        ratios[reduced.frequencies[:count] < self.goal.band[0] / 2] = 0.0  # peaks outside, as of free motions
        return warnings_of_peaks(model, eigenvalues, changes, ratios, self.goal.tolerance)
