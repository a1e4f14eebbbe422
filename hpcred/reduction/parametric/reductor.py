"""Reduce a model that depends on parameters, to a tolerance over the band and the ranges, or by a basis."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from functools import partial

import numpy as np

from ...linalg.matrix_estimates import symmetry_defect
from ...model.damping import GivenDamping
from ...model.definiteness import check_definite
from ...model.frames import Buckens, apply_frame
from ...model.load_columns import resultants
from ...model.parametric_model import ParametricModel
from ...model.second_order_model import SYMMETRIC_TO
from ...parallel.declared import declared
from ...parallel.failures import InputError, Owned
from ...parallel.petsc import free_dropped
from ...parallel.progress import counted
from ..notes import Notes
from ..run import Run, identity_of_model
from ..tolerance.outcome import accuracy_of
from ..tolerance.reductor import ToleranceReductor
from .accuracy import ParameterAccuracy
from .compression import compress
from .greedy import Greedy
from .reduced import ParametricReducedModel, projected_parts
from .settings import ParameterSearch


@dataclass(frozen=True, kw_only=True)
class ParametricReductor(ToleranceReductor):
    """Reduce until eps(f) <= tolerance is proven over the band and the ranges of the parameters (see greedy)."""

    parameter_search: ParameterSearch = ParameterSearch()
    parametric: ParametricModel | None = None  # the one that is being reduced

    def reduce(self, model) -> ParametricReducedModel:
        check_parametric(model, self.frame, self.damping)
        if self.goal.static == "exact":
            raise InputError(
                "static: found 'exact' for a model with parameters, at whose other values it would not be; leave it out"
            )
        if self.settings.drop_above is not None:
            raise InputError("drop_above: found it for a model with parameters and a tolerance; leave it out")
        with model.at() as reference:
            reduced = replace(self, parametric=model)._reduce(reference)
            parts = projected_parts(model, reduced, self.damping)
            known = {item.name: getattr(reduced, item.name) for item in fields(reduced)}
            known["resultants"], known["model"] = resultants(reference), reference.shared()
        free_dropped(model.comm)
        return ParametricReducedModel(**known, parameters=model.parameters, **parts)

    def _search(self, vectors, run, groups, kept):
        open_run = partial(self._run_at, run)
        greedy = Greedy(self.parametric, vectors, run, self.goal, self.parameter_search, open_run, len(kept))
        greedy.run_to_end()
        return greedy.first, *self._compressed(greedy, run, kept)

    @contextmanager
    def _run_at(self, first, point, visited):
        """A run at a point, whose notes go to that of the reference in the end."""
        parametric = self.parametric
        values = dict(zip(parametric.reference, point, strict=True))
        with Owned(parametric.comm) as owned:
            model = owned.owns(parametric.at(**values))
            if any(item.of == "M" for item in parametric.terms):
                check_definite(model)
            framed = apply_frame(model, self.frame, self.damping)
            if framed.rigid_size != first.framed.rigid_size:
                raise InputError(
                    f"{model.name}: {framed.rigid_size} rigid-body modes, but {first.framed.rigid_size} at the "
                    "reference values; terms of K that hold a body have no place in the Buckens frame"
                )
            identity = {}
            if self.store is not None:
                asked = {"frame": self.frame, "damping": self.damping, "basis": [
                    *(asdict(item) for item in self.basis), {"parameters": [list(item) for item in visited]},
                    [parametric.model.digest_of(key) for key in ("M", "K", "D", "B", "Ct")],
                    asdict(self.parameter_search),
                ]}  # fmt: skip
                identity = identity_of_model(model, framed, **asked)
            run = owned.owns(Run(
                framed, self.progress, first.tolerance, self.factoring, first.columns, self.counts_modes, self.store,
                identity, Notes(components=first.notes.components),
            ))  # fmt: skip
            yield run
            first.notes.add(run.recorded, components=False)
        free_dropped(parametric.comm)

    def _compressed(self, greedy, run, kept):
        """Return the columns of the basis that the tolerance asks for at all values, and what is known of them."""
        goal, judge, estimated = self.goal, greedy.first.judge, greedy.estimate
        eps, noise = goal.tolerance, max(search.judge.noise for search in greedy.searches)
        noise = max(noise, *(search.judge.lost for search in greedy.searches))
        fine = max(0.9 * eps - estimated - noise, 0.3 * eps, noise)
        aim = fine if not greedy.reason else max(0.9 * eps, min(0.5 * estimated, 1.0))
        points = list(dict.fromkeys([*greedy.visited, *greedy.points, *greedy.checks()]))
        fixed = np.eye(greedy.basis.size)[:, list(kept)]
        with self.progress.stage("compress"):
            found = compress(
                greedy.projections, goal, greedy.reference, greedy.visited, points, aim, fixed, self._rigid_beside(run)
            )
        reason = greedy.reason or found.limited
        rest = estimated if reason else min(estimated, 3 * judge.floor)
        worst = int(found.errors.argmax())
        accuracy = accuracy_of(
            greedy.first, reason, found.pair, found.frequencies, found.curve,
            largest=float(found.errors.max()) + rest, noise=max(noise, found.noise),
        )  # fmt: skip
        names = list(self.parametric.reference)
        of_parameters = ParameterAccuracy(
            ranges={item.name: item.range for item in self.parametric.parameters},
            reference=self.parametric.reference, points=tuple(greedy.known), checked=len(points),
            worst=dict(zip(names, points[worst], strict=True)),
        )  # fmt: skip
        searches = greedy.searches
        missing = max(search.missing_modes for search in searches)
        return found.factor, replace(
            accuracy, worst=float(found.worst[worst]), parameters=of_parameters, uncompressed_size=greedy.basis.size,
            points=tuple(point for search in searches for point in search.expansion.points),
            proofs=tuple(proof for search in searches for proof in search.proofs), missing_modes=max(missing, 0),
        )  # fmt: skip


def check_parametric(model, frame, damping):
    """Refuse a parametric model that cannot be reduced: unsymmetric terms, terms that the frame or the damping leaves
    out. Collective."""
    declared("model", model, ParametricModel)
    for item in model.terms:
        if item.of in ("M", "K") and (defect := symmetry_defect(item.matrix)) > SYMMETRIC_TO:
            raise InputError(
                f"{model.name}: the term of {item.of} with the factor '{item.factor}' is not symmetric: "
                f"||A - A^T|| / ||A|| = {defect:.1e}, expected round-off (below {SYMMETRIC_TO:g}); circulatory forces "
                "are not reduced over parameters"
            )
        if item.of == "M" and isinstance(frame, Buckens):
            raise InputError(
                f"{model.name}: found a term of M with the factor '{item.factor}' in the Buckens frame, whose "
                "rigid-body modes depend on M; hold the body (frame kind 'tangent' or 'chord')"
            )
        if item.of == "D" and not isinstance(damping, GivenDamping):
            raise InputError(
                f"damping.kind: found '{damping.kind}', which replaces D and so the "
                f"{counted(sum(each.of == 'D' for each in model.terms), 'term')} of D of {model.name}; expected 'given'"
            )
