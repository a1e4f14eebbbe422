"""Apply the reference frame of the floating-frame formulation (2.3), which removes the rigid-body motion of a body.

The tangent and the chord frame (14, 15) remove dofs; the Buckens frame (16) keeps the free body and deflates its
rigid-body modes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..fe.dofs import DIRECTIONS, INTERFACE_THERE, direction_index, position_of_node, row_of, rows_of_node
from ..linalg.blocks import column_norms, from_dense, local_rows, times
from ..linalg.csr import assembled, sparse_rows
from ..parallel.declared import Settings, declared
from ..parallel.failures import InputError
from ..parallel.petsc import PETSc
from ..parallel.ranges import Label, Node
from .damping import with_damping
from .interfaces.coupling import couple
from .interfaces.nodes import node_number
from .rigid_body.modes import RigidBodyModes
from .second_order_model import SecondOrderModel, listed

ONLY_RIGID = 1e-11  # of a load that is left after it is equilibrated: round-off
RESISTS = 1e-6  # ||K_v r|| of rigid-body motions r over ||K_v|| ||r||
COLLINEAR = 1e-6  # area of the unit triangle below which three points count as collinear


def _ordered(key, value):
    if value is not None and sorted(value) != ["x", "y", "z"]:
        raise InputError(f"{key}: found '{value[:20]}', expected an order of x, y and z such as 'yxz'")


def _direction(key, value):
    direction_index(value, key)


class FrameSettings(Settings):
    """Base of the frames."""

    where = "frame."


@dataclass(frozen=True)
class NoFrame:
    """No frame: the matrices as they are, for a body that is supported already."""

    kind: Literal["none"] = field(default="none", kw_only=True, repr=False)


@dataclass(frozen=True)
class Tangent(FrameSettings):
    """Tangent frame: the body frame is fixed to one node with six dofs, all of which are zero.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of a rigid interface.
    """

    kind: Literal["tangent"] = field(default="tangent", kw_only=True, repr=False)
    node: Node


@dataclass(frozen=True)
class Chord(FrameSettings):
    """Chord frame through three nodes (14, 15): u(P1) = 0, u_2(P2) = u_3(P2) = 0, u_3(P3) = 0.

    Parameters
    ----------
    nodes : tuple of three int or str
        P1, P2 and P3, not on a line: numbers of nodes, or names of rigid interfaces.
    axes : str, optional
        Global directions of the axes 1, 2, 3, such as "yxz"; axis 3 must not lie in the plane of the points. By
        default axis 1 points from P1 to P2, and axis 3 is normal to the plane.

    Raises
    ------
    InputError
        For axes that are no order of x, y, z.
    """

    kind: Literal["chord"] = field(default="chord", kw_only=True, repr=False)
    nodes: tuple[Node, Node, Node]
    axes: Annotated[str | None, _ordered] = None


@dataclass(frozen=True)
class Buckens(FrameSettings):
    """Buckens frame: the free body without its rigid-body modes, which has the smallest elastic displacement (16).

    Parameters
    ----------
    supports : sequence of (int, str), optional
        Pairs of a node and a direction to hold in the solves of inertia relief, which determine the rigid-body
        motion. The result does not depend on them; by default they are chosen automatically.
    """

    kind: Literal["buckens"] = field(default="buckens", kw_only=True, repr=False)
    supports: tuple[tuple[Label, Annotated[str, _direction]], ...] | None = None


@dataclass(frozen=True, eq=False)
class FramedModel:
    """A model with its damping, in its reference frame: `model` in the free coordinates, T with q = T q_free in
    `restore` (n, n_free), None if no dofs were removed, `rigid`-body modes to deflate, and the `damping` model, also
    where it has no matrix."""

    model: SecondOrderModel
    restore: PETSc.Mat | None = None
    rigid: RigidBodyModes | None = None
    damping: object = None

    @property
    def rigid_size(self) -> int:
        """The number of rigid-body modes that are deflated."""
        return 0 if self.rigid is None else self.rigid.count

    @property
    def rigid_columns(self):
        """The rigid-body modes that are deflated, as a block, or None."""
        return None if self.rigid is None else self.rigid.R


def apply_frame(model: SecondOrderModel, frame=None, damping=None) -> FramedModel:
    """Return the model with the damping, in the frame; `model` is not changed. Collective.

    Raises InputError if the frame does not fit the body, or the damping is not possible.
    """
    frame = declared("frame", frame, Frame | None)
    free, coupling = couple(with_damping(model, damping))
    restore = rigid = None
    if isinstance(frame, Buckens):
        rigid = _free_body(free, frame)
    elif isinstance(frame, Tangent):
        free, restore = _remove(free, _rows_of_tangent(free, frame), None)
    elif isinstance(frame, Chord):
        free, restore = _remove(free, *_rows_of_chord(free, frame))
    if coupling is not None and restore is not None:
        restore = coupling.matMult(restore)
    return FramedModel(free, restore or coupling, rigid, damping)


def inputs_without_effect(framed) -> tuple[str, ...]:
    """Return a warning of inputs that only accelerate a free body as a whole. Collective.

    Their elastic response is round-off. Raises InputError if there are no other inputs.
    """
    model = framed.model
    if framed.rigid is None or model.B is None:
        return ()
    load = from_dense(model.B)
    before = column_norms(load)
    framed.rigid.equilibrate(load)
    vanish = column_norms(load) <= ONLY_RIGID * before
    names = [name for name, nothing in zip(model.input_names, vanish, strict=True) if nothing]
    if not names:
        return ()
    text = f"{model.name}: the inputs {listed(names)} push the free body as a whole only, and deform it by round-off"
    if len(names) == len(vanish):
        raise InputError(f"{text}; there is nothing to compute, expected loads that are not those of a rigid motion")
    return (f"{text}; leave them out",)


def _rows_of_tangent(model, frame):
    rows = rows_of_node(model, node_number(model, frame.node))
    if len(rows) < 6:
        have = ", ".join(DIRECTIONS[d] for d in sorted(rows))
        raise InputError(
            f"frame: the tangent frame needs a node with six dofs, node {frame.node} has {have}; {INTERFACE_THERE}, of "
            "kind 'rigid', and name it, or take the chord or the Buckens frame"
        )
    return list(rows.values())


def _free_body(model, frame):
    """Return the rigid-body modes of a body in the Buckens frame, with the supports that the user chose."""
    refuse_unsymmetric(model)
    rigid = RigidBodyModes(model, soft=True)
    if rigid.count == 0:
        raise InputError(
            f"frame: the Buckens frame needs a free body, but {model.name} is supported "
            f"(||K R|| / ||K|| = {rigid.defect:.1e} for rigid-body motions R); take frame kind 'none'"
        )
    for term in model.added:  # the static stiffness does not show one that carries nothing at rest
        resists = column_norms(times(term.matrix, rigid.R)) / column_norms(rigid.R)
        if resists.max() > RESISTS * term.matrix.norm():
            raise InputError(
                f"frame: the Buckens frame needs a free body, but the {term.law.family} part {term.name} of "
                f"{model.name} resists its rigid-body motions; put it into the multibody model, or take frame kind "
                "'none'"
            )
    if frame.supports is not None:
        rows = [row_of(model, tuple(pair)) for pair in frame.supports]
        if len(set(rows)) != rigid.count or not _holds(model, rigid, rows):
            raise InputError(
                f"frame.supports: expected {rigid.count} dofs that hold the body without constraining it, "
                f"found {[tuple(pair) for pair in frame.supports]}"
            )
        rigid.hold(rows)
    return rigid


def refuse_unsymmetric(model):
    """Refuse an unsymmetric K in the Buckens frame. Collective."""
    if not model.is_symmetric("K"):
        raise InputError(
            f"frame: the Buckens frame does not go with the unsymmetric K of {model.name}, whose forces "
            "may push the body as a whole; hold it (frame kind 'tangent' or 'chord', or none)"
        )


def _holds(model, rigid, rows):
    """Test whether no rigid-body motion is left when the rows are held."""
    with local_rows(rigid.R) as view:
        mine = {row: view[row - model.first_row].real.copy()
                for row in rows if 0 <= row - model.first_row < model.local_rows}  # fmt: skip
        largest = float(np.abs(view).max(initial=0.0))
    motion_of = {}
    for refused in model.comm.allgather(mine):
        motion_of |= refused
    largest = max(model.comm.allgather(largest))
    return np.linalg.svd(np.array([motion_of[row] for row in rows]) / largest)[1].min() > 1e-6


def _rows_of_chord(model, frame):
    """Return global rows to hold, and the dofs of nodes to be rotated before."""
    # the axes of the frame, from three points that are not on a line
    nodes = [node_number(model, node) for node in frame.nodes]
    points = np.array([position_of_node(model, node) for node in nodes])
    along, across = points[1] - points[0], points[2] - points[0]
    normal = np.cross(along, across)
    sizes = np.linalg.norm(along) * np.linalg.norm(across)
    if np.linalg.norm(normal) <= COLLINEAR * sizes:
        listed = ", ".join(
            f"node {node} at ({x:g}, {y:g}, {z:g})" for node, (x, y, z) in zip(frame.nodes, points, strict=True)
        )
        raise InputError(f"frame.nodes: the three points of the chord frame are collinear: {listed}")
    if frame.axes is None:
        e1, e3 = along / np.linalg.norm(along), normal / np.linalg.norm(normal)
        axes = np.array([e1, np.cross(e3, e1), e3])
    else:
        axes = np.eye(3)[["xyz".index(name) for name in frame.axes]]
    # P1 is held; rotations left by u2(P2), u3(P2), u3(P3) = 0 must vanish
    left = [np.cross(arm, axes[i]) for arm, i in ((along, 1), (along, 2), (across, 2))]
    if np.linalg.svd(np.array(left) / np.linalg.norm(along))[1].min() < COLLINEAR:
        raise InputError(
            f"frame.axes: with axes '{frame.axes}' the supports at nodes {list(frame.nodes)} leave a rotation "
            "free; choose axis 1 along the line from the first to the second node, axis 3 normal to the plane"
        )
    # (14, 15): rows that are held, and nodes whose rows are turned into the axes for that
    held, rotated = [], []
    for node, indices in zip(nodes, ([0, 1, 2], [1, 2], [2]), strict=True):
        rows = rows_of_node(model, node)
        if not all(d in rows for d in range(3)):
            raise InputError(f"frame.nodes: node {node} needs dofs in x, y and z for the chord frame")
        directions = axes[indices]
        aligned = np.flatnonzero((np.abs(directions) > 1 - 1e-12).any(axis=0))
        if len(aligned) == len(indices) or len(indices) == 3:
            held += [rows[d] for d in (range(3) if len(indices) == 3 else aligned)]
        else:
            rotated.append(([rows[d] for d in range(3)], axes))
            held += [rows[i] for i in indices]  # then dof i of the node is along axis i
    return held, rotated


def _remove(model, held, rotated):
    """Return the model without the global rows `held`, after rotating the dofs (rows, axes) of some nodes, and T."""
    comm, first, last = model.comm, model.first_row, model.first_row + model.local_rows
    free = np.setdiff1d(np.arange(first, last), held).astype(PETSc.IntType)
    total = comm.allreduce(len(free))
    rotation = _rotation(model, rotated) if rotated else None
    keep = PETSc.IS().createGeneral(free, comm=model.K.comm)
    operator = model.operator.map(
        lambda mat: (mat if rotation is None else mat.ptap(rotation)).createSubMatrix(keep, keep)
    )
    columns = (comm.exscan(len(free)) or 0) + np.arange(len(free))
    selection = sparse_rows(model.K, [(free - first, columns, np.ones(len(free)))], (len(free), total))
    restore = selection if rotation is None else rotation.matMult(selection)
    dofs = None if model.dofs is None else model.dofs.take(free - first)
    return model.in_coordinates(operator, restore, dofs), restore


def _rotation(model, rotated):
    """Return Q (n, n): the identity but for 3 x 3 blocks whose columns are the axes of the nodes to rotate."""
    first, last = model.first_row, model.first_row + model.local_rows
    blocks = [(np.repeat(rows, 3), np.tile(rows, 3), axes.T.ravel()) for rows, axes in rotated]
    i, j, v = (np.concatenate(arrays) for arrays in zip(*blocks, strict=True))
    straight = np.setdiff1d(np.arange(first, last), i)
    mine = (i >= first) & (i < last)
    entries = (straight, i[mine]), (straight, j[mine]), (np.ones(len(straight)), v[mine])
    return assembled(model.K, *map(np.concatenate, entries))


Frame = Annotated[NoFrame | Tangent | Chord | Buckens, Field(discriminator="kind")]
