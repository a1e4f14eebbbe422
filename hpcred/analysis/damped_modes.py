"""Compute damped modes of a full model: the poles of s^2 M + s D + K nearest to a frequency, and their shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..linalg.damped_eigensolver import damped_eigenpairs, damped_residuals
from ..linalg.solvers.base import SingularMatrix
from ..linalg.solvers.complex import ComplexSolver
from ..linalg.solvers.settings import Factoring
from ..linalg.solvers.shifted import ShiftedSolver
from ..model.damping import Damping, ModalDamping, caughey_terms, damping_or_given, loss_factor_of
from ..model.frames import Buckens, Frame, apply_frame
from ..model.rigid_body.rows_alone import warnings_of_rows_alone
from ..model.second_order_model import SecondOrderModel, require_model
from ..parallel.declared import declared, spelled
from ..parallel.failures import InputError, Owned
from ..parallel.petsc import is_complex
from ..parallel.progress import Progress
from ..parallel.ranges import FREQUENCY, within
from ..reduction.run.projection import everywhere
from .pole_tracking import damping_ratios

SHIFT = 1e-6  # of trace(K) / trace(M), where K is singular
INACCURATE = 1e-6  # residual above which a warning is given


@dataclass(frozen=True, eq=False, kw_only=True)
class DampedModes:
    """Poles and shapes of a full model.

    Attributes
    ----------
    poles : ndarray, complex, shape (k,)
        rad/s, with imaginary parts of at least 0, by their distance from the target.
    residuals : ndarray, shape (k,)
        ||(s^2 M + s D + K) x|| / (|s|^2 ||M x|| + |s| ||D x|| + ||K x||).
    shapes : SLEPc.BV, shape (n, 2 k)
        Re and Im of the shapes x side by side: call close().
    warnings : tuple of str
    """

    poles: np.ndarray
    residuals: np.ndarray
    shapes: object = None
    warnings: tuple[str, ...] = ()

    @property
    def frequencies(self) -> np.ndarray:
        """Damped frequencies in Hz, (k,)."""
        return self.poles.imag / (2 * np.pi)

    @property
    def damping_ratios(self) -> np.ndarray:
        """Damping ratios, (k,); negative ones grow."""
        return damping_ratios(self.poles)

    def close(self) -> None:
        """Free the shapes. Collective."""
        if self.shapes is not None:
            self.shapes.destroy()


@spelled
def damped_modes(
    model: SecondOrderModel, count: int = 12, frame: Frame | None = None, damping: Damping | None = None, *,
    target: float = 0.0, factoring: Factoring | None = None, progress: Progress | None = None,
) -> DampedModes:  # fmt: skip
    """Return the damped modes nearest to a frequency: by default the lowest. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        M, D and K need not be symmetric.
    count : int, default 12
        Modes to find.
    frame : Frame, optional
        Holds the body; by default none.
    damping : Damping, optional
        By default the damping matrix of the model, if it has one.
    target : float, default 0
        Hz. Above 0 it needs a complex build of PETSc.
    factoring : Factoring, optional
        How to factor, and in how much memory.

    Returns
    -------
    DampedModes
        The caller closes it.

    Raises
    ------
    InputError
        For damping without a matrix D, laws of frequency, the Buckens frame, and a target above 0 in a real build.
    ComputationError
        If the eigenproblem is not solved.

    Notes
    -----
    Krylov-Schur iteration of the linearised problem with a factor of s^2 M + s D + K at the target, begun again beside
    the modes found until nothing nearer appears, so that equal poles are all found; memory for about 12 `count` vectors
    of n numbers.
    """
    require_model(model)
    if declared("count", count, int) < 1:
        raise InputError(f"count: found {count}, expected at least 1")
    # lowest modes in a real build, those nearest to a target in a complex one
    target = declared("target", target, float)
    within("target", target, FREQUENCY)
    if target and not is_complex():
        raise InputError(
            f"target: found {target:g} Hz, which needs a complex build of PETSc (hpcred --scalar complex, or "
            "hpcred.start('complex') first); a real build finds the lowest modes, target 0"
        )
    if isinstance(frame, Buckens):
        raise InputError("frame: found the Buckens frame, expected one that holds the body, or none")
    # s^2 M + s D + K has to be sparse, with constant matrices
    damping = damping_or_given(model, damping)
    if loss_factor_of(damping) or isinstance(damping, ModalDamping) or caughey_terms(damping) is not None:
        raise InputError(
            f"damping: found kind '{damping.kind}', expected viscous damping with a sparse matrix: given, Rayleigh, or "
            "a Caughey series of at most two terms without loss factor"
        )
    if model.added:
        raise InputError(
            f"{model.name}: it has {model.added.plural}, and poles that are not those of a quadratic form; reduce it "
            "and take poles() of the reduced model"
        )
    progress = progress or Progress(model.comm)
    with Owned(model.comm) as owned:
        framed = apply_frame(model, frame, damping)
        free = framed.model
        if count > free.size:
            raise InputError(f"count: {count} modes asked for, {model.name} has {free.size}")
        # shift-and-invert of the quadratic form, beside 0 where K is singular
        shift = 2j * np.pi * target if target else 0.0
        kind = ComplexSolver if target else ShiftedSolver
        solver = owned.owns(kind(free, prefix="damped_", factoring=factoring))
        with progress.stage("factor", f"{target:g} Hz", solver.known):
            try:
                solver.factor(shift**2, shift)
            except SingularMatrix:
                shift = (SHIFT * free.mean_eigenvalue) ** 0.5 + shift
                solver.factor(shift**2, shift)
        with progress.stage("damped modes", f"{count} nearest to {target:g} Hz"):
            poles, block = damped_eigenpairs(free.M, free.D, free.K, count, shift, solver.solve)
        residuals = damped_residuals(free.M, free.D, free.K, poles, block)
        shapes = everywhere(model, framed, block)
    warnings = (*warnings_of_rows_alone(model), *_warnings(count, poles, residuals))
    return progress.found(DampedModes(poles=poles, residuals=residuals, shapes=shapes, warnings=warnings))


def _warnings(count, poles, residuals):
    warnings = []
    if len(poles) < count:
        warnings.append(f"{len(poles)} of the {count} damped modes asked for were found")
    if residuals.max() > INACCURATE:
        worst = int(residuals.argmax())
        warnings.append(
            f"the mode at {poles[worst].imag / (2 * np.pi):.6g} Hz has a relative residual of {residuals[worst]:.1e}"
        )
    return tuple(warnings)
