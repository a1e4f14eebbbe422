"""Coriolis and spin softening terms of a body that spins."""

import numpy as np
import pytest
import scipy.linalg
from helpers import to_dense

import hpcred
from hpcred import Dofs, InputError, Parameter, ParametricModel, SecondOrderModel, rotation_terms

OMEGA = Parameter("omega", (0.0, 1000.0), unit="rad/s")
AXIS = np.array([2.0, -1.0, 2.0]) / 3


def cross(e):
    return np.array([[0, -e[2], e[1]], [e[2], 0, -e[0]], [-e[1], e[0], 0]])


def frequencies_of_spinning(model, axis, omega):
    """Angular frequencies of a model that spins, ascending, each once; it is closed."""
    with (model, ParametricModel(model, [OMEGA], rotation_terms(model, axis)) as parametric,
          parametric.at(omega=omega) as spinning):  # fmt: skip
        K, D, M = (to_dense(getattr(spinning, key)) for key in "KDM")
    n = len(K)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    found = np.linalg.eigvals(A)
    assert np.abs(found.real).max() <= 1e-5 * np.abs(found).max()
    return np.sort(np.abs(found.imag))[::2]


@pytest.mark.mpi
@pytest.mark.parametrize("axis", ["z", "x", AXIS, 5 * AXIS])
def test_matrices(comm, axis):
    e = np.eye(3)["xyz".index(axis)] if isinstance(axis, str) else AXIS
    with hpcred.solid((3, 2, 1), None, 3, False, comm) as model:
        mass = to_dense(model.M)[::3, ::3]
        terms = rotation_terms(model, axis, "w")
        D, K = (to_dense(item.matrix) for item in terms)
    assert [(item.of, item.factor) for item in terms] == [("D", "w"), ("K", "w^2")]
    assert pytest.approx(2 * np.kron(mass, cross(e)), abs=1e-13 * np.abs(D).max()) == D
    assert pytest.approx(np.kron(mass, cross(e) @ cross(e)), abs=1e-13 * np.abs(K).max()) == K


@pytest.mark.mpi
def test_points_on_springs_seen_from_a_turning_frame(comm):
    """A vibration of omega_0 at rest is one of omega_0 - omega and one of omega_0 + omega in the turning frame."""
    with hpcred.solid((2, 1, 1), None, 3, False, comm) as solid:
        mass, dofs = to_dense(solid.M), gathered(comm, solid.dofs)
    model = SecondOrderModel(mass, None, 1e4 * mass, np.eye(len(mass))[:, :1], dofs=dofs, comm=comm)
    found = frequencies_of_spinning(model, AXIS, 30.0)
    third = len(mass) // 3
    assert found == pytest.approx(np.repeat([70.0, 100.0, 130.0], third), rel=1e-5)


def test_a_shaft_seen_from_a_turning_frame():
    """Bending of a slender shaft of a square section, whose frequency at rest the rotation hardly changes."""
    with hpcred.solid((12, 1, 1), (1.0, 0.02, 0.02), 3, True) as model:
        K, M = to_dense(model.K), to_dense(model.M)
        at_rest = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)[:2])
        omega = 0.3 * at_rest[0]
        found = frequencies_of_spinning(model, "x", omega)[:2]
    assert at_rest[1] == pytest.approx(at_rest[0], rel=1e-6)
    assert found == pytest.approx([at_rest[0] - omega, at_rest[0] + omega], rel=1e-3)


def gathered(comm, dofs):
    return Dofs(*(np.concatenate(comm.allgather(part)) for part in (dofs.node, dofs.direction, dofs.position)))


def masses(directions, diagonal, nodes=(1, 2)):
    """A model of masses and springs of its own."""
    rows = len(directions)
    dofs = Dofs(np.array(nodes)[np.cumsum(np.array(directions) == 0) - 1], directions, np.zeros((rows, 3)))
    dofs.position[dofs.node == 2, 0] = 1.0
    return SecondOrderModel(np.diag(diagonal), None, np.eye(rows), np.eye(rows)[:, :1], dofs=dofs)


def test_nodes_that_are_held_in_the_direction_of_the_axis():
    """They need no row there, and rotations without mass count as nothing."""
    with masses([0, 1, 0, 1, 5], [2.0, 2.0, 3.0, 3.0, 0.0]) as model:
        D, K = (to_dense(item.matrix) for item in rotation_terms(model, "z"))
    expected = np.zeros((5, 5))
    expected[:2, :2], expected[2:4, 2:4] = [[0, -4], [4, 0]], [[0, -6], [6, 0]]
    assert pytest.approx(expected) == D
    assert pytest.approx(-np.diag([2.0, 2.0, 3.0, 3.0, 0.0])) == K


@pytest.mark.parametrize(
    ("directions", "diagonal", "axis", "message"),
    [
        ([0, 1, 2, 0, 2], np.ones(5), "z", "^rotation: node 2 of model has no row in y, but one in x, which the rot"),
        ([0, 1, 0, 1], np.ones(4), "x", "^rotation: node 1 of model has no row in z, but one in y"),
        ([0, 1, 2], [1.0, 2.0, 1.0], "z", "^rotation: the mass of model is not the same in the directions normal to"),
        ([0, 1, 2, 3], np.ones(4), "z", "^rotation: model has mass in rotations or other dofs that are no displacem"),
        ([0, 1, 2], np.ones(3), "w", "^rotation_terms: axis: found 'w', expected 'x', 'y', 'z' or a vector of three"),
        ([0, 1, 2], np.ones(3), (0, 0, 0), r"^rotation_terms: axis: found \(0, 0, 0\), expected"),
        ([0, 1, 2], np.ones(3), (0, 1), r"found \(0, 1\), expected 'x'"),
        ([0, 1, 2], np.ones(3), (0, 1, np.nan), "nan"),
    ],
)
def test_what_is_refused(directions, diagonal, axis, message):
    with masses(directions, diagonal) as model, pytest.raises(InputError, match=message):
        rotation_terms(model, axis)


def test_models_without_nodes_are_refused():
    message = "^model has no node coordinates, which a rotation needs"
    with SecondOrderModel(np.eye(3), None, np.eye(3)) as model, pytest.raises(InputError, match=message):
        rotation_terms(model, "z")


@pytest.mark.mpi
def test_beams_are_refused(linkage):
    with pytest.raises(InputError, match="^rotation: .* has mass in rotations"):
        rotation_terms(linkage, "z")
