"""Define Campbell diagrams: the poles of a model over a parameter, and what they show."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..linalg.solvers.settings import Factoring
from ..model.damping import Damping
from ..model.frames import Frame
from ..parallel.as_html import as_html
from ..parallel.declared import declared
from ..parallel.progress import Progress
from .damped_modes import damped_modes
from .pole_tracking import damping_ratios
from .whirl import in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FULL_POINTS = 5  # values at which the full model is solved
SPARE = 2  # more modes there than the reduced model has
SPEEDS = {"rad/s": 1.0, "1/s": 1.0, "rpm": np.pi / 30, "1/min": np.pi / 30, "Hz": 2 * np.pi}  # in rad/s


@dataclass(frozen=True, kw_only=True)
class CriticalSpeed:
    """Where a mode has a multiple of the speed as its frequency.

    Attributes
    ----------
    order : float
        The multiple.
    mode : int
        Column of the diagram, from 0.
    value : float
        The speed in the unit of the parameter.
    frequency : float
        Hz.
    damping_ratio : float
    whirl : str
        forward, backward, none or unknown.
    """

    order: float
    mode: int
    value: float
    frequency: float
    damping_ratio: float
    whirl: str


@dataclass(frozen=True, kw_only=True, eq=False)
class FullPoles:
    """Poles of a full model at a value of the parameter.

    Attributes
    ----------
    value : float
        Of the parameter.
    poles : ndarray, complex, shape (k,)
        rad/s, of imaginary parts of at least 0.
    residual : float
        The largest relative residual of the eigenproblem.
    """

    value: float
    poles: np.ndarray
    residual: float

    @property
    def frequencies(self) -> np.ndarray:
        """Damped frequencies in Hz, (k,)."""
        return self.poles.imag / (2 * np.pi)

    @property
    def damping_ratios(self) -> np.ndarray:
        """Damping ratios, (k,); negative ones grow."""
        return damping_ratios(self.poles)


@dataclass(frozen=True, kw_only=True, eq=False)
class Campbell:
    """Poles of a reduced model over a parameter; see `campbell`.

    Attributes
    ----------
    parameter, unit : str
    values : ndarray, shape (V,)
        Those asked for, and those between where the poles need smaller steps.
    poles : ndarray, complex, shape (V, k)
        rad/s, a column a mode, with imaginary parts of at least 0; NaN where a mode is not: a vibration that is damped
        over-critically has two real poles, of which one begins a column.
    orbits : ndarray, shape (V, k)
        How round the orbits of the nodes are: 1 for circles with the rotation, -1 for those against it, 0 for lines;
        NaN where this is not known.
    highest : float
        Hz, up to which modes are shown.
    orders : tuple of float
        Multiples of the speed that critical speeds belong to.
    stability_limit : float or None
        The first value where a real part gets positive; None where the model is stable over the whole range.
    unstable_frequency : float or None
        Of that pole in Hz.
    critical_speeds : tuple of CriticalSpeed
        By order and speed.
    full : tuple of FullPoles
        Of the full model at some values.
    warnings : tuple of str
    """

    parameter: str
    unit: str
    values: np.ndarray
    poles: np.ndarray
    orbits: np.ndarray
    highest: float
    orders: tuple[float, ...] = ()
    stability_limit: float | None = None
    unstable_frequency: float | None = None
    critical_speeds: tuple[CriticalSpeed, ...] = ()
    full: tuple[FullPoles, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """What is known of stability."""
        name, unit = self.parameter, f" {self.unit}" * bool(self.unit)
        if self.stability_limit is None:
            low, high = self.values[[0, -1]]
            return f"stable for {name} = {low:.6g} to {high:.6g}{unit}"
        how = "without vibration" if not self.unstable_frequency else f"at {self.unstable_frequency:.6g} Hz"
        rpm = f" ({self.stability_limit * 30 / np.pi:.6g} rpm)" if self.unit == "rad/s" else ""
        return f"UNSTABLE from {name} = {self.stability_limit:.8g}{unit}{rpm} on, {how}"

    def plot(self, title: str | None = None) -> Figure:
        """Draw the diagram, with damping ratios where there is damping: see plot_campbell. `title`: by default what is
        known of stability."""
        import hpcred  # the public functions, which stand above

        return hpcred.workflows.plot_campbell(self, title)

    def _repr_html_(self):
        """Return stability, modes at both ends and critical speeds for notebooks."""
        unit = f" ({self.unit})" * bool(self.unit)
        facts = {
            self.parameter + unit: f"{self.values[0]:.6g} to {self.values[-1]:.6g}",
            "modes": f"{self.poles.shape[1]} up to {self.highest:.6g} Hz",
        }
        rows = [{"order": critical.order, "mode": critical.mode + 1, f"{self.parameter}{unit}": critical.value,
                 "f (Hz)": critical.frequency, "damping (%)": 100 * critical.damping_ratio, "whirl": critical.whirl}
                for critical in self.critical_speeds]  # fmt: skip
        return as_html(f"Campbell diagram: {self.sentence}", facts, rows, self.warnings)

    @property
    def frequencies(self) -> np.ndarray:
        """Damped frequencies in Hz, (V, k)."""
        return self.poles.imag / (2 * np.pi)

    @property
    def damping_ratios(self) -> np.ndarray:
        """Damping ratios, (V, k); negative ones grow."""
        return damping_ratios(self.poles)

    def spread(self, count: int) -> np.ndarray:
        """Return `count` of the values, or fewer, about equally spaced."""
        wanted = np.linspace(self.values[0], self.values[-1], count)
        return np.unique(self.values[np.abs(self.values[:, None] - wanted).argmin(axis=0)])

    @property
    def full_rows(self) -> list[dict]:
        """Return a row for each pole of the full model below `highest`: its value, frequency (Hz) and damping ratio,
        and the relative distance of the nearest pole of the reduced model, where it has the value."""
        rows = []
        for check in self.full:
            near = self.poles[np.flatnonzero(self.values == check.value)]
            near = near[np.isfinite(near)]
            for pole in check.poles[check.frequencies <= self.highest]:
                distance = np.abs(near - pole).min(initial=np.inf) / max(abs(pole), 1e-300)
                rows.append({
                    "value": check.value, "frequency": float(pole.imag / (2 * np.pi)),
                    "damping_ratio": float(damping_ratios(pole)), "distance": float(distance),
                })  # fmt: skip
        return rows

    def with_full(
        self, model, values: ArrayLike | None = None, frame: Frame | None = None, damping: Damping | None = None, *,
        at: dict[str, float] | None = None, count: int | None = None, factoring: Factoring | None = None,
        progress: Progress | None = None,
    ) -> Campbell:  # fmt: skip
        """Return the diagram with poles of the full model at some values. Collective.

        Parameters
        ----------
        model : ParametricModel
        values : array_like, optional
            Of the parameter; by default five of the diagram.
        frame : Frame, optional
            That of the reduction.
        damping : Damping, optional
            By default the damping matrix of the model, if it has one.
        at : dict of str to float, optional
            Values of the other parameters.
        count : int, optional
            The lowest modes, so many; by default a few more than the diagram has.
        factoring : Factoring, optional
            How to factor, and in how much memory.

        Raises
        ------
        InputError, ComputationError
            As damped_modes does.

        Notes
        -----
        A factor and an eigenproblem of twice the size at each value: see damped_modes.
        """
        if values is None:
            values = self.spread(FULL_POINTS)
        values = np.unique(np.array(declared("values", values, tuple[float, ...])))
        full, warnings = [], list(self.warnings)
        for value in values.tolist():
            below = self.frequencies[np.argmin(np.abs(self.values - value))] <= self.highest
            with model.at(**(at or {}), **{self.parameter: value}) as there:
                wanted = min(count or int(below.sum()) + SPARE, there.size)
                modes = damped_modes(there, wanted, frame, damping, factoring=factoring, progress=progress)
                modes.close()  # its shapes
            full.append(FullPoles(value=value, poles=modes.poles, residual=float(modes.residuals.max())))
            warnings += modes.warnings
        return replace(self, full=tuple(full), warnings=tuple(dict.fromkeys(warnings)))

    @property
    def speeds(self) -> np.ndarray | None:
        """The values in rad/s, (V,), or None where the parameter is no speed."""
        factor = SPEEDS.get(self.unit)
        return None if factor is None else factor * self.values

    @property
    def whirl(self) -> list[list[str]]:
        """forward, backward, none or unknown, (V, k)."""
        return [[in_words(orbit) for orbit in row] for row in self.orbits]
