"""Form the equations of motion of a flexible body in the floating frame, with constraints on nodes (12, 13).

Coordinates: position r of the body frame (inertial axes), unit quaternion p, elastic coordinates q; velocities in body
axes v, w, and u = q'. With the momenta P = M(q) (v, w, u) and the kinetic energy T the equations are those of Lagrange
in quasi-velocities,

    P_v' + w x P_v = F,   P_w' + w x P_w + v x P_v = L,   P_u' - dT/dq = Q - K q - D u,

in which M(q) is exact for a displacement field linear in q, so that a free undamped body keeps energy and momentum.
Constraints are added with multipliers on velocity level, as an index-2 system (Section 5.2 of the paper). The
multipliers are the rates of unknown impulses, whose error the integrator controls like that of the motion. Loads,
springs and constraints act on nodes by B (6, 6 + m), which maps (v, w, u) to the velocity and angular velocity of a
node; see joints for its kinematics. Viscoelastic parts of Maxwell's law add c L (L^T q - x) to K q, and states x, the
displacements of dashpots, with x' = (L^T q - x) / time (see reduction.result.maxwell_states).
"""

from dataclasses import dataclass

import numpy as np

from ..body.floating_frame import FloatingFrame
from ..body.node_shapes import NodeShape
from ..body.rotations import (
    cross,
    exponential,
    quaternion_rate,
    rate_derivative,
    rate_matrix,
    rate_of_quaternion,
    rotation,
)
from ..model.rotation import skew
from ..parallel.failures import ComputationError, InputError
from ..reduction.result.maxwell_states import MaxwellStates

ROUND_OFF = 1e-14
CHUNK = 100  # times whose energies are computed at once


def _moved(r, p, q, step):
    """Return r, p, q after a small motion (6 + m,) in the coordinates of (v, w, u)."""
    p = p + quaternion_rate(p, step[3:6])
    return r + rotation(p) @ step[:3], p / np.linalg.norm(p), q + step[6:]


def _beyond_round_off(values, size):
    """Return Values, and zero where they are round-off of what they are the difference of, `size`."""
    return np.where(np.abs(values) > ROUND_OFF * size, values, 0.0)


@dataclass
class NodeMotion:
    """Position x (3,) and rotation R (3, 3) of a node, and B (6, 6 + m) to its velocity; inertial axes."""

    x: np.ndarray
    R: np.ndarray
    B: np.ndarray


def node_motion(shape: NodeShape, origin, r, A, q) -> NodeMotion:
    """Return the motion of a node of a body with a frame at `origin` (3,) of the model, r (3,), A (3, 3) and q (m,)."""
    moved, turned, phi, psi = shape.motion(q)
    arm = shape.position - origin + moved
    B = np.zeros((6, 6 + len(q)))
    B[:3, :3] = B[3:, 3:6] = A
    B[:3, 3:6], B[:3, 6:] = A @ skew(-arm), A @ phi
    if not shape.rotates:
        return NodeMotion(r + A @ arm, A, B)
    R, J = exponential(turned)
    B[3:, 6:] = A @ J @ psi
    return NodeMotion(r + A @ arm, A @ R, B)


class FlexibleBody:
    """Equations of motion of a body with reduced K, D (m, m), under gravity (3,).

    `loads`: Load; `springs`: LineElement, BushingElement; `holds`: Hold, the constraints; `pushes`: Push; `elements`:
    of added terms, relaxed at the start.
    """

    def __init__(
        self, floating_frame: FloatingFrame, K, D, gravity=(0.0, 0.0, 0.0), loads=(), springs=(), holds=(), pushes=(),
        elements: MaxwellStates | None = None,
    ):  # fmt: skip
        self.floating_frame, self.K, self.D, self.pushes = floating_frame, np.asarray(K), np.asarray(D), pushes
        self._skew = (self.K - self.K.T) / 2  # which stores no energy
        self._sizes_of_K = np.abs(self.K)
        self.gravity, self.loads, self.springs, self.holds = np.asarray(gravity, dtype=float), loads, springs, holds
        self.size, self.mass = len(floating_frame.Ct), floating_frame.mass
        ends = np.cumsum([0, *map(len, holds)]).tolist()
        self.multipliers, rows = ends[-1], map(slice, ends[:-1], ends[1:])
        self._rows_of_holds = list(zip(holds, rows, strict=True))
        ends = np.cumsum([0, 3, 4, self.size, 6 + self.size, self.multipliers, 3]).tolist()
        self._parts = [slice(first, last) for first, last in zip(ends, [*ends[1:], None], strict=True)]
        self.elements = elements or MaxwellStates(np.zeros((self.size, 0)), np.zeros(0), np.zeros(0))
        self._shapes = {acting.shape.node: acting.shape for acting in (*loads, *springs, *holds)}

    # The state y: r, p, q | v, w, u | impulses of constraints | work of loads and of drives, losses | dashpots
    def split(self, y):
        """Return views r, p, q, z = (v, w, u), impulses, energies and displacements of dashpots of a state (size, ...);
        of y', multipliers and powers."""
        return [y[rows] for rows in self._parts]

    def node_motions(self, r, A, q) -> dict:
        """Return the NodeMotion of every node with a load, spring or constraint, by number."""
        origin = self.floating_frame.origin
        return {node: node_motion(shape, origin, r, A, q) for node, shape in self._shapes.items()}

    def inertia_forces(self, q, z, M):
        """Return M' z + (w x P_v, w x P_w + v x P_v, -dT/dq): what stands beside M z'."""
        v, w, u = z[:3], z[3:6], z[6:]
        P, Ct = M @ z, M[6:, :3]
        at_q, at_u = self.floating_frame.varied(np.stack([q, z[6:]]))
        slope = self.floating_frame.dJ.reshape(-1, 9) + at_q[:, 9:]
        flow, W, V = u @ Ct, skew(w), skew(v)
        pushed = u @ at_u[:, :6]
        h = np.empty_like(z)
        h[:3] = pushed[:3] + W @ (P[:3] + flow)
        h[3:6] = pushed[3:] + (u @ slope).reshape(3, 3) @ w + W @ P[3:6] + V @ (P[:3] - flow)
        h[6:] = at_u[:, 6:9] @ w - Ct @ (V @ w) - slope @ np.outer(w, w / 2).ravel()
        return h

    def _weight(self, A, q):
        """Return the generalised force (6 + m,) of gravity."""
        if not self.gravity.any():
            return np.zeros(6 + self.size)
        body, g = self.floating_frame, self.gravity @ A
        return np.concatenate([self.mass * g, cross(body.first_moment(q), g), body.translations(q) @ g])

    def applied(self, t, A, q, z, motions):
        """Return generalised forces of gravity, loads and springs (6 + m,); powers of loads and of springs' dampers."""
        total, power, loss = self._weight(A, q), 0.0, 0.0
        for load in self.loads:
            node = motions[load.shape.node]
            force = load.wrench(t, node.R) @ node.B
            total += force
            power += force @ z
        for push in self.pushes:
            force = push.value(t) * push.force
            total += force
            power += force @ z
        for spring in self.springs:
            node = motions[spring.shape.node]
            v, omega = np.split(node.B @ z, 2)
            total += spring.wrench(node.x, node.R, v, omega) @ node.B
            loss += spring.dissipation(node.x, v, omega)
        return total, power, loss

    @property
    def impulse(self) -> np.ndarray:
        """The generalised impulse (6 + m,) at t = 0 of bases that move at once."""
        return sum((push.value.jump * push.force for push in self.pushes), np.zeros(6 + self.size))

    def constraints(self, t, motions):
        """Return G (c, 6 + m) and rates (c,): the constraints on velocity level are G z = rates."""
        G, rates = np.empty((self.multipliers, 6 + self.size)), np.empty(self.multipliers)
        for hold, rows in self._rows_of_holds:
            node = motions[hold.shape.node]
            N = hold.directions(t, node.R)
            G[rows], rates[rows] = N @ node.B, N @ hold.velocity(t, node.x)
        return G, rates

    def gaps(self, t, motions):
        """Return how far (c,) the held nodes are from where they are to be, in m and rad."""
        gaps = [hold.gap(t, motions[hold.shape.node].x, motions[hold.shape.node].R) for hold in self.holds]
        return np.concatenate([np.zeros(0), *gaps])

    def reactions(self, t, motions, multipliers) -> dict:
        """Return force and moment (6,) of the constraints on each held node, by number; inertial axes."""
        wrenches = {}
        for hold, rows in self._rows_of_holds:
            node = hold.shape.node
            wrenches[node] = wrenches.get(node, 0.0) + multipliers[rows] @ hold.directions(t, motions[node].R)
        return wrenches

    def residual(self, t, y, yp):
        """Return F(t, y, y') of the index-2 system."""
        r, p, q, z, _, _, dashpots = self.split(y)
        rp, pp, qp, zp, multipliers, powers, dashpots_p = self.split(yp)
        A = rotation(p)
        M = self.floating_frame.mass_matrix(q)
        motions = self.node_motions(r, A, q)
        total, power, loss = self.applied(t, A, q, z, motions)
        G, rates = self.constraints(t, motions)
        u = z[6:]
        damping, pull, inertia = self.D @ u, multipliers @ G, M @ zp
        stress = self.K @ q + damping
        # at rest the equations hold to round-off, in which Newton's method would look for convergence in vain
        size = np.abs(total) + np.abs(multipliers) @ np.abs(G) + np.abs(M) @ np.abs(zp)
        size[6:] += self._sizes_of_K @ np.abs(q)
        stretch_p, lost = dashpots_p, loss + (damping + self._skew @ q) @ u
        if self.elements.size:
            elements = self.elements
            stretch, per_time = elements.L.T @ q - dashpots, 1 / elements.times
            stress += elements.L @ (elements.factors * stretch)
            large = np.abs(elements.L.T) @ np.abs(q) + np.abs(dashpots)
            size[6:] += np.abs(elements.L) @ (elements.factors * large)
            lost += elements.factors @ (per_time * stretch**2)
            stretch_p = _beyond_round_off(dashpots_p - per_time * stretch, per_time * large)
        balance = inertia + self.inertia_forces(q, z, M) - total - pull
        balance[6:] += stress
        residual = np.empty_like(y)
        places = self.split(residual)
        places[0][:] = rp - A @ z[:3]
        places[1][:] = pp - quaternion_rate(p, z[3:6]) - (1 - p @ p) * p
        places[2][:] = qp - u
        places[3][:] = _beyond_round_off(balance, size)
        places[4][:] = _beyond_round_off(G @ z - rates, np.abs(G) @ np.abs(z) + np.abs(rates))
        places[5][:] = powers
        places[5][:] -= power, rates @ multipliers, lost
        places[6][:] = stretch_p
        return residual

    def jacobians(self, t, y, yp):
        """Return dF/dy and dF/dy', but for the powers, which are integrals that nothing depends on."""
        r, p, q, z, *_ = self.split(y)
        _, _, _, zp, multipliers, *_ = self.split(yp)
        A, m, n = rotation(p), self.size, len(y)
        at_r, at_p, at_q, at_z, at_c, _, at_d = self._parts
        by_place, by_z, rates_by_place, G = self.tangents(t, r, A, q, z, zp, multipliers)
        dy, dyp = np.zeros((n, n)), np.eye(n)
        # a change of r moves the body by A^T dr in its axes, one of p turns it by 2 Q^T dp
        Q = rate_of_quaternion(p)
        turned = 2 * Q.T / (p @ p)
        for rows, block in ((at_z, by_place), (at_c, rates_by_place)):
            dy[rows, at_r], dy[rows, at_p], dy[rows, at_q] = block[:, :3] @ A.T, block[:, 3:6] @ turned, block[:, 6:]
        dy[at_z, at_z], dy[at_c, at_z] = by_z, G
        dyp[at_z, at_z], dyp[at_z, at_c], dyp[at_c, at_c] = self.floating_frame.mass_matrix(q), -G.T, 0.0
        # kinematics: r' = A v, p' = Q(p) w / 2 = W p / 2, q' = u
        v, w = at_z.start, at_z.start + 3
        W = np.zeros((4, 4))
        W[0, 1:], W[1:, 0], W[1:, 1:] = -z[3:6], z[3:6], -skew(z[3:6])
        dy[at_r, at_p], dy[at_r, v:w] = A @ skew(z[:3]) @ turned, -A
        dy[at_p, at_p] = 2 * np.outer(p, p) - (1 - p @ p) * np.eye(4) - W / 2
        dy[at_p, w : w + 3], dy[at_q, w + 3 : w + 3 + m] = -Q / 2, -np.eye(m)
        # Maxwell elements
        elements = self.elements
        dy[w + 3 : w + 3 + m, at_d] = -elements.factors * elements.L
        dy[at_d, at_q], dy[at_d, at_d] = -elements.L.T / elements.times[:, None], np.diag(1 / elements.times)
        return dy, dyp

    def tangents(self, t, r, A, q, z, zp, multipliers):
        """Return the Jacobians (6 + m, 6 + m) of the equations of motion by displacements in the coordinates of
        (v, w, u), and by z; those (c, 6 + m) of G z - rates by displacements; and G."""
        motions = self.node_motions(r, A, q)
        by_place, by_z = self._tangents_of_inertia(A, q, z, zp)
        G, _ = self.constraints(t, motions)
        rates_by_place = np.zeros_like(G)
        elements = self.elements
        by_place[6:, 6:] += self.K + (elements.factors * elements.L) @ elements.L.T
        by_z[6:, 6:] += self.D
        wrenches = self.reactions(t, motions, multipliers)
        for node, motion in motions.items():
            shape, B = self._shapes[node], motion.B
            velocity, by_motion = B @ z, self._velocity_by_place(shape, A, q, z)
            stiffness, damping, wrench = np.zeros((6, 6)), np.zeros((6, 6)), wrenches.get(node, 0.0) + np.zeros(6)
            # forces that change with place, rotation and velocity of the node
            for load in self.loads:
                if load.shape.node == node:
                    own = load.wrench(t, motion.R)
                    wrench += own
                    if load.follows:
                        stiffness[:3, 3:] += skew(own[:3])
                        stiffness[3:, 3:] += skew(own[3:])
            for spring in self.springs:
                if spring.shape.node == node:
                    wrench += spring.wrench(motion.x, motion.R, *np.split(velocity, 2))
                    for total, tangent in zip((stiffness, damping), spring.tangents(motion.x, motion.R, velocity[:3]),
                                           strict=True):  # fmt: skip
                        total += tangent
            for hold, rows in self._rows_of_holds:
                if hold.shape.node == node:
                    N, turns = hold.directions(t, motion.R), hold.support.state(t)[3]
                    rates_by_place[rows] = N @ by_motion - N[:, :3] @ skew(turns) @ B[:3]
                    if (turned := hold.cross_by_rotation(t, motion.R)) is not None:
                        stiffness[3:, 3:] -= multipliers[rows][-1] * turned
                        rates_by_place[rows.stop - 1] += (velocity[3:] - turns) @ turned @ B[3:]
            by_place += B.T @ (stiffness @ B + damping @ by_motion) - self._turned_wrench(shape, A, q, B, wrench)
            by_z += B.T @ damping @ B
        return by_place, by_z, rates_by_place, G

    def _tangents_of_inertia(self, A, q, z, zp):
        """Return the Jacobians (6 + m, 6 + m) of M z' + inertia forces - weight by displacements and by z."""
        body, M, m = self.floating_frame, self.floating_frame.mass_matrix(q), self.size
        v, w, u = z[:3], z[3:6], z[6:]
        at_q, at_u, at_up = body.varied(np.stack([q, u, zp[6:]]))
        Ct, P, W, V = M[6:, :3], M @ z, skew(w), skew(v)
        slope = (body.dJ.reshape(-1, 9) + at_q[:, 9:]).reshape(m, 3, 3)

        def slopes(a, change):
            """Return the Jacobian of M a by q (6 + m, m)."""
            moved = skew(a[3:6]) @ Ct.T + change[:, :3].T
            turned = (slope @ a[3:6] + change[:, 3:6] - change[:, 6:9]).T - skew(a[:3]) @ Ct.T
            return np.concatenate([moved, turned, body.Ct1 @ a[:3] + body.Cr1 @ a[3:6]])

        by_q, flow = slopes(z, at_u), skew(u @ Ct)
        # M' and the Jacobians of M' z - dT/dq, and of the gyroscopic terms
        by_z = np.zeros_like(M)
        by_z[3:6, :3], by_z[:3, 3:6], by_z[3:6, 3:6] = flow, -flow, np.tensordot(u, slope, axes=1)
        by_z[6:, :6], by_z[:6, 6:] = at_u[:, :6], at_u[:, :6].T
        by_z[:, 6:] += by_q
        by_z[6:] -= by_q.T
        by_z[:3] += W @ M[:3]
        by_z[3:6] += W @ M[3:6] + V @ M[:3]
        by_z[:3, 3:6] -= skew(P[:3])
        by_z[3:6, :3] -= skew(P[:3])
        by_z[3:6, 3:6] -= skew(P[3:6])
        # by q also the second derivatives of M; by rotations only the weight changes
        by_place = np.zeros_like(M)
        by_place[:, 6:] = slopes(zp, at_up)
        by_place[:3, 6:] += W @ (by_q[:3] + at_u[:, :3].T)
        by_place[3:6, 6:] += W @ by_q[3:6] + V @ (by_q[:3] - at_u[:, :3].T) + (at_u[:, 9:].reshape(m, 3, 3) @ w).T
        g = self.gravity @ A
        by_place[6:, 6:] -= body.Ct1 @ (V @ w + g) + body.J2.reshape(m, m, 9) @ np.outer(w, w).ravel()
        weight = skew(g)
        by_place[:, 3:6] -= M[:, :3] @ weight
        by_place[3:6, 6:] += weight @ Ct.T
        return by_place, by_z

    def _velocity_by_place(self, shape, A, q, z):
        """Return the derivative (6, 6 + m) of the velocities of a node by displacements, in inertial axes."""
        moved, turned, phi, psi = shape.motion(q)
        w, u, J = z[3:6], z[6:], rate_matrix(turned)
        speed = z[:3] + cross(w, shape.position - self.floating_frame.origin + moved) + phi @ u
        D = np.zeros((6, 6 + self.size))
        D[:3, 3:6], D[3:, 3:6] = -skew(speed), -skew(w + J @ (psi @ u))
        D[:3, 6:], D[3:, 6:] = skew(w) @ phi, -rate_derivative(-turned, psi @ u) @ psi
        if shape.phi1 is not None:
            D[:3, 6:] += shape.phi1 @ u
            D[3:, 6:] += J @ (shape.psi1 @ u)
        D[:3], D[3:] = A @ D[:3], A @ D[3:]
        return D

    def _turned_wrench(self, shape, A, q, B, wrench):
        """Return the derivative (6 + m, 6 + m) of B^T wrench by displacements, for a wrench (6,) in inertial axes."""
        _, turned, phi, psi = shape.motion(q)
        force, moment = wrench[:3] @ A, wrench[3:] @ A
        D = np.zeros((6 + self.size,) * 2)
        D[:, 3:6] = B[:3].T @ A @ skew(force) + B[3:].T @ A @ skew(moment)
        D[3:6, 6:] = -skew(force) @ phi
        D[6:, 6:] = psi.T @ rate_derivative(turned, moment) @ psi
        if shape.phi1 is not None:
            D[6:, 6:] += np.tensordot(force, shape.phi1, axes=1)
            D[6:, 6:] += np.tensordot(moment @ rate_matrix(turned), shape.psi1, axes=1)
        return D

    def assemble(self, r, p, q):
        """Return r, p, q after the least rigid motion that brings the held nodes to their places, and whether it moved.

        Raises InputError where no rigid motion does.
        """
        moved = False
        for _ in range(50):
            motions = self.node_motions(r, rotation(p), q)
            gap = self.gaps(0.0, motions)
            if np.abs(gap).max(initial=0.0) < 1e-12 * max(1.0, np.abs(r).max()):
                return r, p, q, moved
            G = self.constraints(0.0, motions)[0][:, :6]
            step = np.linalg.lstsq(G, -gap, rcond=1e-10)[0]
            r, p, q = _moved(r, p, q, np.concatenate([step, 0 * q]))
            moved = True
        raise InputError(
            f"constraint.at: the body stays {np.abs(gap).max():.2g} m or rad away from the given places; check them, "
            "or let it be strained by start = 'static'"
        )

    def start(self, r, p, q, z):
        """Return a consistent state and its derivative: velocities projected onto the constraints, and what bases that
        move at once add to them.

        Returns y, y' and the largest change by the projection. Raises InputError for dependent constraints.
        """
        A, M = rotation(p), self.floating_frame.mass_matrix(q)
        motions = self.node_motions(r, A, q)
        G, rates = self.constraints(0.0, motions)
        self._check_rank(G)
        c = self.multipliers
        inverse = np.linalg.solve(M, G.T)
        projected = z - inverse @ np.linalg.solve(G @ inverse, G @ z - rates)
        change = float(np.abs(projected - z).max())
        jump = np.linalg.solve(M, self.impulse)
        projected = projected + jump - inverse @ np.linalg.solve(G @ inverse, G @ jump)
        v, w, u = projected[:3], projected[3:6], projected[6:]
        total, power, loss = self.applied(0.0, A, q, projected, motions)
        force = total - self.inertia_forces(q, projected, M)
        damping = self.D @ u
        force[6:] -= self.K @ q + damping
        system = np.block([[M, -G.T], [G, np.zeros((c, c))]])
        solution = np.linalg.solve(system, np.concatenate([force, -self._drift_rates(r, p, q, projected)]))
        zp, multipliers = solution[: 6 + self.size], solution[6 + self.size :]
        y = np.concatenate([r, p, q, projected, np.zeros(c + 3), self.elements.L.T @ q])
        powers = [power, rates @ multipliers, (damping + self._skew @ q) @ u + loss]
        state = [A @ v, quaternion_rate(p, w), u, zp, multipliers, powers, np.zeros(self.elements.size)]
        return y, np.concatenate(state), change

    def _drift_rates(self, r, p, q, z):
        """Return (G z - rates)' (c,) at t = 0 for z' = 0, by differences of second order towards later times."""
        drives = [drive for hold in self.holds for drive in (*hold.support.shifts, *hold.support.turns)]
        times = [drive.longest_step() for drive in drives]
        step = 1e-4 * min([1.0, 1 / (1.0 + np.linalg.norm(z[3:6])), *times])
        differences = []
        for h in (step, 2 * step):
            motions = self.node_motions(*self._state(_moved(r, p, q, h * z)))
            G, rates = self.constraints(h, motions)
            differences.append(G @ z - rates)
        return (4 * differences[0] - differences[1]) / (2 * step)

    @staticmethod
    def _state(placed):
        r, p, q = placed
        return r, rotation(p), q

    def _check_rank(self, G):
        """Raise InputError, naming the joints, where constraints depend on each other."""
        left, values, _ = np.linalg.svd(G, full_matrices=True)
        rank = int((values > 1e-10 * values.max(initial=0.0)).sum())
        if rank == len(G):
            return
        unheld = np.abs(left[:, rank:]).max(axis=1) > 1e-6
        labels = np.repeat([hold.label for hold in self.holds], [len(hold) for hold in self.holds])
        named = ", ".join(dict.fromkeys(labels[unheld]))
        raise InputError(
            f"constraint: the constraints depend on each other ({named}); leave one of them out, hold less by it, or "
            "reduce with more elastic coordinates, which let the nodes move apart"
        )

    def _check_held(self, G, motions):
        """Raise InputError where constraints and springs leave rigid motions free."""
        springs = [spring.held(motions[spring.shape.node].x) @ motions[spring.shape.node].B for spring in self.springs]
        rows = np.concatenate([G, *springs])[:, :6]
        values = np.linalg.svd(rows, compute_uv=False)
        free = 6 - int((values > 1e-8 * values.max(initial=1.0)).sum())
        if free:
            raise InputError(
                f"start: 'static' needs constraints or springs that hold the body, but they leave {free} rigid motions "
                "free"
            )

    def equilibrium(self, r, p):
        """Return r, p, q at rest under gravity, loads and drives at t = 0. Raises InputError where a rigid motion is
        free."""
        m, c, q = self.size, self.multipliers, np.zeros(self.size)
        multipliers, still = np.zeros(c), np.zeros(6 + m)
        for _ in range(50):
            motions = self.node_motions(r, rotation(p), q)
            G, _ = self.constraints(0.0, motions)
            self._check_rank(G)
            self._check_held(G, motions)
            force = self._static_force(r, p, q, multipliers)
            stiffness = self.tangents(0.0, r, rotation(p), q, still, still, multipliers)[0]
            system = np.block([[stiffness, -G.T], [G, np.zeros((c, c))]])
            step = np.linalg.solve(system, np.concatenate([force, -self.gaps(0.0, motions)]))
            r, p, q = _moved(r, p, q, step[: 6 + m])
            multipliers = multipliers + step[6 + m :]
            if np.abs(step[: 6 + m]).max() < 1e-12 * max(1.0, np.abs(q).max()):
                return r, p, q
        raise ComputationError("start: no static equilibrium was found in 50 steps")

    def _static_force(self, r, p, q, multipliers):
        """Return generalised forces (6 + m,) on the body at rest at t = 0."""
        A = rotation(p)
        motions = self.node_motions(r, A, q)
        total, _, _ = self.applied(0.0, A, q, np.zeros(6 + self.size), motions)
        total += self.constraints(0.0, motions)[0].T @ multipliers
        total[6:] -= self.K @ q
        return total

    def energies(self, r, A, q, z, dashpots):
        """Return kinetic, elastic and gravity's energy (nt, 3) in J at many times; the elastic one is also that of
        Maxwell elements."""
        body, energies = self.floating_frame, np.empty((len(q), 3))
        v, w, u = np.split(z, [3, 6], axis=1)
        for first in range(0, len(q), CHUNK):
            chunk = slice(first, first + CHUNK)
            change = body.varied(q[chunk])
            couplings = np.concatenate([body.Ct, body.Cr], axis=1) + change[:, :, :6]
            centre = body.mc + np.einsum("tk,tki->ti", q[chunk], body.Ct + change[:, :, :3] / 2)
            inertia = body.J + np.einsum("tk,tki->ti", q[chunk], body.dJ.reshape(-1, 9) + change[:, :, 9:] / 2).reshape(
                -1, 3, 3
            )
            energies[chunk, 0] = (
                self.mass * (v[chunk] ** 2).sum(axis=1) / 2 + (w[chunk] * np.cross(centre, v[chunk])).sum(axis=1)
                + np.einsum("ti,tij,tj->t", w[chunk], inertia, w[chunk]) / 2
                + np.einsum("tk,tki,ti->t", u[chunk], couplings, z[chunk, :6])
            )  # fmt: skip
            weight = np.einsum("ti,tij,j->t", centre, A[chunk].transpose(0, 2, 1), self.gravity)
            energies[chunk, 2] = -(self.mass * r[chunk] @ self.gravity + weight)
        energies[:, 0] += np.einsum("ti,ij,tj->t", u, body.Me, u) / 2
        stretch = q @ self.elements.L - dashpots
        energies[:, 1] = (np.einsum("ti,ij,tj->t", q, self.K, q) + stretch**2 @ self.elements.factors) / 2
        return energies
