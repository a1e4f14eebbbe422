"""One flexible body in the floating frame of reference: its equations of motion with point constraints (12, 13).

Coordinates: position r of the body frame (inertial axes), unit quaternion p, elastic coordinates q; velocities in body
axes v, w, and u = q'. With the momenta P = M(q) (v, w, u) and the kinetic energy T the equations are those of Lagrange
in quasi-velocities,

    P_v' + w x P_v = F,   P_w' + w x P_w + v x P_v = L,   P_u' - dT/dq = Q - K q - D u,

in which M(q) is exact for a displacement field linear in q, so that a free undamped body keeps energy and momentum.
Point constraints enter with multipliers on velocity level, as an index-2 system (Section 5.2 of the paper). The
multipliers are the derivatives of unknown impulses, which the integrator can control as well as the motion.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..parallel.failures import ComputationError, InputError
from .floating_frame import FloatingFrame
from .node_shapes import NodeShape


def rotation(p: np.ndarray) -> np.ndarray:
    """A (3, 3) from body to inertial axes of a quaternion (w, x, y, z) of any length; (k, 3, 3) of (k, 4)."""
    return Rotation.from_quat(p[..., [1, 2, 3, 0]]).as_matrix()  # SciPy puts the scalar last


def quaternion_rate(p: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """p' of a body that turns with omega (3,) in body axes."""
    w, x, y, z = p
    matrix = np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])
    return 0.5 * matrix @ omega


def _moved(r, p, q, step):
    """r, p, q after a small motion (6 + m,) in the coordinates of (v, w, u)."""
    p = p + quaternion_rate(p, step[3:6])
    return r + rotation(p) @ step[:3], p / np.linalg.norm(p), q + step[6:]


@dataclass(frozen=True)
class Force:
    """A force in inertial axes at a node; `value(t)` gives (3,) in N."""

    shape: NodeShape
    value: object


@dataclass(frozen=True)
class PointConstraint:
    """The node stays at `place` (3,), or where it starts, in these inertial directions (k, 3)."""

    shape: NodeShape
    directions: np.ndarray
    place: object = None


class FlexibleBody:
    """Equations of motion of a body with reduced K, D (m, m), under gravity (3,), forces and point constraints."""

    def __init__(self, floating_frame: FloatingFrame, K, D, gravity=(0.0, 0.0, 0.0), forces=(), constraints=()):
        self.floating_frame, self.K, self.D = floating_frame, np.asarray(K), np.asarray(D)
        self.gravity, self.forces, self.constraints = np.asarray(gravity, dtype=float), forces, constraints
        self.size, self.mass = len(floating_frame.Ct), floating_frame.mass
        self.multipliers = sum(len(item.directions) for item in constraints)
        self._dJ, self._J2, self._Cr1 = floating_frame.dJ, floating_frame.J2, floating_frame.Cr1

    # The state y: r, p, q | v, w, u | impulses of the constraints | work of the forces, dissipated energy
    def split(self, y):
        """Views r, p, q, z = (v, w, u), impulses and energies of a state (size, ...); of y', multipliers and powers."""
        m = self.size
        cuts = np.cumsum([3, 4, m, 6 + m, self.multipliers])
        return np.split(y, cuts)

    def local(self, shape: NodeShape, q):
        """Position (3,) of a node in the body frame."""
        return shape.position - self.floating_frame.origin + shape.phi @ q

    def first_moment(self, q):
        """Mass times centre of mass (3,) in the body frame."""
        return self.floating_frame.mc + self.floating_frame.Ct.T @ q

    def inertia(self, q):
        """J(q) (3, 3)."""
        quadratic = np.tensordot(q, np.tensordot(q, self._J2, axes=(0, 0)), axes=(0, 0))
        return self.floating_frame.J + np.tensordot(q, self._dJ, axes=(0, 0)) + quadratic

    def mass_matrix(self, q):
        """M(q) (6 + m, 6 + m), (13)."""
        body, m = self.floating_frame, self.size
        mc = self.first_moment(q)
        Cr = body.Cr + np.tensordot(self._Cr1, q, axes=(1, 0))
        M = np.zeros((6 + m, 6 + m))
        M[:3, :3] = self.mass * np.eye(3)
        M[3:6, :3] = np.cross(mc, np.eye(3)).T  # skew(mc)
        M[:3, 3:6] = M[3:6, :3].T
        M[3:6, 3:6] = self.inertia(q)
        M[6:, :3], M[6:, 3:6], M[6:, 6:] = body.Ct, Cr, body.Me
        M[:3, 6:], M[3:6, 6:] = body.Ct.T, Cr.T
        return M

    def inertia_forces(self, q, z, M):
        """M' z + (w x P_v, w x P_w + v x P_v, -dT/dq): what stands beside M z'."""
        v, w, u = z[:3], z[3:6], z[6:]
        P = M @ z
        slope = self._dJ + 2 * np.tensordot(self._J2, q, axes=(1, 0))  # dJ/dq_k (m, 3, 3)
        flow = self.floating_frame.Ct.T @ u
        gyroscopic = self._Cr1 @ w  # [i, k]: (integral of Phi_k x Phi_i) . w
        h = np.zeros_like(z)
        h[:3] = np.cross(w, flow) + np.cross(w, P[:3])
        h[3:6] = np.cross(flow, v) + np.tensordot(u, slope, axes=(0, 0)) @ w + np.cross(w, P[3:6]) + np.cross(v, P[:3])
        h[6:] = gyroscopic @ u - (self.floating_frame.Ct @ np.cross(v, w) + 0.5 * slope @ w @ w + gyroscopic.T @ u)
        return h

    def applied(self, t, A, q):
        """Generalised forces of gravity and of the forces at nodes (6 + m,), and of the latter alone."""
        body = self.floating_frame
        g = A.T @ self.gravity
        gravity = np.concatenate([self.mass * g, np.cross(self.first_moment(q), g), body.Ct @ g])
        own = np.zeros_like(gravity)
        for force in self.forces:
            f = A.T @ force.value(t)
            own += np.concatenate([f, np.cross(self.local(force.shape, q), f), force.shape.phi.T @ f])
        return gravity + own, own

    def constraint_matrix(self, A, q):
        """G (c, 6 + m): G z is the velocity of the constrained points along their directions."""
        rows = [np.zeros((0, 6 + self.size))]
        for item in self.constraints:
            a = item.directions @ A  # directions in body axes (k, 3)
            arm = self.local(item.shape, q)
            rows.append(np.concatenate([a, np.cross(arm, a), a @ item.shape.phi], axis=1))
        return np.concatenate(rows)

    def places(self, r, p, q):
        """Where the constrained points are to be, [(3,)] in inertial axes; where they start, unless told."""
        A = rotation(p)
        return [r + A @ self.local(item.shape, q) if item.place is None else np.asarray(item.place)
                for item in self.constraints]  # fmt: skip

    def drift(self, r, A, q, places):
        """Distance (c,) of the constrained points from their places along the directions."""
        parts = [np.zeros(0)]
        for item, place in zip(self.constraints, places, strict=True):
            parts.append(item.directions @ (r + A @ self.local(item.shape, q) - place))
        return np.concatenate(parts)

    def residual(self, t, y, yp):
        """F(t, y, y') of the index-2 system."""
        _, p, q, z, _, _ = self.split(y)
        rp, pp, qp, zp, multipliers, power = self.split(yp)
        A = rotation(p)
        M = self.mass_matrix(q)
        total, own = self.applied(t, A, q)
        G = self.constraint_matrix(A, q)
        damping = self.D @ z[6:]
        force = total - self.inertia_forces(q, z, M) + G.T @ multipliers
        force[6:] -= self.K @ q + damping
        return np.concatenate(
            [
                rp - A @ z[:3],
                pp - quaternion_rate(p, z[3:6]) - (1 - p @ p) * p,
                qp - z[6:],
                M @ zp - force,
                G @ z,
                power - np.array([own @ z, damping @ z[6:]]),
            ]
        )

    def jacobians(self, t, y, yp):
        """dF/dy and dF/dy' for the Newton steps, which need no exact ones.

        The columns of the quaternion and of v and w are differences; those of q and u hold stiffness and damping, which
        outweigh the inertia forces there.
        """
        _, p, q, _, _, _ = self.split(y)
        m, c, n = self.size, self.multipliers, len(y)
        G = self.constraint_matrix(rotation(p), q)
        at_q, at_z, at_m, at_e = 7, 7 + m, 13 + 2 * m, 13 + 2 * m + c
        dy, dyp = np.zeros((n, n)), np.eye(n)
        dyp[at_z:at_m, at_z:at_m] = self.mass_matrix(q)
        dyp[at_m:at_e, at_m:at_e] = 0.0
        base = self.residual(t, y, yp)
        for column in (*range(3, 7), *range(at_z, at_z + 6)):
            step = 1e-7 * max(1.0, abs(y[column]))
            moved = y.copy()
            moved[column] += step
            dy[:, column] = (self.residual(t, moved, yp) - base) / step
        dy[at_q:at_z, at_z + 6 : at_m] = -np.eye(m)
        dy[at_z + 6 : at_m, at_q:at_z] = self.K
        dy[at_z + 6 : at_m, at_z + 6 : at_m] = self.D
        dyp[at_z:at_m, at_m:at_e] = -G.T
        dy[at_m:at_e, at_z:at_m] = G
        return dy, dyp

    def assemble(self, r, p, q):
        """r, p, q after the least rigid motion that brings the held points to their places, and whether it moved.

        Raises InputError where no rigid motion does.
        """
        place, moved = self.places(r, p, q), False
        for _ in range(50):
            A = rotation(p)
            gap = self.drift(r, A, q, place)
            if np.abs(gap).max(initial=0.0) < 1e-12 * max(1.0, np.abs(r).max()):
                return r, p, q, moved
            G = self.constraint_matrix(A, q)[:, :6]
            step = np.linalg.lstsq(G, -gap, rcond=1e-10)[0]
            r, p, q = _moved(r, p, q, np.concatenate([step, 0 * q]))
            moved = True
        raise InputError(
            f"constraint.at: the body stays {np.abs(gap).max():.2g} m away from the given places; check them, or let "
            "it be strained by start = 'static'"
        )

    def start(self, r, p, q, z):
        """A consistent state and its derivative: velocities projected onto the constraints.

        Returns y, y' and the largest change of a velocity. Raises InputError for dependent constraints.
        """
        A, M = rotation(p), self.mass_matrix(q)
        G = self.constraint_matrix(A, q)
        self._check_rank(G)
        c = self.multipliers
        inverse = np.linalg.solve(M, G.T)
        projected = z - inverse @ np.linalg.solve(G @ inverse, G @ z) if c else z
        v, w, u = projected[:3], projected[3:6], projected[6:]
        bias = [np.zeros(0)]
        for item in self.constraints:
            arm, rate = self.local(item.shape, q), item.shape.phi @ u
            bias.append(item.directions @ A @ (np.cross(w, v + np.cross(w, arm)) + 2 * np.cross(w, rate)))
        total, own = self.applied(0.0, A, q)
        force = total - self.inertia_forces(q, projected, M)
        damping = self.D @ u
        force[6:] -= self.K @ q + damping
        system = np.block([[M, -G.T], [G, np.zeros((c, c))]])
        solution = np.linalg.solve(system, np.concatenate([force, -np.concatenate(bias)]))
        zp, multipliers = solution[: 6 + self.size], solution[6 + self.size :]
        y = np.concatenate([r, p, q, projected, np.zeros(c + 2)])
        rates = [A @ v, quaternion_rate(p, w), u, zp, multipliers, [own @ projected, damping @ u]]
        return y, np.concatenate(rates), float(np.abs(projected - z).max(initial=0.0))

    def _check_rank(self, G):
        values = np.linalg.svd(G, compute_uv=False)
        if len(values) and values.min() < 1e-10 * values.max():
            raise InputError("constraint: the constraints depend on each other; leave one of them out")

    def equilibrium(self, r, p):
        """r, p, q at rest under gravity and the forces at t = 0. Raises InputError where a rigid motion is free."""
        m, q = self.size, np.zeros(self.size)
        place = self.places(r, p, q)
        for _ in range(50):
            A = rotation(p)
            G = self.constraint_matrix(A, q)
            self._check_rank(G)
            values = np.linalg.svd(G[:, :6], compute_uv=False)
            free = 6 - int((values > 1e-8 * values.max(initial=1.0)).sum())
            if free:
                raise InputError(
                    f"start: 'static' needs constraints that hold the body, but they leave {free} rigid motions free"
                )
            total, _ = self.applied(0.0, A, q)
            stiffness = np.zeros((6 + m, 6 + m))
            stiffness[6:, 6:] = self.K
            system = np.block([[stiffness, -G.T], [G, np.zeros((len(G), len(G)))]])
            total[6:] -= self.K @ q
            step = np.linalg.solve(system, np.concatenate([total, -self.drift(r, A, q, place)]))
            r, p, q = _moved(r, p, q, step[: 6 + m])
            if np.abs(step[: 6 + m]).max() < 1e-12 * max(1.0, np.abs(q).max()):
                return r, p, q
        raise ComputationError("start: no static equilibrium was found in 50 steps")

    def energies(self, r, p, q, z):
        """Kinetic, elastic and gravity energy in J."""
        kinetic = 0.5 * z @ self.mass_matrix(q) @ z
        moment = self.mass * r + rotation(p) @ self.first_moment(q)
        return kinetic, 0.5 * q @ self.K @ q, -self.gravity @ moment
