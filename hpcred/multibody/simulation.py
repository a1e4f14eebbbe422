"""Time simulation of one flexible body: a Body and a Simulation enter, motion, forces and energies over time leave."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from ..parallel.failures import ComputationError, InputError
from ..parallel.ranges import ANYTHING, COUNT, FREQUENCY, LABEL, within
from .body import Body, check_moving, remarks
from .equations_of_motion import FlexibleBody, Force, PointConstraint, rotation

Vector = tuple[float, float, float]
AXES = ("x", "y", "z")
ZERO = (0.0, 0.0, 0.0)


def _require_finite(where, **values):
    """Raise InputError for NaN and Inf, which TOML can write, and for numbers beyond all units."""
    for key, value in values.items():
        within(f"{where}{key}", value, ANYTHING)


@dataclass(frozen=True)
class ConstantForce:
    """A force in N in inertial axes at a node."""

    node: int
    value: Vector
    kind: Literal["constant"] = field(default="constant", kw_only=True, repr=False)

    def __post_init__(self):
        within("force.node", self.node, LABEL)
        _require_finite("force.", value=self.value)

    def __call__(self, t):
        return np.asarray(self.value)

    def longest_step(self):
        return np.inf


@dataclass(frozen=True)
class SineForce:
    """amplitude sin(2 pi frequency t + phase) at a node; N, Hz, rad."""

    node: int
    amplitude: Vector
    frequency: float
    phase: float = 0.0
    kind: Literal["sine"] = field(default="sine", kw_only=True, repr=False)

    def __post_init__(self):
        within("force.node", self.node, LABEL)
        _require_finite("force.", amplitude=self.amplitude, frequency=self.frequency, phase=self.phase)
        if self.frequency <= 0:
            raise InputError(f"force.frequency: found {self.frequency:g}, expected a positive frequency in Hz")
        within("force.frequency", self.frequency, FREQUENCY)
        within("force.phase", self.phase, (-1e6, 1e6, "rad"))

    def __call__(self, t):
        return np.asarray(self.amplitude) * np.sin(2 * np.pi * self.frequency * t + self.phase)

    def longest_step(self):
        return 1 / (8 * self.frequency)


@dataclass(frozen=True)
class TableForce:
    """Forces in N at ascending times in s, linear between them, constant before the first and after the last."""

    node: int
    times: tuple[float, ...]
    values: tuple[Vector, ...]
    kind: Literal["table"] = field(default="table", kw_only=True, repr=False)

    def __post_init__(self):
        within("force.node", self.node, LABEL)
        _require_finite("force.", times=self.times, values=self.values)
        if len(self.times) != len(self.values) or not self.times:
            raise InputError(
                f"force.values: found {len(self.values)} forces for {len(self.times)} times, expected as many"
            )
        if any(late <= early for early, late in zip(self.times, self.times[1:], strict=False)):
            raise InputError("force.times: expected ascending times")

    def __call__(self, t):
        return np.array([np.interp(t, self.times, column) for column in zip(*self.values, strict=True)])

    def longest_step(self):
        return min(np.diff(self.times), default=np.inf)


AnyForce = Annotated[ConstantForce | SineForce | TableForce, Field(discriminator="kind")]


@dataclass(frozen=True)
class Joint:
    """A node held in inertial directions, at the point `at` (m) or where it starts."""

    node: int
    directions: tuple[str, ...] = AXES
    at: Vector | None = None

    def __post_init__(self):
        _require_finite("constraint.", at=self.at or ())
        within("constraint.node", self.node, LABEL)
        if not self.directions or any(name not in AXES for name in self.directions):
            raise InputError(f"constraint.directions: found {list(self.directions)}, expected some of x, y, z")
        if len(set(self.directions)) < len(self.directions):
            raise InputError(f"constraint.directions: found {list(self.directions)}, expected each once")


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """One simulation; SI units, inertial axes.

    end: last time; steps: output intervals. start: "given" by position, rotation (vector, rad), velocity,
    angular_velocity of the body frame and the elastic coordinates, or "static": the rest position under gravity and the
    forces at t = 0. observe: nodes whose displacements are found beside those of forces and constraints. The tolerances
    are those of the integrator.
    """

    end: float
    steps: int = 500
    gravity: Vector = ZERO
    start: str = "given"
    position: Vector = ZERO
    rotation: Vector = ZERO
    velocity: Vector = ZERO
    angular_velocity: Vector = ZERO
    elastic: tuple[float, ...] = ()
    elastic_velocity: tuple[float, ...] = ()
    observe: tuple[int, ...] = ()
    relative_tolerance: float = 1e-5
    absolute_tolerance: float = 1e-8
    force: tuple[AnyForce, ...] = ()
    constraint: tuple[Joint, ...] = ()

    def __post_init__(self):
        for key in ("end", "steps", "relative_tolerance", "absolute_tolerance"):
            if not 0 < getattr(self, key) < np.inf:
                raise InputError(f"{key}: found {getattr(self, key):g}, expected a finite number of more than 0")
        within("end", self.end, (1e-15, 1e9, "s"))
        within("steps", self.steps, COUNT)
        within("relative_tolerance", self.relative_tolerance, (1e-14, 0.5, ""))
        within("absolute_tolerance", self.absolute_tolerance, (1e-30, 1.0, ""))
        within("observe", self.observe, LABEL)
        moving = ("velocity", "angular_velocity", "elastic", "elastic_velocity")
        _require_finite("", **{key: getattr(self, key) for key in ("gravity", "position", "rotation", *moving)})
        if self.start not in ("given", "static"):
            raise InputError(f"start: found '{self.start[:40]}', expected 'given' or 'static'")
        if self.start == "static" and any(any(getattr(self, key)) for key in moving):
            raise InputError(f"start: 'static' is a state of rest; leave out {', '.join(moving)}")

    @property
    def nodes(self) -> list[int]:
        """All nodes that are observed, loaded or held."""
        return sorted({*self.observe, *(item.node for item in (*self.force, *self.constraint))})


@dataclass
class Motion:
    """What a simulation found at its output times t (nt,); SI units.

    position (nt, 3) of the body frame and quaternion (nt, 4), scalar first; velocity (nt, 3) and angular_velocity
    (nt, 3) in body axes; elastic, elastic_velocity (nt, m). For k nodes: node_position (nt, k, 3) and
    node_displacement from the undeformed place at the start, inertial axes. constraint_force (nt, c) on the body with
    `constraint_names`. energies: kinetic, elastic, gravity, work (of the forces), dissipated (nt,). drift: largest
    distance of a held point from its place. balance: largest defect of the energy relative to the largest energy.
    notes: what was changed or approximated. factorisations: of the integrator's Newton matrices.
    """

    t: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    elastic: np.ndarray
    elastic_velocity: np.ndarray
    nodes: list
    node_position: np.ndarray
    node_displacement: np.ndarray
    constraint_names: list
    constraint_force: np.ndarray
    energies: dict
    drift: float
    balance: float
    notes: list
    factorisations: int


def simulate(body: Body, setup: Simulation, progress=None) -> Motion:
    """Simulate a Body whose `nodes` hold those of the setup, as an index-2 system by Radau IIA of order 5.

    On one rank. Raises InputError (dependent constraints, free rigid motion in a static start, structural damping, no
    mass in a direction, rigid-body motions in the basis, an unknown node) or ComputationError.
    """
    check_moving(body, "a simulation")
    shapes = {shape.node: shape for shape in body.nodes}
    for node in setup.nodes:
        if node not in shapes:
            known = ", ".join(map(str, shapes))
            raise InputError(f"node {node} is none of the nodes of the body, {known}; name it when the body is made")
    size = body.reduced.size
    for key in ("elastic", "elastic_velocity"):
        if len(getattr(setup, key)) not in (0, size):
            raise InputError(f"{key}: found {len(getattr(setup, key))} numbers, expected {size}")
    system = FlexibleBody(
        body.floating_frame, body.reduced.K, body.reduced.D, setup.gravity,
        [Force(shapes[item.node], item) for item in setup.force],
        [PointConstraint(shapes[item.node], np.eye(3)[[AXES.index(name) for name in item.directions]], item.at)
         for item in setup.constraint],
    )  # fmt: skip
    r, p = np.array(setup.position), np.roll(Rotation.from_rotvec(setup.rotation).as_quat(), 1)  # scalar first
    A = rotation(p)
    q, u = (np.array(getattr(setup, key) or np.zeros(size)) for key in ("elastic", "elastic_velocity"))
    z = np.concatenate([A.T @ setup.velocity, A.T @ setup.angular_velocity, u])
    origin = {node: r + A @ system.local(shape, np.zeros(size)) for node, shape in shapes.items()}
    notes = remarks(body)
    if setup.start == "static":
        r, p, q = system.equilibrium(r, p)
    else:
        r, p, q, moved = system.assemble(r, p, q)
        if moved:
            notes.append("the initial position did not fit the constraints and was moved there")
    y0, yp0, change = system.start(r, p, q, z)
    if change > 1e-10 * max(1.0, np.abs(z).max()):
        notes.append(f"the initial velocities did not fit the constraints and were projected (change {change:.2g})")
    t, states, rates, factorisations = _integrate(system, setup, y0, yp0, progress)
    return _motion(system, setup, shapes, origin, t, states, rates, notes, factorisations)


def _integrate(system, setup, y0, yp0, progress):
    try:
        from scipy_dae.integrate import solve_dae
    except ImportError as error:
        raise InputError("a simulation needs scipy_dae: pip install 'hpcred[simulate]'") from error

    shown = -1

    def residual(t, y, yp):
        nonlocal shown
        if progress is not None and int(20 * t / setup.end) > shown:
            shown = int(20 * t / setup.end)
            progress.say(f"t = {t:.4g} s of {setup.end:g} s")
        return system.residual(t, y, yp)

    # impulses begin at zero, and their rates, the forces, have round-off relative to their own size
    tolerance = np.full(len(y0), setup.absolute_tolerance)
    forces = system.split(yp0)[4]
    system.split(tolerance)[4][:] *= max(1.0, np.abs(forces).max(initial=0.0))
    # a pulse must not be stepped over
    longest = min([setup.end / 20, *(item.longest_step() for item in setup.force)])
    found = solve_dae(
        residual, (0.0, setup.end), y0, yp0, method="Radau", jac=system.jacobians, max_step=longest,
        rtol=setup.relative_tolerance, atol=tolerance, t_eval=np.linspace(0, setup.end, setup.steps + 1),
    )  # fmt: skip
    if not found.success:
        raise ComputationError(
            f"the integrator stopped at t = {found.t[-1] if len(found.t) else 0:.4g} s: {found.message}; "
            "loosen the tolerances, or leave out pseudo-modes far above the band (drop_above)"
        )
    return found.t, found.y, found.yp, int(found.nlu)


def _motion(system, setup, shapes, origin, t, states, rates, notes, factorisations):
    r, p, q, z, _, energy = (part.T for part in system.split(states))
    multipliers = system.split(rates)[4].T
    p = p / np.linalg.norm(p, axis=1)[:, None]
    axes = rotation(p)
    nodes = list(shapes)
    positions = np.array(
        [[r[i] + A @ system.local(shapes[node], q[i]) for node in nodes] for i, A in enumerate(axes)]
    ).reshape(len(t), len(nodes), 3)
    parts = np.array([system.energies(r[i], p[i], q[i], z[i]) for i in range(len(t))])
    energies = dict(zip(("kinetic", "elastic", "gravity"), parts.T, strict=True))
    energies |= {"work": energy[:, 0], "dissipated": energy[:, 1]}
    defect = parts.sum(axis=1) - parts[0].sum() - energy[:, 0] + energy[:, 1]
    scale = max(np.abs(parts - parts[0] * [0, 0, 1]).max(), np.abs(energy).max(), np.finfo(float).tiny)
    place = system.places(r[0], p[0], q[0])
    drift = max(np.abs(system.drift(r[i], A, q[i], place)).max(initial=0.0) for i, A in enumerate(axes))
    names = [f"{item.node}:{name}" for item in setup.constraint for name in item.directions]
    start = np.array([origin[node] for node in nodes]).reshape(len(nodes), 3)
    return Motion(
        t, r, p, z[:, :3], z[:, 3:6], q, z[:, 6:], nodes, positions, positions - start, names, multipliers,
        energies, float(drift), float(np.abs(defect).max() / scale), notes, factorisations,
    )  # fmt: skip
