"""Velocities, accelerations and section forces over time."""

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

import hpcred
from hpcred.body.node_shapes import NodeShape
from hpcred.linalg.blocks import local_rows
from hpcred.model.damping import Rayleigh
from hpcred.outputs import CutOutput, MotionOutput, StressOutput
from hpcred.simulation.loads import ConstantForce
from hpcred.simulation.simulation import Simulation, _rates_of_nodes, simulate


def block(targets, damping):
    """A free block of 8 cells along x, with forces at its ends, the outputs, and the set TIP of x > 0.045."""
    model = hpcred.solid((8, 3, 3), None, 4, clamped=False, comm=MPI.COMM_SELF)
    dofs = model.dofs
    model = model.with_fields(sets={"TIP": np.unique(dofs.node[dofs.position[:, 0] > 0.045])})
    tip, far = (int(dofs.node[np.argmin(np.abs(dofs.position - place).sum(axis=1))])
                for place in ((0.08, 0.015, 0.015), (0.0, 0.015, 0.015)))  # fmt: skip
    model = model.with_inputs([(tip, "all"), (far, "all")]).with_outputs(targets(tip))
    rom = hpcred.reduce(
        model, [hpcred.Modes(count=12), hpcred.StaticCorrection()], frame=hpcred.Buckens(), damping=damping
    )
    return model, rom, hpcred.body.body_of(model, rom, nodes=[tip, far]), tip


def test_a_thrown_body():
    """Spinning about z and pushed in x of the space: rates of the nodes are those of their places."""
    _, _, body, tip = block(lambda tip: [(tip, "x")], Rayleigh(0.0, 1e-6))
    setup = Simulation(
        end=0.025, steps=1000, velocity=(0.3, -0.2, 0.1), angular_velocity=(1.0, 2.0, 40.0),
        force=(ConstantForce(tip, (3.0, 0.0, 1.0)),), relative_tolerance=1e-8, absolute_tolerance=1e-11,
    )  # fmt: skip
    motion = simulate(body, setup)
    step, late = motion.t[1], slice(100, None)  # when the blow of the start has died away
    for places, rates in ((motion.node_position, motion.node_velocity),
                          (motion.node_velocity, motion.node_acceleration)):  # fmt: skip
        middle = (places[2:] - places[:-2]) / (2 * step)
        assert np.abs(middle - rates[1:-1])[late].max() < 1e-4 * np.abs(rates[late]).max()
    assert np.abs(motion.node_acceleration[late]).max() > 40.0**2 * 0.03


def test_rates_of_a_node_that_moves_on_a_curve():
    """Shapes of second order: x = phi q + q phi1 q / 2, against x(t) for q(t) of second degree, by differences."""
    rng, m, step = np.random.default_rng(1), 3, 1e-3
    phi1 = rng.normal(size=(3, m, m))
    shape = NodeShape(node=1, position=rng.normal(size=3), phi=rng.normal(size=(3, m)), psi=np.zeros((3, m)),
                      rotates=False, phi1=phi1 + phi1.transpose(0, 2, 1), psi1=np.zeros((3, m, m)))  # fmt: skip
    q, u, du = rng.normal(size=(3, m))
    body = SimpleNamespace(nodes=[shape], floating_frame=SimpleNamespace(origin=np.zeros(3)))

    def parts(state):  # r, p, q and z, each of one time
        return tuple(part[:, None] for part in state)

    rest, turn = np.zeros(6), np.array([1.0, 0.0, 0.0, 0.0])
    found = _rates_of_nodes(body, SimpleNamespace(split=parts), (np.zeros(3), turn, q, np.append(rest, u)),
                            (np.zeros(3), turn, u, np.append(rest, du)))  # fmt: skip
    before, now, after = (shape.motion(q + u * t + du * t * t / 2)[0] for t in (-step, 0.0, step))
    assert found["node_velocity"][0, 0] == pytest.approx((after - before) / (2 * step), rel=1e-4)
    assert found["node_acceleration"][0, 0] == pytest.approx((after - 2 * now + before) / step**2, rel=1e-4)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
def test_the_force_of_a_cut_balances_load_and_inertia(direction):
    """A force at the end of a free block: the cut passes on what does not accelerate the side before it."""
    load = 0.5 * np.array(direction)
    model, rom, body, tip = block(
        lambda tip: [CutOutput(cut="TIP", component=name) for name in ("fx", "fz")] + [
            StressOutput(node=60, stress="xx"), MotionOutput(node=tip, direction="x", quantity="acceleration")],
        Rayleigh(0.0, 2e-5),
    )  # fmt: skip
    setup = Simulation(end=2e-3, steps=400, force=(ConstantForce(tip, tuple(load)),), relative_tolerance=1e-7,
                       absolute_tolerance=1e-12)  # fmt: skip
    motion = simulate(body, setup)
    assert motion.output_names == list(rom.output_names)
    # mean over the side of the acceleration of its nodes, from the basis and the frame; the motion is small
    frame = np.gradient(motion.velocity, motion.t, axis=0), np.gradient(motion.angular_velocity, motion.t, axis=0)
    M = model.M.convert("dense").getDenseArray().real
    dofs = model.dofs
    with local_rows(rom.columns) as rows:
        columns = rows.real.copy()
    side = dofs.position[:, 0] > 0.045
    about = dofs.position - body.floating_frame.origin
    rates = np.gradient(motion.elastic_velocity, motion.t, axis=0)
    q2 = rates @ columns.T + frame[0][:, dofs.direction]
    q2 += np.cross(frame[1][:, None, :], about[None])[:, np.arange(len(side)), dofs.direction]
    for place, axis in enumerate((0, 2)):
        rows = (side & (dofs.direction == axis)).astype(float)
        balance = load[axis] - q2 @ (M @ rows)
        late = slice(250, -2)
        found, size = motion.outputs[late, place], np.abs(load).max()
        assert np.abs(found - balance[late]).max() < 2e-2 * size
    if direction[0]:
        assert motion.outputs[-50:, 0].mean() == pytest.approx(0.25, rel=0.15)
    y = motion.elastic @ rom.C.T + np.gradient(motion.elastic_velocity, motion.t, axis=0) @ rom.Ca.T
    assert np.abs(motion.outputs[2:-2, :3] - y[2:-2, :3]).max() < 1e-6 * np.abs(y[:, :3]).max()
    assert np.abs(motion.outputs[late, 3] - y[late, 3]).max() < 2e-2 * np.abs(y[:, 3]).max()
