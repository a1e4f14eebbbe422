"""Form the equations of motion of a flexible body in the floating frame, with constraints on nodes (12, 13).

Coordinates: position r of the body frame (inertial axes), unit quaternion p, elastic coordinates q; velocities in body
axes v, w, and u = q'. With the momenta P = M(q) (v, w, u) and the kinetic energy T the equations are those of Lagrange
in quasi-velocities,

    P_v' + w x P_v = F,   P_w' + w x P_w + v x P_v = L,   P_u' - dT/dq = Q - K q - D u,

in which M(q) is exact for a displacement field linear in q, so that a free undamped body keeps energy and momentum.
Constraints are added with multipliers on velocity level, as an index-2 system (Section 5.2 of the paper). The
multipliers are the derivatives of unknown impulses, whose error the integrator controls like that of the motion. Loads,
springs and constraints act on nodes by B (6, 6 + m), which maps (v, w, u) to the velocity and angular velocity of a
node; see joints for its kinematics. Viscoelastic parts of Maxwell's law add c L (L^T q - x) to K q, and states x, the
displacements of dashpots, with x' = (L^T q - x) / time (see reduction.result.maxwell_states).
"""

from dataclasses import dataclass

import numpy as np

from ..body.floating_frame import FloatingFrame
from ..body.node_shapes import NodeShape
from ..body.rotations import cross, of_vector, quaternion_rate, rate_matrix, rotation
from ..model.rotation import skew
from ..parallel.failures import ComputationError, InputError
from ..reduction.result.maxwell_states import MaxwellStates

ROUND_OFF = 1e-14


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
    B[:3, :3], B[:3, 3:6], B[:3, 6:] = A, -A @ skew(arm), A @ phi
    B[3:, 3:6] = A
    if not shape.rotates:
        return NodeMotion(r + A @ arm, A, B)
    B[3:, 6:] = A @ rate_matrix(turned) @ psi
    return NodeMotion(r + A @ arm, A @ of_vector(turned), B)


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
        self.gravity, self.loads, self.springs, self.holds = np.asarray(gravity, dtype=float), loads, springs, holds
        self.size, self.mass = len(floating_frame.Ct), floating_frame.mass
        self.multipliers = sum(len(hold) for hold in holds)
        ends = np.cumsum([0, 3, 4, self.size, 6 + self.size, self.multipliers, 3]).tolist()
        self._parts = [slice(first, last) for first, last in zip(ends, [*ends[1:], None], strict=True)]
        self.elements = elements or MaxwellStates(np.zeros((self.size, 0)), np.zeros(0), np.zeros(0))
        self._shapes = {item.shape.node: item.shape for item in (*loads, *springs, *holds)}

    # The state y: r, p, q | v, w, u | impulses of constraints | work of loads and of drives, losses | dashpots
    def split(self, y):
        """Return views r, p, q, z = (v, w, u), impulses, energies and displacements of dashpots of a state (size, ...);
        of y', multipliers and powers."""
        return [y[part] for part in self._parts]

    def node_motions(self, r, A, q) -> dict:
        """Return the NodeMotion of every node with a load, spring or constraint, by number."""
        origin = self.floating_frame.origin
        return {node: node_motion(shape, origin, r, A, q) for node, shape in self._shapes.items()}

    def inertia_forces(self, q, z, M):
        """Return M' z + (w x P_v, w x P_w + v x P_v, -dT/dq): what stands beside M z'."""
        v, w, u = z[:3], z[3:6], z[6:]
        body, P = self.floating_frame, M @ z
        slope = body.inertia_slopes(q)
        Ct = body.translations(q)
        flow = Ct.T @ u
        gyroscopic = body.Cr1 @ w  # [i, k]: (integral of Phi_k x Phi_i) . w
        h = np.zeros_like(z)
        h[:3] = cross(w, flow) + u @ (u @ body.Ct1) + cross(w, P[:3])
        h[3:6] = cross(flow, v) + u @ (slope @ w) + u @ (u @ body.Cr1)
        h[3:6] += cross(w, P[3:6]) + cross(v, P[:3])
        h[6:] = gyroscopic @ u - (Ct @ cross(v, w) + 0.5 * slope @ w @ w + gyroscopic.T @ u)
        return h

    def applied(self, t, A, q, z, motions):
        """Return generalised forces of gravity, loads and springs (6 + m,); powers of loads and of springs' dampers."""
        body = self.floating_frame
        g = A.T @ self.gravity
        total = np.concatenate([self.mass * g, cross(body.first_moment(q), g), body.translations(q) @ g])
        power = loss = 0.0
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

    def constraints(self, t, motions):
        """Return G (c, 6 + m) and rates (c,): the constraints on velocity level are G z = rates."""
        G, rates = [np.zeros((0, 6 + self.size))], [np.zeros(0)]
        for hold in self.holds:
            node = motions[hold.shape.node]
            N = hold.directions(t, node.R)
            G.append(N @ node.B)
            rates.append(N @ hold.velocity(t, node.x))
        return np.concatenate(G), np.concatenate(rates)

    def gaps(self, t, motions):
        """Return how far (c,) the held nodes are from where they are to be, in m and rad."""
        parts = [hold.gap(t, motions[hold.shape.node].x, motions[hold.shape.node].R) for hold in self.holds]
        return np.concatenate([np.zeros(0), *parts])

    def reactions(self, t, motions, multipliers) -> dict:
        """Return force and moment (6,) of the constraints on each held node, by number; inertial axes."""
        wrenches, first = {}, 0
        for hold in self.holds:
            node = hold.shape.node
            mine = multipliers[first : first + len(hold)] @ hold.directions(t, motions[node].R)
            wrenches[node] = wrenches.get(node, 0.0) + mine
            first += len(hold)
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
        damping = self.D @ z[6:]
        force = total - self.inertia_forces(q, z, M) + G.T @ multipliers
        parts = self.elements
        stretch, per_time = parts.L.T @ q - dashpots, 1 / parts.times
        force[6:] -= self.K @ q + damping + parts.L @ (parts.factors * stretch)
        # at rest the equations hold to round-off, in which Newton's method would look for convergence in vain
        size = np.abs(total) + np.abs(G.T) @ np.abs(multipliers) + np.abs(M) @ np.abs(zp)
        large = np.abs(parts.L.T) @ np.abs(q) + np.abs(dashpots)
        size[6:] += np.abs(self.K) @ np.abs(q) + np.abs(parts.L) @ (parts.factors * large)
        lost = loss + (damping + self._skew @ q) @ z[6:] + parts.factors @ (per_time * stretch**2)
        return np.concatenate(
            [
                rp - A @ z[:3],
                pp - quaternion_rate(p, z[3:6]) - (1 - p @ p) * p,
                qp - z[6:],
                _beyond_round_off(M @ zp - force, size),
                _beyond_round_off(G @ z - rates, np.abs(G) @ np.abs(z) + np.abs(rates)),
                powers - np.array([power, rates @ multipliers, lost]),
                _beyond_round_off(dashpots_p - per_time * stretch, per_time * large),
            ]
        )

    def jacobians(self, t, y, yp):
        """Return dF/dy and dF/dy' for the Newton steps, which need no exact ones.

        The columns of r, the quaternion, v and w are differences; those of q and u hold stiffness and damping, which
        outweigh the inertia forces there.
        """
        r, p, q, *_ = self.split(y)
        m, c, n = self.size, self.multipliers, len(y)
        motions = self.node_motions(r, rotation(p), q)
        # known in closed form: tangents of springs and loads, mass matrix, constraints
        G, _ = self.constraints(t, motions)
        stiffness, damping = self._tangents(motions)
        stiffness[6:, 6:] += self._stiffness_of_loads(t, y, yp, motions)
        # where the blocks of coordinates, velocities, multipliers and Maxwell elements begin
        at_q, at_z, at_m, at_e, at_d = 7, 7 + m, 13 + 2 * m, 13 + 2 * m + c, 16 + 2 * m + c
        dy, dyp = np.zeros((n, n)), np.eye(n)
        dyp[at_z:at_m, at_z:at_m] = self.floating_frame.mass_matrix(q)
        dyp[at_m:at_e, at_m:at_e] = 0.0
        base = self.residual(t, y, yp)
        # by differences: places and quaternion of the frame, and its velocities
        placed = range(3) if self.springs or any(hold.support.turns for hold in self.holds) else ()
        for column in (*placed, *range(3, 7), *range(at_z, at_z + 6)):
            step = 1e-7 * max(1.0, abs(y[column]))
            moved = y.copy()
            moved[column] += step
            dy[:, column] = (self.residual(t, moved, yp) - base) / step
        # the elastic coordinates, q' = v and M v' + D v + K q = ...
        dy[at_q:at_z, at_z + 6 : at_m] = -np.eye(m)
        dy[at_z:at_m, at_q:at_z] = stiffness[:, 6:]
        dy[at_z:at_m, at_z + 6 : at_m] = damping[:, 6:]
        # Maxwell elements and constraint forces
        parts = self.elements
        pull, follow = parts.factors * parts.L, parts.L.T / parts.times[:, None]
        dy[at_z + 6 : at_m, at_q:at_z] += pull @ parts.L.T
        dy[at_z + 6 : at_m, at_d:] = -pull
        dy[at_d:, at_q:at_z], dy[at_d:, at_d:] = -follow, np.diag(1 / parts.times)
        dyp[at_z:at_m, at_m:at_e] = -G.T
        dy[at_m:at_e, at_z:at_m] = G
        return dy, dyp

    def _stiffness_of_loads(self, t, y, yp, motions):
        """Return the stiffness (m, m) of inertia forces, loads and reactions on displacements of second order."""
        _, p, _, z, *_ = self.split(y)
        _, _, _, zp, multipliers, *_ = self.split(yp)
        body, A = self.floating_frame, rotation(p)
        v, w = z[:3], z[3:6]
        products = np.concatenate([w * w, [w[0] * w[1], w[1] * w[2], w[0] * w[2]]])
        stiffness = body.Ct1 @ (zp[:3] + cross(w, v) - A.T @ self.gravity) + body.Cr1 @ zp[3:6] + body.Oe1 @ products
        wrenches = self.reactions(t, motions, multipliers)
        for item in (*self.loads, *self.springs):
            node, x = item.shape.node, motions[item.shape.node]
            wrench = item.wrench(t, x.R) if item in self.loads else item.wrench(x.x, x.R, *np.split(x.B @ z, 2))
            wrenches[node] = wrenches.get(node, 0.0) + wrench
        for node, wrench in wrenches.items():
            shape = self._shapes[node]
            if shape.phi1 is not None:
                stiffness -= np.tensordot(wrench[:3] @ A, shape.phi1, axes=1)
                stiffness -= np.tensordot(wrench[3:] @ A, shape.psi1, axes=1)
        return stiffness

    def _tangents(self, motions):
        """Return stiffness and damping (6 + m, 6 + m) of the elastic coordinates and of the springs."""
        stiffness, damping = np.zeros((6 + self.size,) * 2), np.zeros((6 + self.size,) * 2)
        stiffness[6:, 6:], damping[6:, 6:] = self.K, self.D
        for spring in self.springs:
            node = motions[spring.shape.node]
            for total, part in zip((stiffness, damping), spring.tangents(node.x, node.R), strict=True):
                total += node.B.T @ part @ node.B
        return stiffness, damping

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
        """Return a consistent state and its derivative: velocities projected onto the constraints.

        Returns y, y' and the largest change of a velocity. Raises InputError for dependent constraints.
        """
        A, M = rotation(p), self.floating_frame.mass_matrix(q)
        motions = self.node_motions(r, A, q)
        G, rates = self.constraints(0.0, motions)
        self._check_rank(G)
        c = self.multipliers
        inverse = np.linalg.solve(M, G.T)
        projected = z - inverse @ np.linalg.solve(G @ inverse, G @ z - rates) if c else z
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
        return y, np.concatenate(state), float(np.abs(projected - z).max(initial=0.0))

    def _drift_rates(self, r, p, q, z):
        """Return (G z - rates)' (c,) at t = 0 for z' = 0, by differences of second order towards later times."""
        drives = [drive for hold in self.holds for drive in (*hold.support.shifts, *hold.support.turns)]
        times = [drive.longest_step() for drive in drives]
        step = 1e-4 * min([1.0, 1 / (1.0 + np.linalg.norm(z[3:6])), *times])
        found = []
        for h in (step, 2 * step):
            motions = self.node_motions(*self._state(_moved(r, p, q, h * z)))
            G, rates = self.constraints(h, motions)
            found.append(G @ z - rates)
        return (4 * found[0] - found[1]) / (2 * step)

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
        part = np.abs(left[:, rank:]).max(axis=1) > 1e-6
        labels = np.repeat([hold.label for hold in self.holds], [len(hold) for hold in self.holds])
        named = ", ".join(dict.fromkeys(labels[part]))
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
        multipliers = np.zeros(c)
        for _ in range(50):
            motions = self.node_motions(r, rotation(p), q)
            G, _ = self.constraints(0.0, motions)
            self._check_rank(G)
            self._check_held(G, motions)
            force = self._static_force(r, p, q, multipliers)
            system = np.block([[self._tangents(motions)[0], -G.T], [G, np.zeros((c, c))]])
            for column, step in enumerate(1e-6 * np.eye(6 + m)[:6]):  # with the stiffness of weight and reactions
                sides = [self._static_force(*_moved(r, p, q, sign * step), multipliers) for sign in (1, -1)]
                system[: 6 + m, column] = (sides[1] - sides[0]) / 2e-6
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

    def energies(self, r, p, q, z, dashpots=()):
        """Return Kinetic, elastic, gravity and springs' energy in J; elastic energy is also in the springs of Maxwell
        elements."""
        A = rotation(p)
        kinetic = 0.5 * z @ self.floating_frame.mass_matrix(q) @ z
        moment = self.mass * r + A @ self.floating_frame.first_moment(q)
        motions = self.node_motions(r, A, q)
        nodes = [motions[spring.shape.node] for spring in self.springs]
        springs = sum(spring.energy(node.x, node.R) for spring, node in zip(self.springs, nodes, strict=True))
        elastic = q @ self.K @ q + self.elements.factors @ (self.elements.L.T @ q - dashpots) ** 2
        return kinetic, 0.5 * elastic, -self.gravity @ moment, springs
