"""Simulate one flexible body in time, and compute its motion, forces and energies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from ..body.body import Body, check_moving, has_no_inertia, remarks
from ..body.preload import Preload, warning_of_basis
from ..body.rotations import continuous, of_vector, quaternion, rotation, vector_of
from ..parallel.declared import as_declared
from ..parallel.failures import ComputationError, InputError
from ..parallel.petsc import MPI
from ..parallel.progress import Progress
from ..parallel.ranges import FREQUENCY, Node, Number, Range, Vector
from ..reduction.result.maxwell_states import maxwell_states
from .drives import AnyDrive
from .equations_of_motion import FlexibleBody, NodeMotion, node_motion
from .integration import integrate, note_on_damping
from .joints import AXES, Joint, holds_of
from .loads import AnyForce, AnyInputLoad, AnyMoment, load_of, push_of
from .springs import ZERO, AnySpring, element_of
from .warnings import Limits, first_frequency, note_on_steps, warnings_of_inputs, warnings_of_places

OUTPUTS = Range(1, 10_000_000)  # output intervals, all of which are kept in memory
SAMPLES = 200  # instants at which loads are looked at
SPEED = Range(-3e8, 3e8, "m/s")
ENERGIES = ("kinetic", "elastic", "gravity", "springs")
LARGE_GRAVITY = 1e3  # m/s^2: above what is asked for in earnest, below 9810
POWERS = ("work", "drives", "dissipated")
FASTEST = 1e9  # rad/s, of a motion that diverges


def _more_than_0(key, value):
    if value is not None and not 0 < value < np.inf:
        raise InputError(f"{key}: found {value:g}, expected a finite number of more than 0")


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """Settings of a simulation. SI units, inertial axes; nodes are numbers, or names of interfaces.

    Parameters
    ----------
    end : float
        Last time in s.
    steps : int, default 500
        Number of output intervals; the integrator chooses its own steps.
    gravity : tuple of three floats, default (0, 0, 0)
        In m/s^2.
    start : {"given", "static"}, default "given"
        Initial state: "given" by the values below, or "static", the rest position under gravity, loads and drives at
        t = 0.
    position : tuple of three floats, default (0, 0, 0)
        Initial position of the body frame in m.
    rotation : tuple of three floats, default (0, 0, 0)
        Initial rotation vector of the body frame in rad.
    velocity, angular_velocity : tuple of three floats, default (0, 0, 0)
        Initial velocity (m/s) and angular velocity (rad/s) of the body frame.
    elastic, elastic_velocity : sequence of float, default ()
        Initial elastic coordinates and their rates; by default zero.
    geometric_stiffness : bool, default True
        Whether loads change the stiffness, if the body has a geometric stiffness.
    observe : sequence of int or str, default ()
        Nodes whose motion is computed, beside those of the tables below.
    relative_tolerance, absolute_tolerance : float, default 1e-5 and 1e-8
        Tolerances of a step of the integrator; the error of a velocity counts by the displacement that it makes in it.
    damp_above : float, optional
        Frequency in Hz above which vibrations are damped numerically in place of followed, by steps of a given length
        in place of those that the tolerances ask for; by default none.
    force, moment : sequence of loads, default ()
        Forces and moments at nodes.
    load : sequence of ConstantLoad, SineLoad or TableLoad, default ()
        Inputs of the reduction, such as pressures, by name.
    constraint : sequence of Joint, default ()
        Joints between nodes and the ground.
    drive : sequence of drives, default ()
        Prescribed motions of the ground to which nodes are held.
    spring : sequence of LineSpring or Bushing, default ()
        Springs and dampers between nodes and the ground.

    Raises
    ------
    InputError
        For values out of range, and initial velocities of a static start.
    """

    end: Annotated[float, _more_than_0, Range(1e-15, 1e9, "s")]
    steps: Annotated[int, _more_than_0, OUTPUTS] = 500
    gravity: Vector = ZERO
    start: Literal["given", "static"] = "given"
    position: Vector = ZERO
    rotation: Vector = ZERO
    velocity: Annotated[Vector, SPEED] = ZERO
    angular_velocity: Vector = ZERO
    elastic: tuple[Number, ...] = ()
    elastic_velocity: tuple[Number, ...] = ()
    geometric_stiffness: bool = True
    observe: tuple[Node, ...] = ()
    relative_tolerance: Annotated[float, _more_than_0, Range(1e-14, 0.5)] = 1e-5
    absolute_tolerance: Annotated[float, _more_than_0, Range(1e-30, 1.0)] = 1e-8
    damp_above: Annotated[float | None, _more_than_0, FREQUENCY] = None
    force: tuple[AnyForce, ...] = ()
    moment: tuple[AnyMoment, ...] = ()
    load: tuple[AnyInputLoad, ...] = ()
    constraint: tuple[Joint, ...] = ()
    drive: tuple[AnyDrive, ...] = ()
    spring: tuple[AnySpring, ...] = ()

    def __post_init__(self):
        as_declared(self)
        moving = ("velocity", "angular_velocity", "elastic", "elastic_velocity")
        if self.start == "static" and any(any(getattr(self, key)) for key in moving):
            raise InputError(f"start: 'static' is a state of rest; leave out {', '.join(moving)}")

    @property
    def warnings(self) -> list[str]:
        """Warnings of numbers that look like mm."""
        size = float(np.linalg.norm(self.gravity))
        return [f"gravity: found {size:g} m/s^2; in SI it is 9.81"] if size > LARGE_GRAVITY else []

    @property
    def nodes(self) -> list:
        """All nodes that are observed, loaded, held or driven: numbers, then names."""
        tables = (*self.force, *self.moment, *self.constraint, *self.drive, *self.spring)
        numbers = {*self.observe, *(table.node for table in tables)}
        return sorted(numbers, key=lambda node: (isinstance(node, str), node))

    def numbered(self, body: Body) -> Simulation:
        """Return the settings with numbers of nodes for their names in `body`. Raises InputError for an unknown name.
        """
        tables = {
            key: tuple(replace(entry, node=body.number(entry.node)) for entry in getattr(self, key))
            for key in ("force", "moment", "constraint", "drive", "spring")
        }
        return replace(self, observe=tuple(map(body.number, self.observe)), **tables)


@dataclass
class Motion:
    """The result of a simulation with nt output times, m elastic coordinates and k nodes. SI units, inertial axes.

    Attributes
    ----------
    t : ndarray, shape (nt,)
        Output times in s.
    position : ndarray, shape (nt, 3)
        Position of the body frame.
    quaternion : ndarray, shape (nt, 4)
        Orientation of the body frame, scalar first.
    velocity, angular_velocity : ndarray, shape (nt, 3)
        Of the body frame, in body axes.
    elastic, elastic_velocity : ndarray, shape (nt, m)
        Elastic coordinates and their rates.
    nodes, node_names, node_rotates : list
        Numbers and names of the nodes, and whether they have rotations.
    node_position : ndarray, shape (nt, k, 3)
        Positions of the nodes.
    node_displacement : ndarray, shape (nt, k, 3)
        Displacements from the undeformed positions at the start.
    node_rotation : ndarray, shape (nt, k, 3)
        Rotation vectors from the undeformed orientation at the start, continued beyond pi; those of the body for nodes
        without rotations.
    node_velocity, node_acceleration : ndarray, shape (nt, k, 3)
        Velocities (m/s) and accelerations (m/s^2) of the nodes.
    output_names : list of str
        Names of the outputs of the reduced model.
    outputs : ndarray, shape (nt, r)
        The outputs y = C q + Cv q' + Ca q'', such as stresses and section forces, from the elastic coordinates alone:
        displacements, velocities and accelerations of nodes are those relative to the body frame, in its axes.
    constraint_names, moment_names, spring_names : list of str
        Names of the columns of forces, of moments, and of springs.
    constraint_force, constraint_moment : ndarray, shape (nt, c) and (nt, d)
        Forces (N) and moments (N m) of joints and drives on the body.
    spring_force, spring_moment : ndarray, shape (nt, s, 3)
        Forces and moments of springs on the body.
    spring_energy : ndarray, shape (nt, s)
        Energies of the springs.
    energies : dict of str to ndarray, shape (nt,)
        kinetic, elastic, gravity, springs, work (of forces and moments), drives (their work), dissipated.
    drift, rotation_drift : float
        Largest distance (m) and angle (rad) of a held node from where it is held.
    balance : float
        Largest defect of the energy balance, relative to the largest energy.
    notes : list of str
        What was changed or approximated.
    warnings : list of str
        Settings that look wrong, and motions beyond what the equations describe, such as those that diverge.
    integrator_steps, factorisations : int
        Numbers of steps, and of factorisations of Newton matrices.
    """

    t: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    elastic: np.ndarray
    elastic_velocity: np.ndarray
    nodes: list
    node_names: list
    node_rotates: list
    node_position: np.ndarray
    node_displacement: np.ndarray
    node_rotation: np.ndarray
    node_velocity: np.ndarray
    node_acceleration: np.ndarray
    output_names: list
    outputs: np.ndarray
    constraint_names: list
    constraint_force: np.ndarray
    moment_names: list
    constraint_moment: np.ndarray
    spring_names: list
    spring_force: np.ndarray
    spring_moment: np.ndarray
    spring_energy: np.ndarray
    energies: dict
    drift: float
    rotation_drift: float
    balance: float
    notes: list
    warnings: list
    integrator_steps: int
    factorisations: int


def simulate(body: Body, setup: Simulation, progress=None) -> Motion:
    """Simulate a body in time.

    On one rank.

    Parameters
    ----------
    body : Body
        Its nodes must include those of the settings.
    setup : Simulation
        The settings.

    Raises
    ------
    InputError
        For dependent constraints, free rigid-body motion in a static start, structural damping, no mass in some
        direction, rigid-body motions in the basis, an unknown node, joints or moments at nodes without rotations, and
        fractional laws of its materials.
    ComputationError
        If the integrator fails.

    Notes
    -----
    The equations of motion (12, 13) with constraints are a differential-algebraic system of index 2, integrated by
    Radau IIA of order 5. Added terms of Maxwell's law have states of their own, relaxed at the start.
    """
    check_moving(body, "a simulation", laws=True)
    added = body.reduced.added
    elements = maxwell_states(added, "a simulation") if added else None
    if has_no_inertia(body):
        raise InputError(
            "the body has no inertia about one of its axes, as where all masses lie on a line, which a simulation "
            "needs; give the model the rotational inertia of its section"
        )
    setup, unloaded = setup.numbered(body), body
    if setup.geometric_stiffness:
        body = body.stiffened()
    shapes = {shape.node: shape for shape in body.nodes}
    for node in setup.nodes:
        if node not in shapes:
            known = ", ".join(map(str, shapes))
            raise InputError(f"node {node} is none of the nodes of the body, {known}; name it when the body is made")
    size = body.reduced.size
    for key in ("elastic", "elastic_velocity"):
        if len(getattr(setup, key)) not in (0, size):
            raise InputError(f"{key}: found {len(getattr(setup, key))} numbers, expected {size}")
    r, p = np.array(setup.position), quaternion(setup.rotation)
    A = rotation(p)
    q, u = (np.array(getattr(setup, key) or np.zeros(size)) for key in ("elastic", "elastic_velocity"))
    z = np.concatenate([A.T @ setup.velocity, A.T @ setup.angular_velocity, u])
    first, undeformed = (
        {node: node_motion(shape, body.floating_frame.origin, r, A, state) for node, shape in shapes.items()}
        for state in (q, np.zeros(size))
    )
    start = {node: (shapes[node], motion.x, motion.R) for node, motion in first.items()}
    holds = holds_of(setup.constraint, setup.drive, start)
    system = FlexibleBody(
        body.floating_frame, body.reduced.K, body.reduced.D, setup.gravity,
        [load_of(entry, shapes[entry.node]) for entry in (*setup.force, *setup.moment)],
        [element_of(entry, *start[entry.node]) for entry in setup.spring],
        holds, [push_of(entry, body) for entry in setup.load], elements,
    )  # fmt: skip
    warnings = setup.warnings + warnings_of_places(body, setup, {node: motion.x for node, motion in first.items()})
    warnings += warnings_of_inputs(body, setup, holds, {node: motion.R for node, motion in first.items()}, A)
    progress = progress or Progress(MPI.COMM_WORLD)
    for warning in warnings:  # before a run that may take long for that reason
        progress.warn(warning)
    notes = remarks(body) + _loads_without_stress(body, setup) + _spins_twice(body, setup)
    if elements is not None:
        notes.append(f"the Maxwell elements of {added.names} are {elements.size} states, relaxed at the start")
    if setup.start == "static":
        r, p, q = system.equilibrium(r, p)
    else:
        r, p, q, moved = system.assemble(r, p, q)
        if moved:
            notes.append("the initial position did not fit the constraints and was moved there")
    _require_possible_speeds(system, setup, r, p, q, z)
    y0, yp0, change = system.start(r, p, q, z)
    if change > 1e-10 * max(1.0, np.abs(z).max()):
        notes.append(f"the initial velocities did not fit the constraints and were projected (change {change:.2g})")
    if setup.damp_above is not None:
        notes.append(note_on_damping(setup))
    elif told := note_on_steps(system, setup, y0, yp0):  # before they are taken
        progress.tell(f"note: {told}")
        notes.append(told)
    limits = Limits(body, system, first_frequency(system, r, p, q), progress.warn)
    with np.errstate(all="ignore"):  # a step in which numbers overflow is tried again, shorter; the motion is checked
        t, states, rates, work = integrate(system, setup, y0, yp0, limits, progress)
        motion = Motion(
            t=t, notes=notes, warnings=warnings, **work,
            **_at_outputs(body, setup, system, undeformed, t, states, rates),
            **_rates_of_nodes(body, system, states, rates), **_outputs(body.reduced, system, t, states, rates),
        )  # fmt: skip
    numbers = [*motion.energies.values(), *(value for value in vars(motion).values() if isinstance(value, np.ndarray))]
    if not all(np.isfinite(value).all() for value in numbers):
        overflown = "the motion has numbers that overflow; loads or drives are too large"
        raise ComputationError("; ".join([*limits.warnings, overflown]))
    motion.warnings += limits.warnings
    if unloaded.geometric_stiffness is not None and setup.geometric_stiffness:
        fastest = motion.angular_velocity[np.linalg.norm(motion.angular_velocity, axis=1).argmax()]
        fastest = fastest.clip(-FASTEST, FASTEST)
        if told := warning_of_basis(unloaded, Preload(omega=tuple(fastest.tolist()))):
            progress.warn(told)
            motion.warnings.append(told)
    return motion


def _require_possible_speeds(system, setup, r, p, q, z):
    """Raise InputError where gravity and loads would give the free body a speed beyond that of light."""
    A, M = rotation(p), system.floating_frame.mass_matrix(q)
    motions = system.node_motions(r, A, q)
    forces = [system.applied(t, A, q, z, motions)[0] for t in np.linspace(0.0, setup.end, SAMPLES)]
    with np.errstate(all="ignore"):
        motions = np.linalg.lstsq(M, np.array([*forces, system.impulse]).T, rcond=None)[0][:3]
        *accelerations, jump = np.linalg.norm(motions, axis=0)
        mean = float(np.mean(accelerations))
    if not mean * setup.end + jump <= SPEED[1]:
        raise InputError(
            f"gravity, loads and bases give the body a speed of {mean * setup.end + jump:.2g} m/s within end = "
            f"{setup.end:g} s, beyond that of light; look at their values and units"
        )


def _loads_without_stress(body, setup) -> list[str]:
    """Return sentences on loads, and nodes with forces, joints or springs, that have no state in the geometric
    stiffness."""
    stiffness = body.geometric_stiffness
    if stiffness is None or not setup.geometric_stiffness:
        return []
    loaded = {entry.node for entry in (*setup.force, *setup.moment, *setup.constraint, *setup.drive, *setup.spring)}
    missing = [
        shape.label for shape in body.nodes
        if shape.node in loaded and shape.phi.any() and not any(state.startswith(f"{shape.label}:")
                                                                for state in stiffness.states)
    ]  # fmt: skip
    sentences = []
    if missing:
        sentences.append(
            f"geometric stiffness: forces at {', '.join(missing)} have no state, so that their stress does not count; "
            "make these nodes inputs or interfaces of the reduction"
        )
    if setup.load:
        names = ", ".join(entry.name for entry in setup.load)
        sentences.append(
            f"geometric stiffness: the stress of the loads {names} does not count: there are states of accelerations, "
            "angular velocities, and forces at nodes"
        )
    return sentences


def _spins_twice(body, setup) -> list[str]:
    """Return sentences on loads that are centrifugal forces."""
    known = {} if body.reduced.record is None else {load.name: load for load in body.reduced.record.loads}
    return [
        f"load '{load.name}': a body that turns has its centrifugal forces without it; these are added to them"
        for load in setup.load if load.name in known and known[load.name].spins
    ]  # fmt: skip


def _names(body) -> dict:
    """Return the name of each node, or its number where it has none, by number."""
    return {shape.node: shape.label for shape in body.nodes}


def _at_outputs(body, setup, system, undeformed, t, states, rates):
    """Return the fields of a Motion that follow from the places of nodes, in one pass over the output times."""
    r, p, q, z, _, powers, dashpots = (rows.T for rows in system.split(states))
    p = p / np.linalg.norm(p, axis=1)[:, None]
    A, multipliers, springs = rotation(p), system.split(rates)[4].T, np.zeros((len(t), len(system.springs), 7))
    # all nodes at all times, then joints and springs one time after the other
    places, turned = np.zeros((len(t), len(body.nodes), 3)), np.zeros((len(t), len(body.nodes), 3, 3))
    for k, shape in enumerate(body.nodes):
        places[:, k], turned[:, k] = _placed(shape, body.floating_frame.origin, r, A, q)
    column = {shape.node: k for k, shape in enumerate(body.nodes)}
    held = {hold.shape.node: column[hold.shape.node] for hold in system.holds}
    gaps, reactions = np.zeros((len(t), system.multipliers)), []
    for i, now in enumerate(t):
        motions = {node: NodeMotion(places[i, k], turned[i, k], None) for node, k in held.items()}
        gaps[i] = system.gaps(now, motions)
        reactions.append(system.reactions(now, motions, multipliers[i]))
        for k, spring in enumerate(system.springs):
            node = node_motion(spring.shape, body.floating_frame.origin, r[i], A[i], q[i])
            springs[i, k, :6] = spring.wrench(node.x, node.R, *np.split(node.B @ z[i], 2))
            springs[i, k, 6] = spring.energy(node.x, node.R)
    stored = np.column_stack([system.energies(r, A, q, z, dashpots), springs[:, :, 6].sum(axis=1)])
    return {
        "position": r, "quaternion": p, "velocity": z[:, :3], "angular_velocity": z[:, 3:6], "elastic": q,
        "elastic_velocity": z[:, 6:], **_energies(stored, powers), **_drifts(system, gaps),
        **_nodes(body, undeformed, places, turned), **_reactions(body, system, reactions),
        "spring_names": [f"{k + 1}:{_names(body)[element.node]}" for k, element in enumerate(setup.spring)],
        "spring_force": springs[:, :, :3], "spring_moment": springs[:, :, 3:6], "spring_energy": springs[:, :, 6],
    }  # fmt: skip


def _placed(shape, origin, r, A, q):
    """Return places (nt, 3) and rotations (nt, 3, 3) of a node at all times."""
    bent, turned = q @ shape.phi.T, q @ shape.psi.T
    if shape.phi1 is not None:
        bent, turned = (linear + np.einsum("ijk,tj,tk->ti", second, q, q) / 2
                        for linear, second in ((bent, shape.phi1), (turned, shape.psi1)))  # fmt: skip
    places = r + np.einsum("tij,tj->ti", A, shape.position - origin + bent)
    return places, A @ of_vector(turned) if shape.rotates else A


def _energies(stored, powers):
    """Return the fields of a Motion on energies (nt, 4) and works and losses (nt, 3)."""
    energies = {**dict(zip(ENERGIES, stored.T, strict=True)), **dict(zip(POWERS, powers.T, strict=True))}
    defect = stored.sum(axis=1) - stored[0].sum() - powers @ [1, 1, -1]
    from_start = stored - stored[0] * [0, 0, 1, 0]  # where gravity is zero is nobody's choice
    scale = max(np.abs(from_start).max(), np.abs(powers).max(), np.finfo(float).tiny)
    return {"energies": energies, "balance": float(np.abs(defect).max() / scale)}


def _drifts(system, gaps):
    """Return the fields of a Motion on errors (nt, c) of the constraints."""
    turned = np.concatenate([[False] * len(hold.translations) + [True] * (len(hold) - len(hold.translations))
                             for hold in system.holds] or [np.zeros(0, dtype=bool)])  # fmt: skip
    return {
        "drift": float(np.abs(gaps[:, ~turned]).max(initial=0.0)),
        "rotation_drift": float(np.abs(gaps[:, turned]).max(initial=0.0)),
    }


def _nodes(body, undeformed, places, turned):
    """Return the fields of a Motion on nodes from their places (nt, k, 3) and rotations (nt, k, 3, 3)."""
    first = [undeformed[node.node] for node in body.nodes]
    starts = np.array([start.R for start in first]).reshape(-1, 3, 3)
    turned = turned @ starts.transpose(0, 2, 1)
    rotations = vector_of(turned.reshape(-1, 3, 3)).reshape(places.shape) if turned.size else np.zeros(places.shape)
    return {
        "nodes": [node.node for node in body.nodes],
        "node_names": list(_names(body).values()),
        "node_rotates": [node.rotates for node in body.nodes],
        "node_position": places,
        "node_displacement": places - np.array([start.x for start in first]).reshape(-1, 3),
        "node_rotation": continuous(rotations),
    }


def _rates_of_nodes(body, system, states, rates):
    """Return the fields of a Motion on velocities and accelerations of nodes.

    With x = r + A (d + u(q)): A^T x' = a = v + w x (d + u) + u', and A^T x'' = w x a + a'.
    """
    _, p, q, z, *_ = (rows.T for rows in system.split(states))
    A, origin = rotation(p), body.floating_frame.origin
    dz = system.split(rates)[3].T
    (v, w, u), (dv, dw, du) = (np.split(rows, [3, 6], axis=1) for rows in (z, dz))
    arrays = [np.zeros((len(q), len(body.nodes), 3)) for _ in range(2)]
    for k, shape in enumerate(body.nodes):
        moved, speed, bent = (rows @ shape.phi.T for rows in (q, u, du))
        if shape.phi1 is not None:
            by_q, by_u = (np.einsum("ijk,tk->tij", shape.phi1, rows) for rows in (q, u))
            moved, speed, bent = (
                rows + np.einsum("tij,tj->ti", matrix, other)
                for rows, matrix, other in ((moved, by_q / 2, q), (speed, by_q, u), (bent, by_q, du))
            )
            bent = bent + np.einsum("tij,tj->ti", by_u, u)
        arm = shape.position - origin + moved
        a = v + np.cross(w, arm) + speed
        rate = np.cross(w, a) + dv + np.cross(dw, arm) + np.cross(w, speed) + bent
        for array, value in zip(arrays, (a, rate), strict=True):
            array[:, k] = np.einsum("tij,tj->ti", A, value)
    return {"node_velocity": arrays[0], "node_acceleration": arrays[1]}


def _outputs(reduced, system, t, states, rates):
    """Return the fields of a Motion on outputs of the reduced model."""
    q, u, du = (rows.T for rows in (system.split(states)[2], system.split(states)[3][6:], system.split(rates)[3][6:]))
    y = sum(rows @ matrix.T for rows, matrix in zip((q, u, du), reduced.output_parts, strict=True))
    for push in system.pushes if reduced.feedthrough is not None else ():
        direct = reduced.feedthrough[:, reduced.input_names.index(push.value.name)]
        y = y + np.outer([push.value(now) for now in t], direct)
    return {"output_names": list(reduced.output_names), "outputs": y}


def _reactions(body, system, reactions):
    """Return the fields of a Motion on forces and moments of constraints, of those {number: (6,)} at each time: the
    components that joints can transmit."""
    able = {}
    for hold in system.holds:
        able[hold.shape.node] = able.get(hold.shape.node, False) | hold.components()
    names_of, names, columns = _names(body), ([], []), ([], [])
    for node, components in able.items():
        for i in np.flatnonzero(components):
            names[i // 3].append(f"{names_of[node]}:{'r' * (i // 3)}{AXES[i % 3]}")
            columns[i // 3].append([reaction[node][i] for reaction in reactions])
    force, moment = (np.array(rows).reshape(-1, len(reactions)).T for rows in columns)
    return {
        "constraint_names": names[0], "constraint_force": force, "moment_names": names[1], "constraint_moment": moment
    }  # fmt: skip
