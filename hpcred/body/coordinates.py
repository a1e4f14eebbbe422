"""The reduced coordinates of a body over time, whatever program computed them, and perhaps the motion of its frame."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np

from ..parallel.failures import InputError

FEWEST = 3  # instants of a difference of second order
SAME_OUTPUT = 1e-6  # of the largest value: what is left of the digits of a table
LARGEST = 1e150  # of numbers in any units, so that their squares are numbers
SAME_TIME = 1e-9  # of the largest time: a limit that somebody typed


@dataclass(frozen=True, kw_only=True)
class FrameMotion:
    """The motion of the body frame at nt instants: `position` (nt, 3) of its origin in m, in inertial axes,
    `quaternion` (nt, 4), scalar first, velocities (nt, 3) in body axes, and the rates of change of their components
    there."""

    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray | None = None
    angular_velocity: np.ndarray | None = None
    acceleration: np.ndarray | None = None
    angular_acceleration: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class Coordinates:
    """Reduced coordinates `q` (nt, m) at instants `t` (nt,) in s, ascending: plain arrays, the same on all ranks.

    Perhaps with their velocities and accelerations (nt, m), and the motion of the `frame`, None where it is at rest or
    not known. `basis`: the digest of the basis that they belong to, where it is known. `outputs`: values (nt,) by name,
    which must be C q. `remarks`: what a reader of the results should know.
    """

    t: np.ndarray
    q: np.ndarray
    velocity: np.ndarray | None = None
    acceleration: np.ndarray | None = None
    frame: FrameMotion | None = None
    basis: str = ""
    outputs: dict = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def require_sound(self, path):
        """Raise InputError for numbers that are not finite, and for instants that do not ascend."""
        if not len(self.t):
            raise InputError(f"{path}: found no instants, expected at least one")
        arrays = {"t": self.t, "q": self.q, "velocity": self.velocity, "acceleration": self.acceleration}
        arrays |= {f"frame {key}": value for key, value in vars(self.frame).items()} if self.frame else {}
        for key, array in arrays.items():
            if array is not None and not (np.abs(array) <= LARGEST).all():
                first = np.argwhere(~(np.abs(array) <= LARGEST))[0]
                wrong = f"beyond +-{LARGEST:g}" if np.isfinite(array[tuple(first)]) else "not finite"
                raise InputError(
                    f"{path}: {key} is {wrong} at instant {first[0] + 1} of {len(self.t)}, expected finite numbers"
                )
        if (np.diff(self.t) <= 0).any():
            k = int(np.argmax(np.diff(self.t) <= 0))
            raise InputError(f"{path}: found t = {self.t[k + 1]:g} s after {self.t[k]:g} s, expected instants that "
                             "ascend; leave out the others")  # fmt: skip

    def require_outputs(self, path, rows: dict):
        """Raise InputError where recorded outputs are not those of the coordinates; `rows` (m,) of C by their names."""
        for name in sorted(set(rows).intersection(self.outputs)):
            values, expected = self.outputs[name], self.q @ rows[name]
            wrong = np.abs(values - expected)
            if not wrong.max() <= SAME_OUTPUT * max(np.abs(values).max(), np.abs(expected).max()):
                k = int(np.argmax(wrong))
                raise InputError(f"{path}: {name} is {values[k]:.6g} at {self.t[k]:g} s, and {expected[k]:.6g} by the "
                                 "coordinates; the motion is that of another body")  # fmt: skip

    def with_rates(self, path, velocity: bool, acceleration: bool) -> Coordinates:
        """Return these with the rates that are wanted, by differences where they are not given.

        Raises InputError for too few instants.
        """
        added, remarks = {}, []
        if (velocity or acceleration) and self.velocity is None:
            added["velocity"] = self._difference(path, self.q, "velocities", "coordinates", remarks)
        if acceleration and self.acceleration is None:
            rates = added.get("velocity", self.velocity)
            added["acceleration"] = self._difference(path, rates, "accelerations", "velocities", remarks)
        if acceleration and self.frame and self.frame.acceleration is None:
            names = (("acceleration", "velocity"), ("angular_acceleration", "angular_velocity"))
            rates = {key: self._difference(path, getattr(self.frame, of), f"{key.replace('_', ' ')}s of the frame",
                                           "velocities", remarks) for key, of in names}  # fmt: skip
            added["frame"] = replace(self.frame, **rates)
        return replace(self, **added, remarks=(*self.remarks, *remarks))

    def _difference(self, path, values, rates, of, remarks):
        if len(self.t) < FEWEST:
            raise InputError(
                f"{path}: found {len(self.t)} instant{'s' * (len(self.t) > 1)} and no {rates}, which differences give "
                f"from {FEWEST} on; give more instants, or ask for displacements only"
            )
        remarks.append(f"{rates} by differences of the {of} over time, of second order in the step, since {path} has "
                       "none")  # fmt: skip
        return np.gradient(values, self.t, axis=0, edge_order=2)

    def thinned(self, path, first, last, every) -> Coordinates:
        """Return one of `every` instants from `first` to `last` (s). Raises InputError where none is left."""
        slack = SAME_TIME * np.abs(self.t).max()
        low = -np.inf if first is None else first - slack
        high = np.inf if last is None else last + slack
        chosen = np.flatnonzero((self.t >= low) & (self.t <= high))[::every]
        if not len(chosen):
            raise InputError(f"{path}: no instant from {low:g} to {high:g} s, found {self.t[0]:g} to {self.t[-1]:g} s")
        return replace(self, **_taken(self, chosen, ("t", "q", "velocity", "acceleration")),
                       frame=self.frame and replace(self.frame, **_taken(self.frame, chosen)),
                       outputs={key: value[chosen] for key, value in self.outputs.items()})  # fmt: skip


def _taken(table, chosen, keys=None) -> dict:
    keys = keys or [attribute.name for attribute in fields(table)]
    return {key: getattr(table, key)[chosen] for key in keys if getattr(table, key) is not None}
