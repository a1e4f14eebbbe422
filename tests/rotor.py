"""An overhung rotor of beams along x with a disk at its end, over the speed in a frame that does not turn."""

import numpy as np
from helpers import bar, dense_model

import hpcred

MASS, POLAR, TRANSVERSE = 2.0, 0.02, 0.012
HELD = hpcred.Tangent(node=1)
RANGE = (0.0, 4000.0)


def shaft_with_internal_damping(comm, external=20.0, internal=2e-5, polar=0.0, elements=4):
    """A ParametricModel in omega (rad/s): a rod of 0.4 m held at node 1 by the frame HELD, with external damping
    `external` M and damping `internal` K that turns with it, whose force is -internal K (q' - omega e_x x q); the
    moments of a disk with the inertia `polar` at its end.
    """
    with bar(comm, 0.4, elements, diameter=0.03) as rod:
        K, M, _ = dense_model(rod)
        turn = np.kron(np.eye(2 * (elements + 1)), [[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
        end, gyroscopic = len(K) - 6, np.zeros_like(K)
        gyroscopic[end + 4, end + 5], gyroscopic[end + 5, end + 4] = polar, -polar
        rotor = hpcred.SecondOrderModel.from_scipy(
            K, M, external * M + internal * K, comm, dofs=labels(len(K), elements), name="shaft"
        )
        with rotor, rotor.with_inputs([(elements + 1, "y"), (elements // 2 + 1, "z")]) as model:
            omega = hpcred.Parameter("omega", (0.0, 3000.0), reference=0.0, unit="rad/s")
            terms = [hpcred.Term("K", -internal * K @ turn, "omega"), hpcred.Term("D", gyroscopic, "omega")]
            return hpcred.ParametricModel(model, [omega], terms)


def labels(size, elements):
    """The dofs of the rod."""
    nodes, place = np.linspace([0, 0, 0], [0.4, 0, 0], elements + 1), np.arange(size)
    return hpcred.Dofs(place // 6 + 1, (place % 6).astype(np.int8), nodes[place // 6])


def overhung_rotor(comm, elements=4, damping=2e-6):
    """A ParametricModel in omega (rad/s): a rod of 0.4 m held at node 1 by the frame HELD, with a disk at the last
    node, where its inputs are."""
    with bar(comm, 0.4, elements, diameter=0.03) as rod:
        K, M, _ = dense_model(rod)
        end = len(K) - 6
        M[end : end + 3, end : end + 3] += MASS * np.eye(3)
        M[end + 3 :, end + 3 :] += np.diag([POLAR, TRANSVERSE, TRANSVERSE])
        gyroscopic = np.zeros_like(K)
        gyroscopic[end + 4, end + 5], gyroscopic[end + 5, end + 4] = POLAR, -POLAR
        dofs = labels(len(K), elements)
        rotor = hpcred.SecondOrderModel.from_scipy(K, M, damping * K, comm, dofs=dofs, name="rotor")
        with rotor, rotor.with_inputs([(elements + 1, "y"), (elements + 1, "z")]) as model:
            omega = hpcred.Parameter("omega", RANGE, reference=0.0, unit="rad/s")
            return hpcred.ParametricModel(model, [omega], [hpcred.Term("D", gyroscopic, "omega")])
