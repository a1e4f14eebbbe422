"""Define the settings of a reduction to a tolerance, and its accuracy: points, proofs and the estimated error."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from ...linalg.known import ModeCount, Source
from ...model.second_order_model import listed
from ...parallel.as_html import as_html
from ...parallel.declared import renamed
from .directions import Direction, rows_of_directions
from .measure import PAPER, AnyMeasure, Paper
from .parameter_accuracy import ParameterAccuracy, in_words

ROUND_OFF = "limited by round-off"  # why a search ended
PERCENT = 1e-6  # tolerance below which errors are not in percent, and percentage below which these have an exponent
WORST = 5  # directions that are shown where nobody asks for all
NAMED = 3  # outputs that a warning names


@dataclass(frozen=True, kw_only=True)
class Point:
    """An expansion point (Hz) of the search: columns that it brought, the `factors` that were made for it and their
    seconds, modes below it (by the negative pivots, None where there are none), and the estimate over the band after
    it, None without one. `factor_of`: the point (Hz) whose factor it was solved with, if not its own. `from_store`: its
    own would have served, but all was there. `source`: of the count of modes, None in files of earlier versions."""

    frequency: float
    columns: int
    factor_seconds: float
    modes_below: int | None
    estimate: float | None = None
    factors: int | None = None
    from_store: bool = False
    factor_of: float | None = None
    source: Source | None = None

    @property
    def count(self) -> ModeCount | None:
        """The count of modes below it, None without one whose source is known."""
        if self.modes_below is None or self.source is None:
            return None
        return ModeCount(modes=self.modes_below, below=self.frequency, source=self.source)

    @property
    def factor_in_words(self) -> str:
        """Which factor it was solved with."""
        if self.factors or (self.factors is None and not self.from_store):
            return f"{self.factor_seconds:.3g} s"
        return "from the store" if self.from_store or self.factor_of is None else f"that of {self.factor_of:.6g} Hz"


@dataclass(frozen=True, kw_only=True)
class Proof:
    """At a new point (Hz): the error of the model before it, as it was `estimated` and as it is `measured` there, and
    the `uncertainty` of the measured one."""

    frequency: float
    estimated: Annotated[float, renamed("estimated", "said")]
    measured: Annotated[float, renamed("measured", "exact")]
    uncertainty: Annotated[float, renamed("uncertainty", "own")]


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """How large the error of an automatic reduction is, and how that is known.

    Attributes
    ----------
    tolerance : float
        The eps that was asked for.
    band : tuple of two floats
        Hz.
    reached : bool
        Whether largest + noise <= tolerance.
    stopped : str
        Why the search ended.
    largest : float
        The estimated eps over the band.
    worst : float
        Hz, where it is largest.
    mean : float
        Q / (upper - lower).
    noise : float
        The round-off of the small models.
    measured : str
        With which damping the error is measured.
    uncompressed_size : int
        Columns before the compression.
    highest : float
        The highest pseudo-frequency in Hz.
    missing_modes : int or None
        Modes of the band that inertia counts and the uncompressed model has not; None where nothing was counted.
    points : tuple of Point
        The expansion points in order.
    proofs : tuple of Proof
        Estimated errors beside measured ones.
    frequencies, eps : tuple of float
        The curve of the error, (S,) each; Hz.
    loss_factor : float
        That of (1 + i eta) K where the response is not measured with the damping of the model alone, else 0.
    beside_damping : bool
        Whether the damping matrix counts beside the loss factor.
    unproven : str
        Why no measured error supports the estimate, "" where one does.
    multigrid : bool
        Whether there was no factor.
    measure : Measure
        What eps is, with its floors.
    directions : tuple of Direction
        The error of every output against the uncompressed model, the worst first.
    silent : tuple of str
        Outputs that no input moves but for round-off, which do not count.
    parameters : ParameterAccuracy or None
        The ranges over which `largest` holds; the curve and the directions belong to the reference values.
    counted : ModeCount or None
        How many modes were counted, up to where, and what counted them.
    last_digits : tuple of float
        By how much, in (rad/s)^2, the last digits of K change the squared frequencies of the pseudo-modes up to the end
        of the band; empty where that was not asked, as over parameters and in files of earlier versions.
    """

    tolerance: float
    band: tuple[float, float]
    reached: bool
    stopped: str
    largest: float
    worst: float
    mean: float
    noise: float
    measured: str
    uncompressed_size: Annotated[int, renamed("uncompressed_size", "big_size")]
    highest: float
    missing_modes: int | None
    points: tuple[Point, ...]
    proofs: tuple[Proof, ...]
    frequencies: tuple[float, ...] = field(repr=False)
    eps: tuple[float, ...] = field(repr=False)
    loss_factor: float = 0.0
    beside_damping: bool = False
    unproven: str = ""
    multigrid: bool = False
    measure: AnyMeasure = PAPER
    directions: tuple[Direction, ...] = ()
    silent: tuple[str, ...] = ()
    parameters: ParameterAccuracy | None = None
    counted: ModeCount | None = None
    last_digits: tuple[float, ...] = field(default=(), repr=False)

    def with_noise(self, noise: float) -> Accuracy:
        """Return the same with so much relative round-off, `noise`, which may be more than the claim bears."""
        if self.reached and not self.largest + noise <= self.tolerance:
            return replace(self, noise=noise, reached=False, stopped=ROUND_OFF)
        return replace(self, noise=noise)

    def times(self, inputs: float, outputs: float) -> Accuracy:
        """Return the same of a model whose `inputs` (p,) and `outputs` (r,) are multiplied by these factors."""
        directions = tuple(replace(known, static=known.static * inputs * outputs) for known in self.directions)
        return replace(self, measure=self.measure.times(inputs, outputs), directions=directions)

    @property
    def factorisations(self) -> int:
        """Factors that were made."""
        made = (not point.from_store if point.factors is None else point.factors for point in self.points)
        return 0 if self.multigrid else sum(made)

    @property
    def modes_in_words(self) -> str:
        """Which modes were counted, and how many of them are missing."""
        lack = f"{self.missing_modes or 'none'} missing"
        if self.parameters is not None:
            lack += f" at any of {len(self.parameters.points)} values"
        if self.counted is not None:
            return f"{self.counted.in_words}, {lack}"
        return "modes not counted" if self.missing_modes is None else f"modes: {lack}"

    @property
    def asked(self) -> bool:
        """Whether there is a tolerance that somebody asked for; machines are estimated without one."""
        return not (self.unproven and self.tolerance == self.largest)

    @property
    def sentence(self) -> str:
        """What a user reads first."""
        ranges = "{:g} to {:g} Hz".format(*self.band)
        if self.parameters is not None:
            ranges += f" and {self.parameters.ranges_in_words}"
        by = " by the norm (55)" if isinstance(self.measure, Paper) else ""
        error, tolerance = (in_percent(value, self.tolerance) for value in (self.largest + self.noise, self.tolerance))
        if self.reached:
            how_large = f"{error} (tolerance {tolerance})" if self.asked else f"about {error}"
            claim = f"largest error{by} {how_large} over {ranges}"
        else:
            # responses of round-off are compared with each other; without a measured value nothing bounds an estimate
            more = " or more" if self.stopped == ROUND_OFF or self.unproven else ""
            claim = (
                f"NOT REACHED: largest error{by} about {error}{more} (tolerance {tolerance}) over {ranges}, "
                f"{self.stopped}"
            )
        return claim + self._proof_in_words() + (f"; not verified: {self.unproven}" if self.unproven else "")

    def _proof_in_words(self):
        """Return what full solves say of the estimate; "" without one."""
        proof = self.proofs[-1] if self.proofs else None
        if self.multigrid:  # whose first points in the band are no proofs yet
            proof = max(self.proofs[1:] or self.proofs, key=lambda proof: proof.measured, default=None)
        if proof is None:
            return ""
        at = f"at {proof.frequency:g} Hz"
        if self.parameters is not None and proof == self.proofs[-1]:
            at += f" and {in_words(self.parameters.points[-1].values)}"
        if self.reached:
            return f", verified {at} (uncompressed model)"
        return f"; a full solve {at} measured {in_percent(proof.measured, self.tolerance)} before the compression"

    @property
    def least_accurate(self) -> str:
        """The WORST least accurate directions as text; "" where nothing is known of them."""
        named = [f"{direction.output} {in_percent(direction.largest, self.tolerance)} at {direction.frequency:.4g} Hz"
                 for direction in self.directions[:WORST]]  # fmt: skip
        return f"least accurate directions: {', '.join(named)}" if named else ""

    def _repr_html_(self):
        """Return the verdict and the least accurate directions for notebooks."""
        rows = rows_of_directions(self.directions[:WORST], self.band)
        return as_html(self.sentence, {}, rows, notes=(self.measured,))

    @property
    def beyond(self) -> tuple[Direction, ...]:
        """The outputs whose responses by themselves are off by more than the tolerance, the worst first."""
        return tuple(direction for direction in self.directions if not direction.largest <= self.tolerance)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user of the result has to know: a tolerance that was not reached, and what the measure hides."""
        sentences = () if self.reached else (self.sentence,)
        if self.silent:
            sentences += (
                f"outputs: {listed(self.silent)}: no input moves them but for round-off, so that eps leaves them out",
            )
        if isinstance(self.measure, Paper) and self.beyond:
            named = [f"{worst.output} {worst.largest:.1g} at {worst.frequency:.4g} Hz" for worst in self.beyond]
            sentences += (
                f"measure: eps is that of the paper (55), the error of all responses together; by themselves "
                f"{len(named)} of {len(self.directions)} outputs are off by more than {self.tolerance:g}: "
                f"{', '.join(named[:NAMED])}{', ...' * (len(named) > NAMED)}; leave measure = \"paper\" out where they "
                "matter",
            )
        return sentences


def in_percent(error: float, tolerance: float) -> str:
    """Return an error as text: in percent, or as a number where the tolerance is far below one; with as many digits
    as it takes to tell it from the tolerance."""
    if not np.isfinite(error):
        return "not known"
    small = tolerance < PERCENT
    for digits in range(2, 7):
        value, bound = (float(f"{number:.{digits - 1}e}") for number in (error, tolerance))
        if value != bound or error == tolerance:
            break
    if small:
        return f"{value:g}"
    text = np.format_float_positional(100 * value, precision=digits, fractional=False, trim="-")
    return f"{text if 100 * value >= PERCENT or not value else f'{100 * value:.1e}'} %"
