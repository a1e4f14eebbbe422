"""Make columns of B of loads, with the sums of their forces and moments, and add them to the inputs of a model."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from ...fe.dofs import DIRECTIONS, OWN, SCALAR, require_dofs, target_of
from ...fe.faces import Faces, placed_nodes, places_of, surface_faces
from ...linalg.blocks import from_dense, inner
from ...linalg.csr import diagonal_of
from ...parallel.declared import declared, nearest
from ...parallel.exchange import exchange
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up
from ...parallel.plugins import found_at
from ...parallel.sums import anywhere
from ..checked_arrays import named_columns
from ..interfaces.motion import extent_in_words, numbers_of_set, on_surface
from ..interfaces.nodes import Nodes, find_interface
from ..rigid_body.modes import rigid_motions
from .kinds import AnyLoad, LoadColumn, input_names
from .on_faces import NodalForces, edges_of, forces_on_edges, forces_on_faces
from .thermal import thermal_forces

ROUND_OFF = 1e-13  # of the largest force, or of a sum of sizes: what is left in directions without a load
BESIDE = 1e-6  # of the length of a path: nodes at one place along it
TO_AND_FRO = 2.0  # length of a path by its length along a direction; a half circle has 1.6
STRIDE = 8  # of keys of node and direction
OF_FILES = "readers.load_files:read_load"  # makes the columns of loads in files
OF_TEMPERATURE = (
    "recovered stresses are those of the displacements, E B u; the stress is less by E alpha T / (1 - 2 nu) in "
    "its normal components"
)


def with_loads(model, loads, given):
    """Return the model with loads as further inputs, see SecondOrderModel.with_loads. Collective."""
    loads, given = declared("loads", loads, tuple[AnyLoad, ...]), dict(given or {})
    # names are those of inputs, each once
    names = list(model.input_names) + [name for load in loads for name in input_names(load)] + list(given)
    twice = min((name for name, count in Counter(names).items() if count > 1), default=None)
    if twice is not None:
        raise InputError(f"load '{twice}': found two inputs of this name, expected each once; give it another name")
    if not loads and not given:
        return model.shared()
    # a column of each, with the sums of its forces and moments
    columns = []
    for load in loads:
        columns += _moving(model, load) if load.kind == "moving" else [_column(model, load)]
    for name, column in given.items():
        local, _ = named_columns(model.comm, model.local_rows, np.reshape(column, (-1, 1)), [name], f"load '{name}'")
        columns.append((local[:, 0], sums_of_column(model, local[:, 0], name, "given")))
    for (local, _), name in zip(columns, names[len(model.input_names) :], strict=True):
        if not anywhere(model.comm, local):
            raise InputError(
                f"load '{name}': every force of it acts on held dofs or is zero, so that it deforms nothing; leave it "
                "out, or export the body without these supports"
            )
    # beside the columns that the model has
    before = np.zeros((model.local_rows, 0)) if model.B is None else model.B.getDenseArray().real
    B = np.column_stack([before, *(local for local, _ in columns)])
    with model.with_input_columns(B, names) as loaded:
        return loaded.with_fields(loads=(*model.loads, *(sums for _, sums in columns)))


def _column(model, load):
    """Return the rows (rows,) of this rank of the column of a load, and its LoadColumn. Collective."""
    where = f"load '{load.name}'"
    if load.kind in ("given", "deck") or (load.kind == "temperature" and load.file):
        return found_at(OF_FILES)(model, load)
    require_dofs(model, where)
    if load.kind == "gravity":
        return inertia_force(model, load.name, lambda points: np.broadcast_to(load.value, points.shape), load.kind)
    if load.kind == "centrifugal":
        field = centrifugal_field(model, load.name, [(load.value**2, load.point, load.axis)])
        column, sums = inertia_force(model, load.name, field, load.kind)
        return column, replace(sums, spins=True)
    if load.kind == "temperature":
        forces = thermal_forces(model, where, lambda nodes: np.full(len(nodes), load.value))
    elif load.kind == "line":
        forces = forces_on_edges(model, _edges(model, load.on, where), where, load.value)
    else:
        faces = faces_on(model, load.on, where)
        key, value = ("pressure", load.value) if load.kind == "pressure" else ("traction", np.array(load.value))
        count = len(faces.behind)
        spread = np.broadcast_to(value, (count, *np.shape(value)))
        forces = forces_on_faces(model, faces, where, **{key: spread})
    return column_of(model, forces, load.name, load.kind)


def _moving(model, load):
    """Return columns and LoadColumns of the points of a moving load. Collective. Raises InputError."""
    where = f"load '{load.name}'"
    require_dofs(model, where)
    nodes, points = _path(model, load, where)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if load.points > len(nodes) or length[-1] == 0:
        raise InputError(
            f"{where}: points: found {load.points} points on a path of {len(nodes)} nodes and {length[-1]:g} m, "
            "expected at most as many points as nodes"
        )
    columns = []
    for name, at in zip(load.input_names, np.linspace(0.0, length[-1], load.points), strict=True):
        k = min(int(np.searchsorted(length, at, side="right")) - 1, len(nodes) - 2)
        share = (at - length[k]) / (length[k + 1] - length[k])
        value = np.zeros((2, 6))
        value[:, :3] = np.outer([1 - share, share], load.value)
        mine = slice(None) if model.comm.rank == 0 else slice(0)  # a force is there once
        forces = NodalForces(nodes[k : k + 2][mine], value[mine], points[k : k + 2][mine])
        columns.append(column_of(model, forces, name, load.kind))
    return columns


def _path(model, load, where):
    """Return the nodes (k,) of a path in their order and their points (k, 3), the same on all ranks. Collective."""
    if isinstance(load.on, tuple):
        nodes = np.array(load.on)
    else:
        # a force at a held node deforms nothing
        mine = np.unique(model.dofs.node[model.dofs.direction != SCALAR].astype(np.int64))
        nodes = np.unique(np.concatenate(model.comm.allgather(mine[inside(model, load.on, mine, where)])))
    there, points = places_of(model, nodes)
    if not there.all():
        raise InputError(f"{where}: on: node {nodes[~there][0]} has no row in {model.name}, or does not exist")
    if len(nodes) < 2:
        raise InputError(f"{where}: on: found {len(nodes)} nodes, expected at least two along a path")
    order = np.arange(len(nodes))
    if load.along is not None:
        place = points @ (np.array(load.along) / np.linalg.norm(load.along))
        order = np.argsort(place, kind="stable")
        _require_line(nodes[order], points[order], place[order], where)
    nodes, points = nodes[order], points[order]
    if not np.linalg.norm(np.diff(points, axis=0), axis=1).all():
        raise InputError(f"{where}: on: found two nodes of the path at one place, expected a line of nodes")
    return nodes, points


def _require_line(nodes, points, place, where):
    """Raise InputError for nodes (k,) with points (k, 3), in the order of their places (k,) along a direction, that lie
    side by side, as those of a face do."""
    reach = place[-1] - place[0]
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    closest = int(np.argmin(np.diff(place)))
    if place[closest + 1] - place[closest] <= BESIDE * reach or length > TO_AND_FRO * reach:
        raise InputError(
            f"{where}: along: found nodes side by side, as {nodes[closest]} and {nodes[closest + 1]} (their path is "
            f"{length:g} m long, and {reach:g} m in this direction), expected nodes of one line, as of an edge; take "
            "these, or numbers in their order"
        )


def inertia_force(model, name, acceleration, kind):
    """Return the rows of this rank of M a, and its LoadColumn, for a function that gives the accelerations a (k, 3) in
    m/s^2 at points (k, 3); nodes do not turn. Collective. Raises InputError."""
    if anywhere(model.comm, model.dofs.direction >= OWN):
        raise InputError(f"load '{name}': {model.name} has dofs in directions of their own, whose weight is not known")
    column, held, coupled = mass_times(model, acceleration)
    remark = ""
    if held and coupled:
        remark = (
            f"the mass of {held} held dofs is not in M, nor is its part in the forces beside them; export the body "
            "without supports where these have to be exact"
        )
    elif held:
        remark = f"the mass of {held} held dofs is not in M, and missing in its sums; it deforms nothing"
    return column, replace(sums_of_column(model, column, name, kind), remark=remark)


def mass_times(model, acceleration) -> tuple[np.ndarray, int, bool]:
    """Return the rows of this rank of M a, how many held dofs have an acceleration, and whether M couples dofs, so that
    their mass is missing beside them; for a function that gives a (k, 3) at points (k, 3). Collective."""
    values = _components(model.dofs, acceleration)
    field, product = model.M.createVecRight(), model.M.createVecLeft()
    field.setArray(values)
    model.M.mult(field, product)
    column = product.getArray(readonly=True).real.copy()
    held = 0 if model.held is None else np.count_nonzero(_components(model.held, acceleration))
    beside = np.abs(column - diagonal_of(model.M) * values).max(initial=0.0)
    held, beside, size = zip(*model.comm.allgather((held, beside, np.abs(column).max(initial=0.0))), strict=True)
    return column, sum(held), bool(max(beside) > ROUND_OFF * max(size))


def _components(dofs, acceleration):
    """Return the accelerations (rows,) of dofs in their directions, zero of those that turn."""
    moved = np.flatnonzero(dofs.direction < 3)
    values = np.zeros(len(dofs.direction))
    values[moved] = acceleration(dofs.position)[moved, dofs.direction[moved]]
    return values


def centrifugal_field(model, name, spins):
    """Return a function of points (k, 3) that gives the accelerations (k, 3) of the centrifugal forces of `spins`:
    squares of angular velocities in (rad/s)^2, a point (3,) in m and a direction (3,) of each axis. Collective. Raises
    InputError for nodes that turn, whose angular accelerations depend on the elements."""
    turns = (model.dofs.direction > 2) & (model.dofs.direction < SCALAR)
    if anywhere(model.comm, turns):
        raise InputError(
            f"load '{name}': found a centrifugal load and nodes that turn, expected solids, of which the mass matrix "
            "gives it exactly"
        )

    def field(points):
        total = np.zeros(points.shape)
        for square, point, direction in spins:
            axis, arm = np.divide(direction, np.linalg.norm(direction)), points - point
            total += square * (arm - np.outer(arm @ axis, axis))
        return total

    return field


def added(name, kind, sums_of):
    """Return the sum of several columns and LoadColumns of one load."""
    columns, sums = zip(*sums_of, strict=True)
    total = {key: tuple(np.sum([getattr(column, key) for column in sums], axis=0).tolist())
             for key in ("force", "moment", "held_force", "held_moment")}  # fmt: skip
    remarks = dict.fromkeys(column.remark for column in sums if column.remark)
    area = sum(column.area for column in sums)
    spins = any(column.spins for column in sums)
    return sum(columns), LoadColumn(name=name, kind=kind, area=area, remark="; ".join(remarks), spins=spins, **total)


def sums_of_column(model, column, name, kind) -> LoadColumn:
    """Return the sums of a column (rows,), without a part on held dofs; zero without nodes. Collective."""
    force = np.zeros(6)
    if model.dofs is not None:
        mine = model.dofs.direction < SCALAR
        value = np.zeros((int(mine.sum()), 6))
        value[np.arange(len(value)), model.dofs.direction[mine]] = column[mine]
        force = _sums(model.comm, model.dofs.position[mine], value)
    return LoadColumn(name=name, kind=kind, force=tuple(force[:3].tolist()), moment=tuple(force[3:].tolist()))


def loads_of(model) -> tuple[LoadColumn, ...]:
    """Return all inputs of a model with nodes that are not directions of nodes, with their sums. Collective."""
    if model.B is None or model.dofs is None:
        return model.loads
    known = {load.name: load for load in model.loads}
    columns = model.B.getDenseArray().real
    return tuple(
        known.get(name) or sums_of_column(model, columns[:, j], name, "given")
        for j, name in enumerate(model.input_names) if name in known or target_of(name) is None
    )  # fmt: skip


def resultants(model) -> np.ndarray | None:
    """Return force and moment (p, 6) about the origin of all inputs at 1, in N and N m, with the parts of loads that
    act on held dofs; None without inputs or nodes. Collective."""
    if model.B is None or model.dofs is None:
        return None
    sums = inner(rigid_motions(model), from_dense(model.B)).T
    for load in model.loads:
        sums[model.input_names.index(load.name)] += [*load.held_force, *load.held_moment]
    return model.comm.bcast(sums)


def _sums(comm, position, value):
    """Return force and moment about the origin (6,) of forces and moments (k, 6) at positions (k, 3), zero for
    round-off. Collective."""
    arms = np.hstack([value[:, :3], value[:, 3:] + np.cross(position, value[:, :3])])
    total, size = np.sum(comm.allgather([arms.sum(axis=0), np.abs(arms).sum(axis=0)]), axis=0)
    largest = np.repeat(size.reshape(2, 3).max(axis=1), 3)
    return np.where(np.abs(total) > ROUND_OFF * largest, total, 0.0)


def column_of(model, forces: NodalForces, name, kind):
    """Return the rows (rows,) of this rank of a column of nodal forces, and its LoadColumn. Collective.

    Forces on held dofs have no row, and count in the sums. Raises InputError for dofs that do not exist.
    """
    comm, dofs, where = model.comm, model.dofs, f"load '{name}'"
    size = max(comm.allgather(float(np.abs(forces.value).max(initial=0.0))))
    # each dof once, and the row that it has
    place, direction = np.nonzero(np.abs(forces.value) > ROUND_OFF * size)
    keys, back = np.unique(forces.node[place] * STRIDE + direction, return_inverse=True)
    value = forces.value[place, direction]
    physical = np.flatnonzero(dofs.direction < SCALAR)
    there, (row,) = look_up(comm, _keys(dofs.take(physical)), [model.first_row + physical], keys)
    held = np.zeros(len(keys), bool)
    if model.held is not None:
        held, _ = look_up(comm, _keys(model.held), [], keys)
    with agreed(comm):
        # forces on held dofs go to the support; other dofs without rows would be lost silently
        lost = keys[~there & ~held]
        if lost.size:
            node, axis = divmod(int(lost[0]), STRIDE)
            raise InputError(
                f"{where}: node {node} has no dof in {DIRECTIONS[axis]} in {model.name}; it follows another node, is "
                "condensed, or does not exist: let the load act elsewhere, or export the body with this dof"
            )
    sums = np.zeros(len(keys))
    np.add.at(sums, back, value)
    # added up on the rank that has the row
    owner = np.searchsorted(model.row_starts, row[there], side="right") - 1
    rows, values = exchange(comm, owner, [row[there], sums[there]])
    column = np.zeros(model.local_rows)
    np.add.at(column, rows - model.first_row, values)
    # sums of the load and of its held part about the origin
    still = np.zeros_like(forces.value)
    still[place, direction] = np.where((held & ~there)[back], value, 0.0)
    total, lost = (_sums(comm, forces.position, forces_of) for forces_of in (forces.value, still))
    sums_by_key = {"force": total[:3], "moment": total[3:], "held_force": lost[:3], "held_moment": lost[3:]}
    return column, LoadColumn(
        name=name, kind=kind, area=forces.area, remark=OF_TEMPERATURE if kind == "temperature" else "",
        **{key: tuple(total_of.tolist()) for key, total_of in sums_by_key.items()},
    )  # fmt: skip


def _keys(dofs):
    return dofs.node.astype(np.int64) * STRIDE + dofs.direction


def inside(model, on, nodes, where):
    """Test which nodes (k,) are those that a load is `on`. Collective. Raises InputError."""
    # a name is that of a node set or of the set of an interface
    if isinstance(on, str):
        place = find_interface(model, on)
        if on in model.set_sizes or place is None or model.interfaces[place].definition is None:
            known = {*model.set_sizes, *(interface.name for interface in model.interfaces)}
            if on not in model.set_sizes:
                raise InputError(
                    f"{where}: on: {model.name} has no node set or interface '{on}'{nearest(on, known)}; it has "
                    f"{', '.join(sorted(known)) or 'none'}"
                )
            on = Nodes(set=on)
        else:
            on = model.interfaces[place].definition.nodes
    # by number, by set, on a cylindrical surface, or in a box, sphere or cylinder
    if isinstance(on, tuple):
        there, _ = places_of(model, np.array(on, np.int64))
        lost = np.array(on)[~there]  # nodes of elements without a row have a message of their own
        known = [np.isin(lost, elements.ravel()) for elements in model.elements.values()]
        known = np.any(model.comm.allgather(np.any([np.zeros(len(lost), bool), *known], axis=0)), axis=0)
        if not known.all():
            raise InputError(f"{where}: on: node {lost[~known][0]} does not exist in {model.name}")
        return np.isin(nodes, on)
    if on.set is not None:
        return look_up(model.comm, numbers_of_set(model, on.set, f"{where}: on"), [], nodes)[0]
    if on.surface is not None:
        return np.isin(nodes, on_surface(model, on, f"{where}: on"))
    if not model.comm.allreduce(int(on.contain(placed_nodes(model)[1]).sum())):
        raise InputError(
            f"{where}: on: none lies there; the nodes of {model.name} lie between {extent_in_words(model)}"
        )
    there, points = places_of(model, nodes)
    return there & on.contain(points)


def _chosen(model, on, table, where):
    """Test of which rows of a table (f, k) of nodes, -1 for none, all nodes are those that a load is `on`."""
    nodes = np.unique(table[table >= 0])
    there = nodes[inside(model, on, nodes, where)]
    return ((table < 0) | np.isin(table, there)).all(axis=1) & (table >= 0).any(axis=1)


def faces_on(model, on, where) -> Faces:
    """Return this rank's part of the faces of the surface that a load acts on. Collective. Raises InputError."""
    faces = _surface(model, where)
    chosen = faces.take(_chosen(model, on, np.hstack([faces.corners, faces.middles]), where))
    if not model.comm.allreduce(len(chosen.behind)):
        raise InputError(
            f"{where}: on: no face of the surface of {model.name} has all its nodes there, those in the middle of its "
            "edges too; `hpcred info model.h5 --figure sets.png` draws the node sets"
        )
    return chosen


def _surface(model, where):
    if not anywhere(model.comm, [len(elements) for elements in model.elements.values()]):
        raise InputError(
            f"{where}: {model.name} has no elements, and so no faces and edges; convert it with the input file of the "
            "finite-element program, or give the load vector (kind = 'given')"
        )
    return surface_faces(model.comm, model.elements)


def _edges(model, on, where):
    """Return this rank's part of the edges that a line load acts on. Collective. Raises InputError."""
    faces = _surface(model, where)
    edges = edges_of(model.comm, faces, model.elements)
    chosen = edges[_chosen(model, on, edges, where)]
    if not model.comm.allreduce(len(chosen)):
        raise InputError(f"{where}: on: no edge of an element on the surface of {model.name} has all its nodes there")
    whole = _chosen(model, on, np.hstack([faces.corners, faces.middles]), where)
    if count := model.comm.allreduce(int(whole.sum())):
        raise InputError(
            f"{where}: on: found {count} whole faces among these nodes, expected nodes along a line; take kind = "
            "'traction' for faces"
        )
    return chosen
