"""Make the stabilisation linkage (anti-roll bar) of Section 5: 20 nodes, 19 beams, 120 dofs, assembled on all ranks."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from ..fe.dofs import Dofs
from ..linalg.csr import compress
from ..model.damping import Rayleigh
from ..model.frames import Chord
from ..model.second_order_model import SecondOrderModel
from ..parallel.exchange import exchange
from ..parallel.petsc import MPI
from ..parallel.shares import row_range

SUPPORTS = ((1, "x"), (1, "y"), (1, "z"), (7, "x"), (7, "z"), (14, "z"))
LOAD = (20, "z")
FRAME = Chord(nodes=(1, 7, 14), axes="yxz")
DAMPING = Rayleigh(alpha=2.0, beta=1e-5)
BAND = (0.0, 300.0)


def positions() -> np.ndarray:
    """Return coordinates (20, 3) in m: arm (nodes 1-5), torsion bar (5-16), arm (16-20)."""
    corners = np.array([[0.40, -0.56, 0], [0, -0.50, 0], [0, 0.50, 0], [0.40, 0.56, 0]])
    segments = [np.linspace(a, b, n + 1)[1:] for a, b, n in zip(corners, corners[1:], (4, 11, 4), strict=False)]
    return np.concatenate([corners[:1], *segments])


def linkage(comm=MPI.COMM_WORLD, inputs=(LOAD,), rod: Rod | None = None) -> SecondOrderModel:
    """Make the free stabilisation linkage of the paper's Section 5. Collective.

    Parameters
    ----------
    comm : MPI.Comm, default all ranks
    inputs : iterable of (int, str), default ((20, "z"),)
        Unit loads, as for SecondOrderModel.with_inputs.
    rod : Rod, optional
        Section and material of the beams.

    Notes
    -----
    The geometry of the paper was not published; this linkage has the same topology. Each rank assembles its share of
    the elements.
    """
    rod = rod or Rod()
    nodes = positions()
    count = len(nodes)
    first, last = row_range(comm, count - 1)
    elements = {"line": np.arange(first, last)[:, None] + [1, 2]}
    # the matrices of this rank's elements
    rows, columns, k, m = [], [], [], []
    for element in range(first, last):
        stiffness, mass = beam_element(nodes[element], nodes[element + 1], rod)
        dofs = 6 * element + np.arange(12)
        rows.append(np.repeat(dofs, 12))
        columns.append(np.tile(dofs, 12))
        k.append(stiffness.ravel())
        m.append(mass.ravel())
    # entries go to the ranks that have their rows
    entries = [np.concatenate([np.zeros(0, dtype), *arrays])
               for arrays, dtype in ((rows, int), (columns, int), (k, float), (m, float))]  # fmt: skip
    ranges = comm.allgather(row_range(comm, 6 * count, 6))
    starts = np.array([start for start, _ in ranges])
    owner = np.searchsorted(starts, entries[0], side="right") - 1
    i, j, k, m = exchange(comm, owner, entries)
    first, last = ranges[comm.rank]
    indptr, indices, values = compress({"K": (i, j, k), "M": (i, j, m)}, first, last, 6 * count)
    mine = np.arange(first, last)
    dofs = Dofs(mine // 6 + 1, (mine % 6).astype(np.int8), nodes[mine // 6])
    with SecondOrderModel.from_csr(
        comm, 6 * count, indptr, indices, values, dofs=dofs, name="linkage", elements=elements
    ) as model:
        return model.with_inputs(inputs)


# Compute stiffness and mass (12, 12) of a 3D Euler-Bernoulli beam element with a round solid section.


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
