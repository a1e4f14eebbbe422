"""Compute Campbell diagrams: frequencies, damping and whirl of a reduced model over a parameter, and what they show."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..model.rotation import unit_axis
from ..parallel.decisions import decided
from ..parallel.declared import declared, refuse_file, spelled
from ..parallel.failures import InputError
from ..parallel.petsc import MPI
from ..parallel.ranges import ANYTHING, within
from ..reduction.result.maxwell_states import maxwell_states
from .campbell_diagram import SPEEDS, Campbell, CriticalSpeed
from .pole_tracking import ZERO, PoleTracker, damping_ratios, growth_of
from .whirl import are_seen, in_words, motions_of, orbits

POINTS = 41  # values over a range
MODES = 12  # drawn where no highest frequency is given
EXACT = 1e-10  # of the range: how well limits and critical speeds are found


@spelled
def campbell(
    model, over: str = "omega", values: ArrayLike | None = None, *, at: dict[str, float] | None = None, nodes=(),
    axis="z", orders: Sequence[float] = (1.0,), highest: float | None = None, unit: str | None = None,
) -> Campbell:  # fmt: skip
    """Return the poles of a reduced model over a parameter, followed from value to value. Collective.

    Parameters
    ----------
    model : ParametricReducedModel
        Or another object whose `at(omega=...)` is a ReducedModel in the same coordinates for all values.
    over : str, default "omega"
        The parameter.
    values : array_like, shape (V,), optional
        Its values, ascending; by default 41 over its range.
    at : dict of str to float, optional
        Values of the other parameters; by default those of reference.
    nodes : iterable of NodeShape, optional
        Nodes whose orbits tell the direction of whirl, with shapes in the coordinates of the model.
    axis : str or array_like, shape (3,), default "z"
        The axis of rotation: x, y, z or a vector; the rotation is positive about it.
    orders : sequence of float, default (1,)
        Multiples of the speed whose crossings with modes are critical speeds, where the parameter is a speed.
    highest : float, optional
        Frequency in Hz up to which modes are shown; by default that of the twelfth mode.
    unit : str, optional
        Of the parameter; by default its own, and rad/s for omega without one. A speed is in rad/s, rpm or Hz.

    Raises
    ------
    InputError
        For unknown parameters, values that do not ascend, structural damping, which has no poles, and fractional laws,
        which have no states.

    Notes
    -----
    Modes that keep their shapes while their frequencies come closer than a thousandth cross; others veer. Steps are
    halved where this, or which mode goes on as which, is not yet clear.

    Maxwell elements of added terms are states. Poles with a damping ratio above 0.9 count as their relaxations,
    which the diagram leaves out.
    """
    refuse_file("model", model, "campbell_file")
    known = {parameter.name: parameter for parameter in getattr(model, "parameters", ())}
    if known and over not in known:
        raise InputError(f"over: found the parameter '{over}', expected one of {', '.join(known)}")
    if over in (at or ()):
        raise InputError(f"at: found a value of {over}, which the diagram is over; leave it out")
    values = _checked_values(values, over, known)
    if unit is None:
        unit = known[over].unit if over in known else ""
        unit = unit or ("rad/s" if over == "omega" else "")
    orders = declared("orders", orders, tuple[float, ...])
    within("orders", orders, (1e-6, 1e6, ""))
    highest = declared("highest", highest, float | None)
    within("highest", highest, (1e-9, 1e12, "Hz"))
    axis = unit_axis("axis", axis)
    matrices = _matrices_of(model, over, dict(at or {}))
    shapes = motions_of(list(nodes))
    return decided(MPI.COMM_WORLD, _campbell, matrices, values, shapes, axis, orders, highest, over, unit)


def _checked_values(values, over, known):
    if values is None:
        if over not in known:
            raise InputError("values: the model has no range of the parameter; give its values")
        values = np.linspace(*known[over].range, POINTS)
    values = np.array(declared("values", values, tuple[float, ...]))
    within("values", values.tolist(), ANYTHING)
    if len(values) < 2 or (np.diff(values) <= 0).any():
        raise InputError(f"values: found {len(values)} values of {over}, expected at least 2 that ascend")
    return values


def _matrices_of(model, over, fixed) -> Callable:
    """Return a function of a value that gives M, D, K in the same coordinates for all values, and MaxwellStates where
    there are added terms."""

    def matrices(value):
        point = fixed | {over: float(value)}
        reduced = model if hasattr(model, "matrices") else model.at(**point)
        if reduced.loss_factor:
            raise InputError(
                f"damping: structural damping (loss factor {reduced.loss_factor:g}) has no poles; reduce with damping "
                f"of kind 'modal' and ratio = {reduced.loss_factor / 2:g}, which is the same at resonance"
            )
        added = getattr(reduced, "added", ())
        elements = [maxwell_states(added, "a Campbell diagram")] if added else []
        if reduced is not model:
            return reduced.M, reduced.D, reduced.K, *elements
        at_value = model.matrices(point)  # at() has coordinates of its own at each value
        return at_value["M"], at_value["D"], at_value["K"], *elements

    return matrices


def _campbell(matrices, values, shapes, axis, orders, highest, over, unit) -> Campbell:
    tracker = PoleTracker(matrices, values[0], np.inf)
    # up to where poles are followed: a little above the lowest ones at both ends
    if highest is None:
        ends = [np.sort(tracker.at(value).poles.imag) for value in values[[0, -1]]]
        highest = 1.05 * max(end[:MODES].max(initial=0.0) for end in ends) / (2 * np.pi) or 1.0
    tracker.limit = 2 * np.pi * highest
    steps, branches, unsure = tracker.over(values)
    # columns of the branches that come below the limit somewhere
    chosen = _shown(steps, branches, tracker.limit)
    column = {branch: k for k, branch in enumerate(chosen)}
    poles = np.full((len(steps), len(chosen)), np.nan + 1j * np.nan)
    round_ = np.full(poles.shape, np.nan)
    speed = SPEEDS.get(unit)
    for row, (step, numbers) in enumerate(zip(steps, branches, strict=True)):
        there = np.flatnonzero(np.isin(numbers, chosen))
        columns = [column[number] for number in numbers[there]]
        poles[row, columns] = step.poles[there]
        round_[row, columns] = _orbits(step, shapes, axis, speed)[there]
    # what the branches cross: stability, and the lines of orders
    warnings = []
    if unsure:
        listed = ", ".join(f"{value:.6g}" for value in unsure[:5])
        warnings.append(f"at {over} = {listed} the smallest step does not tell which mode goes on as which")
    limit, unstable = _stability(tracker, steps)
    critical = () if speed is None else _critical(tracker, steps, branches, column, orders, speed, shapes, axis)
    above = [step.value for step in steps if limit is None and growth_of(step, np.inf)[0] > 0]
    if above:
        warnings.append(
            f"at {over} = {above[0]:.6g} a pole above {highest:.6g} Hz is unstable, which may be one of the reduction"
        )
    return Campbell(
        parameter=over, unit=unit, values=np.array([step.value for step in steps]), poles=poles, orbits=round_,
        highest=highest, orders=() if speed is None else orders,
        stability_limit=limit, unstable_frequency=unstable, critical_speeds=critical, warnings=tuple(warnings),
    )  # fmt: skip


def _shown(steps, branches, limit) -> list[int]:
    """Return the branches that come below the limit: those of the first value, by frequency, and then those that begin
    later, but for second zeros, as a mode has them where it passes zero."""
    first, moving, low = {}, set(), set()
    for row, (step, numbers) in enumerate(zip(steps, branches, strict=True)):
        for number, pole in zip(numbers.tolist(), step.poles, strict=True):
            if abs(pole) > ZERO * step.size:
                moving.add(number)
            first.setdefault(number, (row, pole.imag, number))
            if pole.imag <= limit:
                low.add(number)
    begun_as_zero = {number for number in low - moving if first[number][0] > 0}
    return sorted(low - begun_as_zero, key=first.get)


def _orbits(poles, shapes, axis, speed):
    """Return the orbits (u,) of the poles of a value, in the sense of the rotation where there is one."""
    if not len(shapes):
        return np.full(len(poles.poles), np.nan)
    motions = np.tensordot(shapes, poles.shapes, (2, 0))
    sizes = np.where(are_seen(motions, poles.poles), orbits(motions, axis), np.nan)
    sense = np.sign(poles.value) if speed is not None and poles.value else 1.0
    # modes of one frequency have no orbits of their own, and what does not vibrate has none
    return np.where(poles.single & (poles.poles.imag > 0), sense * sizes, 0.0)


def _stability(tracker, steps) -> tuple[float | None, float | None]:
    """Return the first value where a pole crosses the imaginary axis, and its frequency in Hz."""
    growths = [growth_of(step, tracker.limit)[0] > 0 for step in steps]
    if True not in growths:
        return None, None
    place = growths.index(True)
    high = steps[place].value
    if place:
        low = steps[place - 1].value
        while high - low > EXACT * (steps[-1].value - steps[0].value):
            middle = (low + high) / 2
            low, high = (low, middle) if tracker.growth(middle)[0] > 0 else (middle, high)
    return high, abs(tracker.growth(high)[1].imag) / (2 * np.pi)


def _critical(tracker, steps, branches, column, orders, speed, shapes, axis) -> tuple[CriticalSpeed, ...]:
    """Return where modes cross the lines of the orders."""
    critical = []
    for before, after, numbers, following in zip(steps, steps[1:], branches, branches[1:], strict=False):
        for i, number in enumerate(numbers):
            j = np.flatnonzero(following == number)
            if number not in column or not len(j):
                continue
            for order in orders:
                ends = [step.poles[k].imag - abs(order * speed * step.value)
                        for step, k in ((before, i), (after, j[0]))]  # fmt: skip
                if ends[0] == 0 or (ends[0] > 0) == (ends[1] > 0) or before.value * after.value < 0:
                    continue
                step, k = _crossing(tracker, before, after, i, order * speed)
                pole = step.poles[k]
                if abs(pole) < ZERO * step.size:  # a free motion, whose frequency is round-off
                    continue
                critical.append(CriticalSpeed(
                    order=order, mode=column[number], value=step.value, frequency=pole.imag / (2 * np.pi),
                    damping_ratio=float(damping_ratios(pole)), whirl=in_words(_orbits(step, shapes, axis, speed)[k]),
                ))  # fmt: skip
    return tuple(sorted(critical, key=lambda crossing: (crossing.order, crossing.value)))


def _crossing(tracker, before, after, place, factor):
    """Return the poles where the mode at a place before crosses the line, and its place there."""

    def at(value):
        step, places, _ = tracker.next(before, value)
        return step, places[place]

    def difference(value):
        if value == before.value:
            return before.poles[place].imag - abs(factor * value)
        step, k = at(value)
        return step.poles[k].imag - abs(factor * value)

    width = after.value - before.value
    return at(scipy.optimize.brentq(difference, before.value, after.value, xtol=EXACT * width, rtol=1e-12))
