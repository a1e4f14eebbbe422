"""Make the stabilisation linkage (anti-roll bar) of Section 5: 20 nodes, 19 beams, 120 dofs, assembled on all ranks."""

import numpy as np

from ..fe.dofs import Dofs
from ..linalg.csr import compress
from ..model.damping import Rayleigh
from ..model.frames import Chord
from ..model.second_order_model import SecondOrderModel
from ..parallel.exchange import exchange
from ..parallel.petsc import MPI
from ..parallel.shares import row_range
from .beam import Rod, beam_element

SUPPORTS = ((1, "x"), (1, "y"), (1, "z"), (7, "x"), (7, "z"), (14, "z"))
LOAD = (20, "z")
FRAME = Chord(nodes=(1, 7, 14), axes="yxz")
DAMPING = Rayleigh(alpha=2.0, beta=1e-5)
BAND = (0.0, 300.0)


def positions() -> np.ndarray:
    """Return coordinates (20, 3) in m: arm (nodes 1-5), torsion bar (5-16), arm (16-20)."""
    corners = np.array([[0.40, -0.56, 0], [0, -0.50, 0], [0, 0.50, 0], [0.40, 0.56, 0]])
    parts = [np.linspace(a, b, n + 1)[1:] for a, b, n in zip(corners, corners[1:], (4, 11, 4), strict=False)]
    return np.concatenate([corners[:1], *parts])


def linkage(comm=MPI.COMM_WORLD, inputs=(LOAD,), rod: Rod | None = None) -> SecondOrderModel:
    """Make the free stabilisation linkage of the paper's Section 5.

    Collective.

    Parameters
    ----------
    comm : MPI.Comm, default all ranks
    inputs : iterable of (int, str), default ((20, "z"),)
        Unit loads, as for SecondOrderModel.with_inputs.
    rod : Rod, optional
        Section and material of the beams.

    Returns
    -------
    SecondOrderModel

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
    rows, columns, k, m = [], [], [], []
    for element in range(first, last):
        stiffness, mass = beam_element(nodes[element], nodes[element + 1], rod)
        dofs = 6 * element + np.arange(12)
        rows.append(np.repeat(dofs, 12))
        columns.append(np.tile(dofs, 12))
        k.append(stiffness.ravel())
        m.append(mass.ravel())
    parts = [np.concatenate([np.zeros(0, dtype), *part])
             for part, dtype in ((rows, int), (columns, int), (k, float), (m, float))]  # fmt: skip
    ranges = comm.allgather(row_range(comm, 6 * count, 6))
    starts = np.array([start for start, _ in ranges])
    owner = np.searchsorted(starts, parts[0], side="right") - 1
    i, j, k, m = exchange(comm, owner, parts)
    first, last = ranges[comm.rank]
    indptr, indices, values = compress({"K": (i, j, k), "M": (i, j, m)}, first, last, 6 * count)
    mine = np.arange(first, last)
    dofs = Dofs(mine // 6 + 1, (mine % 6).astype(np.int8), nodes[mine // 6])
    with SecondOrderModel.from_csr(
        comm, 6 * count, indptr, indices, values, dofs=dofs, name="linkage", elements=elements
    ) as model:
        return model.with_inputs(inputs)
