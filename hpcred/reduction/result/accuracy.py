"""Define the settings of a reduction to a tolerance, and its accuracy: points, proofs and the estimated error."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np

from ...linalg.known import ModeCount, Source
from ...model.damping import Caughey, GivenDamping, ModalDamping, NoDamping, Rayleigh, Structural
from ...model.second_order_model import listed
from ...parallel.as_html import as_html
from ...parallel.declared import as_declared, renamed
from ...parallel.failures import InputError
from ...parallel.ranges import COUNT, FREQUENCY, require_band, within
from ..small.error_estimate import UNIFORM
from ..small.pseudo_modal import Proportional
from .directions import Direction, rows_of_directions
from .measure import PAPER, AnyMeasure, Measure, Paper, measure_called
from .parameter_accuracy import ParameterAccuracy, in_words

ROUND_OFF = "limited by round-off"  # why a search ended
PERCENT = 1e-6  # tolerance below which errors are not in percent, and percentage below which these have an exponent
UNDAMPED = 1e-8  # damping ratio up to which a mode counts as undamped
WORST = 5  # directions that are shown where nobody asks for all
NAMED = 3  # outputs that a warning names


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What an automatic reduction may take.

    At most `factorisations`, `columns` of the uncompressed model, `size` coordinates of the result and `seconds`; where
    one of them ends the search the tolerance is not reached. `points` (Hz) are taken first, before the search chooses.
    The response of an undamped model is measured with the loss factor 2 `zeta0`.
    """

    factorisations: int = 14
    columns: int = 600
    size: int | None = None
    seconds: float | None = None
    zeta0: float = 1e-3
    points: tuple[float, ...] = ()

    def __post_init__(self):
        as_declared(self, "adaptive.")
        for key in ("factorisations", "columns", "size", "seconds", "zeta0"):
            if getattr(self, key) is not None and not 0 < getattr(self, key) < np.inf:
                raise InputError(f"adaptive.{key}: found {getattr(self, key)}, expected more than 0")
        if self.factorisations < 2:
            raise InputError(f"adaptive.factorisations: found {self.factorisations}, expected at least 2")
        if not 1e-12 <= self.zeta0 < 1:
            raise InputError(f"adaptive.zeta0: found {self.zeta0:g}, expected a damping ratio below 1")
        for key in ("factorisations", "columns", "size"):
            within(f"adaptive.{key}", getattr(self, key), COUNT)
        within("adaptive.seconds", self.seconds, (1e-6, 1e9, "s"))
        within("adaptive.points", self.points, FREQUENCY)


@dataclass(frozen=True, kw_only=True)
class Adaptive(Limits):
    """Reduction to an accuracy: eps(f) <= `tolerance` over `band` (Hz), within Limits.

    `measure`: what eps is, "directions" (each response over the drive points of its input and output) or "paper", the
    Frobenius norm (55). `static`: with "exact" the deflection at 0 Hz under every input is that
    of the full model to round-off, which takes a factor of K and as many coordinates as there are inputs.
    """

    tolerance: float
    band: tuple[float, float]
    measure: Literal["directions", "paper"] | Measure = "directions"
    static: Literal["tolerance", "exact"] = "tolerance"

    @property
    def error_measure(self) -> Measure:
        """What `measure` stands for."""
        return measure_called(self.measure)

    def __post_init__(self):
        as_declared(self, keys=("tolerance", "band", "measure", "static"))
        super().__post_init__()
        require_band("band", self.band)
        if not 1e-15 <= self.tolerance < 1:
            raise InputError(f"tolerance: found {self.tolerance:g}, expected a relative error such as 1e-4")


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

    `largest`: the estimated eps over the band, at `worst` (Hz), `mean` its mean Q / (upper - lower), `noise` the
    round-off of the small models; `reached`: largest + noise <= tolerance; `stopped`: why the search ended, as text;
    `unproven`: why no measured error supports the estimate, "" where one does. `measured`: with which damping, as text;
    `loss_factor`: that of (1 + i eta) K where the response is not measured with the damping of the model alone, else 0;
    `beside_damping`: whether the damping matrix counts too. `uncompressed_size`: columns before the compression;
    `highest`: pseudo-frequency (Hz); `missing_modes`: of the band that inertia counts and the uncompressed model
    has not, None where nothing was counted; `counted`: how many were counted, up to where, and what counted them.
    `measure`: what eps is, with its floors; `directions`: of every output, the worst first, against the uncompressed
    model. `frequencies` (S,) and `eps` (S,): the curve. `proofs`: estimated errors beside measured ones. `points`: in
    order. `silent`: outputs that no input moves but for round-off, which do not count. `multigrid`: whether there was
    no factor. `parameters`: of a model that depends on parameters, over whose
    ranges `largest` holds, while the curve and the directions belong to the reference values.
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

    def with_noise(self, noise: float) -> Accuracy:
        """Return the same with so much round-off, which may be more than the claim bears."""
        if self.reached and not self.largest + noise <= self.tolerance:
            return replace(self, noise=noise, reached=False, stopped=ROUND_OFF)
        return replace(self, noise=noise)

    def times(self, inputs: float, outputs: float) -> Accuracy:
        """Return the same of a model whose inputs and outputs are multiplied by factors."""
        directions = tuple(replace(item, static=item.static * inputs * outputs) for item in self.directions)
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
    def sentence(self) -> str:
        """What a user reads first."""
        ranges = "{:g} to {:g} Hz".format(*self.band)
        if self.parameters is not None:
            ranges += f" and {self.parameters.ranges_in_words}"
        by = " by the norm (55)" if isinstance(self.measure, Paper) else ""
        error, tolerance = (in_percent(value, self.tolerance) for value in (self.largest + self.noise, self.tolerance))
        if self.reached:
            claim = f"largest error{by} {error} (tolerance {tolerance}) over {ranges}"
        else:
            # responses of round-off are compared with each other; without a measured value nothing bounds an estimate
            more = " or more" if self.stopped == ROUND_OFF or self.unproven else ""
            claim = (
                f"NOT REACHED: largest error{by} about {error}{more} (tolerance {tolerance}) over {ranges}, "
                f"{self.stopped}"
            )
        return claim + self._proof_in_words() + (f"; not confirmed: {self.unproven}" if self.unproven else "")

    def _proof_in_words(self):
        """Return what full solves say of the estimate; "" without one."""
        proof = self.proofs[-1] if self.proofs else None
        if self.multigrid:  # whose first points in the band are no proofs yet
            proof = max(self.proofs[1:] or self.proofs, key=lambda item: item.measured, default=None)
        if proof is None:
            return ""
        at = f"at {proof.frequency:g} Hz"
        if self.parameters is not None and proof == self.proofs[-1]:
            at += f" and {in_words(self.parameters.points[-1].values)}"
        if self.reached:
            return f", confirmed by a full solve {at}"
        return f"; a full solve {at} measured {in_percent(proof.measured, self.tolerance)} before the compression"

    @property
    def least_accurate(self) -> str:
        """The WORST least accurate directions as text; "" where nothing is known of them."""
        named = [f"{item.output} {in_percent(item.largest, self.tolerance)} at {item.frequency:.4g} Hz"
                 for item in self.directions[:WORST]]  # fmt: skip
        return f"least accurate directions: {', '.join(named)}" if named else ""

    def _repr_html_(self):
        """Return the verdict and the least accurate directions for notebooks."""
        rows = rows_of_directions(self.directions[:WORST], self.band)
        return as_html(self.sentence, {}, rows, notes=(self.measured,))

    @property
    def beyond(self) -> tuple[Direction, ...]:
        """The outputs whose responses by themselves are off by more than the tolerance, the worst first."""
        return tuple(item for item in self.directions if not item.largest <= self.tolerance)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user of the result has to know: a tolerance that was not reached, and what the measure hides."""
        found = () if self.reached else (self.sentence,)
        if self.silent:
            found += (
                f"outputs: {listed(self.silent)}: no input moves them but for round-off, so that eps leaves them out",
            )
        if isinstance(self.measure, Paper) and self.beyond:
            named = [f"{item.output} {item.largest:.1g} at {item.frequency:.4g} Hz" for item in self.beyond]
            found += (
                f"measure: eps is that of the paper (55), the error of all responses together; by themselves "
                f"{len(named)} of {len(self.directions)} outputs are off by more than {self.tolerance:g}: "
                f"{', '.join(named[:NAMED])}{', ...' * (len(named) > NAMED)}; leave measure = \"paper\" out where they "
                "matter",
            )
        return found


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


def measured_damping(damping, zeta0: float, band, added="") -> tuple[Proportional, bool, str]:
    """Return the damping with which responses are measured: its proportional part, whether a given D is added, and a
    sentence; `added`: what the added terms of the model are called, which always act."""
    if added:
        return _beside_added(damping, zeta0, band, added)
    if isinstance(damping, GivenDamping):
        loss = damping.loss_factor
        words = "measured with the damping matrix of the model"
        return Proportional(eta=loss), True, f"{words} and the loss factor {loss:g}" if loss else words
    if isinstance(damping, Structural) and damping.loss_factor:
        return Proportional(eta=damping.loss_factor), False, f"measured with the loss factor {damping.loss_factor:g}"
    if isinstance(damping, Rayleigh | Caughey) and smallest_ratio(damping.coefficients, band) > UNDAMPED:
        return proportional(damping.coefficients), False, "measured with the damping of the model"
    ratio, why = zeta0, "undamped"
    if isinstance(damping, ModalDamping):
        ratio = max(float(damping.at(np.linspace(*band, UNIFORM)).min()), 1e-6)
        why = "the smallest modal ratio"
    return Proportional(eta=2 * ratio), False, f"measured with the loss factor {2 * ratio:g} ({why})"


def _beside_added(damping, zeta0, band, added):
    """Return the same of a model with added terms, which damp it."""
    words = f"measured with the {added} of the model"
    if isinstance(damping, Rayleigh | Caughey):
        return proportional(damping.coefficients), False, f"{words} and its damping"
    if isinstance(damping, NoDamping) or (isinstance(damping, Structural) and not damping.loss_factor):
        return Proportional(), False, words
    found, given, of_damping = measured_damping(damping, zeta0, band)
    return found, given, words + of_damping.replace("measured with", " and", 1)


def proportional(coefficients) -> Proportional:
    """Return the damping of a Caughey series (39), of which Rayleigh damping is the first two terms."""
    alpha, beta, *higher = (*coefficients, 0.0)[: max(len(coefficients), 2)]
    return Proportional(alpha, beta, 0.0, tuple(higher) if any(higher) else ())


def smallest_ratio(coefficients, band) -> float:
    """Return the smallest damping ratio of a series over a band (Hz), without its sign."""
    omega = 2 * np.pi * np.linspace(max(band[0], 1e-3 * band[1]), band[1], UNIFORM)
    return float(np.abs(sum(a * omega ** (2 * k - 1) for k, a in enumerate(coefficients)) / 2).min())
