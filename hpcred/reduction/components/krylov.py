"""Extend a basis by rational block Krylov subspaces of the pencil K + s^2 M (32, 41-46).

Damping is left out when the basis is built, which is exact in the limit of light proportional damping (4.2.1), and
enters with the projection. At s = i omega the matrix K - omega^2 M is real, as it is for real s.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from ...linalg.basis import ComplexBasis
from ...linalg.blocks import as_pairs, copy_of, times
from ...linalg.free_motions import free_motions_refused
from ...linalg.solvers.base import MOVES_FREELY, SingularMatrix
from ...model.damping import is_proportional
from ...parallel.declared import as_declared
from ...parallel.failures import InputError
from ...parallel.ranges import COUNT, FREQUENCY, RATE, within
from .component import PointComponent
from .krylov_sequence import KrylovSequence
from .point_blocks import PointBlocks


def _not_negative(key, value):
    if value < 0:
        raise InputError(f"{key}: found {value}, expected 0 or more")
    within(key, value, (0, COUNT[1], ""))


Order = Annotated[int, _not_negative]


class PencilSequence(KrylovSequence):
    """(K + s^2 M)^-1 L, then repeatedly (K + s^2 M)^-1 M; for s^2 = inf M^-1 L, then M^-1 K.

    `square`: s^2, real. `loads`: a block L, by default the inputs of the run; `inputs`: what it is in the key.
    """

    rule = "pencil"

    def __init__(self, run, square, name, wanted=None, loads=None, inputs=("inputs",)):
        self._square, self._name, self._loads = square, name, run.loads if loads is None else loads
        key = run.identity_of("M", "K", *inputs)
        super().__init__(run, wanted, square=[square.real + 0.0, square.imag + 0.0], **key)
        self.labels = str(square), "0" if square == np.inf else "0.0"

    def _load_columns(self):
        return self._loads.getActiveColumns()[1]

    def _factor(self):
        return self.run.solvers.factored(self._square, self._name)

    def _next_load(self):
        if not self.ends:
            return copy_of(self._loads, self.run.model.K)
        start, stop = self._start(len(self.ends) - 1), self.ends[-1]
        mass_images = self.vectors.mass_images_between(start, stop)
        if mass_images is not None and self._square != np.inf and not self.run.tau:
            return copy_of(mass_images, self.run.model.K)
        matrix = self.run.model.K if self._square == np.inf else self.run.model.M
        return times(matrix, self.vectors.columns_between(start, stop))


class ComplexPencilSequence(PencilSequence):
    """The same for a complex s^2."""

    kind = ComplexBasis

    def _factor(self):
        solver = self.run.solvers.complex()
        with self.run.progress.stage("factor", self._name, solver.known):
            solver.factor(self._square)
            return solver

    def _next_load(self):
        return super()._next_load() if self.ends else as_pairs(self._loads, self.run.model.K)


@dataclass(frozen=True)
class Krylov(PointComponent):
    """Blocks at s = decay + i 2 pi frequency: (K + s^2 M)^-1 B, then repeatedly (K + s^2 M)^-1 M.

    The reduced transfer function and its first `order` derivatives with respect to s^2 match those of the full
    undamped model there (42, 43); with C = B^T it is 2 (order + 1) moments. Points that are neither real nor imaginary
    give twice the columns (50).

    Parameters
    ----------
    frequency : float, optional
        Hz.
    order : int
        It adds order + 1 blocks.
    decay : float, optional
        Laplace variable in 1/s.
    infinity : bool
        M^-1 B, then repeatedly M^-1 K, which matches Markov parameters, in place of a point.
    """

    kind: Literal["krylov"] = field(default="krylov", kw_only=True, repr=False)
    frequency: float | None = None
    order: Order = 0
    decay: float | None = None
    infinity: bool = False

    def __post_init__(self):
        as_declared(self, "krylov.")
        if self.infinity == (self.frequency is not None or self.decay is not None):
            raise InputError("krylov: expected frequency (Hz), decay (1/s) or both, or infinity = true")
        self.point  # noqa: B018  (refused early)

    @property
    def point(self) -> complex:
        """The expansion point s; infinity is complex infinity."""
        return complex(np.inf) if self.infinity else laplace(self.kind, self.frequency, self.decay)

    @property
    def name(self) -> str:
        return "infinity" if self.infinity else point_name(self.point)

    def _is_complex(self):
        return bool(self.point.real and self.point.imag)

    def columns(self, inputs: int, rigid: int) -> int:
        """Return the number of vectors before deflation."""
        return (2 if self._is_complex() else 1) * inputs * (self.order + 1)

    def complex_shift(self, damped: bool) -> bool:
        return self._is_complex()

    def blocks(self, run) -> PointBlocks:
        """Return the blocks of the point. Collective. Raises InputError where the point is an eigenfrequency.

        Block Arnoldi: the vectors of the point are kept orthonormal by themselves, because (K + s^2 M)^-1 M has to act
        on the whole block and not only on what the basis did not have yet.
        """
        model = run.model
        if self._is_complex() and not is_proportional(model):
            raise InputError(
                f"krylov: the point {self.name} is complex and the damping of {model.name} is not proportional; "
                "kind 'second_order_krylov' fits"
            )
        if not run.loads.getActiveColumns()[1]:
            raise InputError(f"krylov: no input loads the free dofs of {model.name}")
        kind = ComplexPencilSequence if self._is_complex() else PencilSequence
        square = np.inf if self.infinity else self.point**2 if self._is_complex() else (self.point**2).real
        sequence = kind(run, square, self.name, wanted=self.order + 1)
        try:
            return sequence.blocks(self.order + 1, f"krylov {self.name}")
        except SingularMatrix as error:
            raise self._refusal(model, run.rigid, error) from error

    def _refusal(self, model, rigid, error):
        if self.infinity:
            return InputError(f"krylov at infinity: the mass matrix of {model.name} is singular; take another point")
        if self.point == 0:
            if rigid is not None:
                return free_motions_refused(model, rigid)
            return InputError(f"krylov point 0 Hz: K of {model.name} is singular: {MOVES_FREELY}")
        return InputError(
            f"krylov point {self.point.imag / 2 / np.pi:.10g} Hz is an eigenfrequency of the undamped model "
            f"(relative distance of its square {error.distance:.1e}), an undamped pole; move the point a little"
        )


@dataclass(frozen=True)
class StaticCorrection(PointComponent):
    """K^-1 B, the deflection under constant loads (by inertia relief for a free body): Krylov(0 Hz, order 0)."""

    kind: Literal["static_correction"] = field(default="static_correction", kw_only=True, repr=False)

    def columns(self, inputs: int, rigid: int) -> int:
        return inputs

    def blocks(self, run) -> PointBlocks:
        return Krylov(frequency=0.0, order=0).blocks(run)


def laplace(kind, frequency, decay, s=None) -> complex:
    """Return s = decay + i 2 pi frequency (Hz, 1/s), or given as (real, imaginary). Raises InputError."""
    if s is not None:
        if frequency is not None or decay is not None:
            raise InputError(f"{kind}: expected s, or frequency and decay, not both")
        point = complex(*s)
    else:
        point = complex(decay or 0.0, 2 * np.pi * (frequency or 0.0))
    if not np.isfinite(point):
        raise InputError(f"{kind}: found the point {point}, expected finite numbers")
    if point.imag < 0:
        raise InputError(f"{kind}.frequency: found {point.imag / 2 / np.pi:g}, expected Hz, not negative")
    if point.real < 0:
        raise InputError(f"{kind}.decay: found {point.real:g}, expected 1/s, not negative: poles lie there")
    within(f"{kind}.decay", point.real, RATE)
    within(f"{kind}.frequency", point.imag / (2 * np.pi), FREQUENCY)
    return point


def point_name(s: complex) -> str:
    """ "150 Hz", "150 Hz + 20 1/s", "20 1/s"."""
    words = [f"{s.imag / 2 / np.pi:g} Hz"] if s.imag or not s.real else []
    return " + ".join(words + ([f"{s.real:g} 1/s"] if s.real else []))
