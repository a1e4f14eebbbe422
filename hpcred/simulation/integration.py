"""Integrate the equations of motion in time by Radau IIA of order 5, with steps of its own choice or of a given length.

The error of a velocity counts by the displacement that it makes in a step: in a stiff mode of frequency omega a
displacement below the tolerance comes with a velocity omega times as large, which would ask for the shortest steps of
all. Vibrations below the tolerance are not followed but damped numerically, since the method is L-stable. Source: E.
Hairer and G. Wanner, Solving Ordinary Differential Equations II, Springer, 1996, IV.8 and VII.4 (variables of higher
index are scaled by powers of the step).
"""

from __future__ import annotations

import time

import numpy as np

from ..body.rotations import rotation
from ..parallel.failures import ComputationError, InputError
from ..parallel.progress import in_time

MOST_STEPS = 1e8  # that a simulation may need; they take weeks
FIRST_STEP = 1e-2  # of the longest; one that the integrator guesses may be so short that round-off ends it
STEPS_OF_A_TURN = 8
FEW_EVALUATIONS, MOST_EVALUATIONS = 5000, 3e9  # of the equations of motion, 30 a step
FEW_STEPS = 5000  # by which the pace of the integrator is known
MOST_TWIST = 3.0  # rad; rotation vectors go round at pi
ANY_ERROR = 1e20  # times the tolerance, which steps of a given length may have
NEWTON = 1e-3  # of the tolerance, to which their equations are solved


def integrate(system, setup, y0, yp0, limits, progress):
    """Return output times (nt,), states and rates (size, nt), and the fields of a Motion on the integrator's work.

    `limits` (t, y) is called at each step.
    """
    solver = _solver(system, setup, y0, yp0, pace := Pace(setup.end, progress))
    twists, velocities = _Twists(system), system.split(solver.atol)[3]
    tolerance, reason = velocities.copy(), None
    outputs = np.linspace(0, setup.end, setup.steps + 1)
    states, rates, done = [y0[:, None]], [yp0[:, None]], 1
    while solver.status == "running":
        # a velocity errs by as much as the displacement that it makes in the step
        velocities[:] = tolerance / solver.h_abs
        reason = solver.step()
        if solver.status == "failed":
            break
        for watch in (pace.stepped, twists, limits):
            watch(solver.t, solver.y)
        if (until := int(np.searchsorted(outputs, solver.t, side="right"))) > done:
            values = solver.dense_output()(outputs[done:until])
            for kept, value in zip((states, rates), values, strict=True):
                kept.append(value)
            done = until
    if solver.status == "failed":
        stopped = (
            f"the integrator stopped at t = {solver.t:.4g} s: {reason.rstrip('.')}; look for loads, drives and "
            "velocities that are too large, loosen the tolerances, damp vibrations above the band (damp_above), or "
            "leave out pseudo-modes far above it (drop_above of the reduction)"
        )
        raise ComputationError("; ".join([*limits.warnings, stopped]))
    work = {"integrator_steps": pace.steps, "factorisations": int(solver.nlu)}
    return outputs, np.hstack(states), np.hstack(rates), work


def _solver(system, setup, y0, yp0, pace):
    """Return the integrator at the start. Raises InputError for loads and drives that need too many steps."""
    try:
        from scipy_dae.integrate import RadauDAE
    except ImportError as error:
        raise InputError("a simulation needs scipy_dae: pip install 'hpcred[simulate]'") from error

    def residual(t, y, yp):
        pace.evaluated()
        return system.residual(t, y, yp)

    # a pulse must not be stepped over
    moving = (*setup.force, *setup.moment, *setup.load, *setup.drive)
    longest = min([setup.end / 20, *(mover.longest_step(setup.end) for mover in moving)])
    for steps, events in ((setup.end / longest, "the fastest load or drive"), (_steps_of_turns(setup), "its turns")):
        if steps > MOST_STEPS:
            raise _too_many(f"end = {setup.end:g} s takes {steps:.1e} steps of {events}", "leave out what is so fast")
    # impulses begin at zero, and their rates, the forces, have round-off relative to their own size
    tolerance = np.full(len(y0), setup.absolute_tolerance)
    forces = system.split(yp0)[4]
    system.split(tolerance)[4][:] *= max(1.0, np.abs(forces).max(initial=0.0))
    # those of dashpots are L^T q
    system.split(tolerance)[6][:] *= np.linalg.norm(system.elements.L, axis=0)
    first, any_error = FIRST_STEP * longest, 1.0
    if setup.damp_above is not None:
        first = longest = min(longest, step_of(setup.damp_above))
        if setup.end / longest > MOST_STEPS:
            raise _too_many(f"damp_above = {setup.damp_above:g} takes {setup.end / longest:.1e} steps", "lower it")
        any_error = ANY_ERROR
    solver = RadauDAE(
        residual, 0.0, y0, yp0, setup.end, jac=system.jacobians, max_step=longest, first_step=first,
        rtol=setup.relative_tolerance * any_error, atol=tolerance * any_error,
    )  # fmt: skip
    if setup.damp_above is not None:
        solver.newton_tol = NEWTON / any_error
    return solver


def step_of(frequency: float) -> float:
    """Return the step (s) that follows vibrations up to a frequency (Hz) and damps those above: omega times it is 1.

    The method multiplies an amplitude in a step by 0.99986 there, 0.993 at twice, 0.83 at four times and 0.32 at ten
    times the frequency; see `amplification`.
    """
    return 1 / (2 * np.pi * frequency)


def amplification(z):
    """Return R(z) of Radau IIA of order 5, the factor of a step of length h for y' = lambda y with z = lambda h."""
    return (1 + 2 * z / 5 + z**2 / 20) / (1 - 3 * z / 5 + 3 * z**2 / 20 - z**3 / 60)


def note_on_damping(setup) -> str:
    """Return a sentence on what `damp_above` does."""
    lost = [100 * (1 - abs(amplification(1j * times)) ** (2 * np.pi / times)) for times in (1, 2, 4)]
    return (
        f"damp_above: steps of {step_of(setup.damp_above):.3g} s whatever their error, by which a vibration loses "
        f"{lost[0]:.1g} % of its amplitude a period at {setup.damp_above:g} Hz, {lost[1]:.1g} % at twice and "
        f"{lost[2]:.2g} % at four times that frequency"
    )


def _steps_of_turns(setup) -> float:
    """Return about how many steps rotations take: those of the drives, and that of a body on which nothing else
    acts."""
    turned = sum(drive.travel(setup.end) for drive in setup.drive if drive.about is not None)
    if not (setup.constraint or setup.drive):
        turned += float(np.linalg.norm(setup.angular_velocity)) * setup.end
    return STEPS_OF_A_TURN * turned / (2 * np.pi)


def _too_many(steps: str, advice: str, most=MOST_STEPS) -> InputError:
    return InputError(f"{steps}, expected at most {most:.0e}; end earlier, or {advice}")


class Pace:
    """Tells how far a simulation is, and refuses one whose steps stay so short, or fail so often, that it takes far too
    many.

    `stepped` is called at each step that is taken; `evaluated` counts all residuals, also those of steps that are tried
    in vain.
    """

    def __init__(self, end, progress):
        self.end, self.t, self.progress = end, 0.0, progress
        self.steps, self.evaluations, self.last = 0, 0, {}
        self.shown, self.begun = -1, time.perf_counter()

    def stepped(self, t, y):
        self.steps, self.t = self.steps + 1, t
        if int(20 * t / self.end) > self.shown:
            self.shown = int(20 * t / self.end)
            passed = time.perf_counter() - self.begun
            left = f", about {in_time(passed * (self.end / t - 1))} left" if self.shown else ""
            self.progress.say(f"t = {t:.4g} s of {self.end:g} s, {self.steps} steps{left}", minor=True)
        self._check(self.steps, FEW_STEPS, "steps", MOST_STEPS)

    def evaluated(self):
        self.evaluations += 1
        self._check(self.evaluations, FEW_EVALUATIONS, "evaluations of the equations", MOST_EVALUATIONS)

    def _check(self, count, few, what, most):
        if count % few:
            return
        passed, self.last[what] = self.t - self.last.get(what, 0.0), self.t
        left = (self.end - self.t) * few / max(passed, 1e-300)
        if left > most:
            raise _too_many(
                f"t = {self.t:.4g} s was reached in {count} {what}, the last {few} of which took {passed:.1e} s, so "
                f"that end = {self.end:g} s takes {left:.1e} more", "look for loads, gravity and velocities that are "
                "too large, or damp what vibrates so fast (damp_above; drop_above of the reduction leaves it out)",
                most,
            )  # fmt: skip


class _Twists:
    """Refuses bushings which a step twists too far, also between output times.

    Rotation vectors go round at pi: one that a step takes beyond comes back from the other side.
    """

    def __init__(self, system):
        self.system, self.last = system, [np.zeros(3)] * len(system.springs)

    def __call__(self, t, y):
        if not self.system.springs:
            return
        r, p, q, *_ = self.system.split(y)
        motions = self.system.node_motions(r, rotation(p), q)
        for k, spring in enumerate(self.system.springs):
            twist = spring.twist(motions[spring.shape.node].R)
            if max(np.linalg.norm(twist), np.linalg.norm(twist - self.last[k])) > MOST_TWIST:
                raise ComputationError(
                    f"spring: the bushing at node {spring.shape.label} was twisted by more than {MOST_TWIST:g} rad at "
                    f"t = {t:.4g} s, and knows no larger rotations; stiffen it, or load it less"
                )
            self.last[k] = twist
