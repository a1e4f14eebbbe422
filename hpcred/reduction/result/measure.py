"""Measure the error of responses: without units and for each direction, or as the paper does (55).

With E = H - Hr the error of output j under input i at a frequency f is

    |E_ji(f)| / (h_j(f) g_i(f)),     eps(f) = the largest of them,

where g_i^2 = max(|b_i^T A^-1 b_i|, floor_i) is the drive-point response of the input. An output that measures where an
input acts has h_j = g_i of that input. Any other has h_j = max(max_i |H_ji| / g_i, floor_j), its largest response.
A floor is the median over the band, or the value at 0 Hz if that is smaller: it bounds eps at zeros. See
docs/theory/error.md. The paper's eps (55) is ||E||_F / ||H||_F.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Literal

import numpy as np
from pydantic import PlainSerializer, PlainValidator

from ...parallel.failures import InputError
from .kinds import UnknownKind, from_table, table_of

PARALLEL = 1e-9  # sine of the angle between a load and a measure of the same direction
STATIC = 1e-3  # of the median, below which a response at 0 Hz is a zero and no floor
SILENT = 1e-13  # of |C_j| |x|, below which an output does not feel the states x, but for round-off
TINY = 1e-300  # least floor
IDLE = 1e300  # floor of an input that moves nothing, beside which no error counts
NO_INPUT, FEELS_NOTHING = -1, -2  # of an output that no input acts at, and of one that feels no input


class Measure(ABC):
    """Base class of error measures; derive from it to add another, as a frozen dataclass with a field `kind`.

    eps(f) is `total` of the errors |E_ji| / (h_j g_i) of all responses, with the `scales` h and g. An instance is the
    argument `measure` of hpcred.reduce.
    """

    kind: str

    @abstractmethod
    def scales(self, H: np.ndarray, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return h (S, r) and g (S, p), of the responses H (S, r, p) and the drive-point responses `drive` (S, p)."""

    def over(self, frequencies, H, drive, drive_of, silent=()) -> Measure:
        """Return the measure with what it takes from responses over a band (see directions); by default nothing.

        Parameters
        ----------
        frequencies : ndarray, shape (S,)
            Hz.
        H : ndarray, complex, shape (S, r, p)
            Responses there.
        drive : ndarray, complex, shape (S, p)
            Drive-point responses of the inputs.
        drive_of
            Which input each output is collocated with.
        silent
            Inputs and outputs that move nothing.
        """
        return self

    def total(self, each: np.ndarray) -> np.ndarray:
        """Return eps (S,) of the errors of `each` response (S, r, p); by default the largest."""
        return each.max(axis=(1, 2), initial=0.0)

    def times(self, inputs: float, outputs: float) -> Measure:
        """Return the measure of responses whose `inputs` (p,) and `outputs` (r,) are multiplied by these factors."""
        return self

    @property
    def floors(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The least h (r,) and g (p,) that scales() gives, where there is one."""
        return None

    @property
    def silent(self) -> tuple[int, ...]:
        """The outputs (from 0) that feel no input, and do not count."""
        return ()

    def each(self, E: np.ndarray, H: np.ndarray, drive: np.ndarray) -> np.ndarray:
        """Return the error of every response (S, r, p), for errors E (S, r, p) of the responses H; `drive`: see scales.
        """
        return self.scaled(E, *self.scales(H, drive))

    @staticmethod
    def scaled(E: np.ndarray, h: np.ndarray, g: np.ndarray) -> np.ndarray:
        """Return |E_ji| / (h_j g_i) (S, r, p), for errors E (S, r, p) and scales h (S, r), g (S, p)."""
        if (h > 0).all() and (g > 0).all():
            each = np.abs(E)
            each /= h[:, :, None]
            each /= g[:, None, :]
            return each
        return _divided(_divided(np.abs(E), h[:, :, None]), g[:, None, :])

    def eps(self, E: np.ndarray, H: np.ndarray, drive: np.ndarray) -> np.ndarray:
        """Return eps (S,) of E, H and `drive`, see each; 0 where E and H vanish."""
        return self.total(self.each(E, H, drive))


@dataclass(frozen=True)
class UnknownMeasure(UnknownKind, Measure):
    """A measure whose class is not known here, as of a result that another program made."""

    def scales(self, H, drive):
        raise InputError(f"measure: found the kind '{self.kind}', whose class is not known here; import it first")


@dataclass(frozen=True, kw_only=True)
class Paper(Measure):
    """||E||_F / ||H||_F (55)."""

    kind: Literal["paper"] = "paper"

    def scales(self, H, drive):
        size = np.sqrt(np.linalg.norm(H, axis=(1, 2)))[:, None]
        return np.broadcast_to(size, H.shape[:2]), np.broadcast_to(size, H.shape[::2])

    def total(self, each):
        return np.linalg.norm(each, axis=(1, 2))


PAPER = Paper()


@dataclass(frozen=True, kw_only=True)
class Directions(Measure):
    """Each response over the drive points of its input and output.

    `inputs` (p,): floors of the drive-point responses |b_i^T A^-1 b_i|. `drive` (r,): the input (from 0) where an
    output measures, else NO_INPUT or FEELS_NOTHING. `outputs` (r,): |c_j| / |b_i| of a drive point, and the floor of
    any other output. All are empty before over().
    """

    kind: Literal["directions"] = "directions"
    inputs: tuple[float, ...] = ()
    outputs: tuple[float, ...] = ()
    drive: tuple[int, ...] = ()

    def over(self, frequencies, H, drive, drive_of, silent=()):
        known = directions(frequencies, H, drive, drive_of, silent)
        # an input that moves nothing elastic, which a warning names, has no response that could be wrong
        return replace(known, inputs=tuple(value or IDLE for value in known.inputs))

    def scales(self, H, drive):
        g = np.sqrt(np.maximum(np.abs(drive), self.inputs))
        h = np.maximum(_divided(np.abs(H), g[:, None, :]).max(axis=2, initial=0.0), self.outputs)
        which = np.array(self.drive, dtype=int)
        at = which >= 0
        h[:, at] = g[:, which[at]] * np.array(self.outputs)[at]
        h[:, which == FEELS_NOTHING] = np.inf
        return h, g

    def times(self, inputs, outputs):
        at = np.array(self.drive, dtype=int) >= 0
        scales = np.array(self.outputs) * np.where(at, outputs / inputs, outputs)
        floors = np.clip(np.array(self.inputs) * inputs * inputs, TINY, IDLE)
        return replace(self, inputs=tuple(floors.tolist()), outputs=tuple(scales.tolist()))

    @property
    def floors(self):
        g, which = np.sqrt(np.array(self.inputs)), np.array(self.drive, dtype=int)
        h = np.array(self.outputs)
        h[which >= 0] *= g[which[which >= 0]]
        return h, g

    @property
    def silent(self):
        return tuple(j for j, which in enumerate(self.drive) if which == FEELS_NOTHING)


MEASURES = {item.kind: item for item in (Directions(), PAPER)}  # by the words of a job file
AnyMeasure = Annotated[  # in records
    Measure, PlainValidator(partial(from_table, Measure, UnknownMeasure)), PlainSerializer(table_of)
]


def measure_called(word: str | Measure) -> Measure:
    """Return the measure that a word of a job file stands for, or the one given. Raises InputError."""
    if isinstance(word, Measure):
        return word
    if word not in MEASURES:
        raise InputError(f"measure: found {word!r}, expected {' or '.join(map(repr, MEASURES))}")
    return MEASURES[word]


def directions(frequencies, H, drive, drive_of, silent=()) -> Directions:
    """Return the measure by directions, with floors from responses at frequencies (U,) in Hz, ascending, over a band.

    H (U, r, p), drive (U, p); `drive_of` (r,): the input at each output and the ratio of the two (see drive_points);
    `silent`: outputs that feel no input.
    """
    which, ratio = drive_of
    which = np.array(which, dtype=int)
    which[list(silent)] = FEELS_NOTHING
    inputs = _floors(frequencies, np.abs(drive))
    g = np.sqrt(np.maximum(np.abs(drive), inputs))
    outputs = _floors(frequencies, _divided(np.abs(H), g[:, None, :]).max(axis=2, initial=0.0))
    outputs = np.where(which >= 0, ratio, np.where(which == FEELS_NOTHING, 0.0, outputs))
    return Directions(inputs=tuple(inputs.tolist()), outputs=tuple(outputs.tolist()), drive=tuple(which.tolist()))


def silent_outputs(C: np.ndarray, states) -> list[int]:
    """Return the outputs (from 0) that feel no input: |c x| is round-off of |c| |x|, for C (r, m) and all arrays of
    `states` x (S, m, p)."""
    feels, size = np.zeros(len(C), dtype=bool), np.linalg.norm(C, axis=1)[:, None]
    for x in states:
        bound = size * np.linalg.norm(x, axis=1)[:, None, :]
        feels |= (np.abs(C @ x) > SILENT * bound).any(axis=(0, 2))
    return np.flatnonzero(~feels).tolist()


def drive_points(B: np.ndarray, Ct: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for each output, a column of Ct (k, r), the input, a column of B (k, p), that acts where it measures, or
    NO_INPUT, and the ratio |c_j| / |b_i| (r,)."""
    if Ct is B or (Ct.shape == B.shape and (Ct == B).all()):
        return np.arange(B.shape[1]), np.ones(B.shape[1])
    b, c = (np.linalg.norm(matrix / _largest(matrix), axis=0) * _largest(matrix) for matrix in (B, Ct))
    unit_b, unit_c = _divided(B, b), _divided(Ct, c)
    cosine = unit_c.T @ unit_b  # (r, p)
    which = np.abs(cosine).argmax(axis=1) if B.shape[1] else np.zeros(len(cosine), dtype=int)
    best = cosine[np.arange(len(cosine)), which]
    apart = np.linalg.norm(unit_c - unit_b[:, which] * best, axis=0)
    parallel = (apart < PARALLEL) & (c > 0)
    ratio = np.where(parallel, _divided(c, b[which]), 1.0)
    return np.where(parallel, which, NO_INPUT), ratio


def _largest(matrix):
    largest = np.abs(matrix).max(axis=0, initial=0.0)
    return np.where(largest > 0, largest, 1.0)


def _floors(frequencies, size):
    """Return the medians of responses (U, k) over the band, or the values at 0 Hz if smaller and not zero."""
    finite = np.isfinite(size)
    median = np.median if finite.all() else np.nanmedian  # which goes column by column
    floors = np.nan_to_num(median(np.where(finite, size, np.nan), axis=0))
    if frequencies[0] == 0:
        static = np.where(np.isfinite(size[0]), size[0], np.inf)
        floors = np.where(static > STATIC * floors, np.minimum(floors, static), floors)
    return floors


def _divided(values, by):
    """Return values / by, 0 for 0 / 0."""
    values, by = np.broadcast_arrays(values, by)
    return np.divide(values, by, out=np.where(values != 0, np.inf, 0.0).astype(values.dtype), where=by != 0)
