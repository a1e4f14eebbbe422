"""Make inputs of motions: what holds a body moves with a given acceleration, as on a shaker.

With u = R b + y, where R b is the static deflection of the body under the motion b of its base (a rigid-body motion
where all that holds it moves) and y is zero at the base,

    M y'' + D y' + K y = -M R b'',

so that the input is the acceleration b'', its column is -M R, and displacements, velocities and accelerations y are
relative to R b. Absolute accelerations are y'' + R b'', with C R as the direct part of their outputs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ...fe.dofs import ABSOLUTE, OWN, SCALAR, Dofs, direction_index, require_dofs
from ...linalg.blocks import create_block, dense_matrix, from_dense, inner, local_rows, real_rows, times
from ...linalg.csr import diagonal_of
from ...linalg.solvers.base import SingularMatrix
from ...linalg.solvers.shifted import ShiftedSolver
from ...parallel.declared import declared
from ...parallel.failures import InputError, Owned
from ...parallel.petsc import PETSc
from ...parallel.ranges import Coordinate, Node
from ...parallel.sums import anywhere, joined
from ..construction import measured_columns
from ..interfaces.motion import with_interfaces
from ..interfaces.nodes import SIX, find_interface
from ..outputs.cuts import cut_output_of
from ..outputs.rates import Rates
from ..outputs.stresses import stress_output_of
from ..outputs.targets import unit_columns
from ..rigid_body.motions import rigid_motions
from .columns import ROUND_OFF, inside, sums_of_column
from .kinds import BASE, SUPPORT, NamedLoad, Place

STRAINS = 1e-3  # of the motion of a base: more beside a rigid-body motion is a deflection, not digits of K
RESISTS = 1e-6  # ||D R|| over ||D|| ||R||, above which D resists the motion of the base


def _six(key, value):
    for name in value:
        if direction_index(name, key) >= len(SIX):
            raise InputError(f"{key}: found '{name}', expected some of {', '.join(SIX)}")
    if not value or len(set(value)) < len(value):
        raise InputError(f"{key}: found {list(value)}, expected some of {', '.join(SIX)}, each once")


@dataclass(frozen=True, kw_only=True)
class Base(NamedLoad):
    """What holds the body moves as a rigid one: base excitation.

    Parameters
    ----------
    name : str, default "base"
        The inputs are NAME:x and so on: accelerations in m/s^2, about axes in rad/s^2.
    on : str, Nodes or sequence of int, optional
        The nodes that move: of a node set or interface of this name, by place, or by number. They are held then, and
        have no row any more. By default all that the finite-element program holds.
    directions : sequence of str, default ("x", "y", "z")
        In which it moves, of x, y, z, rx, ry, rz; in the others it stands still.
    at : tuple of three floats, optional
        The point in m whose motion this is, for rotations; by default the mean of the nodes that move.
    absolute : sequence of str or (int or str, str), default ()
        Places as those of inputs, whose absolute accelerations become outputs, behind the others.

    Raises
    ------
    InputError
        For directions that do not exist, and names that are no words.
    """

    name: str = "base"
    on: Place | None = None
    directions: Annotated[tuple[str, ...], _six] = SIX[:3]
    at: tuple[Coordinate, Coordinate, Coordinate] | None = None
    absolute: tuple[str | tuple[Node, str], ...] = ()

    @property
    def where(self) -> str:
        return f"base '{self.name}': "

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(f"{self.name}:{name}" for name in self.directions)

    @property
    def axes(self) -> list[int]:
        return [SIX.index(name) for name in self.directions]


def with_bases(model, bases, factoring=None):
    """Return the model with the motions of bases as further inputs: see SecondOrderModel.with_bases. Collective."""
    bases = declared("base", bases, tuple[Base, ...])
    if not bases:
        return model.shared()
    require_dofs(model, "a base that moves")
    _check_names(model, bases)
    # rows that move with each base, and the motions R of all rows when it does
    moved = [_rows_of(model, base) for base in bases]
    _check_rows(model, bases, moved)
    gone = np.any(moved, axis=0)
    shapes = [_rigid(model, base, mask, gone) for base, mask in zip(bases, moved, strict=True)]
    model_f, free = _without_rows(model, gone, bases)
    with model_f:
        _deflect(model, model_f, bases, shapes, gone, free, factoring)
        R = np.hstack([shape.motion for shape in shapes])
        loads, columns = _columns(model, bases, shapes)
        return _assembled(model, model_f, bases, R, columns, loads, free)


@dataclass
class _Shape:
    """Motions R (rows of this rank, k) of a base in k directions, those of a rigid body (rows, k), and whether it is
    more than that: a deflection."""

    motion: np.ndarray
    rigid: np.ndarray
    strains: bool = False


def _check_names(model, bases):
    gone = [base.on for base in bases if isinstance(base.on, str)]  # with the interfaces there go their inputs
    names = [name for name in model.input_names if name.rpartition(":")[0] not in gone]
    names += [name for base in bases for name in base.input_names]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"base: found two inputs '{twice}', expected each once; give the base another name")
    for base in bases:
        if find_interface(model, base.name) is not None and base.on != base.name:
            raise InputError(
                f"{base.where}name: an interface is called so, whose forces have these names; give the base another "
                "name, or name the interface by `on`"
            )
    if sum(base.on is None for base in bases) > 1:
        raise InputError("base: found two bases without `on`, expected one: all that the program holds moves with it")


def _rows_of(model, base) -> np.ndarray:
    """Return which rows of this rank move with a base, none of one that is held already. Collective."""
    comm, held = model.comm, model.held
    count = comm.allreduce(0 if held is None else len(held.node))
    if base.on is None:
        if not count:
            raise InputError(
                f"{base.where}{model.name} has no held nodes that could move, as far as is known; name the nodes of "
                "the base by `on`, or export the body with its supports"
            )
        return np.zeros(model.local_rows, bool)
    chosen = inside(model, base.on, model.dofs.node, base.where.removesuffix(": "))
    mask = chosen & (model.dofs.direction != SCALAR)
    if not comm.allreduce(int(mask.sum())):
        raise InputError(f"{base.where}on: none of these nodes has a row in {model.name}; leave `on` out where the "
                         "program that wrote the matrices holds them")  # fmt: skip
    if count:
        numbers = np.unique(np.concatenate(comm.allgather(model.dofs.node[mask])))
        if stuck := joined(comm, np.intersect1d(held.node, numbers)[:1].tolist()):
            raise InputError(f"{base.where}on: node {stuck[0]} is held in some direction by the program that wrote the "
                             "matrices; leave `on` out, or export the body without that support")  # fmt: skip
    return mask


def _check_rows(model, bases, moved):
    """Refuse rows of two bases, bodies of which nothing is left, and directions in space that are not known."""
    twice = model.comm.allreduce(int((np.sum(moved, axis=0) > 1).sum()))
    if twice:
        raise InputError(f"base: found {twice} dofs of {model.name} that belong to two bases, expected each in one")
    if not model.comm.allreduce(int((~np.any(moved, axis=0)).sum())):
        raise InputError(f"{bases[0].where}on: all nodes of {model.name} belong to it; nothing is left to vibrate")
    if anywhere(model.comm, model.dofs.direction >= OWN):
        raise InputError(f"{bases[0].where}{model.name} has dofs in directions of their own, whose motion is not known")


def _rigid(model, base, mask, gone) -> _Shape:
    """Return the motions of a base as those of a rigid body, without other bases. Collective."""
    at = base.at
    if at is None:
        place = find_interface(model, base.on) if isinstance(base.on, str) else None
        position = model.held.position if base.on is None else model.dofs.position[mask]
        total, count = model.comm.allreduce(position.sum(axis=0)), model.comm.allreduce(len(position))
        at = total / count if place is None else model.interfaces[place].position
    rigid = real_rows(rigid_motions(model, at))[:, base.axes].copy()
    return _Shape(np.where((gone & ~mask)[:, None], 0.0, rigid), rigid)


def _without_rows(model, gone, bases):
    """Return the model without rows of bases, which are held, and without the interfaces and inputs there; and its rows
    among those of this rank. Collective."""
    comm = model.comm
    free = np.flatnonzero(~gone)
    if not comm.allreduce(int(gone.sum())):
        return model.shared(), free
    keep = PETSc.IS().createGeneral((free + model.first_row).astype(PETSc.IntType), comm=model.K.comm)
    operator = model.operator.map(lambda mat: mat.createSubMatrix(keep, keep))
    columns = {key: dense_matrix(operator["K"], mat.getDenseArray().real[free])
               for key in ("B", "Ct") if (mat := getattr(model, key)) is not None}  # fmt: skip
    away = model.dofs.take(np.flatnonzero(gone))
    if model.held is not None:
        labels = [(getattr(model.held, key), getattr(away, key)) for key in ("node", "direction", "position")]
        away = Dofs(*map(np.concatenate, labels))
    bare = model.with_fields(
        operator=operator, **{"B": None, "Ct": None} | columns, dofs=model.dofs.take(free), held=away, Gt=None,
        interfaces=(),
    )  # fmt: skip
    replaced = [base.on for base in bases]
    if others := [interface.definition for interface in model.interfaces if interface.name not in replaced]:
        with bare:
            bare = with_interfaces(bare, others)
    return bare, free


def _deflect(model, framed, bases, shapes, gone, free, factoring):
    """Add to the motions of bases the static deflections of the body between them and what else holds it: K R = 0 where
    it is free. Collective. Raises InputError where the bases do not hold it."""
    if not model.comm.allreduce(int(gone.sum())):
        return  # all that is held moves as a rigid body
    residual = np.hstack([
        # of a base that the program holds, K R of the whole is what its rows that are not here take
        shape.motion - (shape.rigid if base.on is None else 0.0) for base, shape in zip(bases, shapes, strict=True)
    ])  # fmt: skip
    forces = real_rows(times(model.K, from_dense(residual, model.K)))[free]
    with Owned(model.comm) as owned:
        solver = owned.owns(ShiftedSolver(framed, None, "base_", factoring=factoring))
        solution = create_block(framed.K, forces.shape[1])
        try:
            solver.factor(0.0)
        except SingularMatrix as error:
            raise InputError(
                f"{bases[0].where}on: the body moves freely while these nodes are held; name nodes that hold it, "
                "three that are not on a line, or one with rotations"
            ) from error
        solver.solve(from_dense(forces, framed.K), solution)
        deflection = -real_rows(solution)
    # R <- R - K^-1 K R on the free rows
    first = 0
    for shape in shapes:
        motion = deflection[:, first : first + shape.motion.shape[1]]
        first += motion.shape[1]
        shape.motion[free] += motion
        sizes = model.comm.allgather((np.abs(motion).max(initial=0.0), np.abs(shape.motion).max(initial=0.0)))
        whole, size = (max(values) for values in zip(*sizes, strict=True))
        beside = np.abs(shape.motion - shape.rigid).max(initial=0.0)
        shape.strains = max(model.comm.allgather(float(beside))) > STRAINS * max(whole, size)


def _columns(model, bases, shapes):
    """Return the LoadColumns, and the columns -M R (rows of this rank, k), of all rows. Collective."""
    loads, columns = [], []
    for base, shape in zip(bases, shapes, strict=True):
        R = from_dense(shape.motion, model.K)
        column = -real_rows(times(model.M, R))
        remarks = []
        beside = np.abs(column + diagonal_of(model.M)[:, None] * shape.motion).max(initial=0.0)
        sizes = model.comm.allgather((beside, np.abs(column).max(initial=0.0)))
        beside, size = (max(values) for values in zip(*sizes, strict=True))
        if base.on is None and beside > ROUND_OFF * size:
            remarks.append("the mass of held dofs is not in M, nor is its part in the forces beside them; export the "
                           "body without supports, and name them by `on`, where these have to be exact")  # fmt: skip
        if shape.strains:
            remarks.append("the body is held elsewhere too: motions are relative to its static deflection while this "
                           "base moves, whose stresses are not among those of the reduced body")  # fmt: skip
        if model.D is not None and _resists(model, R):
            remarks.append("the damping matrix resists the motion of the base itself; here it acts on the motion "
                           "relative to the base alone")  # fmt: skip
        for k, name in enumerate(base.input_names):
            sums = sums_of_column(model, column[:, k], name, SUPPORT if shape.strains else BASE)
            loads.append(replace(sums, remark="; ".join(remarks)))
        columns.append(column)
    return tuple(loads), np.hstack(columns)


def _resists(model, R) -> bool:
    """Test whether D acts on the motions R. Collective."""
    with local_rows(times(model.D, R)) as rows, local_rows(R) as motion:
        sizes = model.comm.allreduce(np.array([(rows.real**2).sum(), (motion.real**2).sum()]))
    return bool(np.sqrt(sizes[0]) > RESISTS * model.D.norm() * np.sqrt(sizes[1]))


def _assembled(model, framed, bases, R, columns, loads, free):
    """Return the model without the rows of bases, with their inputs and the outputs. Collective."""
    comm, where = model.comm, f"{model.name}: outputs"
    # inputs that act on bases alone push nothing
    before = np.zeros((len(free), 0)) if framed.B is None else framed.B.getDenseArray().real
    acts = np.any(comm.allgather(before.any(axis=0)), axis=0)
    names = [name for name, there in zip(model.input_names, acts, strict=True) if there]
    B = np.hstack([before[:, acts], columns[free]])
    kept = tuple(load for load in model.loads if load.name in names)
    # outputs: those of before, by default where the other inputs act, and absolute accelerations
    before_of, called = {"C": before[:, acts].T}, names
    if model.has_own_outputs:
        Ct = np.zeros((0, len(free))) if framed.Ct is None else framed.Ct.getDenseArray().real.T
        before_of, called = model.rates.of(Ct), list(model.own_output_names)
    targets = tuple(target for base in bases for target in base.absolute)
    absolute, places = unit_columns(model, "base.absolute", targets) if targets else (np.zeros((len(R), 0)), [])
    if not called and not places:
        raise InputError(f"{bases[0].where}{model.name} has no outputs; name places by `outputs`, for motions relative "
                         "to the base, or by `absolute` of the base, for absolute accelerations")  # fmt: skip
    strained = next((name for name in called if stress_output_of(name) or cut_output_of(name)), None)
    if strained and any(load.deflects for load in loads):
        raise InputError(f"{bases[0].where}the output '{strained}' would lack the stress of the static deflection, "
                         "since the body is held elsewhere too; leave it out, or let all supports move")  # fmt: skip
    rows_of = {key: np.vstack([before_of[key], np.zeros((len(places), len(free)))]) for key in before_of}
    if places:
        rows_of.setdefault("Ca", np.zeros((len(called) + len(places), len(free))))[len(called) :] = absolute[free].T
        called = list(called) + [f"{ABSOLUTE}acceleration {name}" for name in places]
    if lost := [name for name, there in zip(model.input_names, acts, strict=True) if not there]:
        remark = f"left out the inputs {', '.join(lost)}, which act on nodes that move as they are told"
        loads = (replace(loads[0], remark="; ".join(filter(None, [loads[0].remark, remark]))), *loads[1:])
    with framed.with_input_columns(B, names + [load.name for load in loads]) as moved:
        columns = (np.ascontiguousarray(rows_of[key].T) if key in rows_of else None for key in ("C", "Cv", "Ca"))
        Ct, rates = measured_columns(moved.K, *columns, called, where)
        if places:
            direct = np.zeros((len(called), B.shape[1]))
            direct[-len(places) :, len(names) :] = inner(from_dense(absolute, model.K), from_dense(R, model.K))
            rates = Rates(rates.parts, comm.bcast(direct))
        elif not {"Cv", "Ca"} & rows_of.keys():
            rates = Rates()
        return moved.with_fields(Ct=Ct, rates=rates, own_output_names=tuple(called), loads=(*kept, *loads))
