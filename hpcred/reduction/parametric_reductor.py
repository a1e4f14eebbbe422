"""Reduce a model that depends on parameters, to a tolerance over the band and the ranges, or by a basis."""

from __future__ import annotations

from contextlib import contextmanager
from copy import copy
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..linalg.blocks import copy_of
from ..model.damping import GivenDamping
from ..model.definiteness import check_definite
from ..model.frames import Buckens, apply_frame
from ..model.loads.columns import resultants
from ..model.parameters.parametric_model import ParametricModel
from ..model.parameters.term_matrices import FIELD
from ..model.rigid_body.modes import acts_on_free_motions
from ..model.second_order_model import SAY_SO, SYMMETRIC_TO
from ..parallel.decisions import decided
from ..parallel.declared import declared
from ..parallel.digest import digest_of_plain
from ..parallel.failures import InputError, Owned
from ..parallel.petsc import PETSc, free_dropped
from ..parallel.progress import counted
from .basis_reductor import BasisReductor, extend_by_all
from .checks import check_added, require_no_frequencies
from .parametric.compression import at_ends_of_band, compress, turned
from .parametric.greedy import Greedy
from .parametric.reduced import ParametricReducedModel, projected_parts
from .parametric.settings import ParameterSearch
from .parametric.training import corner_points
from .result.parameter_accuracy import ParameterAccuracy, in_words
from .result.record import TERMS
from .run.notes import Notes
from .run.run import Run
from .search.outcome import Outcome, accuracy_of, changed, project_until_settled
from .tolerance_reductor import ToleranceReductor

CORNERS = 32  # of the ranges, unless they are more, at which stability is looked at


@dataclass(frozen=True, kw_only=True)
class AtReference:
    """What reductors of models with parameters have besides: `parametric`, the model that is reduced at its reference.
    """

    parametric: ParametricModel | None = None

    @property
    def constant(self):
        """The part of the model without parameters."""
        return self.parametric.model


@dataclass(frozen=True, kw_only=True)
class ParametricBasisReductor(AtReference, BasisReductor):
    """Reduce by the components of a basis at some values of the parameters, one after the other on one basis.

    `parameter_points`: the values, by default the reference.
    """

    parameter_points: tuple[dict[str, float], ...] = ()

    def reduce(self, model) -> ParametricReducedModel:
        if self.settings.projection == "two_sided" and model.model.Ct is not None:
            raise InputError("projection: found 'two_sided' for a model with parameters, expected 'one_sided'")
        return reduced_with_terms(self, model)

    def plan(self, framed):
        plan = super().plan(framed)
        return plan._replace(columns=max(len(self.parameter_points), 1) * plan.columns)

    def fill(self, spaces):
        (vectors,), (first,), _ = spaces
        if not self.parameter_points:
            extend_by_all(self.basis, *spaces)
        for values in self.parameter_points:
            point = tuple(self.parametric.checked(values).values())
            with run_at(self, first, point) as run:
                local = run.new_basis(run.columns)
                extend_by_all(self.basis, [local], [run], 1)
                vectors.extend(copy_of(local.columns, first.model.K))


@dataclass(frozen=True, kw_only=True)
class ParametricReductor(AtReference, ToleranceReductor):
    """Reduce until eps(f) <= tolerance is verified over the band and the ranges of the parameters (see greedy)."""

    parameter_search: ParameterSearch = ParameterSearch()

    def reduce(self, model) -> ParametricReducedModel:
        if self.goal.static == "exact":
            raise InputError(
                "static: found 'exact' for a model with parameters, at whose other values it would not be; leave it out"
            )
        if self.settings.drop_above is not None:
            raise InputError("drop_above: found it for a model with parameters and a tolerance; leave it out")
        return reduced_with_terms(self, model)

    def search(self, vectors, run, groups, kept):
        terms = digests_of_terms(self.parametric) if self.store is not None else []
        asked = [terms, asdict(self.parameter_search)]

        def open_run(point, visited):
            return run_at(self, run, point, [*asked, [list(values) for values in visited]])

        greedy = Greedy(self.parametric, vectors, run, self.goal, self.parameter_search, open_run, kept, terms)
        greedy.run_to_end()
        return greedy

    def outcome(self, greedy, run):
        goal, judge, estimated = self.goal, greedy.first.judge, greedy.estimate
        fixed = np.eye(greedy.basis.size)[:, : greedy.kept]
        with self.progress.stage("project"):
            fixed, noise = _project_again(greedy, fixed)
        # what the estimate and round-off leave of the tolerance is the goal of the compression
        eps, lost = goal.tolerance, [search.judge.lost for search in greedy.searches]
        noise = max(noise, greedy.projections.round_off, *lost)
        fine = max(0.9 * eps - estimated - noise, 0.3 * eps, noise)
        aim = fine if not greedy.reason else max(0.9 * eps, min(0.5 * estimated, 1.0))
        # the fewest columns that reach it at all points
        points = [*greedy.visited, *greedy.points]
        with self.progress.stage("compress"):
            points += at_ends_of_band(greedy.projections, points, goal.band)
            points = list(dict.fromkeys([*points, *greedy.checks()]))
            fewest = compress(
                greedy.projections, goal, greedy.reference, greedy.visited, points, aim, fixed, self.rigid_beside(run)
            )
        # the accuracy at the reference, with the largest error over all values in its place
        reason = greedy.reason or fewest.limited
        rest = (estimated if reason else min(estimated, 3 * judge.floor)) + greedy.lost
        worst = int(fewest.errors.argmax())
        accuracy = accuracy_of(
            greedy.first, reason, fewest.pair, fewest.frequencies, fewest.curve,
            largest=float(fewest.errors.max()) + rest, noise=max(noise, fewest.noise),
        )  # fmt: skip
        names = list(self.parametric.reference)
        of_parameters = ParameterAccuracy(
            ranges={parameter.name: parameter.range for parameter in self.parametric.parameters},
            reference=self.parametric.reference, points=tuple(greedy.known), checked=len(fewest.points),
            worst=dict(zip(names, fewest.points[worst], strict=True)),
        )  # fmt: skip
        # points, proofs and counts of all values
        searches = greedy.searches
        counted_modes = missing = None
        if all(search.expansion.highest_count for search in searches):
            counted_modes = greedy.first.expansion.highest_count
            missing = max(0, *(search.missing_modes for search in searches))
        accuracy = replace(
            accuracy, worst=float(fewest.worst[worst]), parameters=of_parameters, uncompressed_size=greedy.basis.size,
            points=tuple(point for search in searches for point in search.expansion.points),
            proofs=tuple(proof for search in searches for proof in search.proofs), missing_modes=missing,
            counted=counted_modes,
        )  # fmt: skip
        return Outcome(fewest.factor, accuracy, greedy.first.projections)


def _project_again(greedy, kept) -> tuple[np.ndarray, float]:
    """Project on the pseudo-modes at the reference, as a search at one value does (see project_until_settled). Returns
    the columns `kept` in terms of the new basis, and the noise of the models. Collective."""
    comm, judge, projections = greedy.parametric.comm, greedy.first.judge, greedy.projections
    last = decided(comm, turned, projections, greedy.reference, greedy.goal)

    def rotated():
        nonlocal kept, last
        pair, outward, inward = last
        projections.rotate(outward)
        kept, last = inward @ kept, decided(comm, turned, projections, greedy.reference, greedy.goal)
        return decided(comm, changed, pair.outer, last[0], greedy.goal.band)

    noise = max(search.judge.noise for search in greedy.searches)
    noise = project_until_settled(greedy.run, judge, last[0].outer, noise, rotated, also=projections.quiet)
    return kept, noise


def reduced_with_terms(reductor, model) -> ParametricReducedModel:
    """Return the model that a reductor makes at the reference, with the terms on its basis. Collective."""
    check_parametric(model, reductor.frame, reductor.damping, reductor.settings.coordinates)
    with model.at() as reference:
        check_reference(model, reference)
        reduced = replace(reductor, parametric=model).reduced(reference)
        projected = projected_parts(model, reduced, reductor.damping)
        reduced = replace(reduced, resultants=resultants(reference), model=reference.shared())
    free_dropped(model.comm)
    whole = ParametricReducedModel.of(reduced, parameters=model.parameters, **projected)
    warnings = (*whole.record.warnings, *warnings_of_stability(whole, model.comm))
    digests = whole.record.digests | {TERMS: digest_of_plain(digests_of_terms(model))}
    return replace(whole, record=replace(whole.record, warnings=warnings, digests=digests))


def warnings_of_stability(reduced, comm) -> tuple[str, ...]:
    """Return a sentence on the first value with poles in the right half-plane, of the reference, those at which the
    model was factored, and the corners of the ranges. Collective."""
    accuracy = reduced.record.accuracy
    visited = [point.values for point in accuracy.parameters.points] if accuracy is not None else []
    corners = [dict(zip(reduced.reference, point, strict=True)) for point in corner_points(reduced.parameters, CORNERS)]

    def first():
        for values in (reduced.reference, *visited, *corners):
            try:
                count = len(reduced.at(**values).unstable_poles())
            except InputError:  # no mass, which is refused where that value is asked for
                continue
            if count:
                return (
                    f"the reduced model is unstable at {in_words(values)}: {count} pole{'s' * (count > 1)} in the "
                    "right half-plane, so that motion grows in time; a Campbell diagram tells from where on",
                )
        return ()

    return decided(comm, first)


def check_reference(parametric, reference):
    """Refuse loads or outputs that are all zero at the reference values. Collective."""
    for mat, of, what in ((reference.B, "B", "loads"), (reference.Ct, "C", "outputs")):
        terms = any(term.of == of for term in parametric.terms)
        if terms and mat is not None and not mat.norm(PETSc.NormType.FROBENIUS) > 0:
            raise InputError(
                f"{parametric.name}: all {what} are zero at the reference values, {in_words(parametric.reference)}, by "
                f"the factors of the terms of {of}; give a parameter a `reference` at which they are not"
            )


@contextmanager
def run_at(reductor, first, point, asked=()):
    """The run of a reductor at a point, whose notes go to the `first`, that of the reference, in the end; `asked`: what
    else decides about columns, for keys of the store. Collective."""
    parametric = reductor.parametric
    values = dict(zip(parametric.reference, point, strict=True))
    with Owned(parametric.comm) as owned:
        model = owned.owns(parametric.at(**values))
        if any(term.of == "M" for term in parametric.terms):
            check_definite(model)
        check_added(model, reductor.damping)
        framed = apply_frame(model, reductor.frame, reductor.damping)
        if framed.rigid_size != first.framed.rigid_size:
            raise InputError(
                f"{model.name}: {framed.rigid_size} rigid-body modes, but {first.framed.rigid_size} at the reference "
                "values; terms of K that hold a body have no place in the Buckens frame"
            )
        run = owned.owns(Run(
            framed, reductor.progress, first.tolerance, reductor.factoring, first.columns, reductor.counts_modes,
            reductor.store, reductor.identity(model, framed, asked), Notes(components=first.notes.components),
            tau=first.tau,
        ))  # fmt: skip
        yield run
        first.notes.add(run.recorded, components=False)
    free_dropped(parametric.comm)


def digests_of_terms(parametric) -> list:
    """Return what tells the constant part and the terms of a model from others. Collective."""
    digests: list = [parametric.model.digests]
    for term in parametric.terms:
        key = FIELD[term.of]
        with parametric.model.with_fields(**{key: copy(term.matrix)}) as with_term:
            digests.append([term.of, term.factor, with_term.digest_of(key)])
    return digests


def check_parametric(model, frame, damping, coordinates):
    """Refuse a parametric model that cannot be reduced: unsymmetric terms, terms that the frame or the damping leaves
    out. Collective."""
    declared("model", model, ParametricModel)
    # each term by itself
    known = zip(model.terms, model.symmetry_defects, model.symmetric_terms, strict=True)
    for term, defect, symmetric in known:
        unsymmetric = term.of in ("M", "K") and not symmetric
        if unsymmetric and not model.model.may_be_unsymmetric(term.of):
            more = f" or a skew-symmetric matrix; {SAY_SO}"
            raise InputError(
                f"{model.name}: the term of {term.of} with the factor '{term.factor}' is not symmetric: "
                f"max |a_ij - a_ji| / |a_ij| = {defect:.1e}, expected round-off (below {SYMMETRIC_TO:g})"
                + (more if term.of == "K" else "")
            )
        if unsymmetric:
            require_no_frequencies(model, damping)
        if unsymmetric and model.model.added:
            raise InputError(
                f"{model.name}: found {model.model.added.plural} beside an unsymmetric term of K with the factor "
                f"'{term.factor}', which no reduction has; leave one of them out"
            )
        if unsymmetric and (isinstance(frame, Buckens) or coordinates == "interface"):
            asked = "the Buckens frame" if isinstance(frame, Buckens) else "interface coordinates"
            raise InputError(
                f"{model.name}: found {asked} and an unsymmetric term of K with the factor '{term.factor}', whose "
                "forces they have no place for; hold the body, in pseudo-modal coordinates"
            )
        if term.of == "K" and isinstance(frame, Buckens) and acts_on_free_motions(model.model, term.matrix):
            raise InputError(
                f"{model.name}: the term of K with the factor '{term.factor}' holds or pushes rigid-body motions, as "
                "springs to the ground and spin softening do, and the Buckens frame has none of these; hold the body "
                "(frame kind 'tangent' or 'chord'), or leave the term out"
            )
        if term.of == "M" and isinstance(frame, Buckens):
            raise InputError(
                f"{model.name}: found a term of M with the factor '{term.factor}' in the Buckens frame, whose "
                "rigid-body modes depend on M; hold the body (frame kind 'tangent' or 'chord')"
            )
        if term.of == "D" and not isinstance(damping, GivenDamping):
            raise InputError(
                f"damping.kind: found '{damping.kind}', which replaces D and so the "
                f"{counted(sum(each.of == 'D' for each in model.terms), 'term')} of D of {model.name}; expected 'given'"
            )
