"""Make the matrices of a body that spins about an axis, in the frame that turns with it, from its mass matrix.

With the angular velocity omega e the velocity of a point is u' + omega e x (x + u), so that M q'' + K q becomes

    M q'' + 2 omega M S q' + (K + omega^2 M S^2) q,    S = skew(e) at every node:

Coriolis forces, and the change of the centrifugal force with the displacement, which softens the directions normal to
the axis (spin softening). The stiffness of the centrifugal stress is not in it: see body.preload.
"""

from __future__ import annotations

import numpy as np

from ..fe.dofs import DIRECTIONS, require_dofs
from ..fe.element_rows import node_rows
from ..linalg.csr import sparse_rows
from ..parallel.failures import InputError
from ..parallel.petsc import PETSc
from ..parallel.sums import joined
from .parameters.definitions import Term
from .second_order_model import require_model

SAME_MASS = 1e-6  # relative difference of masses in x, y, z that the digits of a text file explain


def rotation_terms(model, axis, parameter: str = "omega") -> tuple[Term, Term]:
    """Return the Coriolis and the spin softening term of a body that spins, in the frame that turns with it.
    Collective.

    Parameters
    ----------
    model : SecondOrderModel
        With nodes, whose mass is that of displacements, the same in all directions, as solid elements have it.
    axis : str or array_like, shape (3,)
        "x", "y" or "z", or a vector along the axis of rotation.
    parameter : str, default "omega"
        Name of the parameter that is the angular velocity in rad/s.

    Returns
    -------
    tuple of Term
        The term of D with the factor omega, skew-symmetric, and the term of K with omega^2, negative semidefinite.

    Raises
    ------
    InputError
        Without nodes, for mass in rotations or that differs with the direction, and for nodes that are held in one of
        the directions that the rotation mixes.

    Notes
    -----
    The terms have PETSc matrices 2 M skew(e) and M skew(e)^2. A body that its supports carry along also has the
    stiffness of its centrifugal stress, which hpcred.preloaded computes.

    Examples
    --------
    >>> omega = hpcred.Parameter("omega", (0.0, 800.0), unit="rad/s")
    >>> rotor = hpcred.ParametricModel(model, [omega], hpcred.rotation_terms(model, "z"))
    """
    require_model(model)
    e = unit_axis("rotation_terms: axis", axis)
    return (Term("D", rotation_matrix(model, "coriolis", e), parameter),
            Term("K", rotation_matrix(model, "spin_softening", e), f"{parameter}^2"))  # fmt: skip


def rotation_matrix(model, kind: str, e) -> PETSc.Mat:
    """Return the matrix of a term, "coriolis" or "spin_softening", about the unit vector e (3,). Collective. Raises
    InputError."""
    require_translations(model, e)
    return coriolis(model, e) if kind == "coriolis" else spin_softening(model, e)


def unit_axis(key: str, axis) -> np.ndarray:
    """Return a unit vector (3,) of "x", "y", "z" or a vector. Raises InputError."""
    if isinstance(axis, str) and axis in DIRECTIONS[:3]:
        return np.eye(3)[DIRECTIONS.index(axis)]
    try:
        e = np.array(axis, dtype=float)
    except (TypeError, ValueError):
        e = np.zeros(0)
    size = np.linalg.norm(e)
    if e.shape != (3,) or not np.isfinite(size) or size == 0:
        raise InputError(f"{key}: found {axis!r}, expected 'x', 'y', 'z' or a vector of three numbers, not all zero")
    return e / size


def coriolis(model, e) -> PETSc.Mat:
    """Return 2 M skew(e) (n, n), skew-symmetric. Collective."""
    turn = at_nodes(model, skew(e))
    product = turn.matMult(model.M)
    product.axpy(-1.0, product.transpose(PETSc.Mat()))
    return product


def spin_softening(model, omega) -> PETSc.Mat:
    """Return M skew(omega)^2 (n, n), symmetric, for masses that are the same in all directions. Collective."""
    product = at_nodes(model, skew(omega) @ skew(omega)).matMult(model.M)
    product.axpy(1.0, product.transpose(PETSc.Mat()))
    product.scale(0.5)
    return product


def skew(v: np.ndarray) -> np.ndarray:
    """Return (3, 3): skew(v) u = v x u."""
    x, y, z = v if isinstance(v, list) else np.asarray(v).tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def at_nodes(model, block: np.ndarray) -> PETSc.Mat:
    """Return the matrix (n, n) that has a (3, 3) block for the displacements of every node. Collective."""
    moved, rows = _rows_of_nodes(model)
    values = block[model.dofs.direction[moved]]
    there = (rows >= 0) & (values != 0)
    triplets = [(np.repeat(moved, 3)[there.ravel()], rows[there], values[there])]
    return sparse_rows(model.K, triplets, model.M.getSizes()[1])


def _rows_of_nodes(model):
    """Return the rows (k,) of this rank that are displacements, and the rows (k, 3) of their nodes, -1 where none is.
    Collective."""
    moved = np.flatnonzero(model.dofs.direction < 3)
    nodes, place = np.unique(model.dofs.node[moved], return_inverse=True)
    return moved, node_rows(model, nodes)[1][place]


def require_translations(model, e):
    """Refuse a model whose mass is not that of displacements, the same in the directions normal to the axis e (3,).
    Collective."""
    dofs = require_dofs(model, "a rotation")
    moved, rows = _rows_of_nodes(model)
    mixed = np.abs(skew(e)) + np.abs(skew(e) @ skew(e)) > 0  # also with itself, which each row has
    lacking = (rows < 0) & mixed[dofs.direction[moved]]
    if nodes := joined(model.comm, _first_lacking(dofs, moved, lacking)):
        node, held, other = nodes[0]
        raise InputError(
            f"rotation: node {node} of {model.name} has no row in {held}, but one in {other}, which the rotation mixes "
            "with it; hold such nodes in all directions, or by a frame, or give the matrices of the terms as files"
        )
    # M w of a random w, without displacements: no other dof may have mass
    w = model.K.createVecRight()
    w.setArray(np.random.default_rng(model.first_row).uniform(0.5, 1.0, model.local_rows))
    others = w.copy()
    others.getArray()[moved] = 0.0
    if (model.M * others).norm() > 0:
        raise InputError(
            f"rotation: {model.name} has mass in rotations or other dofs that are no displacements, expected that of "
            "solid elements; give the matrices of the terms as files"
        )
    # M S = S M, where S turns displacements about the axis
    turn = at_nodes(model, skew(e))
    difference, turned = model.M * (turn * w), turn * (model.M * w)
    difference.axpy(-1.0, turned)
    if difference.norm() > SAME_MASS * turned.norm():
        raise InputError(
            f"rotation: the mass of {model.name} is not the same in the directions normal to the axis, expected M of "
            "solid elements; give the matrices of the terms as files"
        )


def _first_lacking(dofs, moved, lacking) -> list[tuple[int, str, str]]:
    """Return node, direction that has no row and one that has, of the first such node of this rank."""
    places = np.argwhere(lacking)[:1]
    return [(int(dofs.node[moved[k]]), DIRECTIONS[axis], DIRECTIONS[dofs.direction[moved[k]]]) for k, axis in places]
