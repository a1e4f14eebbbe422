"""What an automatic reduction is asked for, and what it knows of its error: limits, points, proofs; no computation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ..model.damping import Caughey, GivenDamping, ModalDamping, Rayleigh, Structural
from ..parallel.declared import as_declared
from ..parallel.failures import InputError
from ..parallel.ranges import COUNT, FREQUENCY, require_band, within
from .error_estimate import UNIFORM
from .pseudo_modal import Law
from .weights import Weights

ROUND_OFF = "limited by round-off"  # why a search ended


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What an automatic reduction may take.

    At most `factorisations`, `columns` of the big basis, `size` coordinates of the result and `seconds`; where one of
    them ends the search the tolerance is not reached. `points` (Hz) are taken first, before the search chooses. The
    response of an undamped model is measured with the loss factor 2 `zeta0`. `weights`: whether eps is that of the
    responses as they are ("none"), or of all outputs and inputs alike ("equal", see weights.equal_weights).
    """

    factorisations: int = 14
    columns: int = 600
    size: int | None = None
    seconds: float | None = None
    zeta0: float = 1e-3
    points: tuple[float, ...] = ()
    weights: Literal["none", "equal"] = "none"

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
    """Reduction to an accuracy: eps(f) = ||H - Hr||_F / ||H||_F <= `tolerance` over `band` (Hz), within Limits."""

    tolerance: float
    band: tuple[float, float]

    def __post_init__(self):
        as_declared(self, keys=("tolerance", "band"))
        super().__post_init__()
        require_band("band", self.band)
        if not 1e-15 <= self.tolerance < 1:
            raise InputError(f"tolerance: found {self.tolerance:g}, expected a relative error such as 1e-4")


@dataclass(frozen=True, kw_only=True)
class Point:
    """An expansion point (Hz) of the search: columns that it brought, the `factors` that were made for it and their
    seconds, modes below it (by the negative pivots, None where there are none), and the estimate over the band after
    it, None without one. `factor_of`: the point (Hz) whose factor it was solved with, if not its own. `from_store`: its
    own would have served, but all was there."""

    frequency: float
    columns: int
    factor_seconds: float
    modes_below: int | None
    estimate: float | None = None
    factors: int | None = None
    from_store: bool = False
    factor_of: float | None = None

    @property
    def factor_in_words(self) -> str:
        """Which factor it was solved with."""
        if self.factors or (self.factors is None and not self.from_store):
            return f"{self.factor_seconds:.3g} s"
        return "from the store" if self.from_store or self.factor_of is None else f"that of {self.factor_of:.6g} Hz"


@dataclass(frozen=True, kw_only=True)
class Proof:
    """At a new point (Hz): the error that the estimate had `said` there of the model before, the `exact` one, and the
    estimated rest (`own`) of the value that is called exact."""

    frequency: float
    said: float
    exact: float
    own: float


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """How large the error of an automatic reduction is, and how that is known.

    `largest`: the estimated eps over the band, at `worst` (Hz), `mean` its mean Q / (upper - lower), `noise` the
    round-off of the small models; `reached`: largest + noise <= tolerance; `stopped`: why the search ended, in
    words; `unproven`: why no exact value stands behind the estimate, "" where one does. `measured`: with which damping,
    in words; `loss_factor`: that of (1 + i eta) K where the response is not measured with the damping of the model,
    else 0. `modes`: counted by inertia below the highest point, those of the big model, and how many were missing.
    `worst_pair`: output, input and error of the pair whose response is worst by itself (see pseudo_modal.worst_pair),
    which eps, the error of all together, may hide. `weights` of the r outputs and of the p inputs, with which eps is
    measured, None without. `frequencies` (S,) and `eps` (S,): the curve. `proofs`: said against
    exact. `points`: in order. `multigrid`: whether there was no factor.
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
    big_size: int
    highest: float
    missing_modes: int
    points: tuple[Point, ...]
    proofs: tuple[Proof, ...]
    frequencies: tuple[float, ...] = field(repr=False)
    eps: tuple[float, ...] = field(repr=False)
    loss_factor: float = 0.0
    worst_pair: tuple[str, str, float] | None = None
    unproven: str = ""
    multigrid: bool = False
    weights: Weights | None = None

    def with_noise(self, noise: float) -> Accuracy:
        """The same with so much round-off, which may be more than the claim bears."""
        if self.reached and not self.largest + noise <= self.tolerance:
            return replace(self, noise=noise, reached=False, stopped=ROUND_OFF)
        return replace(self, noise=noise)

    @property
    def factorisations(self) -> int:
        """Factors that were made."""
        made = (not point.from_store if point.factors is None else point.factors for point in self.points)
        return 0 if self.multigrid else sum(made)

    @property
    def sentence(self) -> str:
        """What a user reads first."""
        low, high = self.band
        proven = self.proofs[-1] if self.proofs else None
        if self.multigrid:  # whose first points in the band are no proofs yet
            proven = max(self.proofs[1:] or self.proofs, key=lambda item: item.exact, default=None)
        by = f", proven {proven.exact:.1e} at {proven.frequency:g} Hz of the big model" if proven else ""
        # responses of round-off are compared with each other; without an exact value nothing bounds an estimate
        more = " or more" if self.stopped == ROUND_OFF or self.unproven else ""
        about = f"{self.largest + self.noise:.1e}{more}"
        claim = (
            f"eps <= {self.tolerance:g} over {low:g} to {high:g} Hz" if self.reached
            else f"NOT REACHED: eps is about {about}, not {self.tolerance:g}, over {low:g} to {high:g} Hz, "
            f"{self.stopped}"
        )  # fmt: skip
        doubt = f"; estimated, not proven: {self.unproven}" if self.unproven else ""
        return f"{claim}: estimated {self.largest:.1e}, round-off {self.noise:.0e}{by}{doubt}"

    @property
    def caveat(self) -> str:
        """What eps hides of the pair that is worst by itself; "" where that is of no account."""
        if self.worst_pair is None or self.worst_pair[2] <= 10 * self.tolerance:
            return ""
        output, input_, own = self.worst_pair
        plain = self.weights is None
        return (
            f"eps is the error of all responses together, {'in SI units' if plain else 'weighed alike'}; that of "
            f"output {output} to input {input_} by itself is {own:.1g}: ask for "
            f"{'equal weights (adaptive.weights) or ' * plain}a smaller tolerance where it matters"
        )


def law_of(damping, zeta0: float, band) -> tuple[Law, bool, str]:
    """How the response of a model with a damping law is measured: its proportional part, whether a given D comes on
    top, and that in words."""
    if isinstance(damping, GivenDamping):
        return Law(), True, "measured with the damping matrix of the model"
    if isinstance(damping, Structural) and damping.loss_factor:
        return Law(eta=damping.loss_factor), False, f"measured with the loss factor {damping.loss_factor:g}"
    series = damping.coefficients if isinstance(damping, Rayleigh | Caughey) else ()
    if any(series) and not any(series[2:]):
        return Law(*(*series, 0.0)[:2]), False, "measured with the damping of the model"
    ratio = zeta0
    if any(series):
        omega = 2 * np.pi * np.linspace(max(band[0], 1e-3 * band[1]), band[1], UNIFORM)
        ratio = max(float((sum(a * omega ** (2 * k - 1) for k, a in enumerate(series)) / 2).min()), 1e-6)
    elif isinstance(damping, ModalDamping):
        ratio = max(float(damping.at(np.linspace(*band, UNIFORM)).min()), 1e-6)
    kind = "the smallest damping ratio of the series" if any(series) else "the smallest modal ratio"
    why = "undamped" if ratio == zeta0 and not isinstance(damping, ModalDamping) else kind
    return Law(eta=2 * ratio), False, f"measured with the loss factor {2 * ratio:g} ({why})"
