"""Put a body under a constant load: K with the geometric stiffness of its stress, and with spin softening.

In the frame of a body that spins with omega small vibrations have the stiffness K + K_sigma + M skew(omega)^2: the last
term, the change of the centrifugal force with the displacement, softens the directions normal to omega (spin softening;
CalculiX has it in its steps with CENTRIF and PERTURBATION). Coriolis forces are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..fe.shape_functions import integration_points, shape_functions
from ..fe.strain_matrices import strain_matrices
from ..linalg.pencil import modes_of
from ..model.frames import Frame
from ..model.loads.columns import mass_times
from ..model.rotation import spin_softening
from ..model.second_order_model import SecondOrderModel
from ..parallel.declared import Settings, declared
from ..parallel.failures import InputError
from ..parallel.petsc import PETSc
from ..parallel.ranges import ANYTHING, Vector, within
from ..parallel.sums import summed
from ..reduction.result.reduced_model import ReducedModel
from .body import Body
from .geometric_stiffness import (
    ACCELERATIONS,
    ANGULAR_ACCELERATIONS,
    OF_BODY,
    SIX,
    VELOCITIES,
    StiffenedFrame,
    check_state,
)
from .rotations import skew
from .stress_stiffness import assembled, node_stiffness
from .unit_states import displacements_of_states, require_stresses, stresses

ZERO = (0.0, 0.0, 0.0)
FAR = 5e-3  # by which a frequency with half of the coordinates may be higher than with all; without load it is not


@dataclass(frozen=True, kw_only=True)
class Preload(Settings):
    """A constant load on a body, in its axes.

    Parameters
    ----------
    omega : tuple of three floats, default (0, 0, 0)
        Angular velocity in rad/s of the body frame, about its origin.
    acceleration : tuple of three floats, default (0, 0, 0)
        Of the body frame in m/s^2, less that of gravity: a body at rest under gravity g has -g.
    angular_acceleration : tuple of three floats, default (0, 0, 0)
        In rad/s^2.
    forces : dict of str to float, default {}
        Forces (N) and moments (N m) by node or interface and direction, such as {"crank:x": 100.0, "20:z": 5.0}.

    Raises
    ------
    InputError
        For numbers that are not finite, and names that are not node and direction.
    """

    where = "preload."

    omega: Vector = ZERO
    acceleration: Vector = ZERO
    angular_acceleration: Vector = ZERO
    forces: dict[str, float] = field(default_factory=dict)

    def __post_init__(self):
        super().__post_init__()
        for state, value in self.forces.items():
            check_state(state)
            if state in OF_BODY:
                raise InputError(f"preload.forces: found '{state}', expected node and direction, such as crank:x")
            within(f"preload.forces.{state}", value, ANYTHING)

    @property
    def values(self) -> dict[str, float]:
        """Return the values of the states of load that are not zero."""
        w = self.omega
        products = [*(x * x for x in w), w[0] * w[1], w[1] * w[2], w[0] * w[2]]
        values = dict(zip(ACCELERATIONS + ANGULAR_ACCELERATIONS + VELOCITIES,
                          (*self.acceleration, *self.angular_acceleration, *products), strict=True))  # fmt: skip
        return {state: value for state, value in (values | self.forces).items() if value}

    @property
    def words(self) -> str:
        """Return the load in a line: states and their values, in SI."""
        return ", ".join(f"{state} = {value:g}" for state, value in self.values.items())

    def acceleration_at(self, points: np.ndarray) -> np.ndarray:
        """Return the accelerations (k, 3) of `points` (k, 3) in m of the undeformed body, from the origin of its frame.
        """
        turning = skew(np.array(self.angular_acceleration)) + skew(np.array(self.omega)) @ skew(np.array(self.omega))
        return self.acceleration + points @ turning.T


def reduced_at(body: Body, preload: Preload) -> ReducedModel:
    """Return the reduced model of a body with geometric stiffness under a preload, with its frequencies there; without
    basis, and without the accuracy that is known without load. The record warns of a preload under which the basis,
    made without it, has not converged.

    Raises InputError without geometric stiffness, of a body that is stiffened or at a preload already, for forces at
    nodes that do not exist, and where the body buckles.
    """
    declared("preload", preload, Preload)
    # a body has one preload, of states that its result has
    stiffness, reduced = body.geometric_stiffness, getattr(body.reduced, "base", body.reduced)
    if body.prestress is not None or isinstance(body.floating_frame, StiffenedFrame):
        state = "stiffened (Body.stiffened)" if body.prestress is None else "at a preload"
        raise InputError(
            f"preload: the body is {state} already, and its stress would count twice; take the result as it was read, "
            "and one preload with all loads"
        )
    if stiffness is None:
        raise InputError(
            "preload: the result has no geometric stiffness; reduce with geometric_stiffness = true in the job"
        )
    known = {node.label for node in body.nodes}
    for state in preload.forces:
        if state not in stiffness.states and state.rpartition(":")[0] not in known:
            raise InputError(
                f"preload.forces: found '{state}', expected nodes with states of load: {', '.join(sorted(known))}"
            )
    # the stiffness there, which has to be stable
    K = _stiffness(body, preload)
    squares = modes_of(K, reduced.M)[0]
    rigid = reduced.rigid_size
    if squares[: rigid + 1].min() < 0 and not rigid:
        raise InputError(
            f"preload: the body has no stable state there: the lowest eigenvalue of its stiffness is {squares[0]:.4g} "
            "(rad/s)^2; it buckles, or flies apart, under a smaller load"
        )
    # accuracy was that of the body without preload
    record = reduced.record and replace(reduced.record, accuracy=None)
    if record and (told := warning_of_basis(body, preload)):
        record = replace(record, warnings=(*record.warnings, told))
    return replace(
        reduced, K=(K + K.T) / 2, frequencies=np.sqrt(np.maximum(squares, 0.0)) / 2 / np.pi, record=record,
        columns=None, left_columns=None, model=None,
    )  # fmt: skip


def _stiffness(body, preload):
    """Return the stiffness (m, m) of a reduced model under a preload."""
    reduced, values = getattr(body.reduced, "base", body.reduced), preload.values
    added = np.tensordot(np.array(list(values.values())), body.geometric_stiffness.of(tuple(values)), axes=1)
    return reduced.K + added + softening_of(body, preload)


def warning_of_basis(body: Body, preload: Preload) -> str:
    """Return a sentence where the basis, which was made without load, has not converged under a preload; "" elsewhere.

    The lower half of the modes of the reduced model without load has its own lowest frequencies; how much higher these
    get under the load than with all modes tells how much the modes that are not in the basis at all would lower them.
    """
    reduced = getattr(body.reduced, "base", body.reduced)
    modes = modes_of(reduced.K, reduced.M)[1]
    K = modes.T @ _stiffness(body, preload) @ modes
    rigid, elastic = reduced.rigid_size, reduced.size - reduced.rigid_size
    half, lowest = rigid + elastic // 2, slice(rigid, rigid + max(elastic // 4, 1))
    if elastic < 2:
        return ""
    few, every = (np.linalg.eigvalsh((matrix + matrix.T) / 2)[lowest] for matrix in (K[:half, :half], K))
    higher = np.sqrt(np.divide(few, every, out=np.ones(len(every)), where=every > 0).clip(min=1.0)) - 1
    worst = int(higher.argmax())
    if higher[worst] < FAR:
        return ""
    return (
        f"preload: the basis was made without {preload.words} and has not converged there: with half of the "
        f"coordinates the elastic frequency {worst + 1}, {np.sqrt(every[worst]) / 2 / np.pi:.4g} Hz, is "
        f"{higher[worst]:.1%} higher, and it may be too high by as much; reduce with more modes, or a model at the "
        "preload (hpcred.preloaded)"
    )


def softening_of(body: Body, preload: Preload) -> np.ndarray:
    """Return the spin softening V^T M skew(omega)^2 V (m, m) of a preload."""
    return body.floating_frame.Oe1 @ _each(VELOCITIES, preload)


def forces_of(body: Body, preload: Preload) -> np.ndarray:
    """Return the generalised forces V^T f (m,) of a preload, by the nodes of the body."""
    frame, shapes = body.floating_frame, {node.label: np.vstack([node.phi, node.psi]) for node in body.nodes}
    total = -frame.Ct @ preload.acceleration - frame.Cr @ preload.angular_acceleration
    total -= frame.Oe @ _each(VELOCITIES, preload)
    for state, value in preload.forces.items():
        label, _, direction = state.rpartition(":")
        total += value * shapes[label][SIX.index(direction)]
    return total


def _each(states, preload) -> np.ndarray:
    """Return the values of some states, zero of those that a preload does not have."""
    values = preload.values
    return np.array([values.get(state, 0.0) for state in states])


def preloaded(
    model: SecondOrderModel, preload: Preload, frame: Frame | None = None, *, origin=(0.0, 0.0, 0.0), factoring=None
) -> SecondOrderModel:
    """Return a model of solids under a preload: K with the stiffness of its stress and of its spin. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        A body that the matrices or the frame hold, of solid elements with types and materials.
    preload : Preload
    frame : Frame, optional
        Holds the body.
    origin : array_like, shape (3,), default (0, 0, 0)
        Origin of the body frame in m, through which the axis of rotation goes.
    factoring : Factoring, optional
        How to factor, and in how much memory.

    Returns
    -------
    SecondOrderModel
        The caller closes it.

    Raises
    ------
    InputError
        For a free body, elements without stress, and nodes that do not exist.
    """
    declared("preload", preload, Preload)
    solids = require_stresses(model)
    origin, values = np.asarray(origin, dtype=float), preload.values
    nodes = [state.rpartition(":")[0] for state in preload.forces]
    nodes = list(dict.fromkeys(int(node) if node.isdecimal() else node for node in nodes))
    # stresses under the preload, as linear statics gives them
    states = displacements_of_states(model, solids, frame, origin, nodes, factoring, values)
    if states.free:
        raise InputError(
            f"preload: {model.name} is a free body, whose rigid-body motions a preload does not leave free; hold it by "
            "a frame, or take the reduced model at the preload (hpcred evaluate)"
        )
    # K + K_G of these stresses, less the softening by the spin
    of_groups = [
        (node_stiffness(group.kind, group.rule, solids.position[members], stress).sum(axis=0), solids.rows[members])
        for group, members, stress in stresses(solids, states.field)
    ]
    K = model.K.copy()
    K.axpy(1.0, assembled(model, of_groups))
    if any(preload.omega):
        K.axpy(1.0, spin_softening(model, preload.omega))

    def on_pattern(mat):
        widened = K.copy()
        widened.zeroEntries()
        widened.axpy(1.0, mat, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        return widened

    # the other matrices on the pattern that K has now
    mats = {key: K if key == "K" else on_pattern(mat) for key, mat in model.matrices.items()}
    remark = remark_on_supports(model, solids, lambda points: preload.acceleration_at(points - origin))
    remarks = (*model.remarks, *solids.warnings(), *([remark] if remark else []))
    return model.with_fields(operator=model.operator.with_matrices(mats), remarks=remarks)


# Measure the inertia forces that are missing where matrices lack the rows of supports.
# The forces -M a of accelerations a of a whole body need the mass between held and free dofs, which went with the rows
# of the held ones. Its part follows from the densities and shape functions of the solid elements at the supports.


def remark_on_supports(model, solids, acceleration) -> str:
    """Return a sentence on the forces that a function of accelerations (k, 3) at points (k, 3) lacks; "" where M has
    them all, or is lumped. Collective."""
    forces, count, coupled = mass_times(model, acceleration)
    if not count or not coupled:
        return ""
    held = solids.rows < 0
    still = np.where(held, acceleration(solids.position), 0.0)
    unknown = any(group.material.density is None and still[group.nodes].any() for group in solids.groups)
    lost = sum(np.abs(np.where(held[group.nodes], 0.0, _forces(group, solids.position, still))).sum()
               for group in solids.groups if group.material.density is not None)  # fmt: skip
    lost, whole, unknown = summed(model.comm, np.array([lost, np.abs(forces).sum(), unknown], dtype=float))
    size = "how much that is needs densities" if unknown else f"{lost / whole:.2g} of all forces"
    return (
        f"preload: the inertia of the mass at {count} held dofs is not in M ({size}): export the body without "
        "supports and hold it by a frame where that counts"
    )


def _forces(group, position, still) -> np.ndarray:
    """Return M_e a (e, k, 3) of the elements of a group, for accelerations (l, 3) of all nodes."""
    _, volumes = strain_matrices(group.kind, group.rule, position[group.nodes])
    points = integration_points(group.kind, "reduced" if group.rule.strain == "mean" else group.rule.scheme)[0]
    N = shape_functions(group.kind, points)[0]
    return group.material.density * np.einsum("eg,ga,eg...->ea...", volumes, N, N @ still[group.nodes])
