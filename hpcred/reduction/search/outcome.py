"""Compress the basis that a search ends with, and state the accuracy of its model."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...parallel.decisions import Team, decided, decided_with
from ...parallel.failures import InputError
from ...parallel.progress import counted
from ..result.accuracy import Accuracy
from ..result.directions import Direction, directions_table
from ..result.measure import MEASURES
from ..small.compression import LITTLE, compressed
from ..small.error_estimate import (
    FINE,
    SHARPEST,
    UNIFORM,
    Comparison,
    grid,
    largest,
    measure_over,
    resolved,
    resonances,
)
from .judging import Judge
from .projections import Projections
from .search import Search

UNPROVEN = "measured errors above 0 Hz need a factor, or a basis with all modes below, and there was neither"
ENDED = "the search ended before a second point"
MIXING = 1e-12  # round-off of K on the columns of a basis at sharp resonances, relative to the highest eigenvalue
SHARP = 5e-4  # damping ratio of these
FEW, SMALL = 16, 0.1  # modes that this may mix, which are looked at by themselves; of the goal: what that may come to
PASSES = 4  # of projections
TRIALS = 8  # compressions, each with the frequencies where the one before was too bad, until nothing is compressed
SHOWN = 1e-6  # of the tolerance: what a curve that is kept shows


class Outcome(NamedTuple):
    """What a search comes to: the `factor` (m, k) from its basis to the columns that the tolerance asks for, the
    accuracy of their model, and the projections by which it is known."""

    factor: np.ndarray
    accuracy: Accuracy
    projections: Projections


def outcome_of(search: Search, drop_above=None, beside=0) -> Outcome:
    """Return what a search comes to. Collective.

    Pseudo-modes above `drop_above` (Hz) are left out, and what that does to the error counts. `beside`: coordinates of
    rigid-body motion that come later.
    """
    kept = np.eye(search.projections.basis.size)[:, : search.kept]
    with search.run.progress.stage("project"):
        kept = project_again(search, kept)
    with search.run.progress.stage("compress"):
        factor, accuracy = decided_with(search.run.model.comm, _compressed, search, drop_above, kept, beside)
    return Outcome(factor, accuracy, search.projections)


def _compressed(team, search, drop_above, kept, beside):
    judge = search.judge
    small = compress(team, judge, search.reason, drop_above, kept, beside)
    rest = judge.estimate if small.reason else min(judge.estimate, 3 * judge.floor)
    return small.factor, accuracy_of(
        search, small.reason, small.pair, small.frequencies, small.curve, largest=float(small.curve.max()) + rest,
        noise=small.noise,
    )  # fmt: skip


class Compressed(NamedTuple):
    """What a search ends with: the `factor` (m, k) from the basis to the columns of the reduced model; that model
    in the uncompressed one (`pair`), and its error (`curve`, (S,)) at frequencies (S,) in Hz; the noise; and why
    the tolerance is not reached, or ""."""

    factor: np.ndarray
    pair: Comparison
    frequencies: np.ndarray
    curve: np.ndarray
    noise: float
    reason: str


def compress(
    team: Team, judge: Judge, reason: str, drop_above: float | None, kept: np.ndarray, beside: int
) -> Compressed:
    """Return the few combinations of a basis that the tolerance asks for, after a search; on the rank of a team that
    decides.

    `reason`: why the search ended before the tolerance was reached, or "". The columns `kept` (m, c), in terms of
    those of the basis, stay in the span. Pseudo-modes above `drop_above` (Hz) are left out, and what that does to the
    error counts. `beside`: coordinates that join the model later, and count for the size. Raises InputError.
    """
    eps, est, noise = judge.settings.tolerance, judge.estimate, max(judge.noise, judge.lost)
    outer = judge.projections.model()
    whole = judge.compare(outer, outer, np.eye(len(outer)), team=team)
    goal = max(0.9 * eps - est - noise, 0.3 * eps, noise) if not reason else max(0.9 * eps, min(0.5 * est, 1.0))
    fixed = np.linalg.qr(outer.coordinates_of(kept))[0] if kept.shape[1] else kept
    pair, frequencies, curve, limited = _reach(judge, whole, goal, fixed, beside)
    reason = reason or limited
    if drop_above is not None and pair.inner.frequencies[-1] > drop_above:
        pair, frequencies, curve = _without_modes_above(drop_above, pair, frequencies, goal)
        if not reason and curve.max() + est + noise > eps:
            reason = f"without the pseudo-frequencies above {drop_above:g} Hz (drop_above)"
    noise = max(noise, float(pair.noise(frequencies).max()))
    return Compressed(outer.vectors @ pair.embedding, pair, frequencies, curve, noise, reason)


def _reach(judge, whole: Comparison, goal, fixed, beside):
    """Return the smallest model whose error stays below the goal between the frequencies as well, in the uncompressed
    one; a grid and its error on it; and why the size that was asked for does not let it, or ""; `fixed`: see
    compressed(), `beside`: see compress()."""
    settings, outer = judge.settings, whole.outer
    S, limited, most = grid([outer], settings.band), "", settings.size
    if most is not None:
        most -= beside
    for trial in range(TRIALS + 1):
        U = compressed(whole, S, goal, fixed) if trial < TRIALS else np.eye(len(outer))
        if most is not None and U.shape[1] > most:
            limited = f"with {settings.size} coordinates"
            U = compressed(whole, S, 0.0, fixed, most=most)
        pair = whole.within(U)
        fine, curve = largest(pair, grid([outer, pair.inner], settings.band, 2 * UNIFORM, FINE), LITTLE * goal)
        if curve.max() <= 1.02 * goal or (most is not None and U.shape[1] >= most):
            break
        S = np.unique(np.concatenate([S, fine[curve > 0.8 * goal]]))
    return pair, *resolved(pair, fine, curve, max(3 * judge.noise, SHOWN * settings.tolerance)), limited


def _without_modes_above(limit, pair: Comparison, frequencies, goal):
    kept = pair.inner.frequencies <= limit
    if not kept.any():
        raise InputError(f"drop_above: no pseudo-frequency lies below {limit:g} Hz")
    inner, turn = pair.inner.restricted(np.eye(len(kept))[:, kept])
    fewer = replace(pair, inner=inner, embedding=pair.embedding @ turn)
    return fewer, *largest(fewer, frequencies, LITTLE * goal)


def project_again(search, kept) -> np.ndarray:
    """Project on the pseudo-modes of the basis (see project_until_settled), whose noise is then that of the search.
    Returns the columns `kept` in terms of the new basis. Collective."""
    projections, judge, comm = search.projections, search.judge, search.run.model.comm
    before = first = decided(comm, projections.model)

    def rotated():
        nonlocal kept, before
        before = before or decided(comm, projections.model)
        projections.rotate(before.vectors)
        kept = before.coordinates_of(kept)
        search.expansion.look_at_outputs_again()  # before the noise of one that is nothing else counts
        noise, before = decided(comm, _changed, judge, before), None
        return noise

    def noise_of(count):
        again = projections.with_lowest_again(first, count)
        return decided(comm, _changed, judge, first, again)

    judge.noise = project_until_settled(
        search.run, judge, first, judge.noise, rotated, also=projections.io.quiet,
        noise_of=noise_of if projections.is_stiffness_alone else None,
    )  # fmt: skip
    return kept


def project_until_settled(run, judge, model, noise, rotated, also=False, noise_of=None) -> float:
    """Project on the pseudo-modes of a basis where its `model` lacks digits (see ask_for_digits) or has noise that
    matters, or `also` otherwise, until that changes nothing: what it changes last is the noise of the models that
    follow, which is returned. `rotated()`: does so once, and returns that change. `noise_of(count)`: what of it
    the lowest modes make, by which few of them are measured first: it is done only where that is not small. Collective.
    """
    sharp, mixed = ask_for_digits(run, judge, model)
    lacks = sharp or also or noise > judge.goal
    if not lacks and 0 < mixed <= FEW and noise_of is not None:
        measured = max(noise, noise_of(mixed))
        if measured <= SMALL * judge.goal:
            return measured
    for _ in range(PASSES if lacks or mixed else 0):
        noise = rotated()
        if noise <= LITTLE * judge.goal:
            break
    return noise


def _sharper(model, band) -> float:
    """Return by how much resonances of a band (Hz) are sharper than SHARP, at least 1."""
    f, ratios = resonances(model)
    return max(1.0, SHARP / max(ratios[(f >= band[0]) & (f <= band[1])].min(initial=SHARP), SHARPEST))


def _changed(judge, before, after=None) -> float:
    """Return how far responses of a model of all columns, by default that which is projected now, are from those of one
    projected before; local."""
    pair = judge.compare(before, judge.projections.model() if after is None else after, np.eye(len(before)))
    return changed(before, pair, judge.settings.band)


def ask_for_digits(run, judge, model) -> tuple[bool, int]:
    """Have the projections that follow keep more digits of K where resonances are sharp; return whether they are, and
    how many of the lowest modes round-off of K on the stiffest columns of a model may have mixed. Collective."""
    sharper = decided(run.model.comm, _sharper, model, judge.settings.band)
    run.cancels *= sharper
    return sharper > 1, int((~(MIXING * model.eigenvalues[-1] <= judge.goal * model.eigenvalues)).sum())


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
    accuracy = Accuracy(
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
    return accuracy.with_noise(noise)


def directions_of(pair, frequencies, band, model) -> tuple[Direction, ...]:
    """Return the accuracy of each output, the least accurate first; local."""
    by, at = measure_over(MEASURES["directions"], band, pair.outer), frequencies[:1]
    found = pair.by(by).errors(frequencies)
    H, drive = pair.responses(at)
    first = by.each(pair.difference(at), H, drive)[0], H[0]
    return directions_table(by, frequencies, found.outputs, found.worst, first, model.output_names, model.input_names)
