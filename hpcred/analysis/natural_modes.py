"""Compute natural modes: the lowest undamped frequencies and shapes, and how much of the mass each of them moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..linalg.blocks import inner, times
from ..linalg.free_motions import ZERO
from ..linalg.refinement import IllConditioned
from ..linalg.solvers.base import SingularMatrix
from ..linalg.solvers.settings import Factoring
from ..model.definiteness import growing, warnings_of_definiteness
from ..model.digits import warnings_of_digits
from ..model.frames import Buckens, Frame, NoFrame, apply_frame
from ..model.rigid_body.modes import RigidBodyModes, rigid_body_quantities, rigid_motions
from ..model.rigid_body.rows_alone import warnings_of_rows_alone
from ..model.second_order_model import SecondOrderModel, require_model
from ..parallel.declared import declared, spelled
from ..parallel.failures import ComputationError, InputError, Owned
from ..parallel.progress import Progress
from ..reduction.checks import check_symmetric
from ..reduction.components.modes import lowest, residuals
from ..reduction.run.projection import everywhere
from ..reduction.run.run import Run

SHIFT = 1e-6  # of trace(K) / trace(M), where K is singular


@dataclass(frozen=True, eq=False, kw_only=True)
class NaturalModes:
    """The lowest modes x of (K, M) with x^T M x = 1, rigid-body modes first, at 0 Hz.

    Attributes
    ----------
    frequencies : ndarray, shape (m,)
        Hz.
    rigid : int
        The number of rigid-body modes.
    participation : ndarray, shape (m, 6), or None
        The factors x^T M r_k in kg^(1/2) and kg^(1/2) m, with the unit translations r_1..r_3 along x, y, z and
        rotations r_4..r_6 about the centre of mass; None without nodes.
    masses : ndarray, shape (6,), or None
        r_k^T M r_k in kg and kg m^2; None without nodes.
    residual : float
        The largest ||K x - lambda M x|| / (lambda ||M x||) of the elastic modes.
    shapes : block or None
        The elastic modes in all dofs, (n, m - rigid); call close().
    warnings : tuple of str
        Sentences on frequencies for which K has too few digits.
    """

    frequencies: np.ndarray
    rigid: int
    participation: np.ndarray | None
    masses: np.ndarray | None
    residual: float
    shapes: object = None
    warnings: tuple[str, ...] = ()

    @property
    def effective_masses(self) -> np.ndarray | None:
        """(m, 6) in kg and kg m^2: the squares of the participation factors. Over all modes they sum to `masses`."""
        return None if self.participation is None else self.participation**2

    def close(self) -> None:
        """Free the shapes. Collective."""
        if self.shapes is not None:
            self.shapes.destroy()


@spelled
def natural_modes(
    model: SecondOrderModel, count: int = 20, frame: Frame | None = None, *, factoring: Factoring | None = None,
    progress: Progress | None = None,
) -> NaturalModes:  # fmt: skip
    """Return the lowest undamped modes, those of rigid-body motions included. Collective.

    Parameters
    ----------
    model : SecondOrderModel
    count : int, default 20
        Modes to find.
    frame : Frame, optional
        Holds the body or leaves it free; without one a free body with nodes is taken as free. If K has null vectors
        that the frame does not know (mechanisms, bodies without nodes) it is shifted.
    factoring : Factoring, optional
        How to factor, and in how much memory.

    Returns
    -------
    NaturalModes
        The caller closes it.

    Raises
    ------
    InputError
        For models without natural frequencies, as with an unsymmetric or indefinite matrix.
    ComputationError
        If the eigenproblem is not solved.
    """
    require_model(model)
    if declared("count", count, int) < 1:
        raise InputError(f"modes: found the number {count}, expected at least 1")
    check_symmetric(model)
    if signs := warnings_of_definiteness(model):
        raise InputError(f"{signs[0]}, which have no natural frequency")
    progress = progress or Progress(model.comm)
    with Owned(model.comm) as owned:
        framed = apply_frame(model, frame or _frame_of(model))
        run = owned.owns(Run(framed, progress, 1e-9, factoring or Factoring()))
        rigid = framed.rigid_size
        free = framed.model.size
        if count > free:
            raise InputError(f"modes: {count} modes asked for, {model.name} has {free}")
        values, block = np.zeros(0), None
        if count > rigid:
            with progress.stage("modes", f"{count} lowest modes"):
                try:
                    # the lowest elastic modes; K is shifted where it is singular in spite of the frame
                    values, block = lowest(run, count - rigid)
                except SingularMatrix:
                    values, block = lowest(run, count - rigid, SHIFT * framed.model.mean_eigenvalue)
                except IllConditioned as error:
                    if frame is not None or not rigid:
                        raise
                    raise ComputationError(
                        f"{error}; where its files have few digits, hpcred modes {model.name} --frame none takes the "
                        "rigid-body modes as K has them"
                    ) from error
        # what is below zero is an instability or round-off, and what is zero a motion without stiffness
        if unstable := growing(model, values):
            raise InputError(f"{unstable}, which have no natural frequency")
        still = values <= ZERO * framed.model.mean_eigenvalue
        residual = float(residuals(run, values, block)[~still].max(initial=0.0))
        # shapes of all motions, rigid ones first, and the part of the mass that moves in each
        shapes = None if block is None else everywhere(model, framed, block)
        blocks = [motions for motions in (framed.rigid_columns, shapes) if motions is not None]
        participation, masses = _participation(model, blocks)
        frequencies = np.sqrt(np.where(still, 0.0, values)) / (2 * np.pi)
        elastic = np.where(still, np.inf, values)
        warnings = warnings_of_rows_alone(model)
        if shapes is not None:
            warnings += warnings_of_digits(model, model.K, elastic, shapes)
        return progress.found(NaturalModes(
            frequencies=np.append(np.zeros(rigid), frequencies)[:count], rigid=min(rigid + int(still.sum()), count),
            participation=None if participation is None else participation[:count], masses=masses, residual=residual,
            shapes=shapes, warnings=tuple(warnings),
        ))  # fmt: skip


def _frame_of(model):
    """Return the Buckens frame if the nodes show a free body, else none."""
    if model.dofs is None:
        return NoFrame()
    return Buckens() if RigidBodyModes(model).count else NoFrame()


def _participation(model, blocks):
    """Return x^T M r_k (m, 6) of the columns x of the blocks, and r_k^T M r_k (6,); None without nodes."""
    if model.dofs is None:
        return None, None
    motions = rigid_motions(model, np.nan_to_num(rigid_body_quantities(model).centre))
    momentum = times(model.M, motions)
    participation = [inner(block, momentum) for block in blocks]
    return np.concatenate([np.zeros((0, 6)), *participation]), np.diag(inner(motions, momentum)).copy()
