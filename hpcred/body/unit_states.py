"""Compute the geometric stiffness of a body of solids: stresses under unit states of load, and their stiffness.

The loads of a body state are those of d'Alembert, -M times the accelerations of the nodes. All states are on the one
support that the displacements of the basis have, which is that of the frame: the held dofs of a tangent or chord frame,
those of a body that is supported, and inertia relief for a free body (Buckens frame), where the load is made
self-equilibrated by rigid-body accelerations. The loads that act at a time and the inertia of the motion are in
equilibrium, so that the reactions of the support cancel in the sum of the states, and with them its choice. With
inertia relief there is no stress in accelerations of the body: they follow from the forces at its nodes.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ..fe.element_rows import ValuesAtRows
from ..fe.solids import Solids
from ..fe.strain_matrices import strain_matrices
from ..linalg.blocks import column_norms, create_block, from_dense, local_rows, times
from ..linalg.solvers.base import SingularMatrix
from ..linalg.solvers.settings import Factoring
from ..linalg.solvers.shifted import ShiftedSolver
from ..model.frames import Frame, NoFrame, apply_frame
from ..model.outputs.targets import unit_columns
from ..model.rigid_body.modes import RigidBodyModes, rigid_motions
from ..model.second_order_model import SecondOrderModel, require_model
from ..parallel.failures import InputError, Owned
from ..parallel.sums import summed
from ..reduction.run.projection import everywhere
from .geometric_stiffness import OF_BODY, SIX, GeometricStiffness
from .node_shapes import interface_nodes
from .stress_stiffness import node_stiffness, projected

NO_LOAD = 1e-10  # of a load that is left after it is equilibrated: round-off
SAME_ENERGY = 1e-2  # relative difference of the strain energies of the elements and of K that a stress may have
MATRICES_AT_A_TIME = 2**22  # numbers in the matrices of some elements


def geometric_stiffness(
    model: SecondOrderModel, columns, frame: Frame | None = None, *, origin=(0.0, 0.0, 0.0),
    nodes: Iterable[int | str] | None = None, factoring: Factoring | None = None,
) -> GeometricStiffness:  # fmt: skip
    """Return the geometric stiffness of a basis, from the stresses of the solid elements under unit states of load.
    Collective.

    Parameters
    ----------
    model : SecondOrderModel
        The full model, with nodes, solid elements, and their types and materials.
    columns : SLEPc.BV, shape (n, m)
        The basis V, such as `ReducedModel.columns`.
    frame : Frame, optional
        That of the reduction, whose support the states have.
    origin : array_like, shape (3,), default (0, 0, 0)
        Origin of the body frame in m.
    nodes : iterable of int or str, optional
        Nodes and interfaces with states of forces; by default those of the inputs and outputs.
    factoring : Factoring, optional
        How to factor, and in how much memory.

    Returns
    -------
    GeometricStiffness
        The same on all ranks; states without stress are left out.

    Raises
    ------
    InputError
        For a model without solids or their materials, for elements whose stresses are not those of the displacements
        of their nodes alone, for nodes that do not exist, and where K is singular in this frame.

    Notes
    -----
    One factorization of K, whatever the number of states. K_sigma = integral of G^T [sigma] G with the gradients G of
    the displacements: see docs/geometric-stiffness.md.
    """
    solids = require_stresses(model)
    origin = np.asarray(origin, dtype=float)
    states = displacements_of_states(model, solids, frame, origin, nodes, factoring)
    shapes = ValuesAtRows(model, solids.rows).of(columns)
    total = summed(model.comm, sum_over_elements(solids, states.field, shapes))
    matrices = model.comm.bcast(total)
    return GeometricStiffness(states.states, (matrices + matrices.transpose(0, 2, 1)) / 2, origin)


class StaticStates(NamedTuple):
    """Displacements `field` (l, 3, s) of the nodes of solids in static states of load, their names, and whether the
    body is free, so that the loads were made self-equilibrated."""

    states: tuple[str, ...]
    field: np.ndarray
    free: bool


def displacements_of_states(model, solids, frame, origin, nodes, factoring, values=None) -> StaticStates:
    """Return the displacements under unit states of load, or under the sum of those with `values` by name.

    States without load, such as accelerations of a free body, are left out. Collective. Raises InputError.
    """
    loads, states = unit_loads(model, origin, nodes)
    if values is not None:
        missing = [state for state in values if state not in states]
        if missing:
            raise InputError(f"preload: {model.name} has no direction {missing[0]}; its states are {', '.join(states)}")
        loads = loads @ np.array([[values.get(state, 0.0)] for state in states])
        states = ["the preload"]
    loaded = model.with_input_columns(loads, states)
    framed = apply_frame(loaded, frame)
    rigid = framed.rigid
    if rigid is None and isinstance(frame, NoFrame | None):
        rigid = RigidBodyModes(framed.model)
        rigid = rigid if rigid.count else None
    right = from_dense(framed.model.B)
    kept = model.comm.bcast(_with_load(right, rigid))
    states = tuple(state for state, there in zip(states, kept, strict=True) if there)
    solution = create_block(framed.model.K, max(len(states), 1))
    if states:
        chosen = _chosen(right, kept, framed.model.K)
        _solve(framed.model, rigid, factoring, chosen, solution)
    moved = everywhere(model, framed, solution)
    field = ValuesAtRows(model, solids.rows).of(moved)[..., : len(states)]
    _check_energy(model, solids, field, moved, states)
    return StaticStates(states, field, rigid is not None)


def require_stresses(model) -> Solids:
    """Return the solids of a model that gives geometric stiffness. Collective. Raises InputError for others."""
    require_model(model)
    try:
        return Solids(model)
    except InputError as error:
        raise InputError(
            f"geometric stiffness: {error}; of beams, shells and other elements it comes from the stresses or the "
            "loaded stiffness of the finite-element program, by tables [[geometric_stiffness]]"
        ) from error


def sum_over_elements(solids, field, shapes) -> np.ndarray:
    """Return V^T K_sigma V (s, m, m) of the elements of this rank, for displacements `field` (l, 3, s) of the states
    and `shapes` (l, 3, m) of the basis at the nodes of the solids."""
    total = np.zeros((field.shape[2], *[shapes.shape[2]] * 2))
    for group, nodes, stress in stresses(solids, field):
        position = solids.position[nodes]
        size = nodes.shape[1]
        step = max(1, MATRICES_AT_A_TIME // (size * max(size * field.shape[2], 3 * shapes.shape[2])))
        for low in range(0, len(nodes), step):
            some = slice(low, low + step)
            matrices = node_stiffness(group.kind, group.rule, position[some], stress[some])
            total += projected(matrices, shapes[nodes[some]])
    return total


def stresses(solids, field):
    """Yield a group of elements, the nodes (e, k) of some of them, and their stresses (e, g, 6, s) in Pa at integration
    points."""
    for group in solids.groups:
        for nodes in group.pieces():
            B, _ = strain_matrices(group.kind, group.rule, solids.position[nodes])
            moved = field[nodes].reshape(len(nodes), 1, B.shape[3], -1)
            yield group, nodes, group.elastic @ (B @ moved)


def unit_loads(model, origin, nodes) -> tuple[np.ndarray, list[str]]:
    """Return the loads (rows of this rank, s) of all states, and their names. Collective."""
    dofs = model.dofs
    fields = create_block(model.M, len(OF_BODY))
    motions = rigid_motions(model, origin)
    arm, moved = dofs.position - origin, dofs.direction < 3
    with local_rows(fields) as rows, local_rows(motions) as rigid:
        rows[:, :6] = rigid
        for column, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)), start=6):
            # the coefficient of w_a w_b in w x (w x r)
            field = np.zeros((len(arm), 3))
            if a == b:
                field[:] = -arm
                field[:, a] = 0.0
            else:
                field[:, a], field[:, b] = arm[:, b], arm[:, a]
            rows[moved, column] = field[moved, dofs.direction[moved]]
    with local_rows(times(model.M, fields)) as rows:
        loads, names = -rows.real.copy(), list(OF_BODY)
    chosen = interface_nodes(model) if nodes is None else list(nodes)
    if chosen:
        columns, targets = unit_columns(model, "nodes", tuple((node, "all") for node in chosen))
        in_space = [target.rpartition(":")[2] in SIX for target in targets]
        loads = np.hstack([loads, columns[:, in_space]])
        names += [target for target, there in zip(targets, in_space, strict=True) if there]
    return loads, names


def _with_load(right, rigid) -> np.ndarray:
    """Make the loads self-equilibrated, and return which are more than round-off (s,)."""
    before = column_norms(right)
    if rigid is not None:
        rigid.equilibrate(right)
    return column_norms(right) > NO_LOAD * before


def _chosen(block, kept, mat):
    """Return a new block of some columns."""
    new = create_block(mat, int(kept.sum()))
    with local_rows(block) as rows, local_rows(new) as target:
        target[...] = rows[:, kept]
    return new


def _solve(model, rigid, factoring, right, solution):
    """Solve K u = f on the support, all columns at once. Raises InputError where K is singular."""
    with Owned(model.comm) as owned:
        solver = owned.owns(ShiftedSolver(model, rigid, "geometric_", factoring=factoring))
        try:
            solver.factor(0.0)
        except SingularMatrix as error:
            raise InputError(
                f"geometric stiffness: K of {model.name} is singular on the support of the frame ({error}), so that "
                "unit loads have no static stress; hold what is loose, or leave the geometric stiffness out"
            ) from error
        solver.solve(right, solution)


def _check_energy(model, solids, field, moved, states):
    """Refuse stresses that are not those of K: elements without stress, other materials. Collective."""
    if not states:
        return
    with local_rows(times(model.K, moved)) as f, local_rows(moved) as u:
        whole = (f.real * u.real).sum(axis=0)
    own, whole = model.comm.bcast(summed(model.comm, np.array([solids.energies(field), whole])))
    share = np.divide(own, whole, out=np.ones(len(own)), where=whole > 0)
    worst = int(np.abs(share - 1).argmax())
    if abs(share[worst] - 1) > SAME_ENERGY:
        raise InputError(
            f"geometric stiffness: under '{states[worst]}' the strain energy of the solid elements of {model.name} is "
            f"{share[worst]:.4g} of that of K: K has other elements as well, or other materials, or elements are "
            "missing at its supports; take the stresses of the finite-element program ([[geometric_stiffness]] with "
            "`stresses`)"
        )
