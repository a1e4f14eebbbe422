"""Compute the response of a full model at thousands of frequencies from a handful of factorisations.

A basis is made by the automatic reduction until it reaches the tolerance. It is used as it is: no basis is compressed,
which would only bring in an error, and none is restored to the dofs of the model. At every frequency asked for the
error is estimated as in the search, from the model without the newest columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ..linalg.pencil import MASSLESS, squared_frequencies
from ..linalg.solvers.base import FactorRecord
from ..linalg.solvers.settings import Factoring
from ..model.damping import Caughey, Damping, ModalDamping, Rayleigh, Structural, caughey_terms, damping_or_given
from ..model.digits import warnings_of_digits
from ..model.frames import Frame, NoFrame, apply_frame, inputs_without_effect
from ..model.input_output_counts import FREQUENCIES, require_room
from ..model.rigid_body.modes import RigidBodyModes, exchange_of_matrices
from ..model.scales import in_usual_units, unscaled
from ..model.second_order_model import SecondOrderModel, listed, massless, require_model
from ..parallel.as_html import as_html
from ..parallel.decisions import decided
from ..parallel.declared import declared, spelled
from ..parallel.failures import InputError, Owned
from ..parallel.progress import Progress, Timing
from ..reduction.checks import check_model, check_unsymmetric, doubts_of_matrices, warnings_of
from ..reduction.result.accuracy import Accuracy
from ..reduction.run.run import Run
from ..reduction.search.goal import Adaptive
from ..reduction.search.outcome import accuracy_of
from ..reduction.search.round_off import projected_again
from ..reduction.search.search import Search, deflation_of_search
from ..reduction.small.compression import LITTLE
from ..reduction.small.error_estimate import FINE, Comparison, grid, largest, resonances
from ..reduction.small.pseudo_modal import UNDAMPED, Proportional, nested
from ..reduction.tolerance_reductor import ROOM
from .error_check import Check, bound_of, fresh_frequencies, measuring_damping
from .frequency_response import checked_frequencies, frequencies_to_draw, frequency_response

POLE = 1e-10  # relative distance of the square of a frequency from an undamped pole, as near as poles are known


@dataclass(frozen=True, eq=False, kw_only=True)
class FullResponse:
    """The frequency response of a full model, and how well it is known.

    Attributes
    ----------
    frequencies : ndarray, shape (F,)
        Hz, ascending and each once.
    response : ndarray, complex, shape (F, r, p)
        Of r outputs under p inputs.
    eps : ndarray, shape (F,)
        Its relative error as estimated, round-off included, with the damping of the response.
    input_names, output_names : tuple of str
        Of the p inputs and r outputs.
    accuracy : Accuracy
        Over the whole band, with the damping that it names.
    factorisations : tuple of FactorRecord
        Those of the search.
    timing : Timing
        Where the time went.
    check : Check or None
        Fresh frequencies against full solves, if asked for.
    warnings : tuple of str
        Sentences.
    models : object
        What the response is computed from.
    scale : float
        A factor of the response.
    """

    frequencies: np.ndarray
    response: np.ndarray
    eps: np.ndarray
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    accuracy: Accuracy
    factorisations: tuple[FactorRecord, ...]
    timing: Timing
    check: Check | None = None
    warnings: tuple[str, ...] = ()
    models: _Models | None = field(default=None, repr=False)
    scale: float = 1.0

    def to_draw(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return `frequencies`, `response` and `eps` with more of them between, so that curves show all peaks."""
        ends = self.frequencies[0], self.frequencies[-1]
        fine = frequencies_to_draw(ends, self.models.resonances_of_response, self.frequencies)
        H, eps = self.models.at(fine)
        H = self.models.pair.outer.io.rates.with_factors(2j * np.pi * fine, H)
        return fine, self.scale * H, eps

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a user reads first: over the band, at the frequencies, and what was checked."""
        count, worst = len(self.frequencies), int(self.eps.argmax())
        above = int((self.eps > self.accuracy.tolerance).sum())
        beyond = f"; above the tolerance at {above} of them" if above else ""
        return (
            f"{self.accuracy.sentence} ({self.accuracy.measured})",
            f"at the {count} frequencies: estimated at most {self.eps[worst]:.1e}, at {self.frequencies[worst]:.6g} Hz"
            f"{beyond}",
            *([self.check.sentence] if self.check else []),
        )

    @property
    def _facts(self) -> dict[str, str]:
        f = self.frequencies
        return {"frequencies": f"{len(f)}, {f[0]:.6g} to {f[-1]:.6g} Hz", "inputs": listed(self.input_names),
                "outputs": listed(self.output_names)}  # fmt: skip

    def __str__(self):
        """Return the verdict, what it is of, and the warnings."""
        facts = "; ".join(f"{key} {value}" for key, value in self._facts.items())
        return "\n".join([*self.sentences, facts] + [f"warning: {text}" for text in self.warnings])

    __repr__ = __str__

    def _repr_html_(self):
        """Return the same for notebooks."""
        first, *others = self.sentences
        return as_html(first, self._facts, notes=others + [f"warning: {text}" for text in self.warnings])

    @property
    def reached(self) -> bool:
        """Whether the tolerance holds over the band and at every frequency, and nothing checked is above it."""
        checked = self.check is None or self.check.passed
        return bool(self.accuracy.reached and self.eps.max() <= self.accuracy.tolerance and checked)


@spelled
def full_response(
    model: SecondOrderModel, frequencies: ArrayLike, frame: Frame | None = None, damping: Damping | None = None, *,
    tolerance: float = 1e-6, band: Sequence[float] | None = None,
    adaptive: Adaptive | None = None, check: int = 0, seed: int | None = None, groups: int | None = None,
    factoring: Factoring | None = None, progress: Progress | None = None,
) -> FullResponse:  # fmt: skip
    """Return the frequency response of a full model at many frequencies, to a tolerance.

    Collective. A basis is made as in a reduction to a tolerance, and is used without compression.

    Parameters
    ----------
    model : SecondOrderModel
    frequencies : array_like, shape (N,)
        Hz, each at least 0.
    frame : Frame, optional
        Reference frame of a free body; by default none.
    damping : Damping, optional
        By default the damping matrix of the model, if it has one. Modal ratios and longer Caughey series are refused.
    tolerance : float, default 1e-6
        Relative error over the band.
    band : sequence of 2 floats, optional
        Hz; by default from the lowest to the highest frequency.
    adaptive : Adaptive, optional
        Tolerance and band with more settings.
    check : int, default 0
        Random frequencies at which the full model is factored to check the error.
    seed : int, optional
        Of the random frequencies.
    groups : int, optional
        Groups of ranks that share the checks (see frequency_response).
    factoring : Factoring, optional
        How to factor, and in how much memory.

    Raises
    ------
    InputError
        For input that does not fit, also if a frequency is an undamped pole.
    ComputationError
        If a computation fails.
    """
    require_model(model)
    declared("factoring", factoring, Factoring | None)
    frequencies = np.unique(checked_frequencies(frequencies))
    if not len(frequencies):
        raise InputError("frequencies: found none, expected at least one, in Hz")
    if declared("check", check, int) < 0:
        raise InputError(f"check: found {check}, expected 0 or more fresh frequencies")
    # the frequencies with the error that is allowed at them
    adaptive = _asked_accuracy(frequencies, tolerance, band, adaptive)
    frame, damping = frame or NoFrame(), damping_or_given(model, damping)
    progress = progress or Progress(model.comm)
    factoring = factoring or Factoring()
    # searched in units in which inputs and outputs are alike
    with in_usual_units(model) as (usual, inputs, outputs):
        result, models = _by_search(usual, frequencies, frame, damping, adaptive, factoring, progress)
        # set against full solves at fresh frequencies, and beside resonances
        if check:
            with progress.stage("check"):
                accuracy = result.accuracy
                seed, fresh = fresh_frequencies(accuracy.band, models.resonances, check, seed, model.comm)
                solved = frequency_response(
                    usual, fresh, frame, measuring_damping(accuracy, damping), factoring=factoring, groups=groups,
                    progress=progress,
                )  # fmt: skip
                estimated, measured = decided(model.comm, models.against, fresh, solved)
            checked = Check(
                seed=seed, bound=bound_of(accuracy), frequencies=tuple(fresh.tolist()), estimated=estimated,
                measured=measured, beside_resonances=len(fresh) - check,
            )
            result = replace(result, check=checked, timing=progress.timing())
    if usual is model:
        return result
    scale = inputs * outputs
    return replace(result, response=unscaled(result.response, scale), accuracy=result.accuracy.times(inputs, outputs),
                   scale=scale)  # fmt: skip


def _asked_accuracy(frequencies, tolerance, band, adaptive) -> Adaptive:
    """Return the settings of a search: `adaptive`, or a tolerance over the band, by default that of the frequencies."""
    if adaptive is None:
        ends = (float(frequencies[0]), float(frequencies[-1]))
        if band is None and ends[0] == ends[1]:
            raise InputError(f"frequencies: found only {ends[0]:g} Hz; give the band in Hz as well")
        adaptive = Adaptive(tolerance=tolerance, band=ends if band is None else band)
    if frequencies[0] < adaptive.band[0] or frequencies[-1] > adaptive.band[1]:
        raise InputError(f"band: found {list(adaptive.band)}, expected one with all frequencies, which go from "
                         f"{frequencies[0]:g} to {frequencies[-1]:g} Hz")  # fmt: skip
    return adaptive


def _by_search(
    model, frequencies, frame, damping, adaptive, factoring, progress, singular=False
) -> tuple[FullResponse, _Models]:
    """Return the response from the basis of a search, and the models that say its error; `singular`: whether M has
    turned out to be. Collective."""
    damping_of_response = _damping_of_response(damping)
    check_model(model)
    check_unsymmetric(model, damping)
    require_room(model, max(len(frequencies), FREQUENCIES))
    exchanged = exchange_of_matrices(model)
    doubts = doubts_of_matrices(model, exchanged)
    for doubt in doubts:  # before what follows from it is refused
        progress.warn(doubt)
    warnings = doubts + warnings_of(model, frame, exchanged)
    _check_support(model, frame, frequencies)
    with Owned(model.comm) as owned:
        with progress.stage("frame"):
            framed = apply_frame(model, frame, damping)
            warnings += inputs_without_effect(framed)
        # the search of a reduction, without compression; massless dofs need the shifted inner product
        room, deflation = min(ROOM, adaptive.columns), deflation_of_search(framed.model)
        tau = 1 / (2 * np.pi * adaptive.band[1]) if singular or massless(framed.model) else 0.0
        run = owned.owns(Run(framed, progress, deflation, factoring, inertia=True, columns=room, tau=tau))
        basis = run.new_basis(room)
        search = Search(basis, run, adaptive)
        try:
            search.run_to_end()
        except InputError:
            if tau or not (run.notes.massless or run.notes.incomplete):
                raise
        # what has no mass may be seen only now, and the search begins again
        if not tau and (run.notes.massless or run.notes.incomplete):
            run.solvers.release()
            return _by_search(model, frequencies, frame, damping, adaptive, factoring, progress, singular=True)
        projections = search.projections
        # responses of the largest model, with the error that the next smaller one has
        with progress.stage("evaluate"):
            outer = decided(model.comm, projections.model)
            seen = decided(model.comm, _seen, search, outer)
            squares = squared_frequencies(outer.eigenvalues, outer.masses, outer.tau)
            scale = 1.0 if outer.masses is None else np.maximum(outer.masses, MASSLESS) ** -0.5
            basis.multiply(outer.vectors * scale)
            run.notes.remarks += warnings_of_digits(model, framed.model.K, squares, basis.columns)
            again = tuple(projected_again(projections))
            inner, embedding = (outer, np.eye(len(outer))) if seen is None else (seen, nested(seen, outer))
            pair = search.judge.compare(inner, outer, embedding)
            models = _Models(pair, again, seen is not None, damping_of_response)
            values, eps, accuracy = decided(model.comm, _evaluate, search, frequencies, models)
        factorisations, warnings = tuple(run.factorisations), (*warnings, *run.notes.warnings)
    values = model.rates.with_factors(2j * np.pi * frequencies, values)
    return progress.found(FullResponse(
        frequencies=frequencies, response=values, eps=eps, accuracy=accuracy, input_names=model.input_names,
        output_names=model.output_names, factorisations=factorisations, warnings=warnings,
        timing=progress.timing(), models=models,
    )), models  # fmt: skip


def _damping_of_response(damping) -> Proportional:
    """Return the proportional part of the damping of the response."""
    if isinstance(damping, ModalDamping) or caughey_terms(damping) is not None:
        kind = "modal ratios belong" if isinstance(damping, ModalDamping) else "a Caughey series of more terms belongs"
        raise InputError(f"damping: {kind} to a reduced model; reduce to a tolerance and take its frequency response")
    if isinstance(damping, Structural):
        return Proportional(eta=damping.loss_factor)
    return Proportional(*(*damping.coefficients, 0.0)[:2]) if isinstance(damping, Rayleigh | Caughey) else UNDAMPED


def _check_support(model, frame, frequencies):
    """Refuse the response at rest of a body that nothing holds, which is infinite. Collective."""
    if frequencies[0] > 0 or not isinstance(frame, NoFrame) or model.dofs is None:
        return
    if RigidBodyModes(model).count:
        raise InputError(f"frequencies: found 0 Hz, where {model.name}, which is free, has none; begin above, "
                         "or take frame kind 'buckens' for the elastic part")  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Models:
    """The models of a search, to tell their difference anywhere in the band: the basis beside what its error is seen
    from (`pair`), which may not be `known`, and the basis projected `again`, which shows the round-off; `damping`: of
    the response, which may be less than that which errors are measured with; local."""

    pair: Comparison
    again: tuple
    known: bool
    damping: Proportional

    @property
    def resonances(self):
        return resonances(self.pair.outer)

    @property
    def resonances_of_response(self):
        return resonances(replace(self.pair.outer, damping=self.damping))

    def at(self, frequencies):
        """Return the response (S, r, p) and its estimated error (S,), round-off included."""
        values = replace(self.pair.outer, damping=self.damping).response(frequencies)
        return values, sum(self.curve(self.damping, frequencies))

    def curve(self, damping, frequencies):
        """Return estimated errors and their noise (S,), with a proportional damping."""
        if not self.known:
            nothing = np.full(len(frequencies), np.inf)
            return nothing, nothing
        pair = self.pair.with_damping(damping)
        curve, noise = pair.curve(frequencies), pair.noise(frequencies)
        H, drive = pair.outer.responses(frequencies)
        for rounded in self.again:
            damped = replace(rounded, damping=damping).response(frequencies)
            noise = np.maximum(noise, pair.measure.eps(damped - H, H, drive))
        return curve, noise

    def against(self, frequencies, solved):
        """Return the estimated error at frequencies (S,), and that against responses (S, r, p) of full solves."""
        pair = self.pair
        H, drive = pair.outer.responses(frequencies)
        estimated = sum(self.curve(pair.outer.damping, frequencies))
        return tuple(estimated.tolist()), tuple(pair.measure.eps(solved - H, solved, drive).tolist())


def _seen(search, outer):
    """Return the model of a search that the error of `outer`, its whole basis, is seen from, or None."""
    framed, held_back = search.run.framed, search.projections.first_held_back
    elastic = framed.model.size - framed.rigid_size
    complete = len(outer) >= elastic or not (held_back or search.reason)  # no column was left to be held back for
    return outer if complete else search.projections.model(np.arange(held_back)) if held_back else None


def _evaluate(search, frequencies, models):
    """Return response and estimated error at the frequencies, and the accuracy over the band."""
    outer = models.pair.outer
    if models.damping == UNDAMPED and outer.is_diagonal and outer.D is None:
        squares = squared_frequencies(outer.eigenvalues, outer.masses, outer.tau)
        squared = squares / (2 * np.pi) ** 2  # below zero where K is indefinite: no poles at a frequency
        gap = np.abs(frequencies[:, None] ** 2 - squared).min(axis=1, initial=np.inf)
        poles = frequencies[gap <= POLE * frequencies**2]
        if len(poles):
            raise InputError(f"frequency {poles[0]:.10g} Hz is a pole of the full model; leave it out or add damping")
    return *models.at(frequencies), _accuracy(search, models)


def _accuracy(search, models) -> Accuracy:
    """Return the accuracy of the whole basis of a search, which is not compressed."""
    pair = models.pair
    S = grid([pair.outer], search.settings.band, step=FINE)
    if models.known:
        S, _ = largest(pair, S, LITTLE * search.settings.tolerance)
    curve, roundoff = models.curve(pair.outer.damping, S)
    noise = max(search.judge.noise, float(roundoff.max()))
    return accuracy_of(search, search.reason, pair, S, curve, largest=float(curve.max()), noise=noise)
