"""Compute stiffness and mass (12, 12) of a 3D Euler-Bernoulli beam element with a round solid section."""

from dataclasses import dataclass
from math import pi

import numpy as np


@dataclass(frozen=True)
class Rod:
    """Material and section: Pa, -, kg/m^3, m."""

    young: float = 2.1e11
    poisson: float = 0.3
    density: float = 7850.0
    diameter: float = 0.022

    @property
    def area(self):
        return pi * self.diameter**2 / 4

    @property
    def second_moment(self):
        return pi * self.diameter**4 / 64


def beam_element(start, end, rod: Rod):
    """Return K and M in global axes of a straight beam from `start` (3,) to `end` (3,).

    Six dofs a node (displacements, rotations); cubic bending with consistent mass and without rotary inertia of
    bending, linear stretching, linear torsion with polar moment 2 I and rotary inertia 2 rho I a length
    (Przemieniecki, Theory of Matrix Structural Analysis, 1968, ch. 5 and 11).
    """
    axis = np.asarray(end, dtype=float) - np.asarray(start, dtype=float)
    length = np.linalg.norm(axis)
    area, inertia = rod.area, rod.second_moment
    shear = rod.young / (2 * (1 + rod.poisson))
    stiffness, mass = np.zeros((12, 12)), np.zeros((12, 12))
    ends = np.array([[1, -1], [-1, 1]])
    shares = np.array([[2, 1], [1, 2]]) / 6
    for dofs, k, m in (
        ([0, 6], rod.young * area / length, rod.density * area * length),
        ([3, 9], shear * 2 * inertia / length, rod.density * 2 * inertia * length),
    ):
        stiffness[np.ix_(dofs, dofs)] = k * ends
        mass[np.ix_(dofs, dofs)] = m * shares
    bending = (rod.young * inertia / length**3) * np.array(
        [[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]
    )
    inert = (rod.density * area * length / 420) * np.array(
        [[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]
    )
    # (displacement, rotation) pairs: v with +rz, w with -ry
    for dofs, sign in (([1, 5, 7, 11], 1), ([2, 4, 8, 10], -1)):
        scale = np.array([1, sign * length, 1, sign * length])
        stiffness[np.ix_(dofs, dofs)] = bending * np.outer(scale, scale)
        mass[np.ix_(dofs, dofs)] = inert * np.outer(scale, scale)
    turn = np.kron(np.eye(4), _local_axes(axis / length))
    return turn.T @ stiffness @ turn, turn.T @ mass @ turn


def _local_axes(axis):
    """Return Rows: the beam axis and two directions normal to it (any two, for a round section)."""
    other = np.eye(3)[np.argmin(np.abs(axis))]
    second = np.cross(axis, other)
    second /= np.linalg.norm(second)
    return np.array([axis, second, np.cross(axis, second)])
