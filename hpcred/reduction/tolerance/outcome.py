"""Compress the basis that a search ends with, and state the accuracy of its model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...parallel.decisions import decided
from ...parallel.progress import counted
from ..measure import MEASURES
from .accuracy import Accuracy
from .compression import compress
from .directions import Direction, directions_table
from .error_estimate import SHARPEST, grid, measure_over, resonances
from .search import Search

UNPROVEN = "measured errors above 0 Hz need a factor, or a basis with all modes below, and there was neither"
ENDED = "the search ended before a second point"
LITTLE = 1e-3  # of the goal: round-off that is no matter
MIXING = 1e-12  # round-off of K on the columns of a basis at sharp resonances, relative to the highest eigenvalue
SHARP = 5e-4  # damping ratio of these
PASSES = 4  # of projections
TOGETHER = 2**22  # errors of single responses that are held at a time


def compressed_basis(search: Search, drop_above=None, kept=range(0), beside=0) -> tuple[np.ndarray, Accuracy]:
    """Return the columns U (m, k) of the basis that the tolerance asks for, and what is known of their model.
    Collective.

    The columns `kept` of the basis stay in the span of U. Pseudo-modes above `drop_above` (Hz) are left out, and what
    that does to the error counts. `beside`: coordinates of rigid-body motion that come later.
    """
    kept = np.eye(search.projections.basis.size)[:, list(kept)]
    with search.run.progress.stage("project"):
        kept = _project_again(search, kept)
    with search.run.progress.stage("compress"):
        return decided(search.run.model.comm, _compressed, search, drop_above, kept, beside)


def _compressed(search, drop_above, kept, beside):
    judge = search.judge
    found = compress(judge, search.reason, drop_above, kept, beside)
    rest = judge.estimate if found.reason else min(judge.estimate, 3 * judge.floor)
    return found.factor, accuracy_of(
        search, found.reason, found.pair, found.frequencies, found.curve, largest=float(found.curve.max()) + rest,
        noise=found.noise,
    )  # fmt: skip


def _project_again(search, kept) -> np.ndarray:
    """Project on the pseudo-modes of the basis where its models lack digits (see ask_for_digits) or have noise that
    matters, until that changes nothing: what it changes last is the noise of the models that follow, in place of that
    of the search. Returns the columns `kept` in terms of the new basis. Collective."""
    projections, judge, comm = search.projections, search.judge, search.run.model.comm
    before = decided(comm, projections.model)
    lacks = ask_for_digits(search.run, judge, before) or projections.io.quiet or judge.noise > judge.goal
    if not lacks:
        return kept
    for _ in range(PASSES):
        projections.rotate(before.vectors)
        kept = before.coordinates_of(kept)
        search.expansion.look_at_outputs_again()  # before the noise of one that is nothing else counts
        judge.noise = decided(comm, _changed, judge, before)
        if judge.noise <= LITTLE * judge.goal:
            break
        before = decided(comm, projections.model)
    return kept


def _sharper(model, band) -> float:
    """Return by how much resonances of a band (Hz) are sharper than SHARP, at least 1."""
    f, ratios = resonances(model)
    return max(1.0, SHARP / max(ratios[(f >= band[0]) & (f <= band[1])].min(initial=SHARP), SHARPEST))


def _changed(judge, before) -> float:
    """Return how far responses of the model of all columns are from those of one projected before; local."""
    pair = judge.compare(before, judge.projections.model(), np.eye(len(before)))
    return changed(before, pair, judge.settings.band)


def ask_for_digits(run, judge, model) -> bool:
    """Have the projections that follow keep more digits of K where resonances are sharp; return whether they are, or
    whether round-off of K on the stiffest columns of a model may have mixed the soft ones. Collective."""
    sharper = decided(run.model.comm, _sharper, model, judge.settings.band)
    run.cancels *= sharper
    return sharper > 1 or not MIXING * model.eigenvalues[-1] <= judge.goal * model.eigenvalues[0]


def changed(before, pair, band) -> float:
    """Return how far responses of `pair.outer` are from those of a model of the same columns that were projected
    before; local."""
    S = grid([before, pair.outer], band)
    H, drive = pair.outer.responses(S)
    return float(pair.measure.eps(H - before.response(S), H, drive).max())


def accuracy_of(search: Search, reason, pair, frequencies, curve, *, largest, noise) -> Accuracy:
    """Return the accuracy of the model that a search ends with, for a `reason` where the tolerance is not reached;
    local.

    `pair`: it and what its error is seen from; `curve` (S,): its error at frequencies (S,) in Hz, with the `largest` to
    be claimed.
    """
    settings, expansion = search.settings, search.expansion
    counted_modes = expansion.highest_count
    missing = None if counted_modes is None else max(search.missing_modes, 0)
    multigrid, unproven = expansion.solver.multigrid, []
    if not search.proofs and (multigrid or reason):  # no measured error stands behind the estimate
        unproven.append(UNPROVEN if multigrid else ENDED)
    if reason and missing:
        unproven.append(f"{counted(missing, 'mode')} of the band not found")
    low, high = settings.band
    found = Accuracy(
        tolerance=settings.tolerance, band=settings.band, reached=not reason, stopped=reason or "reached",
        largest=largest, worst=float(frequencies[curve.argmax()]), noise=noise, measured=expansion.measured,
        highest=float(pair.inner.frequencies.max()),
        mean=float(((curve[1:] + curve[:-1]) / 2 * np.diff(frequencies)).sum() / (high - low)),
        uncompressed_size=search.projections.basis.size, missing_modes=missing,
        counted=counted_modes, points=tuple(expansion.points), proofs=tuple(search.proofs),
        frequencies=tuple(frequencies.tolist()), eps=tuple(curve.tolist()),
        loss_factor=pair.outer.damping.eta, beside_damping=search.projections.damped, multigrid=multigrid,
        unproven="; ".join(unproven), measure=pair.measure,
        silent=tuple(search.run.model.output_names[j] for j in pair.measure.silent),
        directions=directions_of(pair, frequencies, settings.band, search.run.model) if np.isfinite(largest) else (),
    )  # fmt: skip
    return found.with_noise(noise)


def directions_of(pair, frequencies, band, model) -> tuple[Direction, ...]:
    """Return the accuracy of each output, the least accurate first; local."""
    by = measure_over(MEASURES["directions"], band, pair.outer)
    parts = np.array_split(frequencies, 1 + len(frequencies) * len(by.outputs) * len(by.inputs) // TOGETHER)
    pair = replace(pair, measure=by)
    return directions_table(by, ((part, pair.each(part), pair.outer.responses(part)[0]) for part in parts),
                            model.output_names, model.input_names)  # fmt: skip
